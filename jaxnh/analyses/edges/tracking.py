"""Boundaries of basins followed by repeated bisection, until their motions settle on edge states.

Two points on either side of a boundary, 1e-11 of a size apart, are carried on by the return map until they are 1e-5
apart, and brought together again (Skufca, Yorke and Eckhardt, Phys. Rev. Lett. 96 (2006) 174101). Both follow a motion
in the boundary, and what attracts there is an edge state. Newton then closes it where it is an orbit: its error is that
of the map, and no longer that of the bisection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.edges.bisection import WIDTH, Bracket, Space, narrow
from jaxnh.analyses.edges.destinations import TILE, Destinations
from jaxnh.analyses.manifolds.saddles import find_germs
from jaxnh.analyses.orbits.search import map_of_lanes
from jaxnh.analyses.section_points import points_after
from jaxnh.orbits.shooting import orbits_from_afar
from jaxnh.systems.rows import select, write_rows

KINDS = ("none", "saddle_orbit", "equilibrium", "chaotic_saddle", "unsettled", "lost")
"""Meanings of the flags of the kind of an edge state."""

NONE, SADDLE_ORBIT, EQUILIBRIUM, CHAOTIC_SADDLE, UNSETTLED, LOST = range(len(KINDS))

PATH = 512
"""Points of a motion in the boundary that are kept, the last ones."""

_APART = 1e-5  # sizes: pairs further apart are brought together
_STRETCH = 16  # returns between two looks at the distance of a pair
_JUMP = 0.1  # sizes: pairs that come so far apart in one return are followed no longer
_CLOSE = 0.03  # sizes: of points that may be one point of a saddle orbit
_ARRIVED = 1e-3  # sizes: from the orbit that a motion in the boundary has settled on
_FLOOR, _GROWS, _LAGS = 1e-4, 10.0, 64  # sizes, times, and returns: neighbours on a chaotic saddle part by so much
_LEAST = 4 * _LAGS  # returns of a motion that is called chaotic


class EdgeStates(NamedTuple):
    """Edge states that pairs lead to.

    Attributes:
        kind: numbers in `KINDS`, (pairs,).
        period: returns of a saddle orbit, else 0, (pairs,).
        points: from the last point of the motion on, NaN after the last of the orbit, (pairs, max_period, d).
        returns: that the boundary was followed for, (pairs,).
        path: last points of the motion, NaN before the first, (pairs, PATH, d).
    """

    kind: Int8[np.ndarray, " pairs"]
    period: Int[np.ndarray, " pairs"]
    points: Float[np.ndarray, "pairs n d"]
    returns: Int[np.ndarray, " pairs"]
    path: Float[np.ndarray, "pairs points d"]


def track_edges(
    space: Space,
    targets: Destinations,
    lanes: LaneRunner,
    pairs: Bracket,
    transient: int,
    most: int,
    max_period: int,
) -> EdgeStates:
    """Return what the boundaries between pairs of points lead to, followed for so many returns at most.

    Args:
        transient: returns before the first look for an orbit; the next are after twice as many each.
    """
    count, d = pairs.near.shape
    kind, returns = np.full(count, UNSETTLED, np.int8), np.zeros(count, int)
    states = EdgeStates(
        kind, np.zeros(count, int), np.full((count, max_period, d), np.nan), returns, np.full((count, PATH, d), np.nan)
    )
    pairs = Bracket(*(np.array(leaf) for leaf in pairs))
    until = transient
    while True:
        while len(active := np.flatnonzero((kind == UNSETTLED) & (returns < until))):
            _follow(space, targets, lanes, pairs, active, states)
        left = np.flatnonzero(kind == UNSETTLED)
        _close(space, lanes, pairs.lane, left, states)
        until *= 2
        if until > most or not np.any(kind == UNSETTLED):
            break
    for k in np.flatnonzero((kind == UNSETTLED) & (returns >= _LEAST)).tolist():
        kind[k] = CHAOTIC_SADDLE if _neighbours_part(space, pairs.lane[k], states.path[k]) else UNSETTLED
    return states


def _follow(
    space: Space,
    targets: Destinations,
    lanes: LaneRunner,
    pairs: Bracket,
    active: Int[np.ndarray, " active"],
    states: EdgeStates,
) -> None:
    """Bring pairs together and carry them on until they are apart, in place."""
    near = narrow(space, targets, lanes, select(pairs, active))
    write_rows(pairs, active, near)
    lane = pairs.lane[active]
    lost = ~(space.distance(near.near, near.far, lane) <= 2 * WIDTH)
    both = _carry(space, lanes, np.concatenate([near.near, near.far]), np.tile(lane, 2))
    first, second = both[: len(active)], both[len(active) :]
    with np.errstate(over="ignore", invalid="ignore"):  # of motions that go to infinity
        gap = np.linalg.norm(space.batch.chart.wrap(first - second) / space.size[lane][:, None], axis=2)
    known = np.cumsum(~np.isfinite(gap), axis=1) == 0
    steps = np.where(known & (gap < _APART), 1, 0).cumprod(axis=1).sum(axis=1)  # returns before they are apart
    last = np.minimum(steps, known.sum(axis=1) - 1)
    row = np.arange(len(active))
    lost |= (last < 0) | ~(gap[row, last] < _JUMP)
    last = np.minimum(np.maximum(last, 0), _STRETCH - 1)
    pairs.near[active], pairs.far[active] = first[row, last], second[row, last]
    states.kind[active[lost]] = LOST
    for k, pair in enumerate(active.tolist()):
        new = first[k, : last[k] + 1]
        states.path[pair] = np.concatenate([states.path[pair], new])[-PATH:]
    states.returns[active] += last + 1


def _carry(
    space: Space, lanes: LaneRunner, u: Float[np.ndarray, "n d"], lane: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n returns d"]:
    """Return the next points of lanes."""
    return points_after(space.batch.take(lane), lanes, u, 0, _STRETCH, TILE)


def _close(
    space: Space,
    lanes: LaneRunner,
    lane: Int[np.ndarray, " pairs"],
    left: Int[np.ndarray, " left"],
    states: EdgeStates,
) -> None:
    """Close the saddle orbits that motions in the boundary have come to, in place."""
    batch, wrap, most = space.batch, space.batch.chart.wrap, states.points.shape[1]
    size, path = space.size[lane[left]], states.path[left]
    lags = range(1, min(most, PATH - 1) + 1)
    back = np.array([np.abs(wrap(path[:, -1] - path[:, -1 - n]) / size).max(axis=1) for n in lags])
    close = np.where(np.isfinite(back), back, np.inf) < _CLOSE
    least = np.where(close.any(axis=0), np.argmax(close, axis=0) + 1, 0)
    for n in np.unique(least[least > 0]).tolist():
        own = left[least == n]
        lanes_of, stretch = lane[own], states.path[own, -n:]
        orbits = orbits_from_afar(
            map_of_lanes(batch, lanes, batch.strobe()), stretch, lanes_of, space.size[lanes_of], wrap
        )
        near = np.abs(wrap(orbits.points - stretch) / space.size[lanes_of][:, None]).max(axis=(1, 2)) < _ARRIVED
        good = np.flatnonzero(orbits.converged & near)
        if not len(good):
            continue
        p, lanes_of = batch.parameters_of(lanes_of[good]), lanes_of[good]
        germs = find_germs(batch, lanes, batch.strobe(), p, orbits.points[good], space.size[lanes_of])
        saddle = np.isfinite(germs.multiplier).reshape(-1, n).all(axis=1)
        own, good = own[good[saddle]], good[saddle]
        rests = n == 1 and not batch.on_section and batch.flow.autonomous
        states.kind[own], states.period[own] = EQUILIBRIUM if rests else SADDLE_ORBIT, n
        states.points[own, :n] = orbits.points[good]


def _neighbours_part(space: Space, lane: int, path: Float[np.ndarray, "points d"]) -> bool:
    """Return whether neighbours on a motion part at an exponential rate, as on no orbit and no torus."""
    path = path[np.isfinite(path).all(axis=1)]
    count = len(path) - _LAGS

    def apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.abs(space.batch.chart.wrap(path[first] - path[second]) / space.size[lane]).max(axis=-1)

    number = np.arange(count)
    distance = apart(number[:, None], number[None, :])
    distance[np.abs(number[:, None] - number[None, :]) < 2] = np.inf
    nearest = np.argmin(distance, axis=1)
    start = np.maximum(distance[number, nearest], _FLOOR)
    growth = [np.median(apart(number + lag, nearest + lag) / start) for lag in range(1, _LAGS + 1)]
    return bool(np.max(growth) > _GROWS)
