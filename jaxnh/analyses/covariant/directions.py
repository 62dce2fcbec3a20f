"""Directions that grow and shrink along motions, and the angles between them, from derivatives of a map. Host code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.exponents.triangles import orthonormalise

MOST_RETURNS = 64
"""Returns that directions may take to settle."""

_SETTLED = 23.0  # directions settle to e^−23 on average


def settling_returns(
    growth: Float[np.ndarray, "lanes k"], growing: Int[np.ndarray, " lanes"], neutral: int
) -> Int[np.ndarray, " lanes"]:
    """Return in how many returns directions settle, a power of two, and 0 where more than `MOST_RETURNS` are needed.

    Args:
        growth: of the vectors, per return.
        growing: number of the first vectors whose angle with the others is looked for, from 1 to k − 1.
        neutral: number of vectors along the flow, after the growing ones.
    """
    k = growth.shape[1]
    first, others, last = (
        np.take_along_axis(growth, np.minimum(each, k - 1)[:, None], axis=1)[:, 0]
        for each in (growing - 1, growing, growing + neutral)
    )
    rate = np.minimum(first - others, -last)
    with np.errstate(divide="ignore"):
        needed = np.where(rate > 0.0, _SETTLED / np.maximum(rate, 1e-300), np.inf)
    known = needed <= MOST_RETURNS
    return np.where(known, 2 ** np.ceil(np.log2(np.maximum(np.where(known, needed, 1.0), 1.0))), 0.0).astype(int)


class DirectionsAlong(NamedTuple):
    """Directions along motions of lanes, at points to which they have settled from both sides.

    Attributes:
        angles: smallest ones between what grows and what shrinks, (lanes, points), rad.
        stretch: logarithm of what the step before has made of volumes that grow, (lanes, points).
        frames: n steps before the points, (points, lanes, d, k).
        directions: orthonormal ones that grow, and orthonormal ones across those that shrink, (points, lanes, 2, d, j).
    """

    angles: Float[np.ndarray, "lanes points"]
    stretch: Float[np.ndarray, "lanes points"]
    frames: Float[np.ndarray, "points lanes d k"]
    directions: Float[np.ndarray, "points lanes 2 d j"]


def directions_along(
    matrices: Float[np.ndarray, "lanes steps d d"],
    frames: Float[np.ndarray, "lanes d k"],
    j: int,
    n: int,
    shear: Float[np.ndarray, "lanes steps d d"] | None,
) -> DirectionsAlong:
    """Return directions at the points from n steps after the first one, so long as n are left.

    What is across the directions that shrink is what transposed maps take it to, from the last step back.

    Args:
        matrices: derivatives of the map at successive points.
        frames: tangent at the first points, of which the first j columns span what grows.
        n: steps that directions take to settle (`settling_returns`).
        shear: into coordinates that angles are measured in; None: they are those of the matrices.
    """
    k, steps = frames.shape[2], matrices.shape[1]
    along, triangles = [frames], []
    for i in range(steps):
        frames, triangle = orthonormalise(matrices[:, i] @ along[-1])
        along.append(frames)
        triangles.append(triangle)
    across = np.broadcast_to(np.linalg.qr(np.random.default_rng(1).normal(size=(k, j)))[0], (len(frames), k, j))
    sheared = {i: _sheared_frame(along[i], None if shear is None else shear[:, i]) for i in range(n - 1, steps - n + 1)}
    sines, stretch, directions = [], [], []
    for i in reversed(range(n, steps)):
        across = np.linalg.qr(np.swapaxes(triangles[i], 1, 2) @ across)[0]
        if i <= steps - n:
            sines.append(_sine(across, j, sheared[i]))
            directions.append(np.stack([along[i][:, :, :j], along[i] @ across], axis=1))
            stretch.append(_volume(triangles[i - 1], j) + _volume(sheared[i], j) - _volume(sheared[i - 1], j))
    angles = np.arcsin(np.minimum(np.stack(sines[::-1], axis=1), 1.0))
    before = np.stack(along[: angles.shape[1]])
    return DirectionsAlong(angles, np.stack(stretch[::-1], axis=1), before, np.stack(directions[::-1]))


def _sheared_frame(
    frame: Float[np.ndarray, "lanes d k"], shear: Float[np.ndarray, "lanes d d"] | None
) -> Float[np.ndarray, "lanes k k"]:
    """Return the columns of a frame in the coordinates that angles are measured in, upper triangular."""
    if shear is None:
        return np.broadcast_to(np.eye(frame.shape[2]), (len(frame), frame.shape[2], frame.shape[2]))
    return np.linalg.qr(shear @ frame)[1]


def _volume(triangles: Float[np.ndarray, "lanes k k"], j: int) -> Float[np.ndarray, " lanes"]:
    """Return the logarithm of what triangles make of the volume of the first j directions."""
    return np.sum(np.log(np.abs(np.diagonal(triangles, axis1=1, axis2=2)[:, :j])), axis=1)


def _sine(
    across: Float[np.ndarray, "lanes k j"], j: int, sheared: Float[np.ndarray, "lanes k k"]
) -> Float[np.ndarray, " lanes"]:
    """Return the sine of the smallest angle between the first j columns of a frame and what shrinks.

    Args:
        across: orthonormal, what is across the directions that shrink, in the frame.
        sheared: the columns of the frame in the coordinates that angles are measured in.
    """
    shrinking = np.linalg.qr(sheared @ np.linalg.qr(across, mode="complete")[0][:, :, j:])[0]
    growing = np.linalg.qr(sheared[:, :, :j])[0]
    left = growing - shrinking @ (np.swapaxes(shrinking, 1, 2) @ growing)
    return np.linalg.svd(left, compute_uv=False)[:, -1]
