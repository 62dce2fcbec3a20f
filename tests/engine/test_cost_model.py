"""The form of a step and the lanes of a tile: small jobs compile little, large ones run fast, and both agree."""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxnh
from jaxnh.analyses.exponents.tangent_growth import advance, average, begin
from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.accuracy.cost_model import is_short, lanes_a_tile, quickest_form
from jaxnh.engine.compute import numerical_plan, solver_plan
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.plan import in_quickest_form
from jaxnh.maps.build import cut_strobe, make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import ADAPTIVE, SOLVERS, SPLITTINGS, verner9
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.corners import with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from tests.flows.lorenz import known_flow

FLOW = known_flow()
TEXT = """\
system: {file: lorenz.py}
sweep: {rho: {start: 24.0, stop: 28.0, count: %d}}
initial: {x: 1.0, y: 1.0, z: 20.0}
accuracy: {solver: tsit5, steps: 60}
analyses: {lyapunov: {transient: 16, periods: %d, exponents: 1}}
"""
SOURCE = """
def system(sigma=10.0, beta=8 / 3, rho=28.0):
    def rhs(state, t):
        x, y, z = state
        return sigma * (y - x), x * (rho - z) - y, x * y - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "time_unit": 0.5}
"""


@given(st.floats(1.0, 1e12), st.floats(1.0, 1e3))
def test_no_larger_job_has_the_slower_form(lane_steps, factor):
    smaller, larger = (quickest_form(verner9, FLOW.system, n).rolled for n in (lane_steps, factor * lane_steps))
    assert smaller or not larger


def test_few_steps_are_in_a_loop_and_many_are_written_out():
    """Ten thousand steps take a hundredth of a second in either form, and compiling the written one takes two."""
    assert quickest_form(verner9, FLOW.system, 1e4).rolled
    assert not quickest_form(verner9, FLOW.system, 1e9).rolled
    assert quickest_form(SPLITTINGS["processed6"], FLOW.system, 1e4) is SPLITTINGS["processed6"]


def test_explicit_steps_of_a_lane_s_own_have_both_forms():
    """A plan keeps the form; of a Rosenbrock method there is one."""
    own = ADAPTIVE["adaptive_dopri8"]
    looped, written = (quickest_form(own, FLOW.system, lane_steps) for lane_steps in (1e4, 1e9))
    assert (looped.rolled, written.rolled) == (True, None)
    for solver in (looped, written):
        assert solver_plan(numerical_plan(Plan(solver, 20, False, 1e-6), {})).solver == solver
    assert in_loop(own).with_least(3) == dataclasses.replace(looped, least=3)
    assert in_loop(ADAPTIVE["rodas5p"]) is quickest_form(ADAPTIVE["rodas5p"], FLOW.system, 1e4) is ADAPTIVE["rodas5p"]


def test_solvers_are_compared_where_a_run_is_worth_the_compiling():
    """A map whose steps end at twenty corners takes 3 s of processor to compile, one of Lorenz's flow 0.2 s."""

    def corners(a=1.0):
        def rhs(y, t):
            return (a + sum(jnp.abs(y[0] - k) for k in range(20)), y[0] - y[1], y[1] - y[2])

        return {"rhs": rhs, "coordinates": ("x", "y", "z")}

    cornered = piecewise_smooth(with_switches(corners, {"a": 1.0}), {"a": 1.0})
    assert cornered.chart.dimension == FLOW.system.chart.dimension
    shortest = [min(n for n in np.logspace(5, 10, 51) if not is_short(verner9, f, n)) for f in (FLOW.system, cornered)]
    assert shortest[0] < 2e7  # half a second of a run
    assert 10.0 * shortest[0] < shortest[1] < 1e9


@given(st.integers(1, 10**7))
def test_a_tile_is_no_larger_than_a_sweep_fills(lanes):
    tile = lanes_a_tile(lanes)
    assert tile in (8, 16, 24, 32, 128, 256) or tile == lanes == 1
    assert tile <= 8 or math.ceil(lanes / tile) * tile < 4 * lanes
    assert tile in (128, 256) or math.ceil(lanes / tile) * tile - lanes < 8 * math.ceil(lanes / tile)


@given(st.integers(1, 10**7))
def test_long_periods_of_few_lanes_have_no_padding(lanes):
    assert lanes_a_tile(lanes, 10**5) == (lanes if lanes < 8 else lanes_a_tile(lanes))


def test_both_forms_are_the_same_map(lanes):
    """Over a unit of time, to rounding: sums over stages are taken in another order."""
    images = []
    for solver in (verner9, in_loop(verner9)):
        strobe = make_return_map(FLOW.system, solver, 200)
        images.append(FLOW.numbers(lanes(iterate, (strobe, np.int32(1)), (FLOW.start, dict(FLOW.parameters)))))
    assert 0.0 < np.abs(images[0] - images[1]).max() < 1e-11
    assert np.abs(images[1] - FLOW.exact).max() < 1e-10


@pytest.mark.parametrize(("lanes", "periods", "looped"), [(2, 64, True), (4096, 65536, False)])
def test_form_follows_from_the_work_of_a_sweep(lanes, periods, looped):
    experiment = jaxnh.Experiment.from_text(TEXT % (lanes, periods), SOURCE)
    plan = Plan(SOLVERS["tsit5"], 60, False, 1e-6)
    assert bool(in_quickest_form(experiment, plan, experiment.requested()).solver.rolled) == looped


def test_a_result_names_its_form():
    assert jaxnh.Session(jaxnh.Experiment.from_text(TEXT % (2, 64), SOURCE)).tree().attrs["stages"] == "loop"


def test_tiles_on_all_cores_have_the_program_of_one():
    """Those of a call go to as many threads as there are cores, in order and with the same bits."""
    one, both = (LaneExecutor(devices=jax.devices("cpu")[:n], tile=2) for n in (1, 2))
    strobe = make_return_map(FLOW.system, in_loop(verner9), 50)
    call = iterate, (strobe, np.int32(40)), (FLOW.start, dict(FLOW.parameters))
    for few, many in zip(jax.tree.leaves(one(*call)), jax.tree.leaves(both(*call)), strict=True):
        np.testing.assert_array_equal(few, many)
    assert [len(executor.programs) for executor in (one, both)] == [1, 1]
    assert not any("num_partitions=2" in executor.program(*call)[0] for executor in (one, both))


def test_equal_parts_of_a_period_are_one_program(lanes):
    """Growth over three periods in four parts each is that over twelve parts one after the other."""
    strobes, p = cut_strobe(FLOW.system, in_loop(verner9), 40, 4), dict(FLOW.parameters)
    begun = lanes(begin, (FLOW.system,), (FLOW.start,), static=(2,))
    parts, rates = average(lanes, strobes, begun, p, 3)
    whole = lanes(advance, (strobes, None, np.int32(3), np.float64(0.0)), (begun, p))
    np.testing.assert_allclose(np.stack(parts.logs), np.stack(whole.logs), rtol=0, atol=1e-11)
    np.testing.assert_allclose(rates[:, : len(whole.logs)], np.stack(whole.logs, axis=-1) / 3, rtol=0, atol=1e-11)
    np.testing.assert_allclose(parts.loss, whole.loss, rtol=0, atol=1e-11)
