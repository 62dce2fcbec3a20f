"""Curves of bifurcations over two parameters and what they pass through, against closed forms and against heyoka."""

from __future__ import annotations

import heyoka as hy
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.analyses.continuation.families import parameter_plane
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.codimension_two import POINTS, special_points
from jaxnh.orbits.bifurcations.curve_errors import errors_of_points, errors_of_special, refine_curve
from jaxnh.orbits.continuation.curves import ParameterPlane, follow_both_ways
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, NEIMARK_SACKER
from jaxnh.orbits.continuation.paths import CLOSED, RANGE, RESONANCE, StepControl
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.helpers import taylor
from tests.helpers.batches import batch_of
from tests.helpers.heyoka_newton import determinant, newton, strobe_map

ROUNDING = 1e-11  # unknowns of order one; Newton's last step is below 1e-9 and shrinks by 1e-6


def plane(period, d, low, high):
    return ParameterPlane(period, lambda gap: gap, np.ones(d), np.array(low, float), np.array(high, float))


def henon(u, values):
    """(x, y) → (1 − a x² + y, b x)."""
    (x, y), (a, b), zero = u.T, values.T, np.zeros(len(u))
    matrix = np.array([[-2 * a * x, zero + 1], [b, zero]]).transpose(2, 0, 1)
    columns = np.array([[-(x**2), zero], [zero, x]]).transpose(2, 0, 1)
    return Derivatives(np.stack([1 - a * x**2 + y, b * x], 1), matrix, columns)


HENON = plane(henon, 2, (-1.5, -1.2), (4.0, 0.5))


def fixed(a, b):
    """The fixed point of Hénon's map with the larger x."""
    x = (-(1 - b) + np.sqrt(max((1 - b) ** 2 + 4 * a, 0.0))) / (2 * a)
    return [[x, b * x]]


def passed(curve, map_plane):
    """What a curve passes through: name and parameters."""
    return [(POINTS[point.kind], *point.values) for point in special_points(map_plane, curve)]


def test_curves_of_henon():
    """Folds a = −(1 − b)²/4, doublings a = 3(1 − b)²/4, and at b = −1 all resonances.

    There the multipliers are e^(±iθ) with cos θ = 1 − √(1 + a).
    """
    [fold] = follow_both_ways(HENON, FOLD, np.array([fixed(-0.25, 0.0)]), np.array([[-0.25, 0.0]]))
    assert fold.ends == (RANGE, RANGE)
    a, b = fold.values.T
    assert np.abs(a + (1 - b) ** 2 / 4).max() < ROUNDING
    assert sorted(b[[0, -1]]) == pytest.approx([-1.2, 0.5])
    [(name, *at)] = passed(fold, HENON)
    assert name == "resonance_1_1"
    # Both multipliers are one: of det(M − 1), which is zero to rounding, they are known to its root; so at 1:2 below.
    assert at == pytest.approx([-1.0, -1.0], abs=1e-7)

    [doubling] = follow_both_ways(HENON, DOUBLING, np.array([fixed(0.75, 0.0)]), np.array([[0.75, 0.0]]))
    a, b = doubling.values.T
    assert np.abs(a - 3 * (1 - b) ** 2 / 4).max() < ROUNDING
    [(name, *at)] = passed(doubling, HENON)
    assert name == "resonance_1_2"
    assert at == pytest.approx([3.0, -1.0], abs=1e-7)

    [torus] = follow_both_ways(HENON, NEIMARK_SACKER, np.array([fixed(0.5, -1.0)]), np.array([[0.5, -1.0]]))
    assert torus.ends == (RESONANCE, RESONANCE)
    assert np.abs(torus.values[:, 1] + 1).max() < ROUNDING
    known = {"resonance_1_1": -1.0, "resonance_1_4": 0.0, "resonance_1_3": 1.25, "resonance_1_2": 3.0}
    found = {name: (a, b) for name, a, b in passed(torus, HENON) if name != "chenciner"}  # it keeps areas
    assert set(found) == set(known)
    for name, exact in known.items():
        near = 1e-6 if name == "resonance_1_1" else ROUNDING  # the multipliers there go like a root
        assert found[name] == pytest.approx((exact, -1.0), abs=near)


def wavy(u, values):
    """x → a + c x + 0.7 x² − 0.4 x³ + 0.2 x⁴ − 0.1 x⁵, in parameters (a, c)."""
    x, (a, c) = u[:, 0], values.T
    slope = c + x * (1.4 + x * (-1.2 + x * (0.8 - 0.5 * x)))
    image = a + x * (c + x * (0.7 + x * (-0.4 + x * (0.2 - 0.1 * x))))
    return Derivatives(image[:, None], slope[:, None, None], np.stack([0 * x + 1, x], 1)[:, None])


WAVY = plane(wavy, 1, (-2.0, -3.0), (2.0, 3.0))


@pytest.mark.parametrize(("kind", "multiplier"), [(FOLD, 1.0), (DOUBLING, -1.0)])
def test_bars_of_points_of_maps(kind, multiplier):
    """A map has no finer one: what is left is rounding, which the bars cover at 95 in 100 points.

    Of a critical x the parameters are c = μ − F′(x) and a = x − c x − F(x), in extended precision; slopes of the curve,
    da/dc = −x − (1 − μ)/F″, say how far the bars of both parameters reach.
    """
    x = np.longdouble(0.1)
    c = multiplier - (x * (1.4 + x * (-1.2 + x * (0.8 - 0.5 * x))))
    start = np.array([[float(x - c * x - x * x * (0.7 + x * (-0.4 + x * (0.2 - 0.1 * x)))), float(c)]])
    [curve] = follow_both_ways(WAVY, kind, np.array([[[float(x)]]]), start)
    errors = errors_of_points(WAVY, curve, [refine_curve(WAVY, curve)] * 2)
    a, c = curve.values.T.astype(np.longdouble)
    x = curve.points[:, 0, 0].astype(np.longdouble)
    # Coefficients as the map has them, in double precision.
    two, three, four, five = (np.longdouble(k) for k in (0.7, -0.4, 0.2, -0.1))
    for _ in range(4):
        bend = 2 * two + x * (6 * three + x * (12 * four + 20 * five * x))
        x = x - (c + x * (2 * two + x * (3 * three + x * (4 * four + 5 * five * x))) - multiplier) / bend
    off = np.abs(a - (x - c * x - x * x * (two + x * (three + x * (four + five * x)))))
    bars = errors[:, 0] + np.abs(-x - (1 - multiplier) / bend) * errors[:, 1]
    regular = np.abs(bend) > 0.05  # beside a cusp c says little of a
    assert np.mean((off <= bars)[regular]) >= 0.95
    assert np.median(bars[regular]) < 1e-13


@pytest.mark.parametrize(
    ("kind", "multiplier", "name"), [(FOLD, 1.0, "cusp"), (DOUBLING, -1.0, "generalised_doubling")]
)
def test_bars_of_cusps_and_generalised_doublings_of_maps(kind, multiplier, name):
    """At F″ = 0, and where the Schwarzian derivative is zero, F‴ + 3/2 F″² = 0 with a multiplier −1.

    Bars know what the differences are wrong by that cubic coefficients are made of; no finer map does.
    """
    part = np.polynomial.Polynomial([0.0, 0.0, 0.7, -0.4, 0.2, -0.1])
    second, third = part.deriv(2), part.deriv(3)
    roots = (second if kind == FOLD else third + 1.5 * second**2).roots()
    x = np.real(roots[np.abs(np.imag(roots)) < 1e-9])
    c = multiplier - part.deriv()(x)
    exact = np.stack([x - c * x - part(x), c], 1)
    x = 0.1
    c = multiplier - part.deriv()(x)
    [curve] = follow_both_ways(WAVY, kind, np.array([[[x]]]), np.array([[x - c * x - part(x), c]]))
    again = [refine_curve(WAVY, curve)] * 2
    points = [point for point in special_points(WAVY, curve) if POINTS[point.kind] == name]
    assert points
    for point in points:
        errors = errors_of_special([WAVY] * 3, [curve, *again], point)
        off = np.abs(exact - point.values)
        assert np.any(np.all(off <= errors + 1e-14, axis=1))  # 1e-14 of the roots
        assert np.all(errors < 1e-8)


def quadratic(u, values):
    """M (x, y) with the trace −2 + a² − δ² and the determinant b, about the fixed point 0."""
    (x, y), (a, b), zero, one = u.T, values.T, np.zeros(len(u)), np.ones(len(u))
    trace = -2.0 + a**2 - 0.08**2
    matrix = np.array([[trace, -b], [one, zero]]).transpose(2, 0, 1)
    columns = np.array([[2 * a * x, -y], [zero, zero]]).transpose(2, 0, 1)
    return Derivatives(np.stack([trace * x - b * y, x], 1), matrix, columns)


def test_tori_beyond_a_neutral_saddle():
    """Multipliers are real, −1.08 and −0.92 at most, where |a| < 0.08, and of modulus one again beyond; b = 1."""
    map_plane = plane(quadratic, 2, (-1.0, 0.5), (1.0, 1.5))
    [torus] = follow_both_ways(map_plane, NEIMARK_SACKER, np.zeros((1, 1, 2)), np.array([[0.5, 1.0]]))
    assert torus.ends == (RANGE, RANGE)
    assert np.abs(torus.values[:, 1] - 1.0).max() < ROUNDING
    second = [a for name, a, _ in passed(torus, map_plane) if name == "resonance_1_2"]
    assert sorted(second) == pytest.approx([-0.08, 0.08], abs=1e-9)


def test_curve_of_period_two():
    """Hénon's second doubling, by its 2-periodic orbit: a = (5b² − 6b + 5)/4, through a strong resonance at b = −1."""
    b = 0.3
    a = (5 * b * b - 6 * b + 5) / 4
    x, y = 0.5, 0.0
    for _ in range(2000):  # just below the doubling the orbit attracts
        x, y = 1 - (a - 0.01) * x * x + y, b * x
    orbit = np.array([[[x, y], [1 - (a - 0.01) * x * x + y, b * x]]])
    [curve] = follow_both_ways(HENON, DOUBLING, orbit, np.array([[a - 0.01, b]]))
    a, b = curve.values.T
    assert np.abs(a - (5 * b * b - 6 * b + 5) / 4).max() < ROUNDING


def cubic(u, values):
    """x → p + q x − x³."""
    x, (p, q) = u[:, 0], values.T
    return Derivatives((p + q * x - x**3)[:, None], (q - 3 * x**2)[:, None, None], np.stack([0 * x + 1, x], 1)[:, None])


def test_cusp_and_generalised_doublings():
    """Folds meet in a cusp at (0, 1); where 9x² = 1, at (±16/27, −2/3), a doubling is neither sub- nor supercritical."""
    cubics = plane(cubic, 1, (-1.0, -1.5), (1.0, 2.0))
    x = 0.3
    q = 1 + 3 * x * x
    [fold] = follow_both_ways(cubics, FOLD, np.array([[[x]]]), np.array([[x - q * x + x**3, q]]))
    [(name, *at)] = passed(fold, cubics)
    assert name == "cusp"
    assert at == pytest.approx([0.0, 1.0], abs=ROUNDING)
    q = -1 + 3 * x * x
    [doubling] = follow_both_ways(cubics, DOUBLING, np.array([[[x]]]), np.array([[x - q * x + x**3, q]]))
    both = sorted(passed(doubling, cubics))
    assert [name for name, *_ in both] == ["generalised_doubling"] * 2
    # Cubic coefficients are differences over 1e-3: their error is its square, of the fifth derivative, which is none.
    assert np.array([at for _, *at in both]) == pytest.approx(
        np.array([[-16 / 27, -2 / 3], [16 / 27, -2 / 3]]), abs=1e-8
    )


def swirl(u, values):
    """z → e^{2i} z (1 + μ + ν |z|² − |z|⁴)."""
    (x, y), (mu, nu) = u.T, values.T
    r = x * x + y * y
    growth, slope = 1 + mu + nu * r - r * r, 2 * (nu - 2 * r)
    turn = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    inner = np.array([[growth + slope * x * x, slope * x * y], [slope * x * y, growth + slope * y * y]])
    columns = np.array([[x, r * x], [y, r * y]])
    return Derivatives(
        (turn @ (growth * u.T)).T, np.einsum("ij,jkl->lik", turn, inner), np.einsum("ij,jkl->lik", turn, columns)
    )


def test_chenciner_point():
    """At μ = 0 a torus is born for every ν; where ν changes sign it changes its side."""
    swirls = plane(swirl, 2, (-0.5, -1.0), (0.5, 1.5))
    [curve] = follow_both_ways(swirls, NEIMARK_SACKER, np.zeros((1, 1, 2)), np.array([[0.0, 0.5]]))
    assert curve.ends == (RANGE, RANGE)
    [(name, *at)] = passed(curve, swirls)
    assert name == "chenciner"
    assert at == pytest.approx([0.0, 0.0], abs=1e-6)  # differences over 1e-3, of |z|⁴


# ---- van der Pol's oscillator


def van_der_pol(force=1.0, omega=1.3):
    """configs/flows/van_der_pol.py at mu = 0.5 in the phase of the drive: its frequency is a parameter like others."""

    def rhs(y, t):
        x, v = y
        return v / omega, (0.5 * (1 - x**2) * v - x + force * jnp.cos(t)) / omega

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi}


def in_heyoka(x, v, force, omega, t):
    """The same."""
    cosine = hy.cos if isinstance(x, hy.expression) else np.cos
    return v / omega, ((1 - x * x) * v / 2 - x + force * cosine(t)) / omega


# With the half of a period and the mirror, H(u) = −P_{1/2}(u), P = H², since (x, v, t) → (−x, −v, t + π) is a symmetry.
HALF = strobe_map(in_heyoka, 2, taylor.TWO_PI / 2, parameters=2)


def by_heyoka(values, u):
    """P and ∂P/∂u."""
    image, first = HALF(values, u)
    image, second = HALF(values, -image)
    return -image, second @ first


def resonance_by_heyoka(values, u, cosine):
    """(force, ω): Newton on H(u) = u, det ∂H/∂u = 1 and tr ∂H/∂u = 2 cos(θ/2)."""

    def mismatch(at):
        image, matrix = HALF(at[:2], at[2:])
        return np.append(-image - at[2:], [determinant(matrix) - 1, -np.trace(matrix) - 2 * cosine])

    return newton(mismatch, [*values, *u])[:2].astype(float)


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "near"), [(48, 1e-8), (8, 1e-5)])
def test_torus_boundary_of_van_der_pol(lanes, steps, near):
    """Where the oscillation is no longer entrained: through resonances, by heyoka's Newton within their errors.

    With 48 steps a period to 1e-8; with 8 errors are far larger than the reference's, whose Newton ends at steps of 1e-12.
    At 1:2 both multipliers are −1 and M is −1, as of a symmetric orbit: the curve goes on."""
    flow = first_order(van_der_pol, {"force": 1.0, "omega": 1.3})
    scene = batch_of(flow, flow.start({"x": 0.0, "v": 0.0}), [1.0], verner9, steps, name="force")
    low, high = np.array([0.2, 1.05]), np.array([6.0, 4.0])
    forced, *others = (
        parameter_plane(scene, lanes, scene.strobe(refinement), np.ones(2), ("force", "omega"), low, high)
        for refinement in (1, 2, 4)
    )
    u, at = np.array([1.0, 0.0]), np.array([1.09, 1.3])
    for _ in range(20):  # with a stronger force the orbit attracts
        u = by_heyoka([1.3, 1.3], u)[0].astype(float)
    for _ in range(6):  # Newton, towards where it no longer does
        image, matrix = by_heyoka(at, u)
        u = u - np.linalg.solve((matrix - np.eye(2)).astype(float), (image - u).astype(float))
    [curve] = follow_both_ways(forced, NEIMARK_SACKER, u[None, None], at[None], StepControl(0.05))
    found = {POINTS[point.kind]: point for point in special_points(forced, curve)}
    again = [refine_curve(plane, curve) for plane in others]
    for name, half in (("resonance_1_3", np.pi / 3), ("resonance_1_4", np.pi / 4), ("resonance_1_2", np.pi / 2)):
        point = found[name]
        _, matrix = HALF(point.values, point.points[0])  # which turns by θ/2 or by π + θ/2
        cosine = np.copysign(np.cos(half), -np.trace(matrix))
        exact = resonance_by_heyoka(point.values, point.points[0], cosine)
        gap = np.abs(point.values - exact)
        assert gap.max() < near
        assert np.all(gap <= errors_of_special([forced, *others], [curve, *again], point) + 1e-12)
    for k in range(0, len(curve.values), max(1, len(curve.values) // 4)):
        image, matrix = by_heyoka(curve.values[k], curve.points[k, 0])
        assert np.abs(image - curve.points[k, 0]).max() < near
        assert abs(determinant(matrix) - 1) < near
    assert CLOSED not in curve.ends
