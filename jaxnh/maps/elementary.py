"""Elementary functions of lane values as arithmetic that runs in vectors: XLA calls a library once a lane for some.

Every argument is brought into a small interval by a constant in several parts, whose products with whole numbers are
exact (Cody and Waite, Software Manual for the Elementary Functions, 1980), and a series does the rest. In double
precision exp and log are right to one unit in the last place, sin, cos and tanh to three: sin and cos up to
|x| = 2²⁶ π, beyond which they are those of an argument that is off by less than one unit of its own last place. As in
all programs of XLA, numbers below 2.2e-308 are zero. Those of single precision are left to XLA.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax


def _parts(x: int, bits: int, count: int) -> tuple[float, ...]:
    """x / 2^bits as a sum of floats, all but the last of 26 bits: times a whole number below 2²⁷ they stay exact."""
    parts = []
    for _ in range(count - 1):
        shift = x.bit_length() - 26
        parts.append(math.ldexp(x >> shift, shift - bits))
        x &= (1 << shift) - 1
    return (*parts, x / (1 << bits))


def _series(x: Array, weights: list[float]) -> Array:
    """Σ weights[k] x^k."""
    total = jnp.full_like(x, weights[-1])
    for weight in reversed(weights[:-1]):
        total = total * x + weight
    return total


def _reduced(x: Array, k: Array, parts: tuple[float, ...]) -> Array:
    """x − k Σ parts, k a whole number."""
    for part in parts:
        x = x - k * part
    return x


# ---- sin and cos

PI_160 = 0x3243F6A8885A308D313198A2E03707344A4093822
"""π 2¹⁶⁰."""
_HALF_PI = _parts(PI_160, 161, 4)
_SINE = [(-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 11)]  # the next term is below 2⁻⁵⁹ of the sum at π/2


def _sine_of(r: Array) -> Array:
    """sin r for |r| ≤ π/2."""
    square = r * r
    return r + r * (square * _series(square, _SINE))


def _sign(turns: Array) -> Array:
    """(−1)^turns."""
    return 1.0 - 2.0 * (turns - 2.0 * jnp.floor(0.5 * turns))


@jax.custom_jvp
def sine(x: Array) -> Array:
    """sin x, of any shape."""
    k = jnp.round(x * (1.0 / np.pi))
    return _sign(k) * _sine_of(_reduced(x, 2.0 * k, _HALF_PI))


@jax.custom_jvp
def cosine(x: Array) -> Array:
    """cos x, of any shape."""
    k = jnp.floor(x * (1.0 / np.pi))
    return -_sign(k) * _sine_of(_reduced(x, 2.0 * k + 1.0, _HALF_PI))


sine.defjvps(lambda dx, _, x: cosine(x) * dx)
cosine.defjvps(lambda dx, _, x: -sine(x) * dx)


# ---- exp, log and tanh

LN2_164 = 0xB17217F7D1CF79ABC9E3B39803F2F6AF40F343267
"""ln 2 · 2¹⁶⁴."""
_LN2 = _parts(LN2_164, 164, 3)
_EXP = [1.0 / math.factorial(k) for k in range(2, 15)]  # the next term is below 2⁻⁶⁰ at ln 2 / 2
_LOG = [2.0 / (2 * k + 1) for k in range(1, 13)]  # of artanh: the next term is below 2⁻⁶⁰ of the sum at (√2 − 1)²
_LARGEST, _LEAST = 710.0, -746.0  # exp is infinite beyond, or zero
_ONE_TO_ROUNDING = 20.0  # tanh beyond
_ONE, _EXPONENT = 1023, 52  # exponent of a float that is one, and where it stands in the bits
_WHOLE, _MAGIC = 1.5 * 2.0**52, 2.0**52  # floats whose last bits are whole numbers, of either sign and of none
_MAGIC_BITS, _HALF_ROOT = (int(np.float64(x).view(np.int64)) for x in (_MAGIC, math.sqrt(0.5)))


def power_of_two(n: Array) -> Array:
    """2ⁿ of whole n from −1022 to 1023."""
    bits = lax.bitcast_convert_type(n + _WHOLE, jnp.int64)
    return lax.bitcast_convert_type((bits + _ONE) << _EXPONENT, jnp.float64)


def _reduced_exponential(x: Array) -> tuple[Array, Array]:
    """Whole n and exp(x − n ln 2) − 1."""
    n = jnp.round(x * (1.0 / math.log(2.0)))
    before = _reduced(x, n, _LN2[:-1])
    last = n * _LN2[-1]
    r = before - last
    left = (before - r) - last  # by rounding
    return n, r + (r * r * _series(r, _EXP) + left)


@jax.custom_jvp
def exponential(x: Array) -> Array:
    """exp x, of any shape."""
    if x.dtype != jnp.float64:
        return jnp.exp(x)
    n, grown = _reduced_exponential(jnp.clip(x, _LEAST, _LARGEST))
    half = jnp.floor(0.5 * n)
    return (1.0 + grown) * power_of_two(half) * power_of_two(n - half)


@jax.custom_jvp
def logarithm(x: Array) -> Array:
    """ln x, of any shape."""
    if x.dtype != jnp.float64:
        return jnp.log(x)
    bits = lax.bitcast_convert_type(x, jnp.int64)
    # x = 2ⁿ m with m from √½ to √2. The exponent comes to stand in the last bits of a float near 2⁵².
    above = lax.shift_right_logical(bits - _HALF_ROOT + (_ONE << _EXPONENT), jnp.int64(_EXPONENT))
    m = lax.bitcast_convert_type(bits - ((above - _ONE) << _EXPONENT), jnp.float64)
    n = lax.bitcast_convert_type(above | _MAGIC_BITS, jnp.float64) - (_MAGIC + _ONE)
    f = m - 1.0
    s = f / (2.0 + f)
    square, half = s * s, 0.5 * f * f
    # ln m = 2 artanh s = f − s f + s³ (2/3 + …), and s f = f²/2 − s f²/2.
    high, middle, low = (n * part for part in _LN2)
    value = high + (f - (half - (s * (half + square * _series(square, _LOG)) + (middle + low))))
    value = jnp.where(x == 0.0, -jnp.inf, jnp.where(x < jnp.inf, value, x))
    return jnp.where(x >= 0.0, value, jnp.nan)


@jax.custom_jvp
def hyperbolic_tangent(x: Array) -> Array:
    """tanh x, of any shape."""
    if x.dtype != jnp.float64:
        return jnp.tanh(x)
    n, grown = _reduced_exponential(2.0 * jnp.minimum(jnp.abs(x), _ONE_TO_ROUNDING))
    power = power_of_two(n)
    less = power * grown + (power - 1.0)  # exp(2|x|) − 1
    return jnp.sign(x) * (less / (less + 2.0))


exponential.defjvps(lambda dx, value, x: value * dx)
logarithm.defjvps(lambda dx, _, x: dx / x)
hyperbolic_tangent.defjvps(lambda dx, value, x: (1.0 - value * value) * dx)
