"""Gram–Schmidt orthonormalisation, written out over lanes: batched QR calls take many times as long."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from jaxnh.systems.state import Vector

_WRITTEN_OUT = 6  # vectors orthonormalised by written-out equations: of ten they are half of a program, here 2,000
_LOST = 1e-9  # of a tangent's length, left across the others: rank is lost, where maps say that some is


def gram_schmidt(
    vectors: Sequence[Vector], singular: Array | None = None
) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
    """Return orthonormal vectors of the same span, and the logarithms of the lengths, components of any shape.

    Args:
        singular: whether the vectors are images under a map that has less than full rank. Those in the span of the ones
            before them, but for rounding, have the logarithm −∞ then, and another direction, across all.
    """
    if len(vectors) > _WRITTEN_OUT and singular is None:
        return _gram_schmidt_in_loop(vectors)
    orthonormal: list[Vector] = []
    logs, lost = [], []
    for whole in vectors:
        vector = _project_out(orthonormal, whole)
        square = sum(v * v for v in vector)
        inverse, grown = 1.0 / jnp.sqrt(square), 0.5 * jnp.log(square)
        if singular is not None:
            lost.append(singular & (square <= _LOST**2 * sum(v * v for v in whole)))
            inverse, grown = jnp.where(lost[-1], 0.0, inverse), jnp.where(lost[-1], -jnp.inf, grown)
        orthonormal.append(tuple(v * inverse for v in vector))
        logs.append(grown)
    for k, vanished in enumerate(lost):
        across = _orthogonal_to(orthonormal)
        orthonormal[k] = tuple(jnp.where(vanished, new, old) for new, old in zip(across, orthonormal[k], strict=True))
    return tuple(orthonormal), tuple(logs)


def _gram_schmidt_in_loop(vectors: Sequence[Vector]) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
    """Return what `gram_schmidt` does: each vector in turn is made a unit one, and taken out of all later ones."""
    components = jnp.stack([jnp.stack(vector) for vector in vectors])
    numbers = jnp.arange(len(vectors)).reshape(-1, *(1,) * (components.ndim - 1))

    def normalise(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        left, squares = carry
        square = jnp.sum(left[k] ** 2, axis=0, keepdims=True)
        unit = (left[k] / jnp.sqrt(square))[None]
        across = left - jnp.sum(left * unit, axis=1, keepdims=True) * unit
        left = jnp.where(numbers > k, across, jnp.where(numbers == k, unit, left))
        return left, squares.at[k].set(square[0])

    start = components, jnp.ones_like(components[:, 0])
    units, squares = lax.fori_loop(0, len(vectors), normalise, start)
    logs = 0.5 * jnp.log(squares)
    return tuple(tuple(unit) for unit in units), tuple(logs)


def _project_out(orthonormal: Sequence[Vector], vector: Vector) -> Vector:
    """Return what is left of a vector across orthonormal ones."""
    for base in orthonormal:
        overlap = sum(v * e for v, e in zip(vector, base, strict=True))
        vector = tuple(v - overlap * e for v, e in zip(vector, base, strict=True))
    return vector


def _orthogonal_to(orthonormal: Sequence[Vector]) -> Vector:
    """Return a unit vector across vectors that are orthonormal or zero, where there is one: nearest to an axis."""
    shares = jnp.stack([sum(e[i] * e[i] for e in orthonormal) for i in range(len(orthonormal[0]))])
    nearest = jnp.argmin(shares, axis=0)
    vector = _project_out(orthonormal, tuple(jnp.where(nearest == i, 1.0, 0.0) for i in range(len(shares))))
    length = jnp.sqrt(sum(v * v for v in vector))
    return tuple(v / length for v in vector)
