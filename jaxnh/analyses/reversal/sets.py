"""Distance and overlap of two sets that points are known of: an attractor and its image.

Both have as many points, and one is the image of the other under a map that keeps distances to the size of the motion.
So the halves of the record of one say how far such samples of one and the same set are from each other.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.intervals import binomial_interval
from jaxnh.maps.section import System

WITHIN = 0.95
"""Share of the points of a set, at least, that are within `SetComparison.spacing` of another sample of it."""

_GAPS = 2.0  # of the distances of neighbours: in points of a curve that are evenly spread gaps differ by as much
_DRIFT = 3.0  # times the distance of neighbours in a half: that of the halves from each other
_PAIRS = 2.0  # points of a pair, near the images of each other
_LEAST_SIZE = 1e-6  # of the largest coordinate: the size of one that is smaller


class SetComparison(NamedTuple):
    """A set A of points of each lane against its image R(A); lengths are in sizes of the motion.

    Attributes:
        distance: largest distance of a point of A from the nearest one of R(A), (lanes,).
        error: largest distance of a point of one half of the record from the nearest of the other, (lanes,).
        spacing: distance within which `WITHIN` of the points of one half have one of the other, and half of which is
            that to a neighbour in their own, (lanes,).
        within: number of points of one half that have one of the image of the other within the spacing, (lanes,).
        coarse_spacing, within_coarse: the same of quarters of the record against each other, (lanes,).
        independent: number of independent points whose share within the spacing scatters as much, (lanes,).
        drifting: whether the halves of the record are further from each other than neighbours within them, (lanes,).
        points: number of points of a lane.
    """

    distance: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    spacing: Float[np.ndarray, " lanes"]
    within: Int[np.ndarray, " lanes"]
    coarse_spacing: Float[np.ndarray, " lanes"]
    within_coarse: Int[np.ndarray, " lanes"]
    independent: Float[np.ndarray, " lanes"]
    drifting: Bool[np.ndarray, " lanes"]
    points: int


def compare_sets(
    batch: LaneBatch,
    lanes: LaneRunner,
    points: Float[np.ndarray, "lanes n d"],
    images: Float[np.ndarray, "lanes n d"],
    resolution: Float[np.ndarray, " lanes"],
) -> SetComparison:
    """Return how sets and their images lie; lengths below the resolution of the points are no distance.

    Where a record drifts on, as that of a torus near a resonance, the set is larger than it shows: the error of the
    distance then reaches to zero.
    """
    nearest = np.array(lanes(_nearest, (batch.system,), (points, images)))
    of_image, parts = nearest[..., 0], nearest[..., 1:].reshape(*nearest.shape[:2], 2, 3)
    with np.errstate(invalid="ignore"):  # of lanes that have failed
        across, inside = np.quantile(parts[..., 1:], WITHIN, axis=1).transpose(2, 0, 1)
    spacing = np.maximum(np.maximum(across, _GAPS * inside), resolution[:, None])
    near = parts[..., 0] <= spacing[:, None]
    within = np.sum(near, axis=1)
    drifting = across[:, 0] > _DRIFT * np.maximum(inside[:, 0], resolution)
    distance, error = np.max(of_image, axis=1), np.max(parts[:, :, 0, 1], axis=1) + resolution
    error = np.where(drifting, np.maximum(error, distance), error)
    fine, coarse = zip(spacing.T, within.T, strict=True)
    return SetComparison(distance, error, *fine, *coarse, independent_points(near[..., 0]), drifting, points.shape[1])


def overlap_interval(sets: SetComparison) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the ends of the 95 % interval of the share that other records of that length have within the spacing."""
    share = sets.within / sets.points
    return binomial_interval(share * sets.independent, sets.independent)


def independent_points(near: Bool[np.ndarray, "lanes n"]) -> Float[np.ndarray, " lanes"]:
    """Return how many independent points have a share that scatters as that of points along a motion.

    R keeps distances, so that a point near the image of another one has that one near its own image: pairs count
    twice, and half of the points are independent at most. Points follow each other besides, and stay near the image
    for some time: autocorrelations say how much more their share varies, summed while the sums of two neighbours are
    positive (Geyer, Stat. Sci. 7 (1992) 473).
    """
    n = near.shape[1]
    away = near - near.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(away, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(power, axis=1)[:, : n - n % 2]
    variance = np.where(covariance[:, :1] > 0.0, covariance[:, :1], 1.0)
    pairs = (covariance / variance).reshape(len(near), -1, 2).sum(axis=2)
    positive = np.logical_and.accumulate(pairs > 0.0, axis=1)
    time = 2.0 * np.sum(pairs, axis=1, where=positive) - 1.0
    return n / (_PAIRS * np.maximum(time, 1.0))


def _nearest(system: System, points: Float[Array, "n d"], images: Float[Array, "n d"]) -> Float[Array, "n 7"]:
    """Return the distance of each point from the nearest image, and three for each of two parts of the record.

    For halves, then for quarters: the distance from the nearest image of the part beside the point's own, from the
    nearest point of that part, and from the nearest other point of its own.
    """
    both = jnp.concatenate([points, images])
    modulus = jnp.max(jnp.abs(both), axis=0)
    angles = np.array(system.chart.angles)
    largest = jnp.max(jnp.where(angles, 0.0, modulus))
    modulus = jnp.maximum(modulus, _LEAST_SIZE * jnp.where(largest > 0.0, largest, 1.0))
    size = jnp.where(angles, np.pi, modulus)
    number = jnp.arange(len(points))

    def of_point(item: tuple[Array, Array]) -> Array:
        point, own = item
        image, other = (
            jnp.max(jnp.abs(system.chart.wrap(others - point[None, :])) / size[None, :], axis=1)
            for others in (images, points)
        )
        distances = [jnp.min(image)]
        for count in (2, 4):
            part, mine = count * number // len(points), count * own // len(points)
            beside, same = part == (mine ^ 1), (part == mine) & (number != own)
            kept = ((beside, image), (beside, other), (same, other))
            distances += [jnp.min(jnp.where(which, values, jnp.inf)) for which, values in kept]
        return jnp.stack(distances)

    return lax.map(of_point, (points, number))
