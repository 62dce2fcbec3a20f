"""Double-double arithmetic: numbers as unevaluated sums of two float64, with relative errors of some 2⁻¹⁰⁴, in JAX.

Sums and products without error (Knuth, TAOCP 2, 4.2.2; Dekker, Numer. Math. 18 (1971) 224) hold where every operation
is rounded once, as it is written. XLA:CPU joins a product and a sum to one operation that is rounded once, in some of
its loops and not in others, and merges constants, (a + 1) − 1 = a. So products whose rounding matters, and constants,
are hidden from it: their bits are joined by exclusive or with a zero that only the running program knows. With open
constants errors are 1e-16; tests/maps/test_extended_precision.py holds compiled results against fractions.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

_HALF = 26  # bits of the upper half of a factor
_HALVINGS = 4  # of an angle before series of sine and cosine
_TERMS = 11  # of these: x²²/23! is below 2⁻¹⁰⁸ at x = π/16


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
        """sin a and cos a, |a| ≤ π, by series at a/16 and doublings; 1 − cos keeps its digits in them."""
        x = Double(a.hi * 0.5**_HALVINGS, None if a.lo is None else a.lo * 0.5**_HALVINGS)
        square, one = self.mul(x, x), self.constant(1)
        sine = versine = self.constant(0)
        for k in range(_TERMS, 0, -1):  # Horner: 1 − x²/(2k (2k+1)) (…), x²/((2k−1) 2k) (1 − …)
            of_sine, of_versine = Fraction(1, 2 * k * (2 * k + 1)), Fraction(1, (2 * k + 1) * (2 * k + 2))
            sine = self.mul(self.mul(square, self.constant(of_sine)), self.add(one, negative(sine)))
            versine = self.mul(self.mul(square, self.constant(of_versine)), self.add(one, negative(versine)))
        sine = self.mul(x, self.add(one, negative(sine)))
        half = Double(0.5 * square.hi, None if square.lo is None else 0.5 * square.lo)
        versine = self.mul(half, self.add(one, negative(versine)))
        for _ in range(_HALVINGS):
            cosine = self.add(one, negative(versine))
            versine = twice(self.mul(sine, sine))
            sine = twice(self.mul(sine, cosine))
        return sine, self.add(one, negative(versine))

    def atan2(self, y: Double, x: Double) -> Double:
        """The angle of (x, y): that of float64, and the angle left after turning back by it, whose cube is nothing."""
        first = exactly(jnp.arctan2(y.hi, x.hi))
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


def exactly(a: ArrayLike) -> Double:
    """A float64."""
    return Double(jnp.asarray(a), None)


def negative(a: Double) -> Double:
    """−a."""
    return Double(-a.hi, None if a.lo is None else -a.lo)


def twice(a: Double) -> Double:
    """2 a."""
    return Double(2.0 * a.hi, None if a.lo is None else 2.0 * a.lo)


def _halves(a: Array) -> tuple[Array, Array]:
    """a as a sum of two numbers of 26 bits: the upper is rounded in its bits, where no product can be joined to it."""
    bits = lax.bitcast_convert_type(a, jnp.int64)
    cut = 53 - _HALF
    upper = lax.bitcast_convert_type((bits + (1 << (cut - 1))) & -(1 << cut), jnp.float64)
    return upper, a - upper
