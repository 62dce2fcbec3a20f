"""What basins are does not hang on the constants that decide when a lane has settled: each is moved, nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.basins import classification, settling
from jaxnh.engine.experiment import Experiment
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

SIDE = 16  # starts of one tile: a hundredth of them are two


def line(start, stop, count):
    return {"start": start, "stop": stop, "count": count}


def particle():
    """Two chaotic attractors and two orbits of period 3, twins each."""
    content = {
        "system": {"constraint": "constant_speed", "a": 0.5, "b": 5.475, "c": 1.0, "omega": 1.0},
        "initial": {"x2": 0.1},
        "sweep": {"x1": line(-3.0, 3.0, SIDE), "y1": line(-3.0, 3.0, SIDE)},
        "accuracy": {"target": 1e-6},
        "analyses": {"basins": {}},
    }
    return Experiment.from_dict(content)


def pendulum():
    """Rest and rotation, without a clock."""
    path = ROOT / "configs" / "flows" / "torque_pendulum.yaml"
    return jaxnh.load(path, [f"sweep.theta.count={SIDE}", f"sweep.rate.count={SIDE}", "accuracy.target=1e-6"])


SCENES = {"particle": particle, "pendulum": pendulum}
CONSTANTS = {
    "SETTLED_TO": (3e-5, 3e-4),
    "_RESTLESS": (3e-3, 3e-2),
    "_FALLS": (0.15, 0.4),
    "_GROWN": (1.2, 2.0),
    "_NEAR_ORBIT": (3e-3, 3e-2),
}


@pytest.fixture(scope="module", params=SCENES)
def usual(request):
    """A scene, and its labels and kinds as the package has them."""
    return request.param, *labels(SCENES[request.param]())


def labels(experiment):
    """Numbers of the attractors of all starts, and for each attractor its kind and period."""
    tree = session_of(experiment).tree()
    kinds = tree["attractors"].to_dataset()
    return tree["basins"]["attractor"].to_numpy().ravel(), sorted(
        zip(kinds["kind"].to_numpy().tolist(), kinds["period"].to_numpy().tolist(), strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [(name, value) for name, pair in CONSTANTS.items() for value in pair])
def test_labels_stay(usual, monkeypatch, name, value):
    """The same attractors, and more than 99 starts in 100 on the same one.

    A lane that has not come near enough when it is said to have settled may be taken for one on another attractor.
    """
    scene, before, kinds = usual
    assert np.all(before > 0)
    having = [module for module in (settling, classification) if hasattr(module, name)]
    assert having
    for module in having:
        monkeypatch.setattr(module, name, value)
    after, found = labels(SCENES[scene]())
    assert found == kinds
    moved = [np.bincount(after[before == number]).argmax() for number in range(1, before.max() + 1)]
    assert len(set(moved)) == len(moved)
    assert np.mean(after == np.array(moved)[before - 1]) > 0.99
