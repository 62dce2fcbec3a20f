"""A sample of the lanes of a result file run again, to compare them bit for bit. No file is written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxnh.engine import plan as work
from jaxnh.engine.lanes import Lanes
from jaxnh.engine.xla_options import configure
from jaxnh.storage import hdf5 as store
from jaxnh.storage.tiles import Job, Piece

_BLOCKS, _LANES = 3, 16


def sample(path: Path) -> dict[str, tuple[int, int]]:
    """For every analysis in a file: how many lanes were run again, and how many of them differ in any bit.

    Three blocks of neighbouring lanes are taken, from both ends and the middle; none where an analysis has no lanes of
    its own.

    Raises:
        store.StoreError: the file says too little of how it was made.
    """
    attrs = store.read_attrs(path)
    if "chosen" not in attrs:
        raise store.StoreError("it does not say all that decided its numbers")
    configure()
    experiment = work.experiment_from(attrs["config"], attrs.get("system_file"))
    split = tuple(analysis.name for analysis, options in experiment.requested() if analysis.splits(options))
    count = len(experiment.sweep.grid())
    job = Job(
        config_sha256=attrs["config_sha256"],
        versions={},
        solver=attrs["solver"],
        steps=int(attrs["steps_per_period"]),
        compensated=attrs["summation"] == "compensated",
        error_estimate=float(attrs["error_estimate"]),
        chosen=json.loads(attrs["chosen"]),
        order=tuple(analysis.name for analysis, _ in experiment.requested()),
        split=split,
        lanes=count,
        tile=_LANES,
    )
    found: dict[str, tuple[int, int]] = dict.fromkeys(job.order, (0, 0))
    if not split:
        return found
    lanes = Lanes()
    for first in sorted({0, max(0, count // 2 - _LANES // 2), max(0, count - _LANES)}):
        piece = Piece(0, split, first, min(first + _LANES, count))
        [done] = work.compute(experiment, job, [piece], lanes)
        for name, group in done.groups.items():
            differs = np.zeros(piece.end - piece.first, bool)
            variables = {key: v.data for key, v in group.variables.items() if v.dims[:1] == ("b",)}
            for ours, theirs in _pairs(path, name, variables, piece):
                differs |= np.any(ours != theirs, axis=1)
            found[name] = found[name][0] + len(differs), found[name][1] + int(differs.sum())
    return found


def _pairs(
    path: Path, name: str, variables: dict[str, np.ndarray], piece: Piece
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The bytes of each lane, (lanes, bytes), as they come out now and as they stand in the file."""
    with h5py.File(path, "r") as file:
        group: Any = file[name]
        for key, ours in variables.items():
            theirs = store.read(group[key], slice(piece.first, piece.end))
            if theirs.dtype != ours.dtype or theirs.shape != ours.shape:
                yield np.zeros((len(ours), 1)), np.ones((len(ours), 1))
            else:
                yield tuple(np.frombuffer(a.tobytes(), np.uint8).reshape(len(a), -1) for a in (ours, theirs))  # pyright: ignore[reportReturnType]
