"""Saddle orbits of lanes, and the directions in which their one-dimensional manifolds begin.

Both kinds of manifolds are unstable ones: the stable manifold of the return map is the unstable one of its inverse.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.orbits.search import newton
from jaxnh.analyses.periodic.newton_on_lanes import images
from jaxnh.analyses.random_starts import Box, box_size, extent, random_start_batch
from jaxnh.analyses.section_points import first_points, points_from
from jaxnh.maps.family import Maps
from jaxnh.orbits.recognition import equal_cycles
from jaxnh.orbits.shooting import close_orbits

_SCALES = 12  # of the distance of random starts from the middle, each half of the one before
_NEUTRAL = 1e-6  # of ln |μ|: a manifold that grows more slowly is not followed


class Saddles(NamedTuple):
    """Orbits of n returns of the map of lanes, with a manifold of one dimension at least.

    Attributes:
        lane: number of the lane of each, (saddles,).
        place: which of the lane's it is, (saddles,).
        points: section coordinates, (saddles, n, d).
    """

    lane: Int[np.ndarray, " saddles"]
    place: Int[np.ndarray, " saddles"]
    points: Float[np.ndarray, "saddles n d"]


class Germs(NamedTuple):
    """Beginnings of branches: a point of an orbit, and the direction of its unstable manifold there.

    Attributes:
        points: that the maps converge to at these parameters, (germs, d).
        directions: of length 1 in sizes, (germs, d); not numbers where the manifold has no or more dimensions.
        multiplier: along it, of one turn of the orbit, (germs,).
    """

    points: Float[np.ndarray, "germs d"]
    directions: Float[np.ndarray, "germs d"]
    multiplier: Float[np.ndarray, " germs"]


def find_orbits(
    batch: LaneBatch, lanes: LaneRunner, period: int, starts: int, seed: int, box: Box
) -> tuple[Saddles, Float[np.ndarray, "lanes d"]]:
    """Return all orbits of so many returns that Newton finds from starts in a box, and the sizes of lanes.

    Starts are the middle of the box, and random ones that lie the denser the nearer to it: Newton sees a saddle that
    expands much from near by alone. Orbits with a point nearest to the middle come first. Sizes are `box_size`.
    """
    at_middle = {name: (0.5 * (low + high), 0.5 * (low + high)) for name, (low, high) in box.items()}
    middle = first_points(random_start_batch(batch, 1, seed, at_middle)[0], lanes)
    many, _ = random_start_batch(batch, starts, seed, box)
    first = first_points(many, lanes).reshape(batch.count, starts, -1)
    size, reach = box_size(batch, box, first), extent(batch, first)[1]
    nearer = 0.5 ** (np.arange(starts) % _SCALES)
    first = middle[:, None] + nearer[:, None] * batch.chart.wrap(first - middle[:, None])
    first = first.reshape(-1, first.shape[-1])
    paths = [points_from(many, lanes, first, period), points_from(batch, lanes, middle, period)]
    path = np.concatenate(paths)
    lane = np.concatenate([np.repeat(np.arange(batch.count), starts), np.arange(batch.count)])
    finite = np.isfinite(path).all(axis=(1, 2))
    known = newton(batch, lanes, batch.strobe(), path[finite], lane[finite], reach)
    d = first.shape[1]
    orbits = [(cycles.lane, cycles.points) for cycles in known if cycles.points.shape[1] == period]
    lane = np.concatenate([np.zeros(0, int), *(lane for lane, _ in orbits)])
    points = np.concatenate([np.zeros((0, period, d)), *(points for _, points in orbits)])
    kept = equal_cycles(lane, points, size[lane], batch.chart.wrap) == np.arange(len(lane))
    lane, points = lane[kept], points[kept]
    turn = (np.argmin(points[:, :, 0], axis=1)[:, None] + np.arange(period)) % period if len(lane) else np.zeros((0, 1))
    points = np.take_along_axis(points, turn[:, :, None].astype(int), axis=1) if len(lane) else points
    away = np.abs(batch.chart.wrap(points - middle[lane, None])) / size[lane, None]
    order = np.lexsort((points[:, 0, 0], np.round(away.max(axis=2).min(axis=1, initial=np.inf), 6), lane))
    lane, points = lane[order], points[order]
    return Saddles(lane, np.arange(len(lane)) - np.searchsorted(lane, lane), points), size


def take_orbits(orbits: Saddles, kept: Bool[np.ndarray, " orbits"], most: int) -> Saddles:
    """Return those of some orbits that are kept, so many of a lane at most, their places counted anew."""
    lane, points = orbits.lane[kept], orbits.points[kept]
    place = np.arange(len(lane)) - np.searchsorted(lane, lane)
    few = place < most
    return Saddles(lane[few], place[few], points[few])


def find_germs(
    batch: LaneBatch,
    lanes: LaneRunner,
    strobe: Maps,
    p: Mapping[str, Float[np.ndarray, " orbits"]],
    points: Float[np.ndarray, "orbits n d"],
    size: Float[np.ndarray, "orbits d"],
    backward: bool = False,
) -> Germs:
    """Return the germs at all points of orbits of a map, (orbits · n, ...), which Newton brings to these parameters.

    Args:
        strobe: the map; for stable manifolds the inverse.
        p: parameters of each orbit.
        points: near the orbits.
        backward: whether the map is the inverse of that along which the points are in order.
    """
    if not len(points):
        return Germs(np.zeros((0, points.shape[2])), np.zeros((0, points.shape[2])), np.zeros(0))
    if backward:
        germs = find_germs(batch, lanes, strobe, p, points[:, ::-1], size)
        turned = [leaf.reshape(*points.shape[:2], -1)[:, ::-1].reshape(leaf.shape) for leaf in germs]
        return Germs(*turned)
    orbits, n, d = points.shape
    number = np.arange(orbits)
    once = images(lanes, strobe, p, np.ones(orbits, np.int32))
    closed = close_orbits(lambda u, number: once(u, number.astype(int)), points, number.astype(float), batch.chart.wrap)
    exact = np.where(closed.converged[:, None, None], closed.points, np.nan)
    blocks = np.where(closed.converged[:, None, None, None], closed.blocks, np.nan)
    turn = np.broadcast_to(np.eye(d), (orbits, n, d, d))
    for k in range(n):  # the product that begins at each point
        turn = np.roll(blocks, -k, axis=1) @ turn
    scale = np.repeat(size, n, axis=0)
    matrices = turn.reshape(-1, d, d) * (scale[:, None, :] / scale[:, :, None])
    multiplier, direction = _expanding(matrices)
    return Germs(exact.reshape(-1, d), direction * scale, multiplier)


def _expanding(matrices: Float[np.ndarray, "n d d"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n d"]]:
    """Return the eigenvalue beyond the unit circle, and its vector, where there is one alone and it is real."""
    finite = np.all(np.isfinite(matrices), axis=(1, 2))
    values, vectors = np.linalg.eig(np.where(finite[:, None, None], matrices, 0.0))
    outside = np.log(np.maximum(np.abs(values), 1e-300)) > _NEUTRAL
    single = finite & (np.sum(outside, axis=1) == 1)
    which = np.argmax(np.abs(values), axis=1)
    row = np.arange(len(matrices))
    value, vector = np.real(values[row, which]), np.real(vectors[row, :, which])
    first = np.argmax(np.abs(vector), axis=1)  # its largest component is positive
    length = np.linalg.norm(vector, axis=1) * np.sign(vector[row, first])
    vector = vector / np.where(length == 0.0, 1.0, length)[:, None]
    return np.where(single, value, np.nan), np.where(single[:, None], vector, np.nan)
