"""Frames of tangents that maps carry on, M_k Q_k = Q_{k+1} R_{k+1}: their triangles, and what rounding hides of them.

A diagonal of R that rounding hides says nothing of growth, and hardly matters for directions, as what is below it does
not. Where the volume of the map is known by itself, the last diagonal is what it leaves beside the others, however
small, and its distance from that of the matrix is the rounding of this. Host code.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

_EPSILON = np.finfo(float).eps
_HIDDEN = 0.1 * _EPSILON  # of the largest growth of a map: less is rounding
_LEAST = 1e-100  # of the largest growth: squares of the inverse are finite
_ROUNDINGS = 8.0

HIDDEN = 16.0
"""Error of a logarithm of growth that rounding hides."""


def orthonormalise(matrices: Float[np.ndarray, "lanes d k"]) -> tuple[np.ndarray, np.ndarray]:
    """Return orthonormal frames, and triangles with positive diagonals that are no less than rounding."""
    frame, triangle = np.linalg.qr(matrices)
    diagonal = np.diagonal(triangle, axis1=1, axis2=2)
    sign = np.where(diagonal < 0.0, -1.0, 1.0)
    triangle = triangle * sign[:, :, None]
    least = _HIDDEN * np.abs(diagonal).max(axis=1, keepdims=True)
    every = np.arange(diagonal.shape[1])
    triangle[:, every, every] = np.maximum(np.abs(diagonal), least)
    return frame * sign[:, None], triangle


def complete_triangles(
    triangles: Float[np.ndarray, "lanes k k"], volumes: Float[np.ndarray, " lanes"]
) -> tuple[Float[np.ndarray, " lanes"], Bool[np.ndarray, " lanes"]]:
    """Put the last diagonal of triangles to what the volume leaves, in place where there is any.

    Return by how much it was off, and where it is known now.
    """
    diagonal = np.diagonal(triangles, axis1=1, axis2=2)
    last, before = volumes / np.prod(diagonal[:, :-1], axis=1), diagonal[:, -1].copy()
    known = np.isfinite(last) & (last > _LEAST * diagonal.max(axis=1))
    triangles[:, -1, -1] = np.where(known, last, before)
    return np.where(known, np.abs(last - before), 0.0), known


def rounding_of_growth(
    triangles: Float[np.ndarray, "steps lanes k k"],
    noise: Float[np.ndarray, "steps lanes"],
    known: Bool[np.ndarray, "steps lanes"],
) -> Float[np.ndarray, "steps lanes k"]:
    """Return errors of logarithms of diagonals by rounding; of the last one those of the others where it is known."""
    sizes = np.abs(np.diagonal(triangles, axis1=2, axis2=3))
    least = _ROUNDINGS * _EPSILON * sizes.max(axis=2)
    rounding = np.minimum(np.maximum(least, noise)[:, :, None] / sizes, HIDDEN)
    of_others = _ROUNDINGS * _EPSILON + np.sum(rounding[:, :, :-1], axis=2)
    rounding[:, :, -1] = np.where(known, of_others, rounding[:, :, -1])
    return rounding
