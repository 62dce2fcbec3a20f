"""Homoclinic orbits that begin at Bogdanov–Takens points, against the series of the normal form."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.continuation.equilibrium_curves import linearisations
from jaxnh.analyses.continuation.families import field_plane
from jaxnh.orbits.bifurcations.bogdanov_takens import amplitude_of, homoclinic_guess, unfold
from jaxnh.orbits.bifurcations.centre_manifold import LinearisedEquilibria
from jaxnh.orbits.collocation.connection_meshes import refined
from jaxnh.orbits.collocation.connections import VanishingPoint, connection_across, follow_connections
from jaxnh.orbits.continuation.paths import BOGDANOV_TAKENS, RANGE, StepControl
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.flows import bogdanov_takens
from tests.flows.bogdanov_takens import A, B
from tests.helpers.batches import batch_of
from tests.helpers.cycle_problems import problem_of

pytestmark = pytest.mark.usefixtures("quick_compiling")

NAMES, LOW, HIGH = ("p", "q"), -np.ones(2), np.ones(2)


def unfolded(define, lanes):
    """The field over (p, q), and the normal form at the origin."""
    flow = first_order(define, {"p": 0.0, "q": 0.0})
    d = flow.chart.dimension
    batch = batch_of(flow, flow.start(dict.fromkeys(flow.coordinates, 0.1)), [-1.0, 1.0], verner9, 40, name="p")
    batch.p["q"] = np.zeros(2)
    plane = field_plane(batch, lanes, np.ones(d), NAMES, LOW, HIGH)
    u, values = np.zeros((1, d)), np.zeros((1, 2))
    return plane, unfold(plane, LinearisedEquilibria(u, values, linearisations(plane, u, values)))


def orbit_near(define, guess):
    problem = problem_of(
        first_order(define, {"p": 0.0, "q": 0.0}, NAMES), NAMES, 0.5 * np.ptp(guess.path.path.ends[0], axis=0)
    )
    return problem, connection_across(problem, guess.path, guess.saddle, guess.saddle)


def test_guesses_and_orbits_of_the_normal_form_in_other_coordinates(lanes):
    """a and b; guesses across the curve of order ε² better than the curve's ε⁴; τ = 10/7 + 288/2401 (ε b / a)²."""
    plane, unfolding = unfolded(bogdanov_takens.bent, lanes)
    assert (unfolding.a, unfolding.b) == pytest.approx((A, B), rel=1e-12)
    amplitudes, misses, terms, states = np.array([0.1, 0.05, 0.025]), list[float](), list[float](), list[float]()
    for eps in amplitudes:
        guess = homoclinic_guess(unfolding, eps)
        _, orbit = orbit_near(bogdanov_takens.bent, guess)
        first, second = bogdanov_takens.betas(guess.path.values[0])
        own, term = bogdanov_takens.second_term(bogdanov_takens.betas(orbit.values), A, B)
        misses.append(abs(first + 4.0 / A * (second * A / B * 7.0 / 10.0) ** 2))
        states.append(np.abs(guess.saddle - orbit.departure.state).max())
        terms.append(term)
        assert own == pytest.approx(eps, rel=eps)
    assert np.diff(np.log2(misses))[-1] < -5.5  # of sixth order
    assert np.diff(np.log2(states))[-1] < -3.5  # of fourth, where orbits are of second
    before, last, _ = terms
    assert (4.0 * last - before) / 3.0 == pytest.approx(288.0 / 2401.0, abs=1e-6)  # the next term is of order ε²
    assert amplitude_of(plane, unfolding, 6.0 * 0.1**2 / A) == pytest.approx(0.1)


def test_a_curve_ends_where_its_orbits_vanish(lanes):
    """From the first orbit to the edge and towards the point; errors are small, the series holds all along."""
    _, unfolding = unfolded(bogdanov_takens.bent, lanes)
    problem, orbit = orbit_near(bogdanov_takens.bent, homoclinic_guess(unfolding, 0.15))
    largest = np.abs(orbit.solution.path.ends[0]).max(axis=0)
    vanishing = [VanishingPoint(np.zeros(3), 0.3 * largest)]
    curve = follow_connections(problem, orbit, -0.1 * np.ones(2), HIGH, StepControl(0.25, 40), vanishing)
    assert set(curve.ends) == {BOGDANOV_TAKENS, RANGE}
    points = [(stretch.problem, point) for stretch in curve.stretches for point in stretch.points]
    eps, terms = bogdanov_takens.second_term(bogdanov_takens.betas([point.values for _, point in points]), A, B)
    assert min(eps) < 0.09
    assert max(eps) > 0.19
    assert np.all(np.abs(terms - 288.0 / 2401.0)[eps > 0.1] < 0.05 * eps[eps > 0.1] ** 2)
    for own, point in (points[0], points[-1]):
        assert refined(own, point).error.max() < 1e-9


def test_sizes_go_with_orbits(lanes):
    """From an orbit of small amplitude to one that is ten times as large, in a few steps."""
    _, unfolding = unfolded(bogdanov_takens.bent, lanes)
    problem, orbit = orbit_near(bogdanov_takens.bent, homoclinic_guess(unfolding, 0.06))
    curve = follow_connections(problem, orbit, -0.1 * np.ones(2), HIGH, StepControl(0.25, 40), [])
    sizes = np.array([stretch.problem.size for stretch in curve.stretches])
    assert np.all(sizes.max(axis=0) > 5.0 * problem.size)
    assert RANGE in curve.ends


@pytest.mark.parametrize(
    "define",
    [
        pytest.param(lambda p=0.0, q=0.0: _flow(p, q, 1.0, 0.0, 1.0), id="b"),
        pytest.param(lambda p=0.0, q=0.0: _flow(p, q, 0.0, 1.0, 1.0), id="a"),
        pytest.param(lambda p=0.0, q=0.0: _flow(p, q, 1.0, 1.0, 0.0), id="parameters"),
    ],
)
def test_what_begins_no_curve(define, lanes):
    """Without a, without b, and where the second parameter does what the first one does."""
    assert unfolded(define, lanes)[1] is None


def _flow(p, q, a, b, unfolds):
    def rhs(y, t):
        w0, w1 = y
        return w1, p + (1.0 - unfolds) * q + unfolds * q * w1 + a * w0 * w0 + b * w0 * w1

    return {"rhs": rhs, "coordinates": ("w0", "w1")}
