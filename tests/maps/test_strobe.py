"""The strobe map against plain diffrax, the Taylor reference, and jacfwd; its iterates and coordinates by identities."""

from __future__ import annotations

import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import taylor
from hypothesis import given, settings
from hypothesis import strategies as st
from measure import CALM, CALM_B, CALM_STATES, SYSTEMS, UNIT, apart, twin

from jaxnh.engine.lanes import Lanes
from jaxnh.maps.build import cut_strobe, make_strobe
from jaxnh.maps.iterate import derivatives, iterate, record, section_map
from jaxnh.maps.step_grids import SmoothGrid, step_grid
from jaxnh.solvers import SOLVERS, SPLITTINGS, isokinetic_terms
from jaxnh.systems.particle import chart, disturbed_speed, unchart, wrap

# Roundings of some 2000 kicks add up at random to 1e-14, and the calm flow enlarges them up to ten times: with ten
# times that to spare,
ROUNDOFF = 1e-12
FINEST = max(SPLITTINGS.values(), key=lambda solver: solver.convergence_order)

systems = pytest.mark.parametrize("system", CALM.values(), ids=CALM)


@pytest.fixture(scope="module")
def lanes():
    """One runner, so that equal programs are compiled once."""
    return Lanes()


def image(lanes, strobe, n=1):
    return lanes(section_map, (strobe, np.int32(n)), (CALM_STATES, CALM_B))


def start_states():
    return jax.tree.map(np.asarray, jax.vmap(unchart)(jnp.asarray(CALM_STATES)))


# ---- one period


@systems
@pytest.mark.parametrize("name", ["strang2", "blanes_moan6"])  # the table is made alike for all; compiling more is slow
def test_kicks_are_diffeqsolve_on_the_same_grid(lanes, system, name):
    """The loop over the table of kicks is `IsokineticSplitting.step` under `diffeqsolve`, to rounding."""
    solver, steps = SPLITTINGS[name], 200
    grid = diffrax.StepTo(step_grid(system, steps, (0.0, system.period)))

    def solve(u, b):
        solution = diffrax.diffeqsolve(
            isokinetic_terms(system), solver, 0.0, system.period, None, unchart(u), args=b, stepsize_controller=grid
        )
        return chart(jax.tree.map(lambda leaf: leaf[-1], solution.ys))

    solved = jax.jit(jax.vmap(solve))(CALM_STATES, CALM_B)
    assert apart(image(lanes, make_strobe(system, solver, steps)), solved).max() < ROUNDOFF


@systems
@pytest.mark.parametrize("solver", SPLITTINGS.values(), ids=SPLITTINGS)
def test_splittings_converge_to_the_reference(lanes, system, solver):
    check_convergence(lanes, system, solver)


def test_runge_kutta_converges_to_the_reference(lanes):
    check_convergence(lanes, CALM["disturbed"], SOLVERS["tsit5"])


def check_convergence(lanes, system, solver):
    """With twice the steps a method of order p has 2⁻ᵖ of the error; twice that is left for the terms that follow.

    Errors are geometric means over lanes, as some lanes are late to follow the law and others cross zero.
    """
    steps = 600 // solver.stages
    coarse, fine = (image(lanes, make_strobe(system, solver, n)) for n in (steps, 2 * steps))
    moved = math.exp(np.log(apart(fine, coarse)).mean())
    error = math.exp(np.log(apart(fine, taylor.strobe(twin(system), CALM_B, CALM_STATES))).mean())
    assert moved > 10 * ROUNDOFF
    assert error < moved * 2.0 ** (1 - solver.convergence_order) + ROUNDOFF


@systems
def test_compensated_sums(lanes, system):
    """Without the roundings of the sums, those of one kick's turn remain: a tenth at most of the error of plain sums."""
    exact = taylor.strobe(twin(system), CALM_B, CALM_STATES)
    plain, compensated = (
        apart(image(lanes, make_strobe(system, FINEST, 100, compensated=c)), exact) for c in (False, True)
    )
    assert np.median(compensated) < 0.1 * np.median(plain)
    assert plain.max() < ROUNDOFF


@pytest.mark.parametrize("name", ["blanes_moan6", "processed6"])
def test_map_over_a_part_of_the_period(name):
    """From 0 to t and from t to the end is the whole period, up to the error of the method at either number of steps."""
    system, solver = CALM["disturbed"], SPLITTINGS[name]
    state, b = unchart(jnp.asarray(CALM_STATES[0])), CALM_B[0]
    exact = taylor.strobe(twin(system), b, CALM_STATES[0])[0]
    errors = []
    for steps in (50, 100):
        first, second = (make_strobe(system, solver, steps, span=span) for span in ((0.0, 2.0), (2.0, system.period)))
        errors.append(apart(chart(second(first(state, b), b)), exact))
    assert errors[1] < errors[0] * 2.0 ** (1 - solver.convergence_order) < 1e-6


@pytest.mark.parametrize("name", ["blanes_moan6", "processed6", "tsit5"])
def test_map_cut_into_parts(name):
    """Seven parts, one after the other, are the map of the next number of steps that seven divides."""
    system, solver = CALM["disturbed"], SOLVERS[name]
    parts = cut_strobe(system, solver, 93, 7)
    state, b = unchart(jnp.asarray(CALM_STATES[0])), jnp.asarray(CALM_B[0])
    end, _ = jax.lax.scan(lambda state, part: (part(state, b), None), state, parts)
    assert apart(chart(end), chart(make_strobe(system, solver, 98)(state, b))) < ROUNDOFF


def test_strobe_that_is_part_of_the_program():
    """Called by itself, inside another program, or handed over as an argument: the same map."""
    strobe = make_strobe(CALM["disturbed"], SPLITTINGS["blanes_moan6"], 100)
    state, b = jax.tree.map(np.asarray, unchart(jnp.asarray(CALM_STATES[0]))), CALM_B[0]
    images = (
        strobe(state, b),
        jax.jit(lambda state, b: strobe(state, b))(state, b),
        jax.jit(lambda strobe, state, b: strobe(state, b))(strobe, state, b),
    )
    for one in images:
        assert apart(chart(one), chart(images[0])) < ROUNDOFF


@pytest.mark.parametrize("system", [*SYSTEMS.values(), disturbed_speed(d=0.999)])
@pytest.mark.parametrize("steps", [1, 2, 7, 1000])
def test_grid_of_steps(system, steps):
    """From one end of the span to the other, as many steps as asked for, each forwards."""
    for span in ((0.0, system.period), (1.5, 2.5)):
        grid = step_grid(system, steps, span)
        assert grid.shape == (steps + 1,)
        assert (grid[0], grid[-1]) == span
        assert np.all(np.diff(grid) > 0)


@pytest.mark.parametrize("system", [*SYSTEMS.values(), disturbed_speed(d=0.999)])
def test_smooth_grid(system):
    """Its map and inverse undo each other, its rate is its slope, and its steps end where `step_grid` has them."""
    grid = SmoothGrid(system)
    t = np.linspace(-0.3, 1.2, 1001) * system.period
    share = grid.share(t)
    np.testing.assert_allclose(grid.time(share), t, rtol=0, atol=1e-13 * system.period)
    slope = (grid.time(share + 1e-6) - grid.time(share - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope, grid.rate(t), rtol=1e-6)
    ends = grid.time(np.linspace(0.0, grid.share(np.asarray(system.period)), 101))
    np.testing.assert_allclose(ends, step_grid(system, 100, (0.0, system.period)), rtol=0, atol=1e-4 * system.period)


# ---- derivatives


def check_derivatives(lanes, strobe, system, error):
    """Against the derivatives of the reference, to the error of the map; those of M and of the slope relative to it."""
    u, monodromy, slope = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, CALM_B))
    exact, exact_monodromy, exact_slope = taylor.strobe_jacobian(twin(system), CALM_B, CALM_STATES)
    assert np.max(apart(u, exact)) < error
    check_equal_derivatives((monodromy, slope), (exact_monodromy, exact_slope), error)
    return u, monodromy, slope


def check_equal_derivatives(one, other, error):
    """To an error relative to the largest; more in lanes that enlarge errors, and with them this one, over tenfold."""
    largest = size(*other)
    allowed = error * largest * np.maximum(1.0, largest / 10)
    assert np.max(np.abs(one[0] - other[0]).max(axis=(1, 2)) / allowed) < 1
    assert np.max(np.abs(one[1] - other[1]).max(axis=1) / allowed) < 1


def size(monodromy, slope):
    """Largest derivative of each lane."""
    return np.maximum(np.abs(monodromy).max(axis=(1, 2)), np.abs(slope).max(axis=1))


def jacfwd(strobe, u, b):
    by_state, by_b = jax.jacfwd(lambda u, b: section_map(strobe, 1, u, b), argnums=(0, 1))(u, b)
    return section_map(strobe, 1, u, b), by_state, by_b


@systems
@pytest.mark.parametrize("compensated", [False, True])
def test_derivatives_of_kicks(lanes, system, compensated):
    """At a hundred steps of order ten the calm map has come down to its roundings. And they are those of jacfwd."""
    strobe = make_strobe(system, FINEST, 100, compensated=compensated)
    u, monodromy, slope = check_derivatives(lanes, strobe, system, ROUNDOFF)
    whole, by_state, by_b = lanes(jacfwd, (strobe,), (CALM_STATES, CALM_B))
    assert np.max(apart(u, whole)) < ROUNDOFF
    check_equal_derivatives((monodromy, slope), (by_state, by_b), ROUNDOFF)


def test_derivatives_of_runge_kutta(lanes):
    """The error of 200 steps of order five is measured by doubling them."""
    system = CALM["constant"]
    coarse, fine = (make_strobe(system, SOLVERS["tsit5"], steps) for steps in (100, 200))
    check_derivatives(lanes, fine, system, apart(image(lanes, fine), image(lanes, coarse)).max())


def test_derivatives_over_periods_by_the_chain_rule(lanes):
    """M of P² is the product of two monodromy matrices, and ∂P²/∂b = M ∂P/∂b + ∂P/∂b at the image."""
    strobe = make_strobe(CALM["disturbed"], SPLITTINGS["blanes_moan6"], 100)
    u, first, slope = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, CALM_B))
    end, second, second_slope = lanes(derivatives, (strobe, np.int32(1)), (u, CALM_B))
    both = lanes(derivatives, (strobe, np.int32(2)), (CALM_STATES, CALM_B))
    product = second @ first
    chained = np.einsum("lij,lj->li", second, slope) + second_slope
    largest = 3 * size(second, second_slope) * np.maximum(size(first, slope), 1)
    assert np.max(apart(both[0], end)) < ROUNDOFF
    assert np.max(np.abs(both[1] - product).max(axis=(1, 2)) / largest) < ROUNDOFF
    assert np.max(np.abs(both[2] - chained).max(axis=1) / largest) < ROUNDOFF


# ---- iterates


def test_iterates_add_up(lanes):
    """Pⁿ is P n times, bit for bit: n is data of one program, and the clock starts anew each period."""
    strobe = make_strobe(SYSTEMS["disturbed"], SPLITTINGS["blanes_moan6"], 50)
    state = start_states()
    five = lanes(iterate, (strobe, np.int32(5)), (state, CALM_B + 5))
    for n in (1, 3, 0, 1):
        state = lanes(iterate, (strobe, np.int32(n)), (state, CALM_B + 5))
    for one, other in zip(jax.tree.leaves(five), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(one, other)


def test_record_is_every_iterate(lanes):
    """The states after 1, 2, 3 periods, and the last of them once more; to the rounding of another program."""
    strobe = make_strobe(CALM["constant"], SPLITTINGS["blanes_moan6"], 100)
    last, states = lanes(record, (strobe,), (start_states(), CALM_B), static=(3,))
    recorded = np.asarray(jax.vmap(jax.vmap(chart))(states))
    for n in (1, 2, 3):
        assert np.max(apart(recorded[:, n - 1], image(lanes, strobe, n))) < 10**n * ROUNDOFF  # the flow of n periods
    assert np.max(apart(recorded[:, 2], jax.vmap(chart)(last))) == 0


# ---- coordinates

angles = st.floats(-math.pi, math.pi)
places = st.floats(-10, 10)


@settings(deadline=None)
@given(places, places, angles)
def test_chart_and_back(x, y, theta):
    """The angle comes back modulo a whole turn, to the rounding of a sine, a cosine and an arc tangent."""
    u = np.array([x, y, theta])
    back = np.asarray(chart(unchart(jnp.asarray(u))))
    assert tuple(back[:2]) == (x, y)
    assert apart(back, u) < 8 * UNIT
    assert -math.pi <= back[2] <= math.pi


@settings(deadline=None)
@given(places, places, angles, st.integers(-5, 5))
def test_wrap_takes_whole_turns_out(x, y, theta, turns):
    """For arrays of NumPy and of JAX alike, and never outside of [−π, π]."""
    u = np.array([x, y, theta + 2 * math.pi * turns])
    for wrapped in (wrap(u), np.asarray(wrap(jnp.asarray(u)))):
        assert tuple(wrapped[:2]) == (x, y)
        assert apart(wrapped, [x, y, theta]) < 8 * 2 * math.pi * (1 + abs(turns)) * UNIT
        assert -math.pi <= wrapped[2] <= math.pi
    np.testing.assert_array_equal(wrap(np.stack([u, -u])), np.stack([wrap(u), wrap(-u)]))
