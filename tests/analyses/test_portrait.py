"""Trajectories against the Taylor reference at times within a period, and the constraint on every sample."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from jaxnh.analyses.base import LANE
from jaxnh.analyses.trajectories.portrait import PortraitOptions, run
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_parts, make_return_map
from jaxnh.solvers import SOLVERS
from tests.flows.particle import SYSTEMS, twin
from tests.helpers import taylor
from tests.helpers.batches import batch_of

B = np.array([2.5, 4.1, 5.3])
NAMES = ("x1", "x2", "y1", "y2")
# One period with 140 steps of order ten (4900 forces) is known to 6e-12 over b in [2, 6] (DESIGN, section 3), with 1260
# steps of Dopri8 to about 1e-8; parts of a period have at least their share of the steps. With ten times that to spare,
PRECISE = {"sofroniou_spaletta10": (140, 6e-11), "dopri8": (105, 1e-5), "blanes_moan6": (240, 1e-7)}

systems = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)


def scene(system, solver="blanes_moan6", steps=60):
    x, y, angle = twin(system).start().astype(float)
    steps = round(steps * system.period / (2 * np.pi) * np.sqrt(system.c))  # as many for the same length of path
    return batch_of(system, ((x, y), (np.cos(angle), np.sin(angle))), B, SOLVERS[solver], steps)


def taylor_path(system, b, times):
    """x1, x2, y1, y2 (times, 4) of the reference from the start state, `times` rising from 0."""
    par = twin(system)
    ta, at_zero = taylor.integrator(par.equations, 0, taylor.REAL, float(np.finfo(taylor.REAL).eps))
    ta.pars[:] = [taylor.REAL(v) for v in (b, par.a, par.c, par.d, par.omega)]
    ta.state[:] = at_zero
    ta.state[:3] = par.start()
    ta.time = taylor.REAL(0)
    path = []
    for t in times.astype(taylor.REAL):
        ta.propagate_until(t)
        x, y, angle = ta.state[:3]
        speed = np.sqrt(par.c + par.d * np.sin(t))
        path.append([x, speed * np.cos(angle), y, speed * np.sin(angle)])
    return np.array(path)


@pytest.mark.parametrize("solver", ["sofroniou_spaletta10", "blanes_moan6"])
@systems
def test_samples_within_a_period_are_those_of_the_reference(system, solver):
    steps, tolerance = PRECISE[solver]
    group = run(PortraitOptions(transient=0, periods=1, samples=7), scene(system, solver, steps), LaneExecutor())
    times = group["t"].to_numpy()
    np.testing.assert_allclose(times, system.period * np.arange(7) / 7, rtol=1e-15)
    for i, b in enumerate(B):
        ours = np.array([group[name].to_numpy()[i] for name in NAMES]).T
        assert np.abs(ours - taylor_path(system, b, times)).max() < tolerance


def test_runge_kutta_solvers_make_parts_as_well():
    system = SYSTEMS["disturbed"]
    steps, tolerance = PRECISE["dopri8"]
    group = run(PortraitOptions(transient=0, periods=1, samples=3), scene(system, "dopri8", steps), LaneExecutor())
    ours = np.array([group[name].to_numpy()[0] for name in NAMES]).T
    assert np.abs(ours - taylor_path(system, B[0], group["t"].to_numpy())).max() < tolerance


@systems
def test_every_sample_obeys_the_constraint(system):
    """x2² + y2² = c + d sin t at any accuracy: it is built in, to the rounding of the kicks of a period."""
    group = run(PortraitOptions(transient=20, periods=3, samples=50), scene(system, steps=20), LaneExecutor())
    x2, y2, t = (group[name].to_numpy() for name in ("x2", "y2", "t"))
    squared_speed = system.c + system.d * np.sin(t)
    assert np.abs(x2**2 + y2**2 - squared_speed).max() < 1e-13


def test_samples_are_counted_from_the_start_state_in_whole_periods():
    system = SYSTEMS["disturbed"]
    options = PortraitOptions(transient=0, periods=5, samples=4)
    group = run(options, scene(system), LaneExecutor())
    assert group["x1"].dims == (LANE, "time")
    assert group["x1"].to_numpy().shape == (3, 20)
    assert [float(group[name].to_numpy()[1, 0]) for name in NAMES] == pytest.approx([0.1, 0.1, 0.1, np.sqrt(0.99)])
    later = run(PortraitOptions(transient=2, periods=3, samples=4), scene(system), LaneExecutor())
    np.testing.assert_allclose(later["t"].to_numpy(), group["t"].to_numpy()[8:], rtol=1e-15)
    # the transient runs by the map of whole periods, whose steps are others: both have an error of 1e-6 or so
    np.testing.assert_allclose(later["x1"].to_numpy(), group["x1"].to_numpy()[:, 8:], atol=1e-3)


@pytest.mark.parametrize("name", ["blanes_moan6", "dopri8"])
def test_no_step_of_a_part_is_longer_than_the_longest_of_the_period(name):
    system = SYSTEMS["disturbed"]
    whole, parts = make_return_map(system, SOLVERS["dopri8"], 90), make_parts(system, SOLVERS["dopri8"], 90, 8)
    assert np.diff(parts.grid).max() <= np.diff(whole.grid).max() * (1 + 1e-6)
    assert np.array_equal(parts.grid[1:, 0], parts.grid[:-1, -1])
    assert all(np.shape(leaf)[0] == 8 for leaf in jax.tree.leaves(make_parts(system, SOLVERS[name], 90, 8)))
