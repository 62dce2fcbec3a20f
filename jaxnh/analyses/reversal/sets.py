"""Distance and overlap of two sets that points are known of: an attractor and its image.

Both have as many points, and one is the image of the other under a map that keeps distances to the size of the motion.
So the halves of the record of one say how far such samples of one and the same set are from each other.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.section import System

WITHIN = 0.95
"""Share of the points of a set that are within `SetComparison.spacing` of another sample of it."""

_LEAST_SIZE = 1e-6  # of the largest coordinate: the size of one that is smaller


class SetComparison(NamedTuple):
    """A set A of points of each lane against its image R(A); lengths are in sizes of the motion.

    Attributes:
        distance: largest distance of a point of A from the nearest one of R(A), (lanes,).
        error: largest distance of a point of one half of the record from the nearest of the other, (lanes,).
        spacing: distance within which `WITHIN` of the points of one half have one of the other, (lanes,).
        within: number of points of one half that have one of the image of the other within the spacing, (lanes,).
        within_coarse: the same of quarters of the record against each other.
        points: number of points of a lane.
    """

    distance: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    spacing: Float[np.ndarray, " lanes"]
    within: Int[np.ndarray, " lanes"]
    within_coarse: Int[np.ndarray, " lanes"]
    points: int


def compare_sets(
    batch: LaneBatch,
    lanes: LaneRunner,
    points: Float[np.ndarray, "lanes n d"],
    images: Float[np.ndarray, "lanes n d"],
    resolution: Float[np.ndarray, " lanes"],
) -> SetComparison:
    """Return how sets and their images lie; lengths below the resolution of the points are no distance."""
    nearest = np.array(lanes(_nearest, (batch.system,), (points, images)))
    of_image, in_half, own_half, in_quarter, own_quarter = np.moveaxis(nearest, -1, 0)
    with np.errstate(invalid="ignore"):  # of lanes that have failed
        spacing, coarse = (np.maximum(np.quantile(own, WITHIN, axis=1), resolution) for own in (own_half, own_quarter))
    return SetComparison(
        np.max(of_image, axis=1),
        np.max(own_half, axis=1) + resolution,
        spacing,
        np.sum(in_half <= spacing[:, None], axis=1),
        np.sum(in_quarter <= coarse[:, None], axis=1),
        points.shape[1],
    )


def _nearest(system: System, points: Float[Array, "n d"], images: Float[Array, "n d"]) -> Float[Array, "n 5"]:
    """Return distances of each point from the nearest image, of all, of the other half, and of the quarter beside it.

    Of the other half, and the quarter, also that from the nearest point itself. The order is: image, image in the half,
    point in the half, image in the quarter, point in the quarter.
    """
    both = jnp.concatenate([points, images])
    modulus = jnp.max(jnp.abs(both), axis=0)
    angles = np.array(system.chart.angles)
    largest = jnp.max(jnp.where(angles, 0.0, modulus))
    modulus = jnp.maximum(modulus, _LEAST_SIZE * jnp.where(largest > 0.0, largest, 1.0))
    size = jnp.where(angles, np.pi, modulus)
    number = np.arange(len(points))
    half, quarter = jnp.asarray(2 * number // len(points)), jnp.asarray(4 * number // len(points))

    def of_point(item: tuple[Array, Array, Array]) -> Array:
        point, own_half, own_quarter = item
        image, own = (
            jnp.max(jnp.abs(system.chart.wrap(others - point[None, :])) / size[None, :], axis=1)
            for others in (images, points)
        )
        other, beside = half != own_half, quarter == (own_quarter ^ 1)
        parts = [jnp.min(jnp.where(part, x, jnp.inf)) for part in (other, beside) for x in (image, own)]
        return jnp.stack([jnp.min(image), *parts])

    return lax.map(of_point, (points, half, quarter))


def binomial_interval(
    count: Int[np.ndarray, " lanes"], total: int
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the ends of the 95 % interval of a share, for numbers of independent draws (Clopper, Pearson 1934)."""
    from scipy.special import betaincinv  # here, as it takes a tenth of a second to import

    low = np.where(count > 0, betaincinv(np.maximum(count, 1), total - count + 1, 0.025), 0.0)
    high = np.where(count < total, betaincinv(count + 1, np.maximum(total - count, 1), 0.975), 1.0)
    return low, high
