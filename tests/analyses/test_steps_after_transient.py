"""Steps of a period once lanes are near their attractors: their error against a Taylor integrator, and who has them."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.basins import basins as basins_of_a_sweep
from jaxnh.analyses.basins.basins import BasinsOptions, choose
from jaxnh.analyses.basins.steps_after_transient import choose_steps
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.window_averages import average_window
from jaxnh.engine.experiment import Experiment
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.kept_programs import session_of
from tests.helpers.measurement import largest_difference

TARGET, STEPS, TRANSIENT = 1e-6, 414, 64
B = 5.475
SYSTEM = constant_speed(b=B)


def scene_over(box, count, seed, target=TARGET):
    """Lanes that start at random in a box of x1 and y1."""
    x, y = np.random.default_rng(seed).uniform(-box, box, (2, count))
    start = (x, y), (np.full(count, 0.1), np.full(count, math.sqrt(0.99)))
    return LaneBatch(SYSTEM, start, {}, SPLITTINGS["processed6"], STEPS, False, TARGET, target=target)


@pytest.mark.slow  # steps are chosen in the quick test below
def test_error_after_the_first_look(lanes):
    """Of other lanes than those that chose: no period of 1,600 errs by more than the target, with 3/4 of the steps some.

    Starts are up to 4 from the origin, where the forces are thirty times those on the attractors.
    """
    few = scene_over(4.0, 512, 1)
    steps = choose_steps(few, lanes, average_window(few, lanes, few.start, TRANSIENT // 2).state)
    assert steps <= STEPS // 3
    others = scene_over(4.0, 100, 2)
    state = average_window(others, lanes, others.start, TRANSIENT // 2).state
    par, worst, with_fewer = twin(SYSTEM), [], []
    for _ in range(16):
        u = SYSTEM.chart.host_points(state)
        exact = taylor.strobe(par, B, u.astype(taylor.REAL))
        maps = (replace(others, steps=n).strobe() for n in (steps, 3 * steps // 4))
        images = [lanes(lambda strobe, z: strobe(z, {}), (strobe,), (state,)) for strobe in maps]
        for found, image in zip((worst, with_fewer), images, strict=True):
            found.append(largest_difference(SYSTEM.chart.host_points(image), exact).max())
        state = images[0]
    assert max(worst) < TARGET < max(with_fewer)


def test_where_nothing_is_gained(lanes):
    """All steps, where the lanes are still where the steps were chosen for, where steps were asked for by number, and
    where there are few: a target that any steps meet is no reason for fewer than eight."""
    few = scene_over(4.0, 256, 1)
    assert choose_steps(few, lanes, few.start) == STEPS
    settled = average_window(few, lanes, few.start, TRANSIENT // 2).state
    assert choose_steps(replace(few, target=0.0), lanes, settled) == STEPS
    assert choose_steps(replace(few, target=1.0, steps=15), lanes, settled) == 15
    assert choose_steps(replace(few, target=1.0, steps=40), lanes, settled) == 10


def test_few_lanes_choose_nothing():
    """Nor is anything computed: there is nothing to compute it with."""
    assert choose(BasinsOptions(), scene_over(4.0, 16 * 1024 - 1, 1), None) == {"steps": STEPS}


@pytest.mark.slow
@pytest.mark.parametrize("random", [False, True])
def test_basins_are_those_of_all_steps(tmp_path, monkeypatch, random):
    """65 x 65 starts over the box, and as many random ones: the same attractors, more than 999 of 1,000 starts alike."""
    monkeypatch.setattr(basins_of_a_sweep, "_MANY", 65**2)  # steps are chosen for 16,384 starts and more
    axis = {"start": -4.0, "stop": 4.0, "count": 65}
    system = {"constraint": "constant_speed", "a": 0.5, "c": 1.0, "omega": 1.0}
    content = {"system": {**system, "b": B}, "initial": {"x2": 0.1}, "sweep": {"x1": axis, "y1": axis}}
    content |= {"accuracy": {"target": TARGET}, "analyses": {"basins": {}}}
    if random:
        basins = {"n_starts": 65**2, "box": {"x1": [-4.0, 4.0], "y1": [-4.0, 4.0]}}
        content |= {"sweep": {"b": {"values": [B]}}, "system": system, "analyses": {"basins": basins}}
        content |= {"initial": {"x1": 0.0, "x2": 0.1, "y1": 0.0}}
    tree = session_of(Experiment.from_dict(content)).tree()
    chosen, steps = json.loads(tree.attrs["auto_settings"])["basins"]["steps"], int(tree.attrs["steps_per_period"])
    assert chosen < steps / 2
    content["accuracy"] = {"solver": tree.attrs["solver"], "steps": steps}
    plain = session_of(Experiment.from_dict(content)).tree()
    assert json.loads(plain.attrs["auto_settings"])["basins"] == {"steps": steps}
    one, other = (t["basins"]["attractor"].to_numpy() for t in (tree, plain))
    assert np.mean(one == other) > 0.999
    assert tree["attractors"]["period"].equals(plain["attractors"]["period"])
    by_tiles = jaxnh.run(Experiment.from_dict({**content, "accuracy": {"target": TARGET}}), output=tmp_path / "r.h5")
    assert by_tiles["basins"]["attractor"].equals(tree["basins"]["attractor"])
