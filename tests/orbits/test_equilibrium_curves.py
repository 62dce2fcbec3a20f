"""Curves of folds and Hopf points of equilibria, their points of codimension two, and the curves that leave there.

Points are compared with roots of their algebraic conditions in long double; coefficients with BifurcationKit's
tests (test/hopf_codim_2/lorenz84.jl), and curves of cycles with normal forms whose cycles are known in closed form.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import root

from jaxnh.analyses.continuation.cycle_curves import cycle_seeds
from jaxnh.analyses.continuation.equilibria import section_plane
from jaxnh.analyses.continuation.equilibrium_curves import follow_all, linearisations
from jaxnh.analyses.continuation.families import field_plane, parameter_plane
from jaxnh.maps.section import Section, begin
from jaxnh.orbits.bifurcations.codimension_two import POINTS, special_points
from jaxnh.orbits.continuation.curves import CURVE_STEPS, follow_both_ways
from jaxnh.orbits.continuation.equilibrium_curves import critical_equilibria
from jaxnh.orbits.continuation.kinds import FOLD, HOPF, KINDS
from jaxnh.orbits.continuation.paths import BOGDANOV_TAKENS, ENDS, MOST_POINTS, RANGE, StepControl
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.flows.bogdanov_takens import lorenz84, normal_form
from tests.helpers.batches import batch_of

pytestmark = pytest.mark.usefixtures("quick_compiling")

SHAPE = {"alpha": 0.25, "g": 0.25, "gamma": 0.987, "delta": 1.04}


class Problem(NamedTuple):
    """A flow with the field over its plane, and a section with its map over the same."""

    batch: object
    field: object
    returns: object
    section: object


def problem(define, low, high, lanes, section=("y", 1, 0.0), normal=None, steps=40, others=None):
    names, others = tuple(low), others or {}
    plain = first_order(define, low | dict.fromkeys(others, 1.0))
    coordinate, number, value = section
    flow = Section(plain, coordinate, number, value, "up", normal)
    d = plain.chart.dimension
    start = begin(flow, plain.start(dict.fromkeys(plain.coordinates, 0.1)))
    batch = batch_of(flow, start, [low[names[0]], high[names[0]]], verner9, steps, name=names[0])
    batch.p.update({name: np.full(2, value) for name, value in [*others.items(), (names[1], low[names[1]])]})
    ends = names, np.array(list(low.values())), np.array(list(high.values()))
    return Problem(
        batch,
        field_plane(batch, lanes, np.ones(d), *ends),
        parameter_plane(batch, lanes, batch.strobe(), np.ones(d - 1), *ends),
        flow,
    )


def curves_from(plane, kind, u, values):
    """All curves that one bifurcation leads to."""
    u, values = np.array([u], float), np.array([values], float)
    return follow_all(
        plane, [(kind, critical_equilibria(plane, kind, u, values, linearisations(plane, u, values)))], CURVE_STEPS
    )


# ---- Lorenz-84: all kinds of points


def conditions(at, names, shape=(0.25, 0.25, "0.987", "1.04")):
    """The field and coefficients of the characteristic polynomial of its linearisation, by name, in long double."""
    x, y, z, u, f, t = at
    alpha, g, gamma, delta = (np.longdouble(value) for value in shape)
    field = [
        -y * y - z * z - alpha * x + alpha * f - gamma * u * u,
        x * y - x * z - y + g,
        x * y + x * z - z,
        -delta * u + gamma * u * x + t,
    ]
    matrix = np.array(
        [
            [-alpha, -2 * y, -2 * z, -2 * gamma * u],
            [y - z, x - 1, -x, 0],
            [y + z, x, x - 1, 0],
            [gamma * u, 0, 0, gamma * x - delta],
        ]
    )
    coefficients, power, one = [np.longdouble(1)], np.zeros((4, 4), np.longdouble), np.eye(4, dtype=np.longdouble)
    for k in range(1, 5):  # Faddeev and LeVerrier
        power = matrix @ power + coefficients[-1] * one
        image = matrix @ power
        coefficients.append(-np.trace(image) / k)
    _, c3, c2, c1, c0 = coefficients
    tests = {
        "bogdanov_takens": (c0, c1),
        "zero_hopf": (c0, c3 * c2 - c1),
        "double_hopf": (c1, c3),
    }
    return np.array(field + list(tests[names]))


def newton(residual, at):
    """The root next to a point, by Newton with derivatives in double and residuals in long double."""
    at, shift = np.array(at, np.longdouble), np.longdouble(1e-9)
    columns = [(residual(at + shift * unit) - residual(at - shift * unit)) for unit in np.eye(len(at))]
    inverse = np.linalg.inv((np.array(columns).T / (2 * shift)).astype(float))
    for _ in range(5):
        at = at - inverse.astype(np.longdouble) @ residual(at)
    return at


@pytest.fixture(scope="module")
def lorenz(lanes):
    return problem(lorenz84, {"f": 1.0, "t": -0.1}, {"f": 3.2, "t": 0.1}, lanes, ("y", 1, -0.02))


@pytest.fixture(scope="module")
def lorenz_curves(lorenz):
    return curves_from(lorenz.field, FOLD, [1.2256, -0.0363, 0.1973, 0.1234], [1.4467, -0.0209])


def test_all_curves_of_lorenz84_from_one_fold(lorenz_curves):
    """From the curve of folds, Hopf curves leave at Bogdanov–Takens and zero–Hopf points, and cross at double Hopf ones.

    Every point is within its error of the root of its algebraic conditions.
    """
    kinds = [KINDS[one.curve.kind] for one in lorenz_curves]
    assert kinds == ["fold", "hopf", "hopf", "hopf"]
    names = [sorted(POINTS[p.point.kind] for p in one.points) for one in lorenz_curves]
    assert names[0] == ["bogdanov_takens", "bogdanov_takens", "cusp", "zero_hopf", "zero_hopf"]
    assert sorted(names[1:]) == [
        ["bogdanov_takens", "double_hopf", "generalised_hopf"],
        ["bogdanov_takens", "double_hopf", "generalised_hopf"],
        ["double_hopf", "double_hopf", "zero_hopf", "zero_hopf"],
    ]
    for point in (p for one in lorenz_curves for p in one.points):
        name = POINTS[point.point.kind]
        if name in ("cusp", "generalised_hopf"):
            continue
        exact = newton(partial(conditions, names=name), [*point.point.points[0], *point.point.values])
        assert np.all(np.abs(exact[4:] - point.point.values) <= point.error)
        assert np.all(point.error < 1e-13)
        assert np.abs(exact[:4] - point.point.points[0]).max() < 1e-11
    cusp = next(p for p in lorenz_curves[0].points if POINTS[p.point.kind] == "cusp")
    assert abs(cusp.point.values[1]) <= cusp.error[1]  # u -> -u, t -> -t is a symmetry


@pytest.mark.parametrize("count", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_errors_of_points_at_random_parameters(lanes, lorenz_curves, count):
    """Of 95 in 100 points the error covers how far the root of the algebraic conditions is; of none it is far too large.

    From a Bogdanov–Takens point, which moves with the other parameters up to a twentieth beside the model's; zero–Hopf
    points are not at all of these.
    """
    known = next(p for p in lorenz_curves[0].points if POINTS[p.point.kind] == "bogdanov_takens").point
    rng, base, rows = np.random.default_rng(2), np.array(list(SHAPE.values())), []
    for _ in range(count):
        shape, at = base * (1.0 + rng.uniform(-0.05, 0.05, 4)), [*known.points[0], *known.values]
        for share in (0.25, 0.5, 0.75, 1.0):
            at = newton(partial(conditions, names="bogdanov_takens", shape=base + share * (shape - base)), at)
        others = dict(zip(SHAPE, shape, strict=True))
        field = problem(
            lorenz84, {"f": 1.0, "t": -0.1}, {"f": 3.2, "t": 0.1}, lanes, ("y", 1, -0.02), others=others
        ).field
        for point in (p for one in curves_from(field, FOLD, at[:4], at[4:]) for p in one.points):
            name, values = POINTS[point.point.kind], point.point.values
            if name not in ("cusp", "generalised_hopf"):
                exact = newton(partial(conditions, names=name, shape=shape), [*point.point.points[0], *values])
                rows += [*zip(np.abs(exact[4:] - values).astype(float), point.error, strict=True)]
    misses, errors = np.array(rows).T
    assert len(rows) >= 20 * count
    assert np.mean(misses <= errors) >= 0.95
    assert np.median(errors) < 100.0 * np.quantile(misses, 0.95)


def test_errors_of_points_far_from_the_origin_of_a_coordinate(lanes):
    """The last digits of w₀ leave its equations off, and the point, at p = q = 0, by more than those of p and q do."""
    low, high, rows = {"p": -0.5, "q": -0.4}, {"p": 0.47, "q": 0.43}, []
    for origin in (0.0, *np.random.default_rng(3).uniform(500.0, 2000.0, 6)):
        others = {"origin": float(origin), "more": 0.37}
        field = problem(normal_form, low, high, lanes, ("w1", 1, 0.001), others=others | {"b": -1.0}).field
        curves = curves_from(field, FOLD, [origin + 0.37, 0.0], [0.0, 0.2])
        rows += [
            (abs(miss), error, origin)
            for point in (point for one in curves for point in one.points)
            if POINTS[point.point.kind] == "bogdanov_takens"
            for miss, error in zip(point.point.values, point.error, strict=True)
        ]
    misses, errors, origins = np.array(rows).T
    assert len(rows) == 28  # from the curve of folds and from that of Hopf points
    assert np.all(misses <= errors)
    assert errors.max() < 1e-11
    assert errors[origins == 0.0].max() < 1e-14


def test_hopf_curves_end_at_bogdanov_takens_points(lorenz_curves):
    fold, *hopf = lorenz_curves
    ends = [one.curve.values[k] for one in hopf for k in (0, -1) if one.curve.ends[k] == BOGDANOV_TAKENS]
    points = [p.point.values for p in fold.points if POINTS[p.point.kind] == "bogdanov_takens"]
    # Twins have one value of the first parameter, whose last digit is not to decide their order.
    known, met = (sorted((tuple(pair) for pair in pairs), key=lambda pair: pair[1]) for pairs in (points, ends))
    assert np.array(met) == pytest.approx(np.array(known), abs=1e-13)
    assert ENDS[BOGDANOV_TAKENS] == "bogdanov_takens"


def test_normal_forms_of_lorenz84(lorenz_curves):
    """a and b of Bogdanov–Takens points as in BifurcationKit's tests, to all of their digits.

    Its c₂ of the generalised Hopf point, G₃₂/12, is of a point that is bisected: test/hopf_codim_2/lorenz84.jl has
    1.86946 for Re G₃₂ to 1e-3.
    """
    forms = {}
    for one in lorenz_curves:
        for point, form in zip(one.points, one.forms, strict=True):
            forms.setdefault(POINTS[point.point.kind], []).append(form)
    for form in forms["bogdanov_takens"]:
        assert form.coefficients[:2] == pytest.approx([0.2144233509273467, 0.6065145518280868], rel=1e-9)
    for form in forms["generalised_hopf"]:
        assert 12.0 * form.coefficients[0] == pytest.approx(1.8694569030805148, abs=1e-3)
        critical = min(np.linalg.eigvals(form.at.matrix[0]), key=lambda value: abs(value.real))
        assert abs(critical.imag) == pytest.approx(0.6903636672622595, abs=1e-5)
    first, *others = [form.coefficients for form in forms["double_hopf"]]
    for other in others:  # one point on two curves, and its mirror image
        assert other == pytest.approx(first, rel=1e-9)
    for form in forms["zero_hopf"]:
        assert form.coefficients[:3] == pytest.approx(forms["zero_hopf"][0].coefficients[:3], rel=1e-9)


# ---- closed forms


def planar(mu=0.0, beta=0.0):
    """w' = (μ + 2i) w + β w|w|² − w|w|⁴: cycles fold along μ = −β²/4, β > 0."""

    def rhs(state, time):
        x, y = state
        square = x * x + y * y
        growth = mu + beta * square - square * square
        return growth * x - 2.0 * y, growth * y + 2.0 * x

    return {"rhs": rhs, "coordinates": ("x", "y")}


def two_pairs(mu=0.0, nu=0.0):
    """w₁' = (μ + i) w₁ − w₁(|w₁|² + 2|w₂|²), w₂' = (ν + 2.3i) w₂ + w₂(|w₁|²/2 − |w₂|²): tori at ν = −μ/2 and μ = 2ν."""

    def rhs(state, time):
        x, y, v, w = state
        one, other = x * x + y * y, v * v + w * w
        first, second = mu - one - 2.0 * other, nu + 0.5 * one - other
        return first * x - y, first * y + x, second * v - 2.3 * w, second * w + 2.3 * v

    return {"rhs": rhs, "coordinates": ("x", "y", "v", "w")}


def zero_and_pair(beta=0.0, nu=0.0):
    """z' = β + z² − |w|², w' = (ν + 2i) w + w (3z + |w|²/5): tori where z = −|w|²/5, that is ν = 2|w|²/5."""

    def rhs(state, time):
        x, y, z = state
        square = x * x + y * y
        growth = nu + 3.0 * z + 0.2 * square
        return growth * x - 2.0 * y, growth * y + 2.0 * x, beta + z * z - square

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


PLANE = -0.5, 0.6
CLOSED = [
    (planar, ("mu", "beta"), [0.0, 0.0], HOPF, [0.0, 0.2], "generalised_hopf", "fold", 1),
    pytest.param(
        *(two_pairs, ("mu", "nu"), [0.0] * 4, HOPF, [0.0, 0.2], "double_hopf", "neimark_sacker", 2),
        marks=pytest.mark.slow,
    ),
    pytest.param(
        *(zero_and_pair, ("beta", "nu"), [0.0] * 3, FOLD, [0.0, 0.2], "zero_hopf", "neimark_sacker", 1),
        marks=pytest.mark.slow,
    ),
]


def misses(define, values):
    """How far both parameters are from the curves in closed form."""
    first, second = values.T
    if define is planar:
        return np.abs(first + second**2 / 4)
    if define is two_pairs:
        return np.minimum(np.abs(second + first / 2), np.abs(first - 2 * second))
    square = second / 0.4  # |w|²; β = |w|² − |w|⁴/25
    return np.abs(first - square + 0.04 * square**2)


@pytest.mark.parametrize(("define", "names", "u", "kind", "values", "name", "born", "count"), CLOSED)
def test_curves_of_cycles_from_points(lanes, define, names, u, kind, values, name, born, count):
    """Folds and tori that leave a point of codimension two of a normal form, all along, as the closed form has them."""
    low, high = (dict.fromkeys(names, end) for end in PLANE)
    normal = (0.0, 1.0, 1.0, 0.0) if define is two_pairs else None  # which cycles of both pairs cross
    flow = problem(define, low, high, lanes, normal=normal)
    [curve, *_] = curves_from(flow.field, kind, u, values)
    [(point, form)] = [
        pair for pair in zip(curve.points, curve.forms, strict=True) if POINTS[pair[0].point.kind] == name
    ]
    assert np.all(np.abs(point.point.values) <= point.error)
    section = section_plane(flow.section)
    seeds = cycle_seeds(flow.field, flow.returns, section, [(point, form)])
    curves = [
        curve
        for seed in seeds
        for curve in follow_both_ways(
            flow.returns, seed.kind, seed.points[None], seed.values[None], StepControl(0.1, 20)
        )
    ]
    assert [KINDS[one.kind] for one in curves] == [born] * count
    for one in curves:
        # The map's error in 40 steps of order nine a unit of time is below 1e-11; multipliers near one resolve a
        # parameter ten times less well.
        assert misses(define, one.values).max() < 1e-9
        assert len(one.values) > 5


def test_folds_of_cycles_that_leave_the_section(lanes):
    """At y = 0.05, which small cycles do not reach: μ = −β²/4 nearly down to r² = β/2 = 0.05², and no cusp on it."""
    low, high = (dict.fromkeys(("mu", "beta"), end) for end in PLANE)
    returns = problem(planar, low, high, lanes, ("y", 1, 0.05)).returns
    x = np.sqrt(0.1 - 0.05**2)
    [curve] = follow_both_ways(returns, FOLD, np.array([[[x]]]), np.array([[-0.01, 0.2]]), StepControl(0.05, 100))
    assert misses(planar, curve.values).max() < 1e-9
    assert 0.005 < curve.values[:, 1].min() < 0.0055
    assert ENDS[curve.ends[int(curve.values[0, 1] > 0.1)]] in ("no_return", "no_convergence")
    assert special_points(returns, curve) == []


def test_a_curve_of_equilibria_that_is_cut_is_listed_once(lanes):
    """Parts of one Hopf curve, cut by `max_steps`, that overlap: μ = 0 from end to end, with its point once."""
    field = problem(planar, {"mu": PLANE[0], "beta": PLANE[0]}, {"mu": PLANE[1], "beta": PLANE[1]}, lanes).field
    seeds = []
    for beta in (-0.3, 0.05, 0.4):
        u, values = np.zeros((1, 2)), np.array([[0.0, beta]])
        seeds.append((HOPF, critical_equilibria(field, HOPF, u, values, linearisations(field, u, values))))
    parts = [one.curve for seed in seeds for one in follow_all(field, [seed], StepControl(0.05, 9))]
    assert all(MOST_POINTS in part.ends for part in parts)
    [whole] = follow_all(field, seeds, StepControl(0.05, 9))
    assert whole.curve.ends == (RANGE, RANGE)
    assert [POINTS[p.point.kind] for p in whole.points] == ["generalised_hopf"]
    beta = whole.curve.values[:, 1]
    assert sorted(beta[[0, -1]]) == pytest.approx(PLANE)
    assert np.all(np.diff(beta) * (beta[-1] - beta[0]) > 0.0)  # no point twice


# ---- Bazykin's predator and prey


def bazykin(alpha=0.3, delta=0.2):
    """Bazykin's predator and prey, γ = 1, ε = 0.01 (Kuznetsov, Elements of Applied Bifurcation Theory, 2004, 8.4)."""

    def rhs(state, time):
        x, y = state
        eaten = x * y / (1.0 + alpha * x)
        return x - eaten - 0.01 * x * x, -y + eaten - delta * y * y

    return {"rhs": rhs, "coordinates": ("x", "y")}


def bazykin_conditions(at):
    """The field, the trace and the determinant of its linearisation, in long double."""
    x, y, alpha, delta = at
    share, small = 1 + alpha * x, np.longdouble("0.01")
    eaten, by_x, by_y = x * y / share, y / share**2, x / share
    a, b, c, d = 1 - by_x - 2 * small * x, -by_y, by_x, -1 + by_y - 2 * delta * y
    return np.array([x - eaten - small * x * x, -y + eaten - delta * y * y, a + d, a * d - b * c])


def test_bogdanov_takens_points_of_bazykin(lanes):
    """On the curve of folds, within their errors of the roots of their conditions; each begins a curve of Hopf points."""
    low, high = {"alpha": 0.05, "delta": 0.01}, {"alpha": 1.0, "delta": 0.6}
    flow = problem(bazykin, low, high, lanes, ("y", 1, 1.0))
    x, y, alpha, delta = root(lambda at: bazykin_conditions(at).astype(float), [3.0, 1.9, 0.3, 0.2]).x
    curves = curves_from(flow.field, FOLD, [x, y], [alpha, delta])
    points = [p for one in curves for p in one.points if POINTS[p.point.kind] == "bogdanov_takens"]
    assert KINDS[curves[0].curve.kind] == "fold"
    assert len(points) >= 2
    assert any(KINDS[one.curve.kind] == "hopf" for one in curves)
    for point in points:
        at = newton(bazykin_conditions, [*point.point.points[0], *point.point.values])
        assert np.all(np.abs(at[2:] - point.point.values) <= point.error)
        assert np.all(point.error < 1e-12)
