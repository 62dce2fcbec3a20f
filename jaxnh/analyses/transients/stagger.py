"""Orbits that stay on a chaotic saddle for as long as is asked, by stagger and step.

A point whose motion stays in the region for long enough is a point near the saddle, and is carried on by the map: a
step. One whose motion leaves sooner is moved by small random vectors, even in the logarithm of their length, until the
motion stays longer: a stagger (Sweet, Nusse and Yorke, Phys. Rev. Lett. 86 (2001) 2261). It needs no more than
lifetimes, whatever the number of unstable directions, and no motion that stays long by itself. Vectors are so
short that the nearer half of the periods that a point stays for is changed by none.

Which motions are met first is not what the natural measure says: parts of the saddle that motions leave soon afterwards
are visited too often. So points are taken from here, and averages from elsewhere (`saddle`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.random_starts import Box
from jaxnh.analyses.section_points import on_constraints, points_after, points_at, states_at
from jaxnh.analyses.transients.lifetimes import is_inside, lifetimes
from jaxnh.analyses.transients.saddle import longest
from jaxnh.systems.rows import select
from jaxnh.systems.state import State

WALKERS = 16
"""Orbits of each lane."""

TRIES = 32
"""Random vectors that a point is moved by at once."""

_FURTHER = 12  # periods: lives longer than is wanted by more are followed no further
_NEAR = 16.0  # points are e^−16 of the saddle's size from it, where motions stay for so long
_SHORTEST = 2  # periods
_LEAST = 1e-15  # of the saddle's size: length of vectors
_MARGIN = 2.0  # vectors shorter by this power than what grows to the saddle's size while a point stays change nothing
_MOST = 4096  # periods
_ROUNDS = 256  # of tries, before an orbit is given up


class _Walk(NamedTuple):
    """Orbits to be followed, so many of each lane in a row.

    Attributes:
        batch: the orbits, with the random starts that they begin from.
        lanes: what runs them.
        region: that they stay in.
        least: periods that motions from their points stay, at least, (orbits,).
        walkers: orbits of a lane.
        size: extent of the saddle, (orbits, d).
        growth: rate per period at which motions are taken to part, (orbits,).
        draws: random numbers of each lane.
    """

    batch: LaneBatch
    lanes: LaneRunner
    region: Box
    least: Int[np.ndarray, " orbits"]
    walkers: int
    size: Float[np.ndarray, "orbits d"]
    growth: Float[np.ndarray, " orbits"]
    draws: Sequence[np.random.Generator]


class _Positions(NamedTuple):
    """Present points of orbits, changed in place.

    Attributes:
        u: section coordinates, (orbits, d).
        left: periods that the motion from there is known to stay, (orbits,).
        failures: rounds of tries in turn without a longer one, (orbits,).
        path: the points, (orbits, points, d), of which so many are `done`, (orbits,).
    """

    u: Float[np.ndarray, "orbits d"]
    left: Int[np.ndarray, " orbits"]
    failures: Int[np.ndarray, " orbits"]
    path: Float[np.ndarray, "orbits points d"]
    done: Int[np.ndarray, " orbits"]


def saddle_orbits(
    batch: LaneBatch,
    lanes: LaneRunner,
    region: Box,
    periods: Int[np.ndarray, "lanes starts"],
    growth: Float[np.ndarray, " lanes"],
    count: int,
    seed: int,
) -> State:
    """Return so many points of each lane's saddle, components (lanes, count); not numbers where an orbit was given up.

    Args:
        batch: random starts, so many of each lane.
        periods: their lifetimes.
        growth: rate per period at which motions part, which says how long is long enough; not above zero: as long as
            the starts stay.
    """
    number, starts = periods.shape
    walkers = min(WALKERS, starts, count)
    chosen = longest(periods, walkers)
    known = growth > 0.0
    rate = np.where(known, growth, 0.0)
    stay = np.where(known, np.ceil(_NEAR / np.where(known, growth, 1.0)), periods.ravel()[chosen].min(axis=1))
    stay = np.clip(stay, _SHORTEST, _MOST).astype(int)
    least = np.repeat(stay, walkers)
    part = batch.take(chosen.ravel())
    size = _extent(part, lanes, least, walkers)
    draws = [np.random.default_rng((seed, place)) for place in part.places[::walkers].tolist()]
    each = -(-count // walkers)
    walk = _Walk(part, lanes, region, least, walkers, size, np.repeat(rate, walkers), draws)
    points = _follow(walk, each)
    flat = points.reshape(number, walkers * each, -1)[:, :count].reshape(number * count, -1)
    return select(states_at(batch, lanes, flat), np.arange(number * count).reshape(number, count))


def _extent(
    batch: LaneBatch, lanes: LaneRunner, least: Int[np.ndarray, " orbits"], walkers: int
) -> Float[np.ndarray, "orbits d"]:
    """Return the extent of the motions of each lane until the middle of what they stay for, at least."""
    u = points_at(batch, lanes, batch.start)
    u = np.concatenate([u[:, None], points_after(batch, lanes, u, 0, int(least.max()))], axis=1)
    early = (np.arange(u.shape[1]) <= least[:, None] // 2)[..., None] & np.isfinite(u)
    low, high = (
        np.where(early, u, outside).reshape(-1, walkers * u.shape[1], u.shape[2]) for outside in (np.inf, -np.inf)
    )
    size = np.maximum(high.max(axis=1) - low.min(axis=1), 0.0)
    size = np.where(size > 0.0, size, size.max(axis=1, keepdims=True))
    return np.repeat(np.where(size > 0.0, size, 1.0), walkers, axis=0)


def _follow(walk: _Walk, each: int) -> Float[np.ndarray, "orbits points d"]:
    """Return so many points of each orbit, after as many as it takes to forget where it began."""
    u, total = points_at(walk.batch, walk.lanes, walk.batch.start), walk.least + each
    orbits, d = u.shape
    left, failures, done = (np.zeros(orbits, int) for _ in range(3))
    now = _Positions(u, left, failures, np.full((orbits, int(total.max()), d), np.nan), done)
    while len(active := np.flatnonzero((done < total) & (failures < _ROUNDS))):
        ready = left[active] >= walk.least[active]
        if not ready.all():
            _stagger(walk, active[~ready], now)
        if ready.any():
            _step(walk, active[ready], now, total)
    now.path[done < total] = np.nan
    return np.take_along_axis(now.path, (walk.least[:, None] + np.arange(each))[..., None], axis=1)


def _stagger(walk: _Walk, which: Int[np.ndarray, " some"], now: _Positions) -> None:
    """Move points to ones that stay longer, in place, where one of the tries does."""
    some, d = len(which), now.u.shape[1]
    moved = (now.u[which, None] + _vectors(walk, which, now.left[which], d)).reshape(-1, d)
    many = walk.batch.take(np.repeat(which, TRIES))
    moved = np.array(walk.lanes(on_constraints, (many.system,), (moved, dict(many.p)))[0])
    state, life = states_at(many, walk.lanes, moved), np.zeros(len(moved), int)
    good = np.flatnonzero(is_inside(many, walk.region, select(state, np.arange(len(moved))[:, None]))[:, 0])
    if len(good):
        near = replace(many.take(good), start=select(state, good))
        most = int(walk.least[which].max()) + _FURTHER
        life[good] = lifetimes(near, walk.lanes, walk.region, most).periods
    life = np.minimum(life.reshape(some, TRIES), walk.least[which, None] + _FURTHER)
    longer = life > now.left[which, None]
    better, row, place = longer.any(axis=1), np.arange(some), np.argmax(longer, axis=1)
    now.u[which[better]] = moved.reshape(some, TRIES, d)[row, place][better]
    now.left[which[better]] = life[row, place][better]
    now.failures[which] = np.where(better, 0, now.failures[which] + 1)


def _vectors(
    walk: _Walk, which: Int[np.ndarray, " some"], left: Int[np.ndarray, " some"], d: int
) -> Float[np.ndarray, "some tries d"]:
    """Return random vectors for points in order of lanes, by draws of each lane; the first of each is none.

    Half of them have a length of its own in each coordinate: of two directions that grow at different rates the faster
    one must be met more closely.
    """
    of_lane, every = which // walk.walkers, list[np.ndarray]()
    growth = left * walk.growth[which]
    longest, least = -0.5 * growth, np.maximum(-_MARGIN * (growth + 1.0), np.log(_LEAST))
    for number, some in zip(*np.unique(of_lane, return_counts=True), strict=True):
        way = walk.draws[number].normal(size=(some, TRIES, d))
        ends = (leaf[of_lane == number][:, None, None] for leaf in (least, longest))
        length = np.exp(walk.draws[number].uniform(*ends, (some, TRIES, d)))
        length[:, ::2] = length[:, ::2, :1]
        every.append(length * way / np.linalg.norm(way, axis=2, keepdims=True))
    vectors = np.concatenate(every) * walk.size[which, None]
    vectors[:, 0] = 0.0
    return vectors


def _step(walk: _Walk, which: Int[np.ndarray, " some"], now: _Positions, total: Int[np.ndarray, " orbits"]) -> None:
    """Carry points on for as long as they stay long enough, in place."""
    ahead = points_after(walk.batch.take(which), walk.lanes, now.u[which], 0, _FURTHER + 1)
    for k, orbit in enumerate(which.tolist()):
        start = now.done[orbit]
        steps = min(int(now.left[orbit] - walk.least[orbit]) + 1, int(total[orbit] - start))
        now.path[orbit, start : start + steps] = np.concatenate([now.u[orbit, None], ahead[k, : steps - 1]])
        now.u[orbit] = ahead[k, steps - 1]
        now.done[orbit] += steps
        now.left[orbit] -= steps
