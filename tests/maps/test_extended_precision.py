"""Double-double arithmetic, compiled, against fractions; the map of the particle in it."""

from __future__ import annotations

from decimal import Decimal, localcontext
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps import elementary
from jaxnh.maps.build import make_return_map
from jaxnh.maps.double_double import Arithmetic, Double, from_float64
from jaxnh.maps.elementary import PI_160
from jaxnh.maps.extended_precision import extend_precision, push_point
from jaxnh.maps.iterate import derivatives
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed

UNIT = 2.0**-104  # of double-double: four roundings of 2⁻¹⁰⁶
HIDDEN = np.int64(0)


def total_of(double, i):
    return Fraction(float(double.hi[i])) + Fraction(float(double.lo[i]))


def test_arithmetic():
    """Sums that cancel, products and quotients of long numbers: a loop, so that operations meet in one program.

    A turn is a few operations of numbers of order one, and its errors grow by its slope, below 1.1: in eight turns less
    than 8 · 10 · 1.1⁸ units.
    """
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.3, 0.3, (2, 64))

    def turns(x, y):
        def turn(at):
            count, x, y = at
            return count + 1, x * y - 0.3 * x / (1.5 + y**2) + 1.0 - 1.0, y - x * x * 0.7 + 0.1

        return jax.lax.while_loop(lambda at: at[0] < 8, turn, (0, x, y))[1:]

    def lane(hidden, x, y):
        return extend_precision(turns, hidden)(from_float64(x), from_float64(y))

    found = jax.jit(jax.vmap(lane, (None, 0, 0)))(HIDDEN, x, y)
    for i in range(len(x)):
        a, b = Fraction(x[i]), Fraction(y[i])
        for _ in range(8):
            a, b = a * b - Fraction(0.3) * a / (Fraction(3, 2) + b * b), b - a * a * Fraction(0.7) + Fraction(0.1)
            a, b = (Fraction(round(number * 2**300), 2**300) for number in (a, b))
        assert abs(total_of(found[0], i) - a) < 8 * 10 * 2.2 * UNIT
        assert abs(total_of(found[1], i) - b) < 8 * 10 * 2.2 * UNIT


@pytest.mark.slow  # elementary functions are quick
def test_angles():
    """Sine and cosine by their series in decimals, and the angle back: four doublings of errors of few units."""
    angle = np.append(np.random.default_rng(1).uniform(-np.pi, np.pi, 40), [1e-9, 3.14159, -1.5708])

    def lane(hidden, a):
        arithmetic = Arithmetic(hidden)
        sine, cosine = arithmetic.sin_cos(from_float64(a))
        return sine, cosine, arithmetic.atan2(sine, cosine)

    sine, cosine, back = jax.jit(jax.vmap(lane, (None, 0)))(HIDDEN, angle)
    with localcontext(prec=60):
        for i, a in enumerate(map(Decimal, angle.tolist())):
            term, sums = Decimal(1), [Decimal(0), Decimal(0)]
            for k in range(60):
                sums[k % 2] += term * (-1) ** (k // 2)
                term = term * a / (k + 1)
            for found, wanted in ((cosine, sums[0]), (sine, sums[1]), (back, a)):
                value = Decimal(float(found.hi[i])) + Decimal(float(found.lo[i]))
                assert abs(value - wanted) < Decimal(64 * UNIT)


sin_cos = jax.jit(jax.vmap(lambda hidden, a: Arithmetic(hidden).sin_cos(a), (None, 0)))


@pytest.mark.parametrize("turns", [1, 7, 1000])
def test_angles_of_many_turns(turns):
    """Whole turns are taken off by 2 π to more digits than two float64 have."""
    angle = np.random.default_rng(2).uniform(-np.pi, np.pi, 8)
    turn = Fraction(PI_160, 1 << 159)
    beyond = [Fraction(a) + turns * turn for a in angle]
    hi = np.array([float(a) for a in beyond])
    lo = np.array([float(a - Fraction(b)) for a, b in zip(beyond, hi, strict=True)])
    for far, near in zip(sin_cos(HIDDEN, Double(hi, lo)), sin_cos(HIDDEN, Double(angle, np.zeros(8))), strict=True):
        gap = (far.hi - near.hi) + (far.lo - near.lo)
        assert np.abs(gap).max() < 8 * UNIT + 2 * np.pi * turns * UNIT / 4  # lo of the angle is rounded


ELEMENTARY = {
    "sqrt": (jnp.sqrt, Decimal.sqrt, (0.01, 30.0)),
    "exp": (jnp.exp, Decimal.exp, (-30.0, 30.0)),
    "log": (jnp.log, Decimal.ln, (1e-6, 1e6)),
    "expm1": (jnp.expm1, lambda x: x.exp() - 1, (-2.0, 2.0)),
    "tanh": (jnp.tanh, lambda x: ((2 * x).exp() - 1) / ((2 * x).exp() + 1), (-3.0, 3.0)),
    "power": (lambda x: x**2.5, lambda x: x ** Decimal("2.5"), (0.1, 10.0)),
    "inverse square": (lambda x: x**-2, lambda x: x**-2, (0.1, 10.0)),
    "exponential of the package": (elementary.exponential, Decimal.exp, (-30.0, 30.0)),
}


@pytest.mark.parametrize("name", ELEMENTARY)
def test_elementary_functions(name):
    """Within 64 units: four doublings double errors of a few units; a logarithm's are of what is added to it."""
    ours, exact, (low, high) = ELEMENTARY[name]
    x = np.append(np.random.default_rng(3).uniform(low, high, 24), [low, high])
    found = jax.jit(jax.vmap(lambda hidden, x: extend_precision(ours, hidden)(from_float64(x)), (None, 0)))(HIDDEN, x)
    with localcontext(prec=60):
        for i, a in enumerate(map(Decimal, x.tolist())):
            value, wanted = Decimal(float(found.hi[i])) + Decimal(float(found.lo[i])), exact(a)
            assert abs(value - wanted) < Decimal(64 * UNIT) * max(abs(wanted), Decimal(1) if name == "log" else 0)


def test_loops_choices_and_comparisons():
    """A loop over rows of a table, with what chooses among numbers that differ beyond float64."""
    small = 2.0**-80

    def function(x, y):
        def turn(total, row):
            larger = jnp.maximum(total * row, y)
            return jnp.where(larger > x, larger - x, jnp.abs(x - larger)), jnp.sign(larger - 1.0)

        total, signs = jax.lax.scan(turn, x, jnp.array([0.5, 1.0, 2.0]))
        return jnp.minimum(total, y), signs.sum(), (x % y) < 0.25

    at = Double(np.array([1.0, 1.0]), np.array([small, -small])), Double(np.array([1.0, 0.5]), np.zeros(2))
    run = jax.jit(jax.vmap(lambda hidden, x, y: extend_precision(function, hidden)(x, y), (None, 0, 0)))
    found, signs, rests = run(HIDDEN, *at)
    for i in range(2):
        x, y = (total_of(one, i) for one in at)
        total, sign = x, 0
        for row in (Fraction(1, 2), 1, 2):
            larger = max(total * row, y)
            total, sign = abs(larger - x), sign + int(np.sign(larger - 1))
        assert total_of(found, i) == min(total, y)
        assert signs.hi[i] == sign
        assert bool(rests[i]) == (x % y < Fraction(1, 4))


def test_products_of_arrays():
    """Sums of products over one axis and over two, of which an axis stays, against fractions."""
    rng = np.random.default_rng(3)
    x, y, z = rng.uniform(-1.0, 1.0, (2, 3, 4)), rng.uniform(-1.0, 1.0, (4, 2, 3)), rng.uniform(-1.0, 1.0, (2, 4, 5))

    def products(x, y, z):
        return jnp.einsum("ijk,kij->i", x, y), jnp.einsum("ijk,ikl->jil", x, z), jnp.tensordot(x, y, 1)

    run = jax.jit(lambda hidden, *arrays: extend_precision(products, hidden)(*map(from_float64, arrays)))
    exact = np.vectorize(Fraction)
    for found, whole in zip(run(HIDDEN, x, y, z), products_of(exact(x), exact(y), exact(z)), strict=True):
        assert found.hi.shape == whole.shape
        error = exact(np.asarray(found.hi)) + exact(np.asarray(found.lo)) - whole
        assert np.abs(error).max() < 8 * UNIT


def products_of(x, y, z):
    several = np.stack([(x[i] * np.moveaxis(y, 0, -1)[i]).sum() for i in range(len(x))])
    one = np.stack([x[i] @ z[i] for i in range(len(x))], axis=1)
    return several, one, np.tensordot(x, y, 1)


def test_unknown_operations_are_named():
    with pytest.raises(NotImplementedError, match="asin is not known in extended precision"):
        extend_precision(jnp.arcsin, HIDDEN)(from_float64(0.5))


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
def test_map_of_the_particle():
    """The same map as in float64, to its rounding; the vector is its derivative, by points 2e-12 apart.

    A period's map has a slope of up to 1e3 and a curvature of 1e6 times it: of the difference (1e-12)² 1e6 is left, and
    rounding of 1e-28 over 1e-12.
    """
    strobe = make_return_map(constant_speed(), SPLITTINGS["blanes_moan6"], 12)
    rng = np.random.default_rng(0)
    u, w, b = rng.uniform(-0.5, 0.5, (8, 3)), rng.normal(size=(8, 3)), np.full(8, 5.5)
    zero = np.zeros_like(u)
    run = jax.jit(jax.vmap(push_point, (None, None, 0, 0, 0)))

    def at(shift):
        p = {"b": Double(b, np.zeros(8))}
        lo = shift * w
        hi = u + lo
        return run(strobe, HIDDEN, Double(hi, lo - (hi - u)), Double(w, zero), p)

    here, (ahead, _), (behind, _) = at(0.0), at(1e-12), at(-1e-12)
    plain = jax.jit(jax.vmap(derivatives, (None, None, 0, 0)))(strobe, np.int32(1), u, {"b": b})
    slope = np.abs(plain.monodromy).max()
    np.testing.assert_allclose(here.image.hi, plain.image, atol=1e-13 * slope)
    difference = ((ahead.hi - behind.hi) + (ahead.lo - behind.lo)) / 2e-12
    np.testing.assert_allclose(here.vector.hi, difference, atol=1e-14 * slope)
