"""Written-out Runge–Kutta methods: their order, and diffrax's own implementation of the same tableaus."""

from __future__ import annotations

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.solvers import RUNGE_KUTTA
from jaxnh.solvers.runge_kutta import two_half_steps
from jaxnh.systems.particle import CHART
from tests.flows.calm_particle import CALM
from tests.flows.particle import STATES, SYSTEMS, B, twin
from tests.helpers import taylor
from tests.helpers.cases import some_slow
from tests.helpers.convergence import order_of
from tests.helpers.diffrax_solvers import RungeKuttaSolver
from tests.helpers.measurement import UNIT, largest_difference

pytestmark = pytest.mark.usefixtures("quick_compiling")

methods = pytest.mark.parametrize("solver", RUNGE_KUTTA.values(), ids=RUNGE_KUTTA)
OWN = {name: getattr(diffrax, name.capitalize()) for name in RUNGE_KUTTA if hasattr(diffrax, name.capitalize())}


@pytest.mark.parametrize("solver", some_slow(dict(RUNGE_KUTTA), "tsit5", "verner9"))
@pytest.mark.parametrize("system", some_slow(CALM, "disturbed"))
def test_order_under_diffrax(system, solver):
    """A wrong coefficient costs one order at least, so half an order less is its sign.

    At coarse steps the next term of the error, one order up, may still lead: it cannot lift the slope by more.
    """
    assert solver.convergence_order - 0.5 < order_of(system, solver) < solver.convergence_order + 1.5


@pytest.mark.parametrize("name", OWN)
def test_tableau_is_that_of_diffrax(name):
    """Both have it from the article that is named, to the last bit."""
    ours, theirs = RUNGE_KUTTA[name], OWN[name].tableau
    for row, other in zip(ours.a[1:], theirs.a_lower, strict=True):
        np.testing.assert_array_equal(row, other)
    np.testing.assert_array_equal(ours.c[1:], theirs.c)
    np.testing.assert_array_equal(ours.b, theirs.b_sol)
    np.testing.assert_array_equal(ours.b_error, theirs.b_error)


@pytest.mark.parametrize("name", OWN)
def test_step_is_that_of_diffrax(name):
    """State and error estimate of one step, to the rounding of a sum over stages in another order."""
    term = diffrax.ODETerm(SYSTEMS["disturbed"].rhs)
    solver, own = RungeKuttaSolver(RUNGE_KUTTA[name]), OWN[name]()

    def step(solver, u, b):
        state = CHART.state(u)
        memory = solver.init(term, 0.3, 0.5, state, {"b": b})
        end, error, *_ = solver.step(term, 0.3, 0.5, state, {"b": b}, memory, False)
        return end, error

    ours = jax.jit(jax.vmap(lambda u, b: step(solver, u, b)))(STATES, B)
    theirs = jax.jit(jax.vmap(lambda u, b: step(own, u, b)))(STATES, B)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        # Stages are below 1 and coefficients below 40: fifteen products, of which each is rounded twice.
        assert np.abs(np.asarray(one) - np.asarray(other)).max() < 2 * 15 * 40 * UNIT


@methods
def test_error_estimate_is_of_the_embedded_order(solver):
    """Both solutions integrate powers of t up to the order of the lower one: their difference is then rounding.

    An abscissa is a sum of coefficients, which are rounded, and its power k has k times that.
    """
    weights, c = np.array(solver.b_error), np.array(solver.c)
    rounding = 4 * UNIT * np.abs(weights) @ [1.0 + sum(map(abs, row)) for row in solver.a]
    for k in range(solver.convergence_order - 1):
        assert abs(weights @ c**k) < (1 + k) * rounding
    assert abs(weights @ c ** (solver.convergence_order - 1)) > 1e-7


@methods
def test_stages_are_those_the_solution_needs(solver):
    """A stage is needed if a value that is not a number there reaches the solution."""

    def end(poisoned):
        calls = iter(range(100))
        term = diffrax.ODETerm(lambda t, y, args: np.nan if next(calls) == poisoned else -y)
        return RungeKuttaSolver(solver).step(term, 0.0, 0.1, np.float64(1.0), None, None, False)[0]

    assert sum(np.isnan(end(poisoned)) for poisoned in range(20)) == solver.stages
    assert abs(end(None) - np.exp(-0.1)) < 0.1**solver.convergence_order / 120


@methods
def test_two_half_steps(solver):
    """As two steps of half the length; sums of twice as many products, each below 40, are rounded otherwise."""

    def step(method, t, h, y):
        return method.written_stages(lambda i, z: jnp.cos(t + method.c[i] * h) - z * z, h, y)

    twice = two_half_steps(solver)
    assert twice.stages == 2 * solver.stages
    apart = step(solver, 0.25, 0.2, step(solver, 0.05, 0.2, 0.3)) - step(twice, 0.05, 0.4, 0.3)
    assert abs(apart) < 2 * 30 * 40 * UNIT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tsit5", "dopri8"])
def test_adaptive_steps(name):
    """Under a PID controller: the same steps as diffrax's own, and the tolerance of a step, added up, as the error."""
    solver = RungeKuttaSolver(RUNGE_KUTTA[name])
    system, tolerance = SYSTEMS["disturbed"], 1e-9
    exact = taylor.strobe(twin(system), B, STATES)

    def solve(solver, u, b):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(system.rhs),
            solver,
            0.0,
            system.period,
            0.01,
            CHART.state(u),
            args={"b": b},
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        )
        return CHART.point(jax.tree.map(lambda leaf: leaf[-1], solution.ys)), solution.stats["num_accepted_steps"]

    ours, steps = jax.jit(jax.vmap(lambda u, b: solve(solver, u, b)))(STATES, B)
    theirs, their_steps = jax.jit(jax.vmap(lambda u, b: solve(OWN[name](), u, b)))(STATES, B)
    assert np.abs(np.asarray(steps) - np.asarray(their_steps)).max() <= 1
    monodromy = taylor.strobe_jacobian(twin(system), B, STATES)[1].astype(float)
    allowed = tolerance * np.asarray(steps) * np.maximum(np.linalg.norm(monodromy, 2, axis=(1, 2)), 1)
    assert np.all(largest_difference(ours, exact) < allowed)
    assert np.all(largest_difference(ours, theirs) < allowed)
