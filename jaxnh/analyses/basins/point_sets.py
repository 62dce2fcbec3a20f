"""Sets of points that a motion runs through: how far lanes are from them, and whether two motions fill the same set.

Invariant sets of a flow that differ have no point in common, whatever means they share. So a lane is on an attractor
where its state comes near the points of that one and of no other. Points lie in a search tree, in sizes of the motion.
Without a clock a lane may come to a cycle in any phase: the path between points is filled in, and distances are taken
across it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.systems.chart import Chart

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_BETWEEN = 8
"""Parts that the path from point to point is filled in with.

Points are as near to each other as the steps of the integration, about a radian of the fastest oscillation at most.
Cubic Hermite polynomials err there by 1/384, and half a part bends away from its tangent by (1/16)²/2 = 0.002 sizes.
"""

_LEAST = 1e-6  # of the sizes of lanes: those of an attractor that is a point, or lies in a plane


class PointSet(NamedTuple):
    """Points of a motion.

    Attributes:
        chart: of which these are section coordinates.
        scale: units of distances in the tree, (d,).
        points: (points, d).
        steps: from each to the next along the path, zero with a clock, (points, d).
        tree: of the points in units.
    """

    chart: Chart
    scale: Float[np.ndarray, " d"]
    points: Float[np.ndarray, "points d"]
    steps: Float[np.ndarray, "points d"]
    tree: KDTree


def point_set(
    chart: Chart,
    points: Float[np.ndarray, "points d"],
    steps: Float[np.ndarray, "points d"],
    size: Float[np.ndarray, " d"],
    lane_size: Float[np.ndarray, " d"] | float = 0.0,
) -> PointSet:
    """Return the set of points of a motion of this size, with the path between them where they have steps.

    Args:
        steps: displacement along the flow in the time from a point to the next, zero with a clock.
        lane_size: size of the motion of the lanes that are compared with it.
    """
    scale = np.maximum(size, _LEAST * lane_size)
    scale = np.where(scale > 0.0, scale, 1.0)
    if np.any(steps):
        points, steps = _interpolate(chart, points, steps)
    from scipy.spatial import KDTree  # here, as it takes a tenth of a second to import

    return PointSet(chart, scale, points, steps, KDTree(_scale(chart, points, scale), boxsize=_box(chart, scale)))


def offsets(points: PointSet, u: Float[np.ndarray, "lanes d"]) -> Float[np.ndarray, "lanes d"]:
    """Return differences of section points from the nearest point of a set, for an autonomous flow from its path."""
    nearest = points.tree.query(_scale(points.chart, u, points.scale))[1]
    away, along = points.chart.wrap(u - points.points[nearest]), points.steps[nearest]
    length = np.sum((along / points.scale) ** 2, axis=1)
    part = np.sum(away * along / points.scale**2, axis=1) / np.where(length > 0.0, length, 1.0)
    return away - np.clip(part, -1.0, 1.0)[:, None] * along


def spacing(
    chart: Chart,
    points: Float[np.ndarray, "points d"],
    steps: Float[np.ndarray, "points d"],
    size: Float[np.ndarray, " d"],
) -> float:
    """Return the largest distance, in sizes, of points of the later half of a motion from those of the earlier half.

    It is large where the motion has not come back by then.
    """
    half = len(points) // 2
    earlier = point_set(chart, points[:half], steps[:half], size)
    if not np.any(steps):
        placed = _scale(chart, points[half:], earlier.scale)
        return float(np.max(earlier.tree.query(placed, p=np.inf)[0]))
    return float(np.max(np.abs(offsets(earlier, points[half:])) / earlier.scale))


def lie_within(
    cloud: PointSet, points: Float[np.ndarray, "points d"], size: Float[np.ndarray, " d"], margin: float
) -> Bool[np.ndarray, " points"]:
    """Return whether points lie within a margin, in sizes, of a set."""
    return np.all(np.abs(offsets(cloud, points)) <= margin * np.where(size > 0.0, size, 1.0), axis=1)


def _interpolate(
    chart: Chart, points: Float[np.ndarray, "points d"], steps: Float[np.ndarray, "points d"]
) -> tuple[Float[np.ndarray, "more d"], Float[np.ndarray, "more d"]]:
    """Insert points by cubic Hermite polynomials, and return them with the steps from each to the next."""
    gap, (begin, end) = chart.wrap(np.diff(points, axis=0)), (steps[:-1], steps[1:])
    square, cube = 3.0 * gap - 2.0 * begin - end, begin + end - 2.0 * gap
    at = (np.arange(_BETWEEN) / _BETWEEN)[:, None, None]
    between = points[:-1] + at * (begin + at * (square + at * cube))
    rate = (begin + at * (2.0 * square + 3.0 * at * cube)) / _BETWEEN
    return between.reshape(-1, points.shape[1]), rate.reshape(-1, points.shape[1])


def _box(chart: Chart, scale: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Return the periods of the coordinates in units, zero for those that are not angles."""
    return np.where(chart.angles, 2 * np.pi / scale, 0.0)


def _scale(chart: Chart, u: Float[np.ndarray, "points d"], scale: Float[np.ndarray, " d"]) -> np.ndarray:
    """Return section points in units, angles in [0, 2π)."""
    box = _box(chart, scale)
    placed = np.where(box > 0.0, np.mod(u / scale, np.where(box > 0.0, box, 1.0)), u / scale)
    return np.where((box > 0.0) & (placed >= box), 0.0, placed)
