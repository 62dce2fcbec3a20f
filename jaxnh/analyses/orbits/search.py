"""Search for all periodic orbits up to a number of returns: Newton from motions of each lane, round by round.

In a round the attractor of each lane is followed for as many strobes as in any other, and for each number of returns
Newton is started by multiple shooting: at the nearest return and at the first point of every window, and at random
starts. A round begins where the last one has ended, so that rounds are samples alike. Orbits that one lane has and its
neighbours have not are tried in these in the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.orbits import OrbitsOptions
from jaxnh.analyses.periodic.attractor_survey import motion_sizes
from jaxnh.analyses.periodic.close_returns import WINDOW, nearest_returns, stretches
from jaxnh.analyses.periodic.newton_on_lanes import images
from jaxnh.analyses.random_starts import random_start_batch
from jaxnh.analyses.section_points import points_and_end, points_from, points_of_starts, states_at
from jaxnh.maps.family import Maps
from jaxnh.maps.section import Section
from jaxnh.orbits.recognition import Cycles, equal_cycles, merge_cycles, no_cycles, primitive_period
from jaxnh.orbits.shooting import Period, orbits_from_afar
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import concatenate
from jaxnh.systems.state import State

WINDOWS = 16
"""Windows of a round."""

_LEAST_ROUNDS = 4
_AT_REST = 1e-6  # sizes of the motion a unit of time: where the section is crossed no faster it is not crossed
_FARTHEST = 100.0  # sizes of the motion: orbits further out are none of this motion


class Search(NamedTuple):
    """Orbits of all lanes of a batch.

    Attributes:
        cycles: by number of returns.
        rounds: that were made of each lane, (lanes,).
        size: of the motion in each section coordinate, (lanes, d).
        moving: whether the motion from the start state stays finite, (lanes,).
        images: of each orbit the number of its image under a symmetry, by number of returns; None: not asked for.
    """

    cycles: Mapping[int, Cycles]
    rounds: Int[np.ndarray, " lanes"]
    size: Float[np.ndarray, "lanes d"]
    moving: Bool[np.ndarray, " lanes"]
    images: Mapping[int, Int[np.ndarray, " cycles"]] | None = None


def search(
    options: OrbitsOptions, batch: LaneBatch, lanes: LaneRunner, strobe: Maps, u: Float[np.ndarray, "lanes d"]
) -> Search:
    """Return the orbits that rounds of Newton find, from points of lanes that have settled.

    A lane is searched until each orbit known has been met in three rounds or more, or for as many as are allowed.

    Args:
        strobe: the map that orbits are sought of.
    """
    d, limit, length = batch.chart.dimension, options.max_period, WINDOWS * WINDOW
    cycles = {n: no_cycles(n, d) for n in range(1, limit + 1)}
    made, at, size = np.zeros(batch.count, int), np.array(u), np.full((batch.count, d), np.nan)
    random = _random_paths(options, batch, lanes)
    open_ = np.arange(batch.count)
    for turn in range(options.rounds):
        with lanes.stage(f"orbits: round {turn + 1}, {len(open_)} lanes", float(len(open_) * length)):
            part = batch.take(open_)
            path, end = points_and_end(part, lanes, states_at(part, lanes, at[open_]), 0, length + limit)
            if not turn:
                size = _sizes(batch, lanes, path, end, random)
            at[open_] = path[:, length - 1]
            paths = [path, *([random[open_, turn]] if random is not None else [])]
            by_returns = _round(options, part, lanes, strobe, paths, size[open_])
        for n, new in by_returns.items():
            cycles[n] = merge_cycles(cycles[n], new._replace(lane=open_[new.lane]), size, batch.chart.wrap)
        made[open_] += 1
        if turn + 1 >= _LEAST_ROUNDS:
            open_ = open_[_doubtful(cycles, batch.count)[open_]]
        if not len(open_):
            break
    return Search(cycles, made, size, np.array(np.isfinite(at).all(axis=1)))


def search_neighbours(
    known: Search, batch: LaneBatch, lanes: LaneRunner, strobe: Maps, neighbours: Int[np.ndarray, "pairs 2"]
) -> Search:
    """Return the orbits with those that lanes have in common with neighbours, by Newton from the orbits of these.

    Args:
        neighbours: numbers of a lane and of one that has values of the parameters next to its own.
    """
    cycles, wrap = dict(known.cycles), batch.chart.wrap
    fresh = {n: np.arange(len(orbits.lane)) for n, orbits in cycles.items()}
    while any(len(numbers) for numbers in fresh.values()) and len(neighbours):
        more = dict[int, list[Cycles]]()
        for n, numbers in fresh.items():
            number, pair = np.nonzero(cycles[n].lane[numbers][:, None] == neighbours[None, :, 0])
            if len(number):
                points, lane = cycles[n].points[numbers[number]], neighbours[pair, 1]
                for new in newton(batch, lanes, strobe, points, lane, known.size):
                    more.setdefault(new.points.shape[1], []).append(new)
        before = {n: len(orbits.lane) for n, orbits in cycles.items()}
        for n, parts in more.items():
            cycles[n] = merge_cycles(cycles[n], concatenate(parts), known.size, wrap, sample=False)
        fresh = {n: np.arange(before[n], len(orbits.lane)) for n, orbits in cycles.items()}
    return known._replace(cycles=cycles)


def map_of_lanes(batch: LaneBatch, lanes: LaneRunner, strobe: Maps) -> Period:
    """Return P and ∂P/∂u at points of lanes of a batch, which are given by their numbers."""
    return images(lanes, strobe, dict(batch.p), np.ones(batch.count, np.int32))


def newton(
    batch: LaneBatch,
    lanes: LaneRunner,
    strobe: Maps,
    points: Float[np.ndarray, "starts n d"],
    lane: Int[np.ndarray, " starts"],
    size: Float[np.ndarray, "lanes d"],
) -> list[Cycles]:
    """Return the orbits that Newton finds from stretches of motions of lanes, by their primitive period."""
    if not len(lane):
        return []
    wrap = batch.chart.wrap
    first = equal_cycles(lane, points, size[lane], wrap) == np.arange(len(lane))  # one of those on a periodic motion
    points, lane = points[first], lane[first]
    orbits = orbits_from_afar(map_of_lanes(batch, lanes, strobe), points, lane, size[lane], wrap)
    with np.errstate(invalid="ignore"):
        near = np.max(np.abs(orbits.points) / size[lane][:, None], axis=(1, 2)) < _FARTHEST
    good = orbits.converged & near & _crosses(batch, lanes, orbits.points, lane, size)
    lane, points = lane[good], orbits.points[good]
    primitive = primitive_period(points, size[lane], wrap)
    periods = np.unique(primitive).tolist()
    return [
        Cycles(lane[primitive == m], points[primitive == m][:, :m], np.zeros(np.sum(primitive == m), int))
        for m in periods
    ]


def _crosses(
    batch: LaneBatch,
    lanes: LaneRunner,
    points: Float[np.ndarray, "cycles n d"],
    lane: Int[np.ndarray, " cycles"],
    size: Float[np.ndarray, "lanes d"],
) -> Bool[np.ndarray, " cycles"]:
    """Return whether a section is crossed at all points; an equilibrium on it is a fixed point of no return."""
    section, (count, n, d) = batch.system, points.shape
    if not isinstance(section, Section):
        return np.ones(count, bool)
    p = batch.parameters_of(np.repeat(lane, n))
    rate = np.asarray(lanes(_crossing_rate, (section,), (points.reshape(-1, d), p))).reshape(count, n)
    rate = np.abs(rate) if section.direction == "both" else rate
    with np.errstate(invalid="ignore"):
        return np.all(rate > _AT_REST * size[lane].max(axis=1)[:, None] / section.flow.period, axis=1)


def _crossing_rate(section: Section, u: Float[Array, " d"], p: Parameters) -> Array:
    return section.rate(section.chart.state(u).state, p)


def _round(
    options: OrbitsOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    strobe: Maps,
    paths: Sequence[np.ndarray],
    size: Float[np.ndarray, "lanes d"],
) -> dict[int, Cycles]:
    """Return the orbits that a round finds by number of returns, from one path of each lane and random ones."""
    (path, *random), by_returns = paths, dict[int, list[Cycles]]()
    start = WINDOW * np.arange(WINDOWS)
    for n in range(1, options.max_period + 1):
        nearest = nearest_returns(path, n, WINDOWS, size, batch.chart.wrap)
        starts = [stretches(path, n, np.concatenate([nearest, np.broadcast_to(start, nearest.shape)], axis=1))]
        for more in random:
            points, which = stretches(more.reshape(-1, *more.shape[2:]), n, np.zeros((more[..., 0, 0].size, 1), int))
            starts.append((points, which // more.shape[1]))
        points, lane = (np.concatenate(leaves) for leaves in zip(*starts, strict=True))
        if len(lane):
            for cycles in newton(batch, lanes, strobe, points, lane, size):
                by_returns.setdefault(cycles.points.shape[1], []).append(cycles)
    return {n: concatenate(parts) for n, parts in by_returns.items()}


def _random_paths(
    options: OrbitsOptions, batch: LaneBatch, lanes: LaneRunner
) -> Float[np.ndarray, "lanes rounds starts points d"] | None:
    """Return motions from the random starts of all rounds, if there are any."""
    if not options.n_starts:
        return None
    many, _ = random_start_batch(batch, options.rounds * options.n_starts, options.seed, options.box)
    first = points_of_starts(many, lanes)
    path = points_from(many.take(np.arange(len(first)) % many.count), lanes, first, options.max_period)
    kinds = path.reshape(-1, batch.count, options.rounds, options.n_starts, *path.shape[1:])
    return np.concatenate(list(kinds), axis=2)


def _sizes(
    batch: LaneBatch,
    lanes: LaneRunner,
    path: Float[np.ndarray, "lanes points d"],
    end: State,
    random: Float[np.ndarray, "lanes ..."] | None,
) -> Float[np.ndarray, "lanes d"]:
    """Return the sizes of the motions of lanes, or of their random starts where these are larger; of angles one."""
    if batch.chart.dimensionless:
        return np.ones((batch.count, path.shape[2]))
    size = motion_sizes(batch, lanes, path, end)
    if random is None:
        return size
    starts = np.where(np.array(batch.chart.angles), 1.0, np.max(np.abs(random[..., 0, :]), axis=(1, 2)))
    return np.where(np.isfinite(starts), np.maximum(size, starts), size)


def _doubtful(cycles: Mapping[int, Cycles], count: int) -> Bool[np.ndarray, " lanes"]:
    """Return which lanes have orbits that were met in one round or two alone."""
    doubtful = np.zeros(count, bool)
    for orbits in cycles.values():
        doubtful[orbits.lane[orbits.rounds <= 2]] = True
    return doubtful
