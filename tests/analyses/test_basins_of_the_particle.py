"""Basins of the paper's particle against heyoka's Taylor integrator with a classification of its own."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.basins.tables import wilson
from jaxnh.engine.experiment import Experiment
from tests.helpers import taylor
from tests.helpers.kept_programs import session_of

SIDE = 31  # 961 starts
TRANSIENT, LAST, LIMIT = 200, 24, 12


@pytest.mark.slow
@pytest.mark.parametrize("b", [4.0, 5.475, 5.51])
def test_shares_of_the_particle(b):
    """Every attractor has the share of starts that an integration of its own finds, within its interval.

    There lanes are told apart by the side of their last strobe points, as attractors are symmetric, with a mean of
    zero, or twins about (±2.6, ±2.8), and by the least n up to 12 after which these recur within 1e-4; none is chaos.
    By then an orbit's transient of 0.712 a turn, the slowest at 5.475, has fallen to exp(−22). The maps differ by 1e-6
    a period, which near a basin's boundary decides; such starts are a small part of all, and the rest has to agree one
    by one.
    """
    grid = {"start": -3.0, "stop": 3.0, "count": SIDE}
    content = {
        "system": {"constraint": "constant_speed", "a": 0.5, "b": b, "c": 1.0, "omega": 1.0},
        "initial": {"x2": 0.1},
        "sweep": {"x1": grid, "y1": grid},
        "accuracy": {"target": 1e-6},
        "analyses": {"basins": {}},
    }
    tree = session_of(Experiment.from_dict(content)).tree()
    number, attractors = tree["basins"]["attractor"].to_numpy().ravel(), tree["attractors"]
    assert np.all(number > 0)
    kind, period = (attractors[name].to_numpy()[number - 1] for name in ("kind", "period"))
    side = _side(attractors["x1_points"].mean("point").to_numpy())[number - 1]
    least = np.where(kind == 0, period, 100)
    ours = side * (1000 + least) + least

    par, axis = taylor.Parameters(), np.linspace(-3.0, 3.0, SIDE)
    starts = [par.start(x1, 0.1, y1) for x1 in axis for y1 in axis]
    states = [taylor.strobe_of_many(par, b, starts, TRANSIENT, 1e-12)]
    for _ in range(LAST - 1):
        states.append(taylor.strobe_of_many(par, b, states[-1], 1, 1e-12))
    points = np.stack(states)[:, :, :2]
    recurs = [np.abs(points[n:] - points[:-n]).max(axis=(0, 2)) < 1e-4 for n in range(1, LIMIT + 1)]
    least = np.where(np.any(recurs, axis=0), 1 + np.argmax(recurs, axis=0), 100)
    side = _side(points[..., 0].mean(axis=0))
    theirs = side * (1000 + least) + least

    assert set(np.unique(ours)) == set(np.unique(theirs))
    for label in np.unique(theirs):
        low, high = wilson(np.sum(ours == label), np.array(SIDE**2))
        assert low <= np.mean(theirs == label) <= high
    assert np.mean(ours == theirs) > 0.95


def _side(mean):
    return np.where(np.abs(mean) < 1.0, 0.0, np.sign(mean))
