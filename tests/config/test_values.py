"""Values by name in a config: an axis takes the place of what `system`, `initial` and `initial.level` say of it."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.config.values import with_values, without_values
from jaxnh.engine.progress import NullProgress
from jaxnh.explorer.sessions import Sessions
from tests.helpers.paths import ROOT

LEVEL = ROOT / "configs/nonholonomic/suslov.yaml"
CONTENT = {"system": {"file": "own.py", "g": 9.81}, "initial": {"x": 1.0, "level": {"energy": 2.0}}, "sweep": {}}


def test_an_axis_takes_the_place_of_a_value():
    names = ("g", "x", "energy")
    assert without_values(CONTENT, names) == {"system": {"file": "own.py"}, "initial": {}, "sweep": {}}
    assert without_values(CONTENT, ("g",))["initial"] == CONTENT["initial"]
    values = dict(zip(names, (1.0, 2.0, 3.0), strict=True))
    changed = with_values(CONTENT, values, ("x",), ("energy",))
    assert changed["system"] == {"file": "own.py", "g": 1.0}
    assert changed["initial"] == {"x": 2.0, "level": {"energy": 3.0}}
    assert CONTENT["initial"] == {"x": 1.0, "level": {"energy": 2.0}}  # what was given stays


@pytest.mark.slow  # starts on a level are quick
@pytest.mark.usefixtures("quick_compiling_once")
def test_a_level_that_becomes_an_axis_and_back():
    """As sessions and the explorer do it: the energy of a top over one of its parameters, and of a plane at one energy."""
    swept = jaxnh.load(LEVEL)
    at_level = swept.from_content(
        with_values({**swept._data(), "sweep": {"b1": {"values": [0.0, 0.1]}}}, {"energy": 0.5}, (), ("energy",)),
        swept.user_file,
    )
    assert at_level.initial.level == {"energy": 0.5}
    again = at_level.variant({"diagram": None}, {"energy": [0.3, 0.4]})
    assert [axis.name for axis in again.axes] == ["b1", "energy"]
    assert again.initial.level is None
    plane = swept.variant({"diagram": None}, {"energy": [0.3, 0.4], "b1": np.array([0.0, 0.1])})
    axes = [axis for axis in plane.axes if axis.name == "b1"]
    sessions = Sessions(plane, axes, ["diagram"], NullProgress())
    assert sessions.content["initial"]["level"] == {"energy": pytest.approx(0.3)}
