"""Attractors along axes of parameters: which are the same at neighbouring values, and where they are born or die.

Between two neighbouring values, an orbit at the strobe and an equilibrium are continued by Newton, there and back. What
this leaves on both sides is held together by where points of one lead to at the other value: two attractors that lead
to each other, and that nothing else leads to, are the same. So an attractor keeps its number through a doubling, a Hopf
bifurcation and the windows of chaos; where a symmetric one gives way to two twins, it dies and both are born.

An orbit that no start state leads to any more is followed on by Newton for as long as it is stable.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.basins.classification import CHAOTIC, EQUILIBRIUM, PERIODIC, POINTS, Attractors
from jaxnh.analyses.basins.clustering import Assignment, match
from jaxnh.analyses.basins.comparison import same_orbits, same_within
from jaxnh.analyses.basins.paths import batch_from_points
from jaxnh.analyses.basins.settling import RESTLESS, SETTLED, resume, settle
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.crises.band_phase import embed_points
from jaxnh.analyses.crises.sudden_growth import keep_common_growths, sudden_growths
from jaxnh.analyses.equilibria.search import equilibria_from_starts
from jaxnh.analyses.periodic.newton_on_lanes import converged, largest_multiplier, orbits
from jaxnh.systems.rows import select, write_rows

BIRTH, DEATH, CRISIS = range(3)
CHANGES = ("birth", "death", "crisis")
"""Kinds of changes: a crisis is the birth, the death or the sudden growth of a chaotic attractor."""

_PROBES = 8  # points of an attractor that are followed at a neighbouring value
_MOST = 5  # of them that have to lead to the same attractor


class Grid(NamedTuple):
    """All values of the parameters, and a lane at each.

    Attributes:
        values: along each axis, each (n,).
        batches: of the values that lanes share.
        row: number of the batch of every value, (values,).
        lane: number of a lane there, (values,).
    """

    values: tuple[Float[np.ndarray, " n"], ...]
    batches: Sequence[LaneBatch]
    row: Int[np.ndarray, " values"]
    lane: Int[np.ndarray, " values"]

    def neighbours(self, axis: int, points: Int[np.ndarray, " some"], way: int) -> Int[np.ndarray, " some"]:
        """Return the neighbours of values along an axis, higher (1) or lower (−1) ones; −1 where there is none."""
        sizes = tuple(len(values) for values in self.values)
        place = list(np.unravel_index(points, sizes))
        order = np.argsort(self.values[axis], kind="stable")
        rank = np.argsort(order)[place[axis]] + way
        place[axis] = order[np.clip(rank, 0, len(order) - 1)]
        return np.where((rank >= 0) & (rank < len(order)), np.ravel_multi_index(place, sizes), -1)

    def batches_at(self, points: Int[np.ndarray, " some"]) -> Iterator[tuple[Int[np.ndarray, " part"], LaneBatch]]:
        """Yield batches of lanes at these values, each with the places of its lanes in `points`."""
        for number in np.unique(self.row[points]).tolist():
            places = np.flatnonzero(self.row[points] == number)
            yield places, self.batches[number].take(self.lane[points[places]])


class Change(NamedTuple):
    """A change along an axis: its kind, the attractor, and the values that it lies between."""

    kind: int
    attractor: int
    axis: int
    before: int
    after: int


class ContinuedAttractors(NamedTuple):
    """Attractors over the parameters.

    Attributes:
        same: for each, the first of those that are the same, (attractors,).
        changes: in the order of the axes, then of attractors.
        unseen: stable orbits that no start state leads to, but that go on from a neighbouring value.
    """

    same: Int[np.ndarray, " attractors"]
    changes: Sequence[Change]
    unseen: Sequence[Unseen]


class _OrbitsBeyond(NamedTuple):
    """Orbits at other values: whether each exists and is stable, a point of it, and how it attracts."""

    there: Bool[np.ndarray, " some"]
    stable: Bool[np.ndarray, " some"]
    u: Float[np.ndarray, "some d"]
    multiplier: Float[np.ndarray, " some"]
    exponent: Float[np.ndarray, " some"]


class Unseen(NamedTuple):
    """An orbit that no start state leads to: the attractor it continues, its value of the parameter, and the orbit."""

    origin: int
    point: int
    u: Float[np.ndarray, " d"]
    multiplier: float
    exponent: float


def continue_attractors(
    grid: Grid,
    lanes: LaneRunner,
    every: Attractors,
    point: Int[np.ndarray, " attractors"],
    transient: int,
    longest: int,
) -> ContinuedAttractors:
    """Identify attractors of neighbouring values of the parameters along every axis.

    Args:
        point: value that each is at, (attractors,).
        transient, longest: of lanes that are run from points of attractors, as of all others.
    """
    same, changes, unseen = np.arange(len(point)), list[Change](), list[Unseen]()
    for axis, values in enumerate(grid.values):
        if len(values) < 2:
            continue
        with lanes.stage(f"basins: {len(point):,} attractors along an axis", 0.0):
            line = _AxisLinks(grid, lanes, every, point, axis)
            line.link_by_newton()
            line.extend_beyond_starts()
            line.link_by_points(transient, longest)
        changes += line.changes()
        unseen += line.unseen
        for attractor in np.flatnonzero(line.next >= 0).tolist():
            _join(same, point, attractor, int(line.next[attractor]))
    there = {(int(same[k]), int(at)) for k, at in enumerate(point)}
    once = dict[tuple[int, int], Unseen]()
    for new in unseen:  # one that is met from several neighbours is the first of them
        key = int(same[new.origin]), new.point
        if key not in there:
            once.setdefault(key, new)
    return ContinuedAttractors(same, changes, tuple(once.values()))


def _join(
    groups: Int[np.ndarray, " attractors"], point: Int[np.ndarray, " attractors"], first: int, second: int
) -> None:
    """Identify two attractors, in place, unless there would then be two at one value, as around a cusp."""
    low, high = sorted((groups[first], groups[second]))
    if low != high and not np.intersect1d(point[groups == low], point[groups == high]).size:
        groups[groups == high] = low


class _AxisLinks:
    """Attractors along one axis, and links between those that are the same at neighbouring values.

    Attributes:
        unseen: orbits that no start state leads to: attractor that they go on from, value, point, multiplier, exponent.
    """

    def __init__(
        self, grid: Grid, lanes: LaneRunner, every: Attractors, point: Int[np.ndarray, " attractors"], axis: int
    ) -> None:
        self._grid, self._lanes, self._every, self._point, self._axis = grid, lanes, every, point, axis
        self._largest = np.max(every.size, axis=0)
        self._orbit = np.isin(every.kind, (PERIODIC, EQUILIBRIUM))
        self._beside = {way: grid.neighbours(axis, point, way) for way in (1, -1)}
        self._links = {way: np.full(len(point), -1) for way in (1, -1)}
        # Of orbits followed on: the last value that they are at, and the one beyond, −1 at the end of the axis.
        self._ends: dict[int, dict[int, tuple[int, int]]] = {1: {}, -1: {}}
        self.unseen: list[Unseen] = []

    @property
    def next(self) -> Int[np.ndarray, " attractors"]:
        """Number of each attractor at the next higher value, −1 where it ends."""
        return self._links[1]

    def _link(self, first: int, second: int, way: int = 1) -> None:
        self._links[way][first], self._links[-way][second] = second, first

    def _attractors_at(self, at: int) -> Int[np.ndarray, " some"]:
        """Return the attractors at a value."""
        return np.flatnonzero(self._point == at)

    # ---- orbits

    def link_by_newton(self) -> None:
        """Link orbits that Newton continues to each other."""
        subset = np.flatnonzero(self._orbit & (self._beside[1] >= 0))
        orbits = self._continue_orbits(subset, self._every.u[subset], self._point[subset], self._beside[1][subset])
        for k, exists, u in zip(subset.tolist(), orbits.there.tolist(), orbits.u, strict=True):
            other = self._identify(k, u, self._beside[1][k]) if exists else -1
            if other >= 0:
                self._link(k, other)

    def extend_beyond_starts(self) -> None:
        """Continue orbits beyond their last attractor while they are stable; link those that are met again."""
        for way in (1, -1):
            left = np.flatnonzero(self._orbit & (self._links[way] < 0))
            at, u = self._point[left], self._every.u[left]
            while len(left):
                end = self._grid.neighbours(self._axis, at, way)
                self._ends[way] |= {origin: (int(at[k]), -1) for k, origin in enumerate(left.tolist()) if end[k] < 0}
                left, at, end, u = (leaf[end >= 0] for leaf in (left, at, end, u))
                orbits = self._continue_orbits(left, u, at, end)
                goes_on = np.zeros(len(left), bool)
                for k, origin in enumerate(left.tolist()):
                    other = self._identify(origin, orbits.u[k], end[k]) if orbits.there[k] and orbits.stable[k] else -1
                    if other >= 0 and self._links[-way][other] < 0:
                        self._link(origin, other, way)
                    elif other < 0 and orbits.there[k] and orbits.stable[k]:
                        goes_on[k] = True
                        self.unseen.append(
                            Unseen(origin, int(end[k]), orbits.u[k], orbits.multiplier[k], orbits.exponent[k])
                        )
                    else:
                        self._ends[way][origin] = int(at[k]), int(end[k])
                left, at, u = left[goes_on], end[goes_on], orbits.u[goes_on]

    def _identify(self, attractor: int, u: Float[np.ndarray, " d"], at: int) -> int:
        """Return the attractor at a value that is an orbit of this kind and period through u; −1 if there is none."""
        there = self._attractors_at(at)
        chart = self._grid.batches[self._grid.row[at]].chart
        like = select(self._every, attractor)._replace(u=u)
        hits = there[same_orbits(chart, like, select(self._every, there), self._largest)]
        return int(hits[0]) if len(hits) else -1

    def _continue_orbits(
        self,
        subset: Int[np.ndarray, " some"],
        u: Float[np.ndarray, "some d"],
        begin: Int[np.ndarray, " some"],
        end: Int[np.ndarray, " some"],
    ) -> _OrbitsBeyond:
        """Continue orbits of attractors through u from values `begin` to `end`: valid only if they lead back to u."""
        orbits_at_end = self._newton(subset, u, end)
        back = self._newton(subset, orbits_at_end.u, begin)
        chart = self._grid.batches[0].chart
        with np.errstate(invalid="ignore"):
            returns = np.all(np.abs(chart.wrap(back.u - u)) <= same_within(self._largest), axis=1)
        return orbits_at_end._replace(there=orbits_at_end.there & back.there & returns)

    def _newton(
        self, subset: Int[np.ndarray, " some"], u: Float[np.ndarray, "some d"], points: Int[np.ndarray, " some"]
    ) -> _OrbitsBeyond:
        """Solve for orbits with the periods of these attractors by Newton from u, at values of the parameters."""
        count = len(subset)
        result = _OrbitsBeyond(np.zeros(count, bool), np.zeros(count, bool), u.copy(), *np.full((2, count), np.nan))
        finite = np.all(np.isfinite(u), axis=1)
        for places, batch in self._grid.batches_at(points):
            for kind in (PERIODIC, EQUILIBRIUM):
                mine = (self._every.kind[subset[places]] == kind) & finite[places]
                if not np.any(mine):
                    continue
                which, among = places[mine], batch.take(np.flatnonzero(mine))
                solve = self._solve_orbits if kind == PERIODIC else self._solve_equilibria
                write_rows(result, which, solve(among, u[which], subset[which]))
        return result

    def _solve_orbits(
        self, batch: LaneBatch, u: Float[np.ndarray, "some d"], subset: Int[np.ndarray, " some"]
    ) -> _OrbitsBeyond:
        period = self._every.period[subset]
        orbit = orbits(self._lanes, batch.strobe(), u, dict(batch.p), period, size := self._every.size[subset])
        exists = converged(self._lanes, batch.strobe(), orbit, dict(batch.p), period, size)
        multiplier = largest_multiplier(orbit.monodromy)
        with np.errstate(divide="ignore", invalid="ignore"):
            exponent = np.log(multiplier) / (period * batch.flow.period)
        return _OrbitsBeyond(exists, multiplier < 1.0, orbit.u, multiplier, exponent)

    def _solve_equilibria(
        self, batch: LaneBatch, u: Float[np.ndarray, "some d"], some: Int[np.ndarray, " some"]
    ) -> _OrbitsBeyond:
        size = np.broadcast_to(self._largest, u.shape)
        zeros = equilibria_from_starts(batch, self._lanes, u, size)
        return _OrbitsBeyond(zeros.exists, zeros.stable, zeros.u, np.full(len(u), np.nan), zeros.exponent)

    # ---- all others

    def link_by_points(self, transient: int, longest: int) -> None:
        """Link remaining attractors of neighbouring values that lead to each other alone."""
        leads: dict[tuple[int, int], int] = {}
        for way in (1, -1):
            inner = np.flatnonzero(self._beside[way] >= 0).tolist()
            inner = [k for k in inner if k in self._unlinked(self._point[k], way)]
            faced = [k for k in inner if len(self._unlinked(self._beside[way][k], -way))]
            to = self._destinations(np.array(faced, int), self._beside[way][faced], transient, longest)
            leads |= {(first, way): int(second) for first, second in zip(faced, to, strict=True)}
        for at in np.unique(self._point[[first for first, way in leads if way == 1]]).tolist():
            after = self._grid.neighbours(self._axis, np.array([at]), 1)[0]
            self._pair(self._unlinked(at, 1), self._unlinked(after, -1), leads)

    def _pair(
        self, ones: Int[np.ndarray, " ones"], others: Int[np.ndarray, " others"], leads: dict[tuple[int, int], int]
    ) -> None:
        """Link attractors of neighbouring values that lead to each other, or one to the other, and to nothing else."""
        arrows = {(first, leads[first, 1]) for first in ones.tolist() if leads[first, 1] >= 0}
        arrows |= {(leads[second, -1], second) for second in others.tolist() if leads[second, -1] >= 0}
        for first, second in sorted(arrows):
            alone = all((a == first) == (b == second) for a, b in arrows)
            if alone and first in ones and second in others:
                self._link(first, second)

    def _unlinked(self, at: int, way: int) -> Int[np.ndarray, " some"]:
        """Return the attractors at a value that end there in this direction: neither linked nor continued by Newton."""
        there = self._attractors_at(at)
        ends = np.array([self._ends[way].get(attractor, (at, at))[0] == at for attractor in there.tolist()], bool)
        return there[(self._links[way][there] < 0) & ends]

    def _destinations(
        self, subset: Int[np.ndarray, " some"], points: Int[np.ndarray, " some"], transient: int, longest: int
    ) -> Int[np.ndarray, " some"]:
        """Return the attractor at a value that most points of each given one lead to, −1 where there is none."""
        to = np.full((len(subset), _PROBES), -1)
        place = np.linspace(0, POINTS - 1, _PROBES).round().astype(int)
        for places, batch in self._grid.batches_at(points):
            start = self._every.points[subset[places]][:, place]
            many = batch.take(np.repeat(np.arange(len(places)), _PROBES))
            many = batch_from_points(many, self._lanes, start.reshape(-1, start.shape[-1]))
            records, at = settle(many, self._lanes, transient, longest), np.repeat(points[places], _PROBES)
            assignment = Assignment(np.full(many.count, -1), self._point, self._every)
            while True:
                match(many, self._lanes, records, at, assignment)
                left = (
                    (assignment.number < 0)
                    & np.isin(records.known, (SETTLED, RESTLESS))
                    & (2 * records.time <= longest)
                )
                if not np.any(left):
                    break
                resume(many, self._lanes, records, np.flatnonzero(left), longest)
            to[places] = assignment.number.reshape(-1, _PROBES)
        most = [np.bincount(row[row >= 0], minlength=1) for row in to]
        return np.array([int(np.argmax(hits)) if hits.max() >= _MOST else -1 for hits in most], int)

    # ---- what has changed

    def changes(self) -> list[Change]:
        """Return the births, deaths and sudden growths of attractors."""
        changes = []
        for origin, kind in enumerate(self._every.kind.tolist()):
            for way, change in ((-1, BIRTH), (1, DEATH)):
                begin, end = self._ends[way].get(origin, (int(self._point[origin]), int(self._beside[way][origin])))
                if self._links[way][origin] < 0 <= end:
                    changes.append(Change(CRISIS if kind == CHAOTIC else change, origin, self._axis, begin, end))
        chains, sizes = list(self._chaotic_chains()), [len(values) for values in self._grid.values]
        along = [np.unravel_index(self._point[chain], sizes)[self._axis] for chain in chains]
        values = self._grid.values[self._axis]
        grown = [sudden_growths(self._clouds(chain), values[at]) for chain, at in zip(chains, along, strict=True)]
        points = [self._point[chain].tolist() for chain in chains]
        grown = keep_common_growths(grown, points, [self._every.exponent[chain] for chain in chains])
        for chain, steps in zip(chains, grown, strict=True):
            for k in np.flatnonzero(steps).tolist():
                origin, other = chain[k], chain[k + 1]
                changes.append(Change(CRISIS, origin, self._axis, int(self._point[origin]), int(self._point[other])))
        return changes

    def _chaotic_chains(self) -> Iterator[list[int]]:
        """Yield chains of two or more chaotic attractors, each linked to the next."""
        chaotic = self._every.kind == CHAOTIC
        for attractor in np.flatnonzero(chaotic).tolist():
            before, chain = int(self._links[-1][attractor]), [attractor]
            if before >= 0 and chaotic[before]:
                continue
            while (other := int(self._links[1][chain[-1]])) >= 0 and chaotic[other]:
                chain.append(other)
            if len(chain) > 1:
                yield chain

    def _clouds(self, chain: Sequence[int]) -> list[Float[np.ndarray, "points k"]]:
        """Return points of attractors, in units of the largest of their sizes."""
        size = np.max(self._every.size[chain], axis=0)
        turns = np.array(self._grid.batches[0].chart.angles)
        return [
            embed_points(self._every.points[attractor], turns, np.where(size > 0.0, size, 1.0)) for attractor in chain
        ]
