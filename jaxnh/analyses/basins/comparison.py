"""Comparison of attractors: how far motions are from one, and whether two are the same. Host code.

Means are no evidence that two are: attractors that a symmetry relates may share all of them. Places are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.analyses.basins.classification import CHAOTIC, EQUILIBRIUM, PERIODIC, POINTS, Attractors
from jaxnh.analyses.basins.paths import pad_points, stays_near
from jaxnh.analyses.basins.point_sets import lie_within, offsets, point_set
from jaxnh.analyses.batch import LaneBatch
from jaxnh.systems.chart import Chart
from jaxnh.systems.rows import concatenate, select

_SAME_ORBIT = 1e-6  # of the largest motion on an attractor of the sweep
_MOSTLY = 0.95  # of the points of a set lie within the largest spacing that those of another look have


def mean_distances(
    batch: LaneBatch, target: Attractors, paths: Float[np.ndarray, "lanes followed d"]
) -> Float[np.ndarray, " lanes"]:
    """Return the mean distances of the points of paths from an attractor, in units of its margin."""
    every = paths.reshape(-1, paths.shape[2])
    return distances(batch.chart, target, every, np.zeros_like(every)).reshape(paths.shape[:2]).mean(axis=1)


def distances(
    chart: Chart, target: Attractors, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"]
) -> Float[np.ndarray, " lanes"]:
    """Return the distances of section points from an attractor, in units of its margin for lanes of these sizes."""
    if not len(u):
        return np.zeros(0)
    turns = max(1, int(target.period)) if target.kind in (PERIODIC, EQUILIBRIUM) else len(target.points)
    away = offsets(point_set(chart, target.points[:turns], target.steps[:turns], target.size, size.max(axis=0)), u)
    unit = np.where(chart.angles, 1.0, np.maximum(target.size, size))
    return np.max(np.abs(away) / np.where(unit > 0.0, unit, 1.0), axis=1) / float(target.margin)


def stay_near(
    batch: LaneBatch, target: Attractors, paths: Float[np.ndarray, "lanes followed d"]
) -> Bool[np.ndarray, " lanes"]:
    """Return whether paths stay near an attractor."""
    edge = target.near * np.where(target.size > 0.0, target.size, 1.0)
    return stays_near(np.array(batch.chart.angles), paths, target.points, edge)


def same_attractors(
    chart: Chart,
    first: Attractors,
    others: Attractors,
    largest: Float[np.ndarray, " d"],
    same_point: Bool[np.ndarray, " others"],
) -> Bool[np.ndarray, " others"]:
    """Return whether each attractor at the same point is the given one: orbits share a point, others fill one set."""
    if first.kind in (PERIODIC, EQUILIBRIUM):
        return same_orbits(chart, first, others, largest) & same_point
    alike = (others.kind == first.kind) & same_point
    for k in np.flatnonzero(alike):
        alike[k] = same_set(chart, first, select(others, k))
    return alike


def same_set(chart: Chart, first: Attractors, second: Attractors) -> bool:
    """Return whether two motions fill the same set: the points of each lie within the spacing of the other's.

    Of chaos the points of one are enough, as a finite look need not have visited all of it.
    """
    margin, within = max(float(first.margin), float(second.margin)), list[bool]()
    for a, b in ((first, second), (second, first)):
        points = a.points[:: max(1, len(a.points) // POINTS)]
        inside = lie_within(point_set(chart, b.points, b.steps, b.size), points, b.size, margin)
        within.append(bool(np.mean(inside) >= _MOSTLY))
    return any(within) if first.kind == CHAOTIC else all(within)


def same_orbits(
    chart: Chart, first: Attractors, others: Attractors, largest: Float[np.ndarray, " d"]
) -> Bool[np.ndarray, " others"]:
    """Return whether each attractor is an equilibrium or orbit of the same kind and period through the point `u`."""
    turns = int(first.period)
    points = others.points[:, :turns] if turns else others.u[:, None]
    apart = np.abs(chart.wrap(points - first.u))
    alike = (others.kind == first.kind) & (others.period == first.period)
    return alike & np.any(np.all(apart <= same_within(largest), axis=-1), axis=1)


def same_within(largest: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Return the largest distance between points of one orbit, from the largest motion of a sweep."""
    return _SAME_ORBIT * np.where(largest > 0.0, largest, 1.0)


def join_attractors(parts: Sequence[Attractors]) -> Attractors:
    """Concatenate attractors, padded to the same number of points."""
    most = max(part.points.shape[1] for part in parts)
    filled = [pad_points(part.points, part.steps, most) for part in parts]
    even = [part._replace(points=points, steps=steps) for part, (points, steps) in zip(parts, filled, strict=True)]
    return concatenate(even)
