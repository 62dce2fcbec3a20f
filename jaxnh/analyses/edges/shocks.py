"""The least shock of an attractor: the smallest displacement of one of its points that leads to another attractor.

From each point and in each of many directions the first change of label is bracketed on a row of lengths and bisected.
The shortest shock is then made shorter by Newton's steps on its length over directions, a parabola through shocks
about it: at a local minimum the length is stationary, so that its error is of second order in the direction's.

Where a third basin has strips, these accumulate on a boundary geometrically, at the rate of the saddle's multiplier,
and even rows miss them. So lengths that approach the boundary geometrically are looked at too, and the first strip
counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.edges.bisection import WIDTH, Bracket, Space, label_points, narrow
from jaxnh.analyses.edges.destinations import TILE, UNDECIDED, Destinations
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.maps.protocol import ReturnMap
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select, write_rows

_ROW = 16  # lengths at which a direction is looked at first
_ANGLES = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005)  # rad: of the parabola's shocks from the best one, step by step
_TRUST = 4.0  # of these angles: the longest step
_BEYOND = 1.5  # times the best length: how far shocks about it are looked for
_COVER = 4.0  # times the last gain
_TWICE = 2.0  # times what twice the steps change
_IN_FRONT = np.geomspace(0.5, 1e-9, 48)  # of the length: distances from the boundary that are looked at in front of it
_PASSES = 4  # searches for a local minimum, each from the first strip in front of the one before


class Shocks(NamedTuple):
    """Shocks from points of attractors.

    Attributes:
        lane, attractor: numbers of the lane and of the attractor, (shocks,).
        point: number of the point of the attractor, (shocks,).
        period: of the attractor where it is an orbit or an equilibrium, else 0, (shocks,).
        base: the point, (shocks, d).
        displacement: in section coordinates, (shocks, d); not numbers where none crosses the boundary.
        length: of it in sizes, (shocks,).
        to: the attractor that it leads to, (shocks,).
        error: of the length, (shocks,).
    """

    lane: Int[np.ndarray, " shocks"]
    attractor: Int[np.ndarray, " shocks"]
    point: Int[np.ndarray, " shocks"]
    period: Int[np.ndarray, " shocks"]
    base: Float[np.ndarray, "shocks d"]
    displacement: Float[np.ndarray, "shocks d"]
    length: Float[np.ndarray, " shocks"]
    to: Int[np.ndarray, " shocks"]
    error: Float[np.ndarray, " shocks"]


def directions_in(dimension: int, count: int, seed: int) -> Float[np.ndarray, "directions d"]:
    """Return unit vectors: both ways along each coordinate, and in a plane evenly around, else random ones."""
    axes = np.concatenate([np.eye(dimension), -np.eye(dimension)])
    if dimension == 1:
        return axes
    if dimension == 2:
        angle = 2 * np.pi * np.arange(count) / count
        return np.column_stack([np.cos(angle), np.sin(angle)])
    drawn = np.random.default_rng(seed).normal(size=(max(count - 2 * dimension, 0), dimension))
    return np.concatenate([axes, drawn / np.linalg.norm(drawn, axis=1, keepdims=True)])[:count]


def least_shocks(
    space: Space,
    targets: Destinations,
    lanes: LaneRunner,
    start: Shocks,
    directions: Float[np.ndarray, "directions d"],
    reach: float,
) -> tuple[Shocks, Int[np.ndarray, " shocks"]]:
    """Return the least shock of each attractor, and how many were tried, from shocks that say its points alone.

    Args:
        directions: unit vectors that are tried from each point.
        reach: longest length that is looked at, in sizes.
    """
    count, each = len(start.lane), len(directions)
    every = select(start, np.repeat(np.arange(count), each))
    tried = _shocks(space, targets, lanes, every, np.tile(directions, (count, 1)), np.full(count * each, reach))
    group = np.unique(np.column_stack([tried.lane, tried.attractor]), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((np.nan_to_num(tried.length, nan=np.inf), group))
    of_each = np.bincount(group)
    best = select(tried, order[np.searchsorted(group[order], np.arange(len(of_each)))])
    left = np.isfinite(best.length)
    for _ in range(_PASSES):
        if not left.any():
            break
        refined = _refine(space, targets, lanes, select(best, left))
        nearer = _in_front(space, targets, lanes, refined)
        strips = np.isfinite(nearer.length)
        write_rows(best, left, refined)
        left[left] = strips
        write_rows(best, left, select(nearer, strips))
    best.error[left] = np.inf  # a strip in front of each strip
    return best, of_each


def _shocks(
    space: Space,
    targets: Destinations,
    lanes: LaneRunner,
    start: Shocks,
    directions: Float[np.ndarray, "shocks d"],
    reach: Float[np.ndarray, " shocks"],
) -> Shocks:
    """Return the first shock in one direction from each point, of a length up to its reach."""
    count, d = start.base.shape
    shares = np.arange(1, _ROW + 1) / _ROW
    way = directions * space.size[start.lane]
    points = start.base[:, None] + (shares * reach[:, None])[:, :, None] * way[:, None]
    flat, labels = label_points(space, targets, lanes, points.reshape(-1, d), np.repeat(start.lane, _ROW))
    points, labels = flat.reshape(points.shape), labels.reshape(count, _ROW)
    points = np.concatenate([start.base[:, None], points], axis=1)
    labels = np.column_stack([start.attractor, labels])
    same = labels == labels[:, :1]
    changed = ~same & (labels != UNDECIDED)
    crossing = np.flatnonzero(changed.any(axis=1))
    first = np.argmax(changed, axis=1)[crossing]
    last = np.max(np.where(same[crossing] & (np.arange(_ROW + 1) < first[:, None]), np.arange(_ROW + 1), 0), axis=1)
    pairs = Bracket(
        start.lane[crossing], points[crossing, last], points[crossing, first],
        start.attractor[crossing], labels[crossing, first],
    )  # fmt: skip
    pairs = narrow(space, targets, lanes, pairs)
    good = (space.distance(pairs.near, pairs.far, pairs.lane) <= WIDTH) & (pairs.far_label != UNDECIDED)
    crossing, pairs = crossing[good], select(pairs, good)
    displacement, length, to = np.full((count, d), np.nan), np.full(count, np.nan), np.full(count, UNDECIDED)
    displacement[crossing] = space.batch.chart.wrap(pairs.far - start.base[crossing])
    length[crossing] = space.distance(pairs.far, start.base[crossing], pairs.lane)
    to[crossing] = pairs.far_label
    return start._replace(displacement=displacement, length=length, to=to, error=np.full(count, WIDTH))


def _refine(space: Space, targets: Destinations, lanes: LaneRunner, best: Shocks) -> Shocks:
    """Return shocks as short as any near them, with errors: of the search and of the map."""
    count, k = len(best.lane), best.base.shape[1] - 1
    pairs = [(i, j) for i in range(k) for j in range(i)]
    units, gain = np.eye(k), np.zeros(count)
    turns = np.concatenate([units, -units, *([units[i] + units[j]] for i, j in pairs)])
    for angle in _ANGLES if k else ():
        directions = _directions(space, best)
        basis = np.array([_orthogonal(direction) for direction in directions])
        around = _shocks_along(
            space, targets, lanes, best, _turned(directions, basis, np.tile(angle * turns, (count, 1, 1)))
        )
        turn = _newton_turn(best.length, around.length.reshape(count, -1), pairs, k, angle)
        moved = _shocks_along(space, targets, lanes, best, _turned(directions, basis, turn[:, None]))
        before, best = best.length, _shortest(best, around, moved)
        gain = before - best.length
    refined = targets.refined(2)
    there = best._replace(base=best.base + _moved_points(refined, lanes, best))
    fine = _shocks_along(space, refined, lanes, there, _directions(space, best)[:, None])
    off = np.nan_to_num(np.abs(fine.length - best.length), nan=np.inf)
    return best._replace(error=WIDTH + _COVER * gain + _TWICE * off)


def _moved_points(targets: Destinations, lanes: LaneRunner, best: Shocks) -> Float[np.ndarray, "shocks d"]:
    """Return by how much points of orbits and equilibria are moved by the steps of a map: one step of Newton."""
    moved, orbits = np.zeros_like(best.base), np.flatnonzero(best.period)
    if not len(orbits):
        return moved
    base, p = best.base[orbits], targets.batch.parameters_of(best.lane[orbits])
    counts = best.period[orbits].astype(np.int32)
    image, monodromy, _ = lanes(_over_periods, (targets.strobe,), (base, p, counts), tile=TILE)
    inverse = np.linalg.pinv(np.eye(base.shape[1]) - monodromy)
    moved[orbits] = np.einsum("lij,lj->li", inverse, targets.batch.chart.wrap(image - base))
    return moved


def _over_periods(strobe: ReturnMap, u: Array, p: Parameters, count: Array) -> Derivatives:
    return derivatives(strobe, count, u, p)


def _in_front(space: Space, targets: Destinations, lanes: LaneRunner, best: Shocks) -> Shocks:
    """Return shocks to the first strip of another basin in front of each boundary; not numbers where there is none.

    The error of the shocks that are given becomes at least the distance from what is not decided in front of them.
    """
    count, d = best.base.shape
    length, way = best.length[:, None] * (1.0 - _IN_FRONT), best.displacement / best.length[:, None]
    points = (best.base[:, None] + length[:, :, None] * way[:, None]).reshape(-1, d)
    labels = label_points(space, targets, lanes, points, np.repeat(best.lane, len(_IN_FRONT)))[1].reshape(count, -1)
    other, row = labels != best.attractor[:, None], np.arange(count)
    undecided = other & (labels == UNDECIDED)  # as basins of attractors that no start has led to
    gap = np.where(undecided.any(axis=1), best.length - length[row, np.argmax(undecided, axis=1)], 0.0)
    best.error[:] = np.maximum(best.error, gap)
    other &= ~undecided
    reach = np.where(other.any(axis=1), length[row, np.argmax(other, axis=1)], np.nan)
    known = np.flatnonzero(np.isfinite(reach))
    nearer = Shocks(*map(np.array, best))._replace(length=np.full(count, np.nan))
    if len(known):
        directions = _directions(space, best)[known]
        write_rows(nearer, known, _shocks(space, targets, lanes, select(best, known), directions, reach[known]))
    return nearer


def _shortest(*parts: Shocks) -> Shocks:
    """Return the shortest of the shocks that each part has some of for each of the first."""
    count = len(parts[0].lane)
    rows = [[leaf.reshape(count, -1, *leaf.shape[1:]) for leaf in part] for part in parts]
    every = Shocks(*(np.concatenate(leaves, axis=1) for leaves in zip(*rows, strict=True)))
    which = np.argmin(np.nan_to_num(every.length, nan=np.inf), axis=1)
    return Shocks(*(leaf[np.arange(count), which] for leaf in every))


def _shocks_along(
    space: Space, targets: Destinations, lanes: LaneRunner, best: Shocks, directions: Float[np.ndarray, "shocks some d"]
) -> Shocks:
    """Return the shocks in some directions from the point of each shock, about as long as it."""
    some = directions.shape[1]
    each = select(best, np.repeat(np.arange(len(best.lane)), some))
    return _shocks(space, targets, lanes, each, directions.reshape(-1, directions.shape[2]), _BEYOND * each.length)


def _directions(space: Space, best: Shocks) -> Float[np.ndarray, "shocks d"]:
    """Return the unit vectors, in sizes, of shocks."""
    way = best.displacement / space.size[best.lane]
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def _turned(
    directions: Float[np.ndarray, "shocks d"],
    basis: Float[np.ndarray, "shocks d-1 d"],
    turns: Float[np.ndarray, "shocks some d-1"],
) -> Float[np.ndarray, "shocks some d"]:
    """Return directions turned by small angles towards those of a basis."""
    moved = directions[:, None] + np.einsum("nsk,nkd->nsd", turns, basis)
    return moved / np.linalg.norm(moved, axis=2, keepdims=True)


def _orthogonal(direction: Float[np.ndarray, " d"]) -> Float[np.ndarray, "d-1 d"]:
    """Return an orthonormal basis of what is orthogonal to a direction."""
    return np.linalg.qr(np.column_stack([direction, np.eye(len(direction))]))[0].T[1:]


def _newton_turn(
    length: Float[np.ndarray, " shocks"],
    around: Float[np.ndarray, "shocks some"],
    pairs: list[tuple[int, int]],
    k: int,
    angle: float,
) -> Float[np.ndarray, "shocks k"]:
    """Return the turn to the least length of a parabola through shocks about others; none where it has no minimum."""
    up, down, both = around[:, :k], around[:, k : 2 * k], around[:, 2 * k :]
    gradient = (up - down) / (2 * angle)
    hessian = np.zeros((len(length), k, k))
    hessian[:, range(k), range(k)] = (up - 2 * length[:, None] + down) / angle**2
    for number, (i, j) in enumerate(pairs):
        mixed = (both[:, number] - up[:, i] - up[:, j] + length) / angle**2
        hessian[:, i, j] = hessian[:, j, i] = mixed
    known = np.all(np.isfinite(np.column_stack([hessian.reshape(len(length), -1), gradient])), axis=1)
    values, vectors = np.linalg.eigh(np.where(known[:, None, None], hessian, np.eye(k)))
    along = np.einsum("nki,nk->ni", vectors, np.where(known[:, None], gradient, 0.0))
    step = -np.einsum("nki,ni->nk", vectors, along / np.maximum(np.abs(values), 1e-12))
    far = np.linalg.norm(step, axis=1) / (_TRUST * angle)
    return step / np.maximum(far, 1.0)[:, None]
