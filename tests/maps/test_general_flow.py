"""Steps of any flow against plain diffrax with projected steps, rolled and written out, and the Taylor reference."""

from __future__ import annotations

import math
from dataclasses import replace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.general_flow import general_strobe
from jaxnh.maps.iterate import derivatives, iterate, section_map
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.step_grids import step_grid
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import RUNGE_KUTTA, SOLVERS, dopri8, tsit5
from jaxnh.solvers.adaptive import in_loop
from jaxnh.solvers.diffrax_solvers import DiffraxSteps
from jaxnh.systems.first_order import first_order
from jaxnh.systems.free_particle import definition, free_particle
from jaxnh.systems.lagrangian import Motion, lagrangian
from jaxnh.systems.particle import disturbed_speed
from tests.flows.calm_particle import CALM, image
from tests.helpers.batches import broadcast_start
from tests.helpers.cases import some_slow
from tests.helpers.convergence import check_derivatives
from tests.helpers.diffrax_solvers import ProjectedSolver
from tests.helpers.measurement import UNIT, largest_difference

pytestmark = pytest.mark.usefixtures("quick_compiling_always")

PARAMETERS = {"a": 0.5, "b": 5.2, "c": 1.0, "d": 0.1, "omega": 1.0}
MOTION = Motion((0.1, 0.1), (0.1, math.sqrt(0.99)), (0.0, 0.0))
FLOWS = {
    "constrained": (lagrangian(definition(frozenset(), constrained=True), PARAMETERS), MOTION),
    "free": (free_particle(0.5, 5.2, 1.0), MOTION),
    "particle": (disturbed_speed(b=5.2), ((0.1, 0.1), (0.1, math.sqrt(0.99)))),
}


@jax.jit
def moved(strobe, state, p):
    """The map as a compiled program has it."""
    return strobe(state, p)


@pytest.mark.slow
def test_derivatives_of_runge_kutta(lanes):
    """The error of 200 steps of order five is measured by doubling them."""
    system = CALM["constant"]
    coarse, fine = (make_return_map(system, SOLVERS["tsit5"], steps) for steps in (100, 200))
    check_derivatives(lanes, fine, system, largest_difference(image(lanes, fine), image(lanes, coarse)).max())


@pytest.mark.parametrize("rolled", [True, False], ids=["rolled", "written out"])
@pytest.mark.parametrize("flow", some_slow(dict(zip(FLOWS, FLOWS, strict=True)), "free"))
@pytest.mark.parametrize("name", [pytest.param("dopri8", marks=pytest.mark.slow), "tsit5"])
def test_steps_are_diffeqsolve_with_projected_steps(name, flow, rolled):
    """The loop of steps is the written-out solver, projected, under `diffrax.diffeqsolve`, to rounding.

    A hundred steps of some 15 sums each, which the flow of one period enlarges a hundredfold at most; roundings are
    shares of the state.
    """
    (system, start), solver = FLOWS[flow], RUNGE_KUTTA[name]
    start, p = jax.tree.map(jnp.float64, start), {"b": jnp.float64(4.9)}
    grid = step_grid(system, 100, (0.0, system.period))
    strobe = general_strobe(system, replace(solver, rolled=rolled), grid)
    assert strobe.trip_counts == ((100.0, float(solver.stages)) if rolled else (100.0,))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(system.rhs), ProjectedSolver(solver, system), 0.0, system.period, None, start, args=p,
        stepsize_controller=diffrax.StepTo(grid), max_steps=128,
    )  # fmt: skip
    exact = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
    for one, other in zip(jax.tree.leaves(moved(strobe, start, p)), jax.tree.leaves(exact), strict=True):
        assert abs(float(one) - float(other)) < 1e-12 * max(1.0, abs(float(other)))


@pytest.mark.parametrize("solver", some_slow(RUNGE_KUTTA, "tsit5"))
def test_rolled_steps_are_those_written_out(solver):
    """Of one step the sums over stages are taken in another order, and no more."""
    system, start = FLOWS["constrained"]
    start, p = jax.tree.map(jnp.float64, start), {"b": jnp.float64(4.9)}
    strobe = general_strobe(system, replace(solver, rolled=True), np.array([0.0, 0.1]))
    written_out = moved(replace(strobe, solver=replace(solver, rolled=False)), start, p)
    for rolled in (strobe, strobe.as_loop()):
        for one, other in zip(jax.tree.leaves(moved(rolled, start, p)), jax.tree.leaves(written_out), strict=True):
            assert abs(float(one) - float(other)) < 2 * 15 * 40 * UNIT


def test_solver_of_diffrax_itself():
    """Any diffrax solver of one term runs under `diffeqsolve`: its own Dopri8 makes the steps of ours."""
    system, start = FLOWS["free"]
    start, p = jax.tree.map(jnp.float64, start), {"b": jnp.float64(4.9)}
    grid = step_grid(system, 100, (0.0, system.period))
    ours, theirs = (
        moved(general_strobe(system, solver, grid), start, p) for solver in (dopri8, DiffraxSteps(diffrax.Dopri8()))
    )
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert abs(float(one) - float(other)) < 1e-12


def test_parameters_in_the_flow_and_in_the_lane(lanes):
    """Values of the lane take the place of the flow's: all lanes at one a are those of a flow that has it."""
    b = np.array([4.9, 5.2])
    start = broadcast_start(MOTION, 2)

    def end(a, p):
        flow = free_particle(a, None, 1.0)
        return lanes(iterate, (make_return_map(flow, dopri8, 100), np.int32(1)), (start, p))

    both, one = end(0.5, {"a": np.full(2, 0.7), "b": b}), end(0.7, {"b": b})
    for x, y in zip(jax.tree.leaves(both), jax.tree.leaves(one), strict=True):
        assert np.abs(x - y).max() < 1e-12


def test_one_program_for_all_values_of_the_flow():
    """Parameters of the flow are data, and so are steps; the particle's c, d and ω here as well."""
    lanes = LaneExecutor()
    start = broadcast_start(FLOWS["particle"][1], 2)
    for c, d, omega, steps in ((1.0, 0.1, 1.0, 80), (1.3, 0.0, 1.5, 60), (0.7, -0.2, 2.0, 100)):
        strobe = make_return_map(disturbed_speed(c=c, d=d, omega=omega), tsit5, steps)
        lanes(iterate, (strobe, np.int32(1)), (start, {"b": np.array([4.9, 5.2])}))
    assert len(lanes.programs) == 1


def jacfwd(strobe, u, p):
    return jax.jacfwd(lambda u, p: section_map(strobe, 1, u, p), argnums=(0, 1))(u, p)


@pytest.mark.slow
def test_derivatives_of_a_system_of_its_own_parameters(lanes):
    """∂P/∂a of T, Q and f is that of jacfwd of the map."""
    system, start = FLOWS["constrained"]
    p = {"a": np.array([0.5, 0.6]), "b": np.array([4.9, 5.2])}
    u, strobe = system.chart.host_points(broadcast_start(start, 2)), make_return_map(system, dopri8, 120)
    image, monodromy, slope = lanes(derivatives, (strobe, np.int32(1)), (u, p), static=("a",))
    assert np.all(np.isfinite(image))
    by_state, by_p = lanes(jacfwd, (strobe,), (u, p))
    assert np.abs(monodromy - by_state).max() < 1e-10 * np.abs(monodromy).max()
    assert np.abs(slope - by_p["a"]).max() < 1e-10 * np.abs(slope).max()


@pytest.mark.parametrize(("terms", "arrays"), [(4, True), (15, False)], ids=["small field", "large field"])
def test_tangents_in_a_loop_are_an_array_or_apart(terms, arrays):
    """Of a small field they are one array, of 120 equations each by itself; they are moved by exp(A t) either way."""
    draws = np.random.default_rng(3).uniform(-1.0, 1.0, (terms, 2, 2)) / terms

    def linear():
        def rhs(y, t):
            return tuple(sum(a[i, 0] * y[0] + a[i, 1] * y[1] for a in draws) for i in range(2))

        return {"rhs": rhs, "coordinates": ("x", "y")}

    system = first_order(linear, {})
    assert (100 < time_split(system).size <= 150) != arrays
    strobe = make_return_map(system, in_loop(tsit5), 64)
    state = jax.tree.map(jnp.asarray, system.start({"x": 1.0, "y": -2.0}))
    along = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    tangents = tuple(Tangent(jax.tree.unflatten(jax.tree.structure(state), list(jnp.asarray(v)))) for v in along)

    def pushed(state):
        return strobe.pushforward(state, {}, tangents)

    exact = scipy.linalg.expm(draws.sum(axis=0))
    ended = jax.jit(pushed)(state)
    columns = np.array([jax.tree.leaves(t.state) for t in ended.tangents]).T
    np.testing.assert_allclose(columns, exact @ along.T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(jax.tree.leaves(ended.state), exact @ [1.0, -2.0], rtol=0, atol=1e-11)
    assert np.exp(ended.log_volume) == pytest.approx(np.linalg.det(exact), rel=1e-11)
    assert ("f64[3] = " in str(jax.make_jaxpr(pushed)(state))) == arrays
