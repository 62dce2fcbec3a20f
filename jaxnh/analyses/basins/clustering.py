"""Lanes to attractors over a whole sweep: which lanes are alike, which of them are judged, and which are on what.

Means say which lanes may be on one attractor, and are no evidence that they are: attractors that a symmetry relates may
share all of them. What counts is where lanes are.

Host code over what lanes and attractors have left; `point` says everywhere which value of the parameters a lane is at,
as lanes at different ones have nothing to do with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.basins.classification import (
    CHAOTIC,
    EQUILIBRIUM,
    NONE,
    PERIODIC,
    POINTS,
    Attractors,
    classify,
    filled_up,
    followed,
    stays_near,
)
from jaxnh.analyses.basins.point_sets import lie_within, offsets, point_set
from jaxnh.analyses.basins.settling import CONSERVATIVE, OPEN, RESTLESS, SETTLED, Lot, go_on
from jaxnh.analyses.basins.volume import keeps_volume
from jaxnh.analyses.batch import LaneBatch, LaneRunner, picked
from jaxnh.systems.chart import Chart

_MOST_CLUSTERS = 64  # of a value of the parameters, that are judged at once
_FRUITLESS = 4  # times in turn that lanes of one cluster are judged in vain
_SEEDS = 4  # of restless lanes, likewise
_SAME_ORBIT = 1e-6  # of the largest motion of the sweep
_CLEARLY = 2.0  # times as far as from its attractor is a lane from every other one, or not near to it
_MOSTLY = 0.95  # of the points of a set lie within the largest spacing that those of another look have


class Assignment(NamedTuple):
    """Attractors of lanes.

    Attributes:
        number: of every lane's attractor in `attractors`, −1 where there is none, (lanes,).
        point: of every attractor, (attractors,).
        attractors: what they are; None where there are none.
        judged: number of lanes that have been judged.
    """

    number: Int[np.ndarray, " lanes"]
    point: Int[np.ndarray, " attractors"]
    attractors: Attractors | None
    judged: int = 0


def find(
    batch: LaneBatch, lanes: LaneRunner, lot: Lot, point: Int[np.ndarray, " lanes"], limit: int, longest: int
) -> Assignment:
    """The attractors of lanes that have been run by themselves; those on none yet go on, in place, while they may.

    Judging takes as long as lanes have gone on before, so that after a round in which no attractor was found half as
    many are judged: all rounds together cost no more than a few of the first.

    Args:
        point: numbers of the values of the parameters that lanes are at, (lanes,).
        limit: period looked for, at most.
        longest: periods that a lane may take.
    """
    found, most = Assignment(np.full(batch.count, -1), np.zeros(0, int), None), _MOST_CLUSTERS
    tested = np.zeros(batch.count, np.bool_)
    while True:
        before = len(found.point)
        found = _search(batch, lanes, lot, point, found, limit, longest, most)
        most = most if len(found.point) > before else max(1, most // 2)
        left = (found.number < 0) & np.isin(lot.known, (SETTLED, RESTLESS))
        new = np.flatnonzero(left & ~tested)
        if len(new):
            kept = new[keeps_volume(batch.take(new), lanes, lot.u[new], longest)]
            lot.known[kept], left[kept], tested[new] = CONSERVATIVE, False, True
        some = np.flatnonzero(left & (2 * lot.time <= longest))
        if not len(some):
            lot.known[left] = OPEN
            return found
        with lanes.stage(f"basins: {len(some):,} lanes longer", float(lot.time[some].sum())):
            go_on(batch, lanes, lot, some, longest)


def _search(
    batch: LaneBatch,
    lanes: LaneRunner,
    lot: Lot,
    point: Int[np.ndarray, " lanes"],
    found: Assignment,
    limit: int,
    longest: int,
    most: int,
) -> Assignment:
    """Lanes matched to attractors, and those that these leave judged, at most so many at a value of the parameters.

    Lanes of one cluster may still be on several attractors, as those that a symmetry relates share means: while new
    ones are found, the lanes of a cluster that are on none of them are judged in turn. So are, a few times, those
    whose leader is on no attractor but elsewhere.
    """
    match(batch, lanes, lot, point, found)
    open_, restless, fruitless = found.number < 0, True, 0
    while True:
        seeds, cluster = _representatives(lot, point, open_, most, restless)
        if not len(seeds):
            return found
        here = batch.take(seeds)
        judged = classify(here, lanes, picked(lot, seeds), limit, longest)
        largest, before = np.nanmax(np.abs(lot.size), axis=0, initial=0.0), len(found.point)
        found, place = _added(here, lanes, found, judged, point[seeds], largest)
        settled = lot.known[seeds] == SETTLED
        found.number[seeds[settled]] = place[settled]
        of_leader = np.where(cluster >= 0, place[cluster], -1)
        match(batch, lanes, lot, point, found, of_leader)
        away = _away(batch.chart, lot, judged, cluster)
        fruitful = len(found.point) > before
        open_, restless = (found.number < 0) & (away | (fruitful & (of_leader >= 0))), False
        fruitless = 0 if fruitful else fruitless + 1
        if fruitless > _FRUITLESS:
            return found


def _away(chart: Chart, lot: Lot, judged: Attractors, cluster: Int[np.ndarray, " lanes"]) -> Bool[np.ndarray, " lanes"]:
    """Lanes of clusters whose leaders are on no attractor, and that are not where these are, as beside a repeller."""
    away = np.zeros(len(cluster), np.bool_)
    for k in np.flatnonzero(judged.kind == NONE).tolist():
        some = np.flatnonzero(cluster == k)
        if len(some) > 1:
            one: Attractors = jax.tree.map(lambda leaf, k=k: leaf[k], judged)
            away[some] = _distances(chart, one, lot.u[some], lot.size[some]) > 1.0
    return away


def match(
    batch: LaneBatch,
    lanes: LaneRunner,
    lot: Lot,
    point: Int[np.ndarray, " lanes"],
    found: Assignment,
    of_leader: Int[np.ndarray, " lanes"] | None = None,
) -> None:
    """Numbers of the attractors of lanes that have none yet, in place, where there is one that fits.

    Lanes that have settled have its means and have come near its points, and to those of no other; restless ones stay
    near its points, nearer than to those of others.

    Args:
        of_leader: attractor whose means a lane shares with the leader of its cluster, −1 where there is none, (lanes,).
    """
    if found.attractors is None:
        return
    open_ = found.number < 0
    settled, restless = (np.flatnonzero(open_ & (lot.known == known)) for known in (SETTLED, RESTLESS))
    paths = followed(batch.take(restless), lanes, lot.u[restless]) if len(restless) else np.empty(0)
    (first, second), nearest = np.full((2, batch.count), np.inf), np.full(batch.count, -1)
    for k in range(len(found.point)):
        one: Attractors = jax.tree.map(lambda leaf, k=k: leaf[k], found.attractors)
        some = settled[point[settled] == found.point[k]]
        fits = np.all(np.abs(lot.means[some] - one.means) <= lot.unit[some] + one.unit, axis=1)
        some = some[fits if of_leader is None else fits | (of_leader[some] == k)]
        distance = _distances(batch.chart, one, lot.u[some], lot.size[some])
        here = np.flatnonzero(point[restless] == found.point[k])
        if len(here):
            here = here[_near(batch, one, paths[here])]
            some, distance = (
                np.append(some, restless[here]),
                np.append(distance, _mean_distances(batch, one, paths[here])),
            )
        nearer = distance < first[some]
        second[some] = np.where(nearer, first[some], np.minimum(second[some], distance))
        first[some], nearest[some] = np.where(nearer, distance, first[some]), np.where(nearer, k, nearest[some])
    shown = (first <= 1.0) & (second > np.minimum(1.0, _CLEARLY * first))
    shown[restless] = nearest[restless] >= 0
    found.number[shown] = nearest[shown]


def _mean_distances(
    batch: LaneBatch, one: Attractors, paths: Float[np.ndarray, "lanes followed d"]
) -> Float[np.ndarray, " lanes"]:
    """Mean distances of the points of paths from an attractor, in its margin."""
    every = paths.reshape(-1, paths.shape[2])
    return _distances(batch.chart, one, every, np.zeros_like(every)).reshape(paths.shape[:2]).mean(axis=1)


def _distances(
    chart: Chart, one: Attractors, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"]
) -> Float[np.ndarray, " lanes"]:
    """Distances of section points from an attractor, in what its margin is for lanes of these sizes."""
    if not len(u):
        return np.zeros(0)
    turns = max(1, int(one.period)) if one.kind in (PERIODIC, EQUILIBRIUM) else len(one.points)
    away = offsets(point_set(chart, one.points[:turns], one.steps[:turns], one.size, size.max(axis=0)), u)
    unit = np.where(chart.angles, 1.0, np.maximum(one.size, size))
    return np.max(np.abs(away) / np.where(unit > 0.0, unit, 1.0), axis=1) / float(one.margin)


def _near(
    batch: LaneBatch, one: Attractors, paths: Float[np.ndarray, "lanes followed d"]
) -> Bool[np.ndarray, " lanes"]:
    """Whether paths stay near an attractor."""
    edge = one.near * np.where(one.size > 0.0, one.size, 1.0)
    return stays_near(np.array(batch.chart.angles), paths, one.points, edge)


def _representatives(
    lot: Lot, point: Int[np.ndarray, " lanes"], open_: Bool[np.ndarray, " lanes"], most: int, restless: bool
) -> tuple[Int[np.ndarray, " seeds"], Int[np.ndarray, " lanes"]]:
    """Open lanes to be judged: the first of each cluster of those that have settled, and some restless ones.

    Returns:
        Their numbers, and for every lane the place among them of the one of its cluster, −1 where it is in none.
    """
    cluster, seeds = np.full(len(point), -1), list[int]()
    settled = np.flatnonzero(open_ & (lot.known == SETTLED))
    for _ in range(most):
        if not len(settled):
            break
        points, first = np.unique(point[settled], return_index=True)
        leaders = settled[first]
        of = np.searchsorted(points, point[settled])
        mine = leaders[of]
        alike = np.all(np.abs(lot.means[settled] - lot.means[mine]) <= lot.unit[settled] + lot.unit[mine], axis=1)
        cluster[settled[alike]] = len(seeds) + of[alike]
        seeds += leaders.tolist()
        settled = settled[~alike]
    others = np.flatnonzero(open_ & (lot.known == RESTLESS)) if restless else np.zeros(0, int)
    for at in np.unique(point[others]):
        here = others[point[others] == at]
        seeds += here[np.unique(np.linspace(0, len(here) - 1, min(_SEEDS, most)).round().astype(int))].tolist()
    return np.array(seeds, int), cluster


def _added(
    batch: LaneBatch,
    lanes: LaneRunner,
    found: Assignment,
    judged: Attractors,
    point: Int[np.ndarray, " reps"],
    largest: Float[np.ndarray, " d"],
) -> tuple[Assignment, Int[np.ndarray, " reps"]]:
    """Attractors with those that are new, and for every representative the number of its own, −1 where it is none."""
    place = np.full(len(point), -1)
    new: list[int] = []
    before = 0 if found.attractors is None else len(found.point)
    for k in range(len(point)):
        if judged.kind[k] == NONE:
            continue
        one: Attractors = jax.tree.map(lambda leaf, k=k: leaf[k], judged)
        if before:
            assert found.attractors is not None
            same = _same(batch.take(slice(k, k + 1)), lanes, one, found.attractors, largest, found.point == point[k])
            if np.any(same):
                place[k] = int(np.argmax(same))
                continue
        if new:
            others = picked(judged, np.array(new))
            same = _same(batch.take(slice(k, k + 1)), lanes, one, others, largest, point[new] == point[k])
            if np.any(same):
                place[k] = before + int(np.argmax(same))
                continue
        place[k] = before + len(new)
        new.append(k)
    added = picked(judged, np.array(new, int))
    every = added if new else None
    if found.attractors is not None:
        every = joined([found.attractors, added])
    of_each = np.concatenate([found.point, point[new].astype(int)])
    return Assignment(found.number, of_each, every, found.judged + len(point)), place


def joined(parts: Sequence[Attractors]) -> Attractors:
    """Attractors of several parts, one after the other, with as many points each."""
    most = max(part.points.shape[1] for part in parts)
    filled = [filled_up(part.points, part.steps, most) for part in parts]
    even = [part._replace(points=points, steps=steps) for part, (points, steps) in zip(parts, filled, strict=True)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *even)


def _same(
    batch: LaneBatch,
    lanes: LaneRunner,
    one: Attractors,
    others: Attractors,
    largest: Float[np.ndarray, " d"],
    here: Bool[np.ndarray, " others"],
) -> Bool[np.ndarray, " others"]:
    """Which of some attractors at the same point another one is: orbits have a point in common, others fill one set."""
    if one.kind in (PERIODIC, EQUILIBRIUM):
        return same_orbits(batch.chart, one, others, largest) & here
    alike = (others.kind == one.kind) & here
    for k in np.flatnonzero(alike):
        alike[k] = same_set(batch.chart, one, jax.tree.map(lambda leaf, k=k: leaf[k], others))
    return alike


def same_set(chart: Chart, one: Attractors, other: Attractors) -> bool:
    """Whether two motions fill the same set: the points of each lie within the spacing of the other's.

    Of chaos the points of one are enough, as a finite look need not have visited all of it.
    """
    margin, within = max(float(one.margin), float(other.margin)), list[bool]()
    for a, b in ((one, other), (other, one)):
        points = a.points[:: max(1, len(a.points) // POINTS)]
        inside = lie_within(point_set(chart, b.points, b.steps, b.size), points, b.size, margin)
        within.append(bool(np.mean(inside) >= _MOSTLY))
    return any(within) if one.kind == CHAOTIC else all(within)


def same_orbits(
    chart: Chart, one: Attractors, others: Attractors, largest: Float[np.ndarray, " d"]
) -> Bool[np.ndarray, " others"]:
    """Which of some attractors are an equilibrium or an orbit that has these kind, period and point `u`."""
    turns = int(one.period)
    points = others.points[:, :turns] if turns else others.u[:, None]
    apart = np.abs(chart.wrap(points - one.u))
    alike = (others.kind == one.kind) & (others.period == one.period)
    return alike & np.any(np.all(apart <= same_within(largest), axis=-1), axis=1)


def same_within(largest: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """How far apart points of one orbit are at most, with the largest motion of a sweep."""
    return _SAME_ORBIT * np.where(largest > 0.0, largest, 1.0)
