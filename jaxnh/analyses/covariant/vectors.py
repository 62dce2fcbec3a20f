"""Covariant Lyapunov vectors of products of matrices (Ginelli et al., Phys. Rev. Lett. 99 (2007) 130601). Host code.

Forward, M_k Q_k = Q_{k+1} R_{k+1} with orthonormal frames Q and triangles R, whose diagonals grow at the exponents.
Backward, C_k = R_{k+1}⁻¹ C_{k+1} with columns of length one; the vectors are the columns of V_k = Q_k C_k, and each is
taken to its successor, M_k v_k ∝ v_{k+1}.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.exponents.triangles import complete_triangles, orthonormalise, rounding_of_growth


class CovariantVectors(NamedTuple):
    """Vectors at the points of motions, for as long as both sweeps have settled.

    Attributes:
        frames: orthonormal, columns, of which the first j span what the first j vectors do, (lanes, points, d, k).
        coefficients: of the vectors in the frames, upper triangular, columns of length one, (lanes, points, k, k).
        growth: logarithm of what the map of each point makes of the length of each vector, (lanes, points, k).
        rounding: error of the growth by rounding, (lanes, points, k).
    """

    frames: Float[np.ndarray, "lanes points d k"]
    coefficients: Float[np.ndarray, "lanes points k k"]
    growth: Float[np.ndarray, "lanes points k"]
    rounding: Float[np.ndarray, "lanes points k"]


def covariant_vectors(
    matrices: Float[np.ndarray, "lanes steps d d"],
    settling: int,
    k: int,
    volumes: Float[np.ndarray, "lanes steps"] | None = None,
) -> CovariantVectors:
    """Return the first k covariant vectors at all points but the first and last `settling`.

    Args:
        matrices: derivatives of the map at successive points, finite and none zero.
        k: vectors wanted; those of a system with constraints are fewer than its coordinates.
        settling: maps in which frames, and from the end the vectors, turn to where they belong.
        volumes: moduli of the determinants of the maps, of k = d, where these are known by themselves.
    """
    lanes, steps, d, _ = matrices.shape
    frame = np.broadcast_to(np.linalg.qr(np.random.default_rng(0).normal(size=(d, k)))[0], (lanes, d, k))
    frames, triangles = np.empty((steps, lanes, d, k)), np.empty((steps, lanes, k, k))
    noise, known = np.zeros((steps, lanes)), np.zeros((steps, lanes), bool)
    for i in range(steps):
        frames[i] = frame
        frame, triangles[i] = orthonormalise(matrices[:, i] @ frame)
        if volumes is not None:
            noise[i], known[i] = complete_triangles(triangles[i], volumes[:, i])
    columns = np.triu(np.ones((k, k))) / np.sqrt(np.arange(1, k + 1))
    inner = slice(settling, steps - settling)
    kept = steps - 2 * settling
    coefficients, growth = np.empty((kept, lanes, k, k)), np.empty((kept, lanes, k))
    for i in reversed(range(settling, steps)):
        columns = np.linalg.solve(triangles[i], np.broadcast_to(columns, (lanes, k, k)))
        length = np.linalg.norm(columns, axis=1)
        columns = columns / length[:, None]
        if i < steps - settling:
            coefficients[i - settling], growth[i - settling] = columns, -np.log(length)
    rounding = rounding_of_growth(triangles[inner], noise[inner], known[inner])
    every = (frames[inner], coefficients, growth, rounding)
    return CovariantVectors(*(np.moveaxis(leaf, 0, 1) for leaf in every))


def sheared(vectors: CovariantVectors, shear: Float[np.ndarray, "lanes points d d"]) -> CovariantVectors:
    """Return vectors in other coordinates at each point, their growth as it was."""
    frames, triangles = np.linalg.qr(shear @ vectors.frames)
    coefficients = triangles @ vectors.coefficients
    coefficients /= np.linalg.norm(coefficients, axis=-2, keepdims=True)
    return vectors._replace(frames=frames, coefficients=coefficients)


def volume_growth(vectors: CovariantVectors) -> Float[np.ndarray, "lanes k points"]:
    """Return the logarithms of what the map makes of the volumes that the first 1, …, k vectors span, at each point."""
    with np.errstate(divide="ignore"):
        sides = np.log(np.abs(np.diagonal(vectors.coefficients, axis1=-2, axis2=-1)))
    grown = np.cumsum(vectors.growth[:, :-1] + np.diff(sides, axis=1), axis=-1)
    return np.moveaxis(grown, -1, 1)


def smallest_angles(vectors: CovariantVectors) -> Float[np.ndarray, "lanes splits points"]:
    """Return the smallest angle between the span of the first j vectors and that of the others, j = 1, …, k − 1.

    Its sine is the least singular value of what is left of an orthonormal basis of the second across the first.
    """
    sines = []
    for j in range(1, vectors.coefficients.shape[-1]):
        basis, _ = np.linalg.qr(vectors.coefficients[..., :, j:])
        sines.append(np.linalg.svd(basis[..., j:, :], compute_uv=False)[..., -1])
    return np.arcsin(np.minimum(np.stack(sines, axis=1), 1.0))
