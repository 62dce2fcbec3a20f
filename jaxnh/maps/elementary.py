"""Elementary functions of lane values as arithmetic that runs in vectors: XLA calls a library once a lane for them.

sin and cos: the argument is brought into [−π/2, π/2] by a multiple of π in four parts (Cody and Waite 1980), and a
Taylor polynomial of degree 21 does the rest. Up to |x| = 2²⁶ π the result is within three units in the last
place; beyond, it is that of an argument which is off by less than one unit of its own last place.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

_TERMS = 11  # of the series of sin: the next one is below 2⁻⁵⁹ of the sum at π/2


def _parts(x: int, bits: int, count: int) -> tuple[float, ...]:
    """x / 2^bits as a sum of floats, all but the last of 26 bits: times a whole number below 2²⁷ they stay exact."""
    parts = []
    for _ in range(count - 1):
        shift = x.bit_length() - 26
        parts.append(math.ldexp(x >> shift, shift - bits))
        x &= (1 << shift) - 1
    return (*parts, x / (1 << bits))


_PI = 0x3243F6A8885A308D313198A2E03707344A4093822  # π 2¹⁶⁰
_HALF_PI = _parts(_PI, 161, 4)


def _sine_series(r: Array) -> Array:
    """sin r for |r| ≤ π/2."""
    weights = [(-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, _TERMS)]
    square = r * r
    total = jnp.full_like(r, weights[-1])
    for weight in reversed(weights[:-1]):
        total = total * square + weight
    return r + r * (square * total)


def _reduced(x: Array, k: Array) -> Array:
    """x − k π/2, k a whole number."""
    for part in _HALF_PI:
        x = x - k * part
    return x


def _sign(turns: Array) -> Array:
    """(−1)^turns."""
    return 1.0 - 2.0 * (turns - 2.0 * jnp.floor(0.5 * turns))


@jax.custom_jvp
def sine(x: Array) -> Array:
    """sin x, of any shape."""
    k = jnp.round(x * (1.0 / np.pi))
    return _sign(k) * _sine_series(_reduced(x, 2.0 * k))


@jax.custom_jvp
def cosine(x: Array) -> Array:
    """cos x, of any shape."""
    k = jnp.floor(x * (1.0 / np.pi))
    return -_sign(k) * _sine_series(_reduced(x, 2.0 * k + 1.0))


sine.defjvps(lambda dx, _, x: cosine(x) * dx)
cosine.defjvps(lambda dx, _, x: -sine(x) * dx)
