"""Isokinetic splittings: their order by algebra and by measurement, the kick in closed form, and what they conserve."""

from __future__ import annotations

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipe

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import SPLITTINGS, kick
from jaxnh.systems.particle import CHART
from tests.flows.calm_particle import CALM
from tests.flows.particle import LANES, STATES, SYSTEMS, B
from tests.helpers.cases import some_slow
from tests.helpers.convergence import order_of
from tests.helpers.diffrax_solvers import SplittingSolver, isokinetic_terms
from tests.helpers.measurement import UNIT

systems = pytest.mark.parametrize("system", some_slow(SYSTEMS, "other"))  # which has all effects
some_splittings = pytest.mark.parametrize("solver", some_slow(dict(SPLITTINGS), "strang2", "processed6"))
splittings = pytest.mark.parametrize("solver", SPLITTINGS.values(), ids=SPLITTINGS)


# ---- order


def times_exponential(series, letter, a):
    """A series in the words of two letters, times exp(a · letter).

    The series is a list over lengths; words of one length are the bits of an index, their last letter its lowest.
    """
    product = []
    for length in range(len(series)):
        total = series[length].copy()
        for j in range(1, length + 1):  # words that end in j times this letter
            ending = (1 << j) - 1 if letter else 0
            total[ending :: 1 << j] += series[length - j] * (a**j / math.factorial(j))
        product.append(total)
    return product


def words(solver, longest, modulus=False):
    """Coefficients of all words in the product of a step's exponentials; with |coefficients| an upper bound of them.

    Of a processed method with the processor before the step and its inverse after it.
    """
    series = [np.array([1.0]), *(np.zeros(2**length) for length in range(1, longest + 1))]
    (drifts, kicks), size = solver.processor, abs if modulus else float
    back = [-drift for drift in drifts[::-1]], [-kick for kick in kicks[::-1]]
    for row in ((drifts, kicks), (solver.drifts, solver.kicks), back):
        for a, b in itertools.zip_longest(*row, fillvalue=0.0):
            series = times_exponential(times_exponential(series, 0, size(a)), 1, size(b))
    return series


@splittings
def test_order_by_algebra(solver):
    """The step equals exp(h(A + B)), whose words of length k all have 1/k!, up to its order, and not one length more.

    Coefficients have fifteen digits at least, and each of some 2 stages products is rounded.
    """
    order = solver.convergence_order
    ours, bounds = words(solver, order + 1), words(solver, order + 1, modulus=True)
    for length in range(order + 2):
        defect = np.abs(ours[length] - 1 / math.factorial(length))
        allowed = 2 * solver.total_kicks(1) * 10 * UNIT * bounds[length]
        if length <= order:
            assert np.all(defect <= allowed)
        else:
            assert np.any(defect > 10 * allowed)


@splittings
def test_coefficients_sum_to_one(solver):
    """And read the same backwards; those of a processor sum to zero."""
    for row in solver.processor:
        assert abs(math.fsum(row)) <= 2 * len(row) * UNIT
    for row in (solver.drifts, solver.kicks):
        assert abs(math.fsum(row) - 1) < 2 * len(row) * UNIT
        np.testing.assert_allclose(row, row[::-1], rtol=0, atol=2 * UNIT)
    assert len(solver.drifts) == solver.stages + 1


@pytest.mark.parametrize("solver", some_slow(SPLITTINGS, "strang2", "blanes_moan4", "processed6"))
@pytest.mark.parametrize("system", some_slow(CALM, "disturbed"))
def test_order_measured(system, solver):
    """Under plain diffrax, or of a processed method, whose processor diffrax does not know, that of the strobe map.

    A wrong coefficient costs a symmetric method two orders or more, so half an order less is its sign.

    At coarse steps the next term of the error, two orders up, may still lead: it cannot lift the slope by more. Where
    the first term was made small for this very flow, as with the processed method, several more lead down to rounding.
    """
    most = math.inf if solver.processor[1] else solver.convergence_order + 2.5
    assert solver.convergence_order - 0.5 < order_of(system, solver) < most


# ---- the kick


def exact_kick(n, f):
    """n turned under a frozen force: (n + e (sinh F + p (cosh F − 1))) / (cosh F + p sinh F), e = f/F, p = e·n.

    In long double, and times exp(−F) above and below, so that nothing overflows; 1 + p is exact where e and n are
    nearly opposite, as the half of |e + n|².
    """
    n, f = (np.array(v, dtype=np.longdouble) for v in (n, f))
    size = np.sqrt((f**2).sum(axis=0))
    e = f / size
    n = n / np.sqrt((n**2).sum(axis=0))
    p = (e * n).sum(axis=0)
    p_plus_one = ((e + n) ** 2).sum(axis=0) / 2
    decay = np.exp(-size)
    sinh, cosh_less_one = (1 - decay**2) / 2, (1 - decay) ** 2 / 2
    return (n * decay + e * (sinh + p * cosh_less_one)) / (decay**2 + p_plus_one * sinh)


def draw(count, largest):
    """n of length one to rounding, and f with |f| up to a largest, (2, count) each."""
    rng = np.random.default_rng(5)
    (theta, phi), size = rng.uniform(-np.pi, np.pi, (2, count)), rng.uniform(0, largest, count)
    return np.array([np.cos(theta), np.sin(theta)]), size * np.array([np.cos(phi), np.sin(phi)])


def kicked(n, f):
    return np.array(jax.jit(kick)(tuple(n), tuple(f)))


def test_kick_is_exact_to_rounding():
    """|f| ≤ 1, of which a step of any use is a small part: nine roundings of numbers up to one stay below 1e-15."""
    n, f = draw(100_000, 1.0)
    assert np.abs(kicked(n, f) - exact_kick(n, f)).max() < 9 * UNIT


@pytest.mark.parametrize("largest", [5.0, 30.0])
def test_strong_kick(largest):
    """|f| of any size: an error of n or f by a rounding turns the result by up to exp(|f|) times that."""
    n, f = draw(100_000, largest)
    away = np.sqrt(((f / np.sqrt((f**2).sum(axis=0)) + n) ** 2).sum(axis=0))  # of the direction that is unstable
    strongest = np.exp(np.sqrt((f**2).sum(axis=0)))
    slope = np.minimum(strongest, 4 / away**2 + 1)  # of the turn in the start angle, from the closed form
    error = np.abs(kicked(n, f) - exact_kick(n, f)).max(axis=0)
    assert np.all(error < 9 * UNIT * (1 + slope) * (1 + largest))


def test_kick_of_any_dimension():
    """In three dimensions n turns in the plane of n and f: the same as in the plane, rotated."""
    n, f = draw(1000, 1.0)
    rotation, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    lift = rotation[:, :2]
    assert np.abs(kicked(lift @ n, lift @ f) - lift @ kicked(n, f)).max() < 40 * UNIT


def test_no_force_no_turn():
    n, _ = draw(100, 1.0)
    assert np.abs(kicked(n, np.zeros_like(n)) - n).max() < 4 * UNIT


# ---- what a step conserves


@systems
@some_splittings
def test_step_is_symmetric_in_time(system, solver):
    """A step from t to t + h and one from there back to t return to the start, to rounding.

    A kick has some ten roundings; what a step of a period's fiftieth enlarges them by is below ten.
    """
    terms, steps = isokinetic_terms(system), SplittingSolver(solver)

    def there_and_back(u, b, t, h):
        there = steps.step(terms, t, t + h, CHART.state(u), {"b": b}, None, False)[0]
        return there, steps.step(terms, t + h, t, there, {"b": b}, None, False)[0]

    t = np.linspace(0, system.period, LANES)
    there, back = jax.vmap(there_and_back)(STATES, B, t, np.full(LANES, 2 * np.pi / 50))  # compiling takes longer
    start = jax.vmap(CHART.state)(jnp.asarray(STATES))
    moved = [
        [
            np.abs(np.asarray(a) - np.asarray(b))
            for a, b in zip(jax.tree.leaves(end), jax.tree.leaves(start), strict=True)
        ]
        for end in (there, back)
    ]
    assert np.min(np.max(moved[0], axis=0)) > 1e-3
    assert np.max(moved[1]) < 2 * 10 * 10 * solver.stages * UNIT


@systems
@some_splittings
def test_unit_vector_stays_one(system, solver):
    """|n| = 1 over 1000 periods: no error of the method, only roundings, and these add up at random.

    Each kick changes |n| by a random rounding of about one unit; no lane of 256 goes further than six standard
    deviations of their sum.
    """
    count, periods, steps = 256, 1000, max(1, 1000 // solver.stages)
    start = (np.full(count, 0.1),) * 2, (np.full(count, 0.1), np.full(count, math.sqrt(0.99)))
    _, n = LaneExecutor()(
        iterate, (make_return_map(system, solver, steps), np.int32(periods)), (start, {"b": np.linspace(0.1, 6, count)})
    )
    length = np.hypot(*(np.asarray(component, np.longdouble) for component in n))
    assert np.abs(length - 1).max() < 6 * 2 * UNIT * math.sqrt(periods * steps * solver.stages)


# ---- the table of kicks


@systems
@splittings
def test_schedule_of_a_period(system, solver):
    """Drifts sum to the path length of a period, and kicks over the speed to ∫ dt/s, up to the error of the method."""
    steps = 400
    grid = np.linspace(0, system.period, steps + 1)
    rows = solver.schedule(system, grid[:-1], grid[1:])
    turns = system.period / (2 * np.pi)
    m = 2 * system.d / (system.c + system.d)
    way = 4 * turns * math.sqrt(system.c + system.d) * ellipe(m)
    assert abs(rows.drift.sum() - way) < 8 * steps * UNIT * way
    # A symmetric quadrature of a smooth periodic function: even a grid of 400 points is exact to rounding.
    t = np.linspace(0, system.period, 4000, endpoint=False)
    time = (1 / np.sqrt(system.c + system.d * np.sin(t))).mean() * system.period
    assert abs(rows.weight.sum() - time) < 100 * steps * UNIT * time
    forced = ((1 + np.sin(system.omega * t)) / np.sqrt(system.c + system.d * np.sin(t))).mean() * system.period
    assert abs(rows.forcing.sum() - forced) < 100 * steps * UNIT * forced
