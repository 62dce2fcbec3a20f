"""Attractors of each lane, and the one that a state leads to: what bisection asks for again and again.

Attractors are those of `basins`, from random starts, each lane by itself. A state leads to one where it has come near
it at two looks in turn: an attractor has a neighbourhood in its basin, and `basins` says how near the ends of lanes on
it are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.basins.classification import CHAOTIC, LIMIT_CYCLE, PERIODIC, QUASIPERIODIC, Attractors
from jaxnh.analyses.basins.clustering import find_attractors
from jaxnh.analyses.basins.point_sets import PointSet, offsets, point_set
from jaxnh.analyses.basins.settling import FAILED, settle
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.family import Maps
from jaxnh.systems.rows import select
from jaxnh.systems.state import State, is_finite

MOST = 8
"""Attractors of a lane at most; starts that lead to others count as undecided."""

ESCAPES, UNDECIDED = -1, -2
"""Labels of states that lead to no attractor: the motion ends or goes to infinity, or is not known in time."""

TILE = 64
"""Lanes a tile of programs that follow edges: there are few, and many calls one after the other."""

_LOOK, _LATER = 8, 12  # periods between the first looks, and what those between later ones are multiples of
_STILL = 1e-12  # of the largest coordinate: what moves by less from look to look has come to rest, or to an orbit
_BEYOND = 1e100  # squares of distances overflow in a search tree
_APART = 0.25  # of the distance to another attractor: what is nearer is near to one alone


class Target(NamedTuple):
    """An attractor as a set that states come near to.

    Attributes:
        points: of it, as a set.
        unit: sizes of its motion, (d,).
        margin: distance in these that is near.
    """

    points: PointSet
    unit: Float[np.ndarray, " d"]
    margin: float


class LaneAttractors(NamedTuple):
    """The attractors of a lane, in the order of the means of their points, so that neighbours number them alike.

    Attributes:
        attractors: None where there are none.
        targets: the same as sets.
        labels: of the starts: places among these, or `ESCAPES` or `UNDECIDED`, (starts,).
    """

    attractors: Attractors | None
    targets: Sequence[Target]
    labels: Int[np.ndarray, " starts"]


class Destinations(NamedTuple):
    """The attractors that states of lanes lead to.

    Attributes:
        batch: of the lanes, in time.
        strobe: the map of a period, or of a unit of time.
        targets: of each lane.
        most: periods that a motion is followed.
    """

    batch: LaneBatch
    strobe: Maps
    targets: Sequence[Sequence[Target]]
    most: int

    def refined(self, refinement: int) -> Destinations:
        """Return the same with so many times the steps."""
        return self._replace(strobe=self.batch.strobe(refinement))


def lane_attractors(
    many: LaneBatch, lanes: LaneRunner, starts: int, transient: int, most: int, max_period: int
) -> list[LaneAttractors]:
    """Return the attractors of lanes that each have so many starts in a batch in time.

    Each lane is judged without the others, so that its numbers do not depend on them.
    """
    records = settle(many, lanes, transient, most)
    known = list[LaneAttractors]()
    for first in range(0, many.count, starts):
        own = np.arange(first, first + starts)
        part = select(records, own)
        classified = find_attractors(many.take(own), lanes, part, np.zeros(starts, int), max_period, most)
        if classified.attractors is None or np.all(classified.number < 0):
            labels, attractors = np.full(starts, UNDECIDED), None
        else:
            hits = np.bincount(classified.number[classified.number >= 0], minlength=len(classified.point))
            order = np.argsort(-hits, kind="stable")[: min(MOST, np.count_nonzero(hits))]
            order = order[_by_means(classified.attractors, order)]
            place = np.full(len(hits) + 1, UNDECIDED)  # the last is that of no attractor
            place[order] = np.arange(len(order))
            labels, attractors = place[classified.number], select(classified.attractors, order)
        labels[part.known == FAILED] = ESCAPES
        known.append(LaneAttractors(attractors, _targets(many, attractors), labels))
    return known


def destinations(
    targets: Destinations, lanes: LaneRunner, state: State, lane: Int[np.ndarray, " states"]
) -> Int[np.ndarray, " states"]:
    """Return the attractors that states of a flow lead to, by their places, or `ESCAPES` or `UNDECIDED`.

    What has come to an orbit or to rest elsewhere, on an attractor that no start has led to, is undecided at once.

    Args:
        lane: the number of the lane of each.
    """
    labels, before = np.full(len(lane), UNDECIDED), np.full(len(lane), UNDECIDED)
    active, elapsed, count = np.arange(len(lane)), 0, _LOOK
    u, calm = np.full((len(lane), targets.batch.chart.dimension), np.nan), np.zeros(len(lane), bool)
    while len(active) and elapsed < targets.most:
        p = targets.batch.parameters_of(lane[active])
        state = lanes.iterate(targets.strobe, count, (state, p), tile=TILE)
        new = targets.batch.chart.host_points(state)
        now = _nearest_attractor(targets, new, lane[active])
        now[~is_finite(state)] = ESCAPES
        with np.errstate(all="ignore"):  # of motions that go to infinity, or are at zero
            moved = np.abs(targets.batch.chart.wrap(new - u[active])) / np.max(np.abs(new), axis=1, keepdims=True)
        still = np.all(moved < _STILL, axis=1)
        elsewhere = (now == UNDECIDED) & still & calm[active]
        done = (now == ESCAPES) | ((now >= 0) & (now == before[active])) | elsewhere
        labels[active[done]], before[active] = now[done], now
        u[active], calm[active] = new, still
        elapsed += count
        count = max(_LOOK, elapsed // (4 * _LATER) * _LATER)
        active, state = active[~done], select(state, ~done)
    return labels


def turns_of(attractors: Attractors, place: int) -> int:
    """Return how many of the points of an attractor are all of it where it is an orbit or an equilibrium."""
    if not returns(attractors, place):
        return attractors.points.shape[1]
    return int(attractors.period[place]) if attractors.kind[place] == PERIODIC else 1


def returns(attractors: Attractors, place: int) -> bool:
    """Return whether an attractor is an orbit of the map or an equilibrium, and so few points."""
    return int(attractors.kind[place]) not in (QUASIPERIODIC, CHAOTIC, LIMIT_CYCLE)


def _by_means(attractors: Attractors, places: Int[np.ndarray, " some"]) -> Int[np.ndarray, " some"]:
    """Return the order of attractors by the means of their points: of the first coordinate that tells two apart."""
    means = [attractors.points[k, : turns_of(attractors, k)].mean(axis=0) for k in places.tolist()]
    size = np.maximum(attractors.size[places].max(axis=0), 1e-300)
    return np.lexsort(np.round(np.array(means) / size, 6).T[::-1])


def _nearest_attractor(
    targets: Destinations, u: Float[np.ndarray, "states d"], lane: Int[np.ndarray, " states"]
) -> Int[np.ndarray, " states"]:
    """Return the attractor that each point is nearest to, among those that it is near to."""
    now = np.full(len(lane), UNDECIDED)
    finite = np.all(np.abs(u) < _BEYOND, axis=1)
    for number in np.unique(lane[finite]).tolist():
        own = np.flatnonzero(finite & (lane == number))
        least = np.ones(len(own))
        for place, target in enumerate(targets.targets[number]):
            distance = _distance(target, u[own])
            nearer: Bool[np.ndarray, " own"] = distance < least
            now[own[nearer]], least[nearer] = place, distance[nearer]
    return now


def _distance(target: Target, u: Float[np.ndarray, "points d"]) -> Float[np.ndarray, " points"]:
    """Return the distances of points from an attractor, in units of its margin."""
    return np.max(np.abs(offsets(target.points, u)) / target.unit, axis=1) / target.margin


def _targets(batch: LaneBatch, attractors: Attractors | None) -> list[Target]:
    targets = list[Target]()
    for k in range(0 if attractors is None else len(attractors.kind)):
        assert attractors is not None
        turns = turns_of(attractors, k)
        size = np.where(np.array(batch.chart.angles), 1.0, attractors.size[k])
        unit = np.where(size > 0.0, size, max(float(size.max()), 1e-300))
        points = attractors.points[k, :turns], attractors.steps[k, :turns]
        targets.append(Target(point_set(batch.chart, *points, attractors.size[k], unit), unit, 0.0))
        targets[k] = targets[k]._replace(margin=float(attractors.margin[k]))
    apart = [
        min((np.min(_distance(t, other.points.points)) for other in targets if other is not t), default=np.inf)
        for t in targets
    ]
    return [
        t._replace(margin=t.margin * min(1.0, _APART * far)) if far > 0.0 else t
        for t, far in zip(targets, apart, strict=True)
    ]
