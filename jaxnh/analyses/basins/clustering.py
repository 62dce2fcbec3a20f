"""Assignment of lanes to attractors over a whole sweep: clusters of like lanes, and lanes judged for each.

Means say which lanes may be on one attractor, and are no evidence that they are: attractors that a symmetry relates may
share all of them. What counts is where lanes are.

An attractor is left by no motion. Where a lane was on what seems to be a chaotic one, by means and place, and went to
infinity or to an orbit or to rest later, as just beyond a crisis, it is none, and its lanes are followed further.

Host code on records of lanes and attractors; `point` says everywhere which value of the parameters a lane is at,
as lanes at different ones have nothing to do with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from jaxnh.analyses.basins.classification import (
    CHAOTIC,
    EQUILIBRIUM,
    LIMIT_CYCLE,
    NONE,
    PERIODIC,
    Attractors,
    classify,
)
from jaxnh.analyses.basins.comparison import distances, join_attractors, mean_distances, same_attractors, stay_near
from jaxnh.analyses.basins.paths import follow_paths
from jaxnh.analyses.basins.settling import (
    CONSERVATIVE,
    FAILED,
    OPEN,
    RESTLESS,
    SETTLED,
    SETTLED_TO,
    TRANSIENT,
    LaneRecords,
    resume,
)
from jaxnh.analyses.basins.volume import keeps_volume
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.systems.chart import Chart
from jaxnh.systems.rows import concatenate, select, spread_indices
from jaxnh.systems.status import NOT_FINITE

_MOST_CLUSTERS = 64  # of a value of the parameters, that are judged at once
_FRUITLESS = 4  # times in turn that lanes of one cluster are judged in vain
_SEEDS = 4  # of restless lanes, likewise
_STRAYS = 2.0  # gaps: by so much means over one window are off the attractor's, all but one in a hundred of them
_CLEARLY = 2.0  # times as far as from its attractor is a lane from every other one, or not near to it


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


class Departures(NamedTuple):
    """Motions that did not stay where they were in their last window.

    Attributes:
        point: value of the parameters of each, (some,).
        records: of that window.
    """

    point: Int[np.ndarray, " some"]
    records: LaneRecords


def find_attractors(
    batch: LaneBatch,
    lanes: LaneRunner,
    records: LaneRecords,
    point: Int[np.ndarray, " lanes"],
    limit: int,
    longest: int,
) -> Assignment:
    """Return the attractors of lanes that have been run by themselves, extending in place lanes that are on none.

    Judging takes as long as lanes have gone on before, so that after a round without a new attractor half as
    many are judged: all rounds together cost no more than a few of the first.

    Args:
        point: numbers of the values of the parameters that lanes are at, (lanes,).
        limit: period looked for, at most.
        longest: periods that a lane may take.
    """
    assignment, most = Assignment(np.full(batch.count, -1), np.zeros(0, int), None), _MOST_CLUSTERS
    tested, transient = np.zeros((2, batch.count), np.bool_)
    departed = list[Departures]()
    while True:
        before = len(assignment.point)
        assignment = _search(batch, lanes, records, point, assignment, limit, longest, most, departed)
        failed = np.flatnonzero((records.known == FAILED) & np.all(np.isfinite(records.u), axis=1))
        gone = [*departed, Departures(point[failed], select(records, failed))]
        assignment, dropped = _drop_transients(batch.chart, assignment, gone, records)
        transient |= dropped
        most = most if len(assignment.point) > before else max(1, most // 2)
        left = (assignment.number < 0) & np.isin(records.known, (SETTLED, RESTLESS))
        new = np.flatnonzero(left & ~tested)
        if len(new):
            kept = new[keeps_volume(batch.take(new), lanes, records.u[new], longest)]
            records.known[kept], left[kept], tested[new] = CONSERVATIVE, False, True
        unsettled = np.flatnonzero(left & (2 * records.time <= longest))
        if not len(unsettled):
            records.known[left] = np.where(transient[left], TRANSIENT, OPEN)
            return assignment
        with lanes.stage(f"basins: extending {len(unsettled):,} lanes", float(records.time[unsettled].sum())):
            resume(batch, lanes, records, unsettled, longest)


def _search(
    batch: LaneBatch,
    lanes: LaneRunner,
    records: LaneRecords,
    point: Int[np.ndarray, " lanes"],
    assignment: Assignment,
    limit: int,
    longest: int,
    most: int,
    departed: list[Departures],
) -> Assignment:
    """Match lanes to attractors and judge the others, at most so many clusters at a value of the parameters.

    Lanes of one cluster may still be on several attractors, as those that a symmetry relates share means: while new
    ones are known, the lanes of a cluster that are on none of them are judged in turn. So are, a few times, those
    whose leader is on no attractor but elsewhere.
    """
    match(batch, lanes, records, point, assignment)
    pending, restless, fruitless = assignment.number < 0, True, 0
    while True:
        seeds, cluster = _representatives(records, point, pending, most, restless)
        if not len(seeds):
            return assignment
        representatives = batch.take(seeds)
        judged = classify(representatives, lanes, select(records, seeds), limit, longest)
        gone = seeds[~_is_finite(judged)]  # long after they had seemed to stay
        records.known[gone], records.status[gone] = FAILED, NOT_FINITE
        before = len(assignment.point)
        assignment, place = _add_attractors(batch.chart, assignment, judged, point[seeds])
        settled = records.known[seeds] == SETTLED
        regular = seeds[~settled & (place >= 0) & np.isin(judged.kind, (PERIODIC, EQUILIBRIUM, LIMIT_CYCLE))]
        departed.append(Departures(point[regular], select(records, regular)))
        assignment.number[seeds[settled]] = place[settled]
        of_leader = np.where(cluster >= 0, place[cluster], -1)
        match(batch, lanes, records, point, assignment, of_leader)
        away = _far_from_leaders(batch.chart, records, judged, cluster)
        fruitful = len(assignment.point) > before
        pending, restless = (assignment.number < 0) & (away | (fruitful & (of_leader >= 0))), False
        fruitless = 0 if fruitful else fruitless + 1
        if fruitless > _FRUITLESS:
            return assignment


def _drop_transients(
    chart: Chart, assignment: Assignment, departures: Sequence[Departures], records: LaneRecords
) -> tuple[Assignment, Bool[np.ndarray, " lanes"]]:
    """Drop chaotic attractors that some motions have left, and return which lanes had been on them."""
    if assignment.attractors is None:
        return assignment, np.zeros(len(assignment.number), np.bool_)
    gone = concatenate(departures)
    stays = np.ones(len(assignment.point), np.bool_)
    for k in np.flatnonzero(assignment.attractors.kind == CHAOTIC).tolist():
        attractor = select(assignment.attractors, k)
        gaps, left = records.gap[assignment.number == k], select(gone.records, gone.point == assignment.point[k])
        stays[k] = not np.any(_was_on(chart, attractor, left, float(np.median(gaps)) if len(gaps) else 0.0))
    number = np.where(stays, np.cumsum(stays) - 1, -1)
    kept = select(assignment.attractors, stays) if np.any(stays) else None
    on = assignment.number >= 0
    dropped = on & ~stays[assignment.number]
    assignment.number[on] = number[assignment.number[on]]
    return assignment._replace(point=assignment.point[stays], attractors=kept), dropped


def _was_on(chart: Chart, target: Attractors, records: LaneRecords, typical: float) -> Bool[np.ndarray, " some"]:
    """Return whether motions were on a chaotic set in their last window, by place and by means within a gap.

    Args:
        typical: median gap of lanes on the set, 4/3 of the standard deviation of means over a window. The gap of one
            lane is by chance far below the error of its means, where both halves of the window err alike.
    """
    unit = records.unit * (np.maximum(records.gap, _STRAYS * typical) / (2.0 * SETTLED_TO))[:, None]
    alike = np.all(np.abs(records.means - target.means) <= unit + target.unit, axis=1)
    alike[alike] = distances(chart, target, records.u[alike], records.size[alike]) <= 1.0
    return alike


def _is_finite(judged: Attractors) -> Bool[np.ndarray, " reps"]:
    return np.all(np.isfinite(judged.points), axis=(1, 2))


def _far_from_leaders(
    chart: Chart, records: LaneRecords, judged: Attractors, cluster: Int[np.ndarray, " lanes"]
) -> Bool[np.ndarray, " lanes"]:
    """Return whether a lane is far from the leader of its cluster, which is on no attractor, as beside a repeller."""
    away, finite = np.zeros(len(cluster), np.bool_), _is_finite(judged)
    for k in np.flatnonzero(judged.kind == NONE).tolist():
        members = np.flatnonzero(cluster == k)
        if not finite[k]:
            away[members] = True
        elif len(members) > 1:
            leader = select(judged, k)
            away[members] = distances(chart, leader, records.u[members], records.size[members]) > 1.0
    return away


def match(
    batch: LaneBatch,
    lanes: LaneRunner,
    records: LaneRecords,
    point: Int[np.ndarray, " lanes"],
    assignment: Assignment,
    of_leader: Int[np.ndarray, " lanes"] | None = None,
) -> None:
    """Assign attractors that fit to lanes that have none yet, in place.

    Lanes that have settled have its means and have come near its points, and to those of no other; restless ones stay
    near its points, nearer than to those of others.

    Args:
        of_leader: attractor whose means a lane shares with the leader of its cluster, −1 where there is none, (lanes,).
    """
    if assignment.attractors is None:
        return
    pending = assignment.number < 0
    settled, restless = (np.flatnonzero(pending & (records.known == known)) for known in (SETTLED, RESTLESS))
    paths = follow_paths(batch.take(restless), lanes, records.u[restless]) if len(restless) else np.empty(0)
    (first, second), nearest = np.full((2, batch.count), np.inf), np.full(batch.count, -1)
    for k in range(len(assignment.point)):
        attractor = select(assignment.attractors, k)
        subset = settled[point[settled] == assignment.point[k]]
        fits = np.all(np.abs(records.means[subset] - attractor.means) <= records.unit[subset] + attractor.unit, axis=1)
        subset = subset[fits if of_leader is None else fits | (of_leader[subset] == k)]
        distance = distances(batch.chart, attractor, records.u[subset], records.size[subset])
        staying = np.flatnonzero(point[restless] == assignment.point[k])
        if len(staying):
            staying = staying[stay_near(batch, attractor, paths[staying])]
            subset, distance = (
                np.append(subset, restless[staying]),
                np.append(distance, mean_distances(batch, attractor, paths[staying])),
            )
        nearer = distance < first[subset]
        second[subset] = np.where(nearer, first[subset], np.minimum(second[subset], distance))
        first[subset] = np.where(nearer, distance, first[subset])
        nearest[subset] = np.where(nearer, k, nearest[subset])
    shown = (first <= 1.0) & (second > np.minimum(1.0, _CLEARLY * first))
    shown[restless] = nearest[restless] >= 0
    assignment.number[shown] = nearest[shown]


def _representatives(
    records: LaneRecords,
    point: Int[np.ndarray, " lanes"],
    pending: Bool[np.ndarray, " lanes"],
    most: int,
    restless: bool,
) -> tuple[Int[np.ndarray, " seeds"], Int[np.ndarray, " lanes"]]:
    """Select pending lanes to be judged: the first of each cluster of settled ones, and a few restless ones.

    Returns:
        Their numbers, and for every lane the place among them of the one of its cluster, −1 where it is in none.
    """
    cluster, seeds = np.full(len(point), -1), list[int]()
    settled = np.flatnonzero(pending & (records.known == SETTLED))
    for _ in range(most):
        if not len(settled):
            break
        points, first = np.unique(point[settled], return_index=True)
        leaders = settled[first]
        owner = np.searchsorted(points, point[settled])
        mine = leaders[owner]
        alike = np.all(
            np.abs(records.means[settled] - records.means[mine]) <= records.unit[settled] + records.unit[mine], axis=1
        )
        cluster[settled[alike]] = len(seeds) + owner[alike]
        seeds += leaders.tolist()
        settled = settled[~alike]
    others = np.flatnonzero(pending & (records.known == RESTLESS)) if restless else np.zeros(0, int)
    for at in np.unique(point[others]):
        lanes_at = others[point[others] == at]
        seeds += lanes_at[spread_indices(len(lanes_at), min(_SEEDS, most))].tolist()
    return np.array(seeds, int), cluster


def _add_attractors(
    chart: Chart,
    assignment: Assignment,
    judged: Attractors,
    point: Int[np.ndarray, " reps"],
) -> tuple[Assignment, Int[np.ndarray, " reps"]]:
    """Add new attractors, and return the number of every representative's own, −1 where it has none."""
    sizes = [judged.size[judged.kind != NONE], *(() if assignment.attractors is None else [assignment.attractors.size])]
    largest = np.max(np.concatenate(sizes), axis=0, initial=0.0)
    place = np.full(len(point), -1)
    new: list[int] = []
    before = 0 if assignment.attractors is None else len(assignment.point)
    for k in range(len(point)):
        if judged.kind[k] == NONE:
            continue
        target = select(judged, k)
        known = [] if assignment.attractors is None else [(0, assignment.attractors, assignment.point)]
        known += [(before, select(judged, np.array(new)), point[new])] if new else []
        for first, others, at in known:
            same = same_attractors(chart, target, others, largest, at == point[k])
            if np.any(same):
                place[k] = first + int(np.argmax(same))
                break
        else:
            place[k] = before + len(new)
            new.append(k)
    added = select(judged, np.array(new, int))
    every = added if new else None
    if assignment.attractors is not None:
        every = join_attractors([assignment.attractors, added])
    of_each = np.concatenate([assignment.point, point[new].astype(int)])
    return Assignment(assignment.number, of_each, every, assignment.judged + len(point)), place
