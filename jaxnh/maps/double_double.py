"""Double-double arithmetic: numbers as unevaluated sums of two float64, with relative errors of some 2⁻¹⁰⁴, in JAX.

Sums and products without error (Knuth, TAOCP 2, 4.2.2; Dekker, Numer. Math. 18 (1971) 224) hold where every operation
is rounded once, as it is written. XLA:CPU joins a product and a sum to one operation that is rounded once, in some of
its loops and not in others, and merges constants, (a + 1) − 1 = a. So products whose rounding matters, and constants,
are hidden from it: their bits are joined by exclusive or with a zero that only the running program knows. With open
constants errors are 1e-16; tests/maps/test_extended_precision.py holds compiled results against fractions.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.elementary import LN2_164, PI_160, power_of_two

_HALF = 26  # bits of the upper half of a factor
_HALVINGS = 4  # of an angle before series of sine and cosine, and of an exponent
_TERMS = 11  # of these: x²²/23! is below 2⁻¹⁰⁸ at x = π/16
_POWERS = 15  # of an exponent: x¹⁵/16! is below 2⁻¹⁰⁸ at x = ln 2/32
_TURN, _LN2 = Fraction(PI_160, 1 << 159), Fraction(LN2_164, 1 << 164)  # 2 π, ln 2
_LEAST_EXPONENT, _LARGEST_EXPONENT = -1022, 1023  # of two
_ONE_TO_ROUNDING = 40.0  # tanh beyond


class Double(NamedTuple):
    """hi + lo, |lo| at most half a unit in the last place of hi; lo is None where it is known to be zero."""

    hi: Any
    lo: Any


class Arithmetic(NamedTuple):
    """The operations.

    Attributes:
        hidden: a zero of int64 that the compiler must not know: an argument of the program.
    """

    hidden: Array

    def add(self, a: Double, b: Double) -> Double:
        """a + b."""
        high, low = two_sum(a.hi, b.hi)
        if a.lo is None or b.lo is None:
            rest = b.lo if a.lo is None else a.lo
            return quick_sum(high, low if rest is None else low + rest)
        less, least = two_sum(a.lo, b.lo)
        high, low = quick_sum(high, low + less)
        return quick_sum(high, low + least)

    def mul(self, a: Double, b: Double) -> Double:
        """a b."""
        high, low = self._product(a.hi, b.hi)
        if b.lo is not None:
            low = low + self._rounded(a.hi * b.lo)
        if a.lo is not None:
            low = low + self._rounded(a.lo * b.hi)
        return quick_sum(high, low)

    def div(self, a: Double, b: Double) -> Double:
        """a / b: three digits of long division."""
        first = a.hi / b.hi
        left = self.add(a, negative(self.mul(b, Double(first, None))))
        second = left.hi / b.hi
        left = self.add(left, negative(self.mul(b, Double(second, None))))
        return self.add(quick_sum(first, second), Double(left.hi / b.hi, None))

    def sin_cos(self, a: Double) -> tuple[Double, Double]:
        """sin a and cos a, by series at a/16, |a| ≤ π, and doublings; 1 − cos keeps its digits in them."""
        x = scale(self.rem(a, self.constant(_TURN), jnp.round), 0.5**_HALVINGS)
        square, unit = self.mul(x, x), self.constant(1)
        sine = versine = self.constant(0)
        for k in range(_TERMS, 0, -1):  # Horner: 1 − x²/(2k (2k+1)) (…), x²/((2k−1) 2k) (1 − …)
            of_sine, of_versine = Fraction(1, 2 * k * (2 * k + 1)), Fraction(1, (2 * k + 1) * (2 * k + 2))
            sine = self.mul(self.mul(square, self.constant(of_sine)), self.add(unit, negative(sine)))
            versine = self.mul(self.mul(square, self.constant(of_versine)), self.add(unit, negative(versine)))
        sine = self.mul(x, self.add(unit, negative(sine)))
        versine = self.mul(scale(square, 0.5), self.add(unit, negative(versine)))
        for _ in range(_HALVINGS):
            cosine = self.add(unit, negative(versine))
            versine = scale(self.mul(sine, sine), 2.0)
            sine = scale(self.mul(sine, cosine), 2.0)
        return sine, self.add(unit, negative(versine))

    def rem(self, a: Double, b: Double, whole: Callable[[Array], Array] = jnp.trunc) -> Double:
        """Remainder of a divided by b; a divisor that is 2 π in float64 is 2 π."""
        turn = self.constant(_TURN)
        if b.lo is None:
            b = select(b.hi == float(_TURN), turn, b)
        return self.add(a, negative(self.mul(Double(whole(a.hi / b.hi), None), b)))

    def sqrt(self, a: Double) -> Double:
        """√a by a step of Newton."""
        root = Double(jnp.sqrt(a.hi), None)
        left = self.add(a, negative(self.mul(root, root)))
        return quick_sum(root.hi, jnp.where(root.hi > 0.0, left.hi / (2.0 * root.hi), 0.0))

    def exp(self, a: Double) -> Double:
        """exp a."""
        power, grown = self._grown(a)
        return scale(self.add(self.constant(1), grown), power)

    def expm1(self, a: Double) -> Double:
        """exp a − 1."""
        power, grown = self._grown(a)
        return self.add(scale(grown, power), self.add(Double(power, None), self.constant(-1)))

    def log(self, a: Double) -> Double:
        """ln a by a step of Newton, of third order."""
        first = Double(jnp.log(a.hi), None)
        left = self.add(self.mul(a, self.exp(negative(first))), self.constant(-1))
        return self.add(first, self.add(left, Double(-0.5 * left.hi * left.hi, None)))

    def tanh(self, a: Double) -> Double:
        """tanh a."""
        twice = scale(Double(jnp.clip(a.hi, -_ONE_TO_ROUNDING, _ONE_TO_ROUNDING), a.lo), 2.0)
        grown = self.expm1(twice)
        return self.div(grown, self.add(grown, self.constant(2)))

    def less(self, a: Double, b: Double) -> Array:
        """Return whether a < b."""
        less, least = (jnp.zeros_like(each.hi) if each.lo is None else each.lo for each in (a, b))
        return (a.hi < b.hi) | ((a.hi == b.hi) & (less < least))

    def atan2(self, y: Double, x: Double) -> Double:
        """The angle of (x, y): that of float64, and the angle left after turning back by it, whose cube is nothing."""
        first = from_float64(jnp.arctan2(y.hi, x.hi))
        sine, cosine = self.sin_cos(first)
        across = self.add(self.mul(y, cosine), negative(self.mul(x, sine)))
        along = self.add(self.mul(x, cosine), self.mul(y, sine))
        return self.add(first, self.div(across, along))

    def constant(self, number: ArrayLike | Fraction) -> Double:
        """A float64 or an array of them, or the nearest sum of two to a fraction; hidden."""
        if not isinstance(number, (Fraction, int)):
            return Double(self._rounded(jnp.asarray(number)), None)
        hi = float(number)
        return Double(self._rounded(jnp.asarray(hi)), self._rounded(jnp.asarray(float(number - Fraction(hi)))))

    def _grown(self, a: Double) -> tuple[Array, Double]:
        """A power of two 2ⁿ and exp(a − n ln 2) − 1, by a series at a sixteenth and doublings."""
        n = jnp.clip(jnp.round(a.hi * (1.0 / float(_LN2))), _LEAST_EXPONENT, _LARGEST_EXPONENT)
        x = scale(self.add(a, negative(self.mul(Double(n, None), self.constant(_LN2)))), 0.5**_HALVINGS)
        grown, unit, two = self.constant(0), self.constant(1), self.constant(2)
        for k in range(_POWERS, 0, -1):  # Horner: x (1 + x/2 (1 + x/3 (…)))
            grown = self.mul(self.mul(x, self.constant(Fraction(1, k))), self.add(unit, grown))
        for _ in range(_HALVINGS):
            grown = self.mul(grown, self.add(two, grown))
        return power_of_two(n), grown

    def _product(self, a: Array, b: Array) -> tuple[Array, Array]:
        """a b rounded, and what rounding has cut off; products of halves are exact however they are joined to sums."""
        high = self._rounded(a * b)
        (a1, a2), (b1, b2) = _halves(a), _halves(b)
        return high, ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2

    def _rounded(self, product: Array) -> Array:
        """A product that is rounded before it goes anywhere, or a constant."""
        bits = lax.bitcast_convert_type(product, jnp.int64)
        return lax.bitcast_convert_type(bits ^ self.hidden, jnp.float64)


def two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """a + b rounded, and what rounding has cut off; of arrays on the host or in a program."""
    total = a + b
    of_b = total - a
    return total, (a - (total - of_b)) + (b - of_b)


def quick_sum(a: Array, b: Array) -> Double:
    """a + b, |a| ≥ |b| or a = 0."""
    total = a + b
    return Double(total, b - (total - a))


def from_float64(a: ArrayLike) -> Double:
    """Return a float64 as a `Double`."""
    return Double(jnp.asarray(a), None)


def negative(a: Double) -> Double:
    """−a."""
    return Double(-a.hi, None if a.lo is None else -a.lo)


def scale(a: Double, power: Any) -> Double:
    """Multiply a by a power of two."""
    return Double(power * a.hi, None if a.lo is None else power * a.lo)


def select(which: Array, a: Double, b: Double) -> Double:
    """Select a where it is asked for, else b."""
    less, least = (jnp.zeros_like(each.hi) if each.lo is None else each.lo for each in (a, b))
    return Double(jnp.where(which, a.hi, b.hi), jnp.where(which, less, least))


def _halves(a: Array) -> tuple[Array, Array]:
    """a as a sum of two numbers of 26 bits: the upper is rounded in its bits, where no product can be joined to it."""
    bits = lax.bitcast_convert_type(a, jnp.int64)
    cut = 53 - _HALF
    upper = lax.bitcast_convert_type((bits + (1 << (cut - 1))) & -(1 << cut), jnp.float64)
    return upper, a - upper
