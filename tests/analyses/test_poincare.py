"""Strobe points against the Taylor reference, and the contract of counts."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from jaxnh.analyses.base import LANE
from jaxnh.analyses.trajectories import poincare
from jaxnh.analyses.trajectories.poincare import PoincareOptions, run
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.failures import count_warnings
from jaxnh.maps.kicks import KickStrobe
from jaxnh.solvers import SPLITTINGS
from tests.flows.particle import SYSTEMS, twin
from tests.helpers import taylor
from tests.helpers.batches import batch_of

B = np.array([5.8, 2.5, 4.1])
ONE_PERIOD = 6e-11  # error of one period of order ten with 4900 forces: 6e-12 (DESIGN, section 3), ten times to spare

systems = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)


def scene(system, solver="sofroniou_spaletta10", steps=140):
    x, y, angle = twin(system).start().astype(float)
    steps = round(steps * system.period / (2 * np.pi) * np.sqrt(system.c))  # as many for the same length of path
    return batch_of(system, ((x, y), (np.cos(angle), np.sin(angle))), B, SPLITTINGS[solver], steps)


def reference(system, b, count):
    """States (count, 3) of one lane at the strobes 0, 1, …, and what an error of a period at each has grown to."""
    par = twin(system)
    points, errors = [par.start()], [0.0]
    for _ in range(count - 1):
        image, monodromy, _ = taylor.strobe_jacobian(par, b, points[-1])
        errors.append(errors[-1] * float(np.linalg.norm(monodromy[0].astype(float), np.inf)) + ONE_PERIOD)
        points.append(image[0])
    return np.array(points), np.array(errors)


@systems
@pytest.mark.parametrize("transient", [0, 2])
def test_strobes_are_those_of_the_reference(system, transient):
    """With no transient the first strobe is the start state, the second the state one period on."""
    group = run(PoincareOptions(transient=transient, strobes=3), scene(system), LaneExecutor())
    for i, b in enumerate(B):
        points, errors = reference(system, b, transient + 3)
        points, errors = points[transient:], errors[transient:]
        speed = np.sqrt(system.c)  # at whole periods sin t = 0
        exact = [points[:, 0], speed * np.cos(points[:, 2]), points[:, 1], speed * np.sin(points[:, 2])]
        for name, values in zip(("x1", "x2", "y1", "y2"), exact, strict=True):
            assert np.all(np.abs(group[name].to_numpy()[i] - values) <= errors + 1e-15), (name, b)


def test_time_counts_from_the_start():
    system = SYSTEMS["other"]
    group = run(PoincareOptions(transient=7, strobes=4), scene(system, "blanes_moan6", 20), LaneExecutor())
    np.testing.assert_allclose(group["t"].to_numpy(), system.period * np.array([7, 8, 9, 10]), rtol=1e-15)
    assert group["x1"].dims == (LANE, "strobe")
    assert group.sizes[LANE] == len(B)


def test_the_constraint_holds_after_thousands_of_periods():
    group = run(
        PoincareOptions(transient=3000, strobes=2), scene(SYSTEMS["constant"], "blanes_moan6", 20), LaneExecutor()
    )
    assert np.abs(group["x2"].to_numpy() ** 2 + group["y2"].to_numpy() ** 2 - 1.0).max() < 2e-15


def test_nothing_is_differentiated(monkeypatch):
    def refuse(*_):
        raise AssertionError("a tangent was asked for")

    monkeypatch.setenv("JAXNH_KEEP_PROGRAMS", "0")  # a program that is found is not traced
    monkeypatch.setattr(KickStrobe, "pushforward", refuse)
    run(PoincareOptions(transient=1, strobes=2), scene(SYSTEMS["constant"], "strang2", 30), LaneExecutor())


def test_trajectories_that_leave_the_numbers_are_counted():
    for codes, lost in (([0, 3, 1], {"not_finite": 1, "singular": 1}), ([0, 0, 0], {})):
        found = xr.Dataset({"status": (LANE, codes)})
        assert poincare.count(found) == {"trajectories": 3, "failed": len(lost), **lost}


def test_a_warning_says_why_trajectories_have_failed():
    """A lane that does not return, or chatters, is finite."""
    counts = poincare.count(xr.Dataset({"status": (LANE, [0, 4, 4, 6])}))
    assert count_warnings("poincare", counts) == (
        "poincare: 2 of 4 trajectories do not return to the section",
        "poincare: 1 of 4 trajectories end in chattering, ever more impacts in finite time",
    )


def test_expected_work_is_the_work_done():
    options, lanes = PoincareOptions(transient=5, strobes=4), LaneExecutor()
    run(options, scene(SYSTEMS["constant"], "strang2", 30), lanes)
    assert lanes.accounts.lane_periods == poincare.periods(options, len(B)) == 3 * 8
