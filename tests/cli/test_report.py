"""What a run says at its end of lanes that have failed, and what `inspect` says of the same file."""

from __future__ import annotations

import h5py
import numpy as np

from jaxnh.cli.inspection import failed_in, show
from tests.helpers.hand_made_results import dataset, tree, write


def test_lanes_that_have_failed_are_named_with_their_reason(tmp_path, capsys):
    """Where each is, and its reason; a warning of the same group has the name of the group once."""
    x = np.zeros((4, 3))
    x[[1, 3]] = np.nan
    flags = {"flag_values": np.arange(2, dtype=np.int8), "flag_meanings": "none off_constraint"}
    variables = {
        "x": (("mu", "strobe"), x, "coordinate x", "m"),
        "status": (("mu",), np.array([0, 1, 0, 1], np.int8), "why the trajectory has failed", "1", flags),
    }
    warning = "diagram: 2 of 4 trajectories are not finite at their end"
    data = dataset({"mu": (np.array([0.5, 1.0, 1.5, 2.0]), "parameter mu")}, variables, warnings=warning)
    path = tmp_path / "result.h5"
    result = tree({"diagram": data}, axes="mu")
    del result.attrs["solver"]
    write(path, result)
    reason = "2 of 4 lanes failed: off_constraint, at mu = 1, 2"
    assert failed_in(path, "diagram") == [reason]
    with h5py.File(path) as file:
        show(path, file)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2:] == [f"diagram: {reason}", warning]
