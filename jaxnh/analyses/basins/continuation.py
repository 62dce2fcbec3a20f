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

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.basins.classification import CHAOTIC, EQUILIBRIUM, PERIODIC, POINTS, Attractors, scene_from
from jaxnh.analyses.basins.clustering import Assignment, match, same_orbits, same_within
from jaxnh.analyses.basins.settling import RESTLESS, SETTLED, go_on, settle
from jaxnh.analyses.batch import LaneBatch, LaneRunner, picked
from jaxnh.analyses.crises.band_phase import embedded
from jaxnh.analyses.crises.sudden_growth import agreed, sudden_growths
from jaxnh.analyses.equilibria.search import equilibria_from_starts
from jaxnh.analyses.periodic.newton_on_lanes import CONVERGED, largest_multiplier, orbits

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

    def beside(self, axis: int, points: Int[np.ndarray, " some"], way: int) -> Int[np.ndarray, " some"]:
        """The neighbours of values along an axis, towards higher (1) or lower (−1) ones; −1 where there is none."""
        sizes = tuple(len(values) for values in self.values)
        place = list(np.unravel_index(points, sizes))
        order = np.argsort(self.values[axis], kind="stable")
        rank = np.argsort(order)[place[axis]] + way
        place[axis] = order[np.clip(rank, 0, len(order) - 1)]
        return np.where((rank >= 0) & (rank < len(order)), np.ravel_multi_index(place, sizes), -1)

    def at(self, points: Int[np.ndarray, " some"]) -> Iterator[tuple[Int[np.ndarray, " part"], LaneBatch]]:
        """Scenes of lanes at some values, each with the places of these in `points`."""
        for number in np.unique(self.row[points]).tolist():
            here = np.flatnonzero(self.row[points] == number)
            yield here, self.batches[number].take(self.lane[points[here]])


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
    """Orbits at other values: which are there, and which of these are stable; points of them, and how they attract."""

    there: Bool[np.ndarray, " some"]
    stable: Bool[np.ndarray, " some"]
    u: Float[np.ndarray, "some d"]
    multiplier: Float[np.ndarray, " some"]
    exponent: Float[np.ndarray, " some"]


class Unseen(NamedTuple):
    """An orbit that no start state leads to: the attractor it goes on from, the value that it is at, and the orbit."""

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
    """Attractors of all values of the parameters held together along every axis.

    Args:
        point: value that each is at, (attractors,).
        transient, longest: of lanes that are run from points of attractors, as of all others.
    """
    same, changes, unseen = np.arange(len(point)), list[Change](), list[Unseen]()
    for axis, values in enumerate(grid.values):
        if len(values) < 2:
            continue
        with lanes.stage(f"basins: {len(point):,} attractors along an axis", 0.0):
            line = _Line(grid, lanes, every, point, axis)
            line.by_newton()
            line.beyond_the_last_start()
            line.by_points(transient, longest)
        changes += line.changes()
        unseen += line.unseen
        for one in np.flatnonzero(line.next >= 0).tolist():
            _join(same, point, one, int(line.next[one]))
    there = {(int(same[k]), int(at)) for k, at in enumerate(point)}
    once = dict[tuple[int, int], Unseen]()
    for one in unseen:  # one that is met from several neighbours is the first of them
        key = int(same[one.origin]), one.point
        if key not in there:
            once.setdefault(key, one)
    return ContinuedAttractors(same, changes, tuple(once.values()))


def _join(groups: Int[np.ndarray, " attractors"], point: Int[np.ndarray, " attractors"], one: int, other: int) -> None:
    """Make two attractors one, in place, unless they would then be two at one value, as around a cusp."""
    low, high = sorted((groups[one], groups[other]))
    if low != high and not np.intersect1d(point[groups == low], point[groups == high]).size:
        groups[groups == high] = low


class _Line:
    """Attractors along one axis: which one each goes on as at the next value, and which one each comes from.

    Attributes:
        unseen: orbits that no start state leads to: attractor that they go on from, value, point, multiplier, exponent.
    """

    def __init__(
        self, grid: Grid, lanes: LaneRunner, every: Attractors, point: Int[np.ndarray, " attractors"], axis: int
    ) -> None:
        self._grid, self._lanes, self._every, self._point, self._axis = grid, lanes, every, point, axis
        self._largest = np.max(every.size, axis=0)
        self._orbit = np.isin(every.kind, (PERIODIC, EQUILIBRIUM))
        self._beside = {way: grid.beside(axis, point, way) for way in (1, -1)}
        self._links = {way: np.full(len(point), -1) for way in (1, -1)}
        # Of orbits followed on: the last value that they are at, and the one beyond, −1 at the end of the axis.
        self._ends: dict[int, dict[int, tuple[int, int]]] = {1: {}, -1: {}}
        self.unseen: list[Unseen] = []

    @property
    def next(self) -> Int[np.ndarray, " attractors"]:
        """What each is at the next higher value where it is found, −1 where it ends."""
        return self._links[1]

    def _link(self, one: int, other: int, way: int = 1) -> None:
        self._links[way][one], self._links[-way][other] = other, one

    def _there(self, at: int) -> Int[np.ndarray, " some"]:
        """Attractors at a value."""
        return np.flatnonzero(self._point == at)

    # ---- orbits

    def by_newton(self) -> None:
        """Link orbits that Newton continues to each other."""
        some = np.flatnonzero(self._orbit & (self._beside[1] >= 0))
        found = self._continued(some, self._every.u[some], self._point[some], self._beside[1][some])
        for one, there, u in zip(some.tolist(), found.there.tolist(), found.u, strict=True):
            other = self._met(one, u, self._beside[1][one]) if there else -1
            if other >= 0:
                self._link(one, other)

    def beyond_the_last_start(self) -> None:
        """Follow orbits on where they end, for as long as they are there and stable; link those that are met again."""
        for way in (1, -1):
            some = np.flatnonzero(self._orbit & (self._links[way] < 0))
            at, u = self._point[some], self._every.u[some]
            while len(some):
                end = self._grid.beside(self._axis, at, way)
                self._ends[way] |= {one: (int(at[k]), -1) for k, one in enumerate(some.tolist()) if end[k] < 0}
                some, at, end, u = (leaf[end >= 0] for leaf in (some, at, end, u))
                found = self._continued(some, u, at, end)
                goes_on = np.zeros(len(some), bool)
                for k, one in enumerate(some.tolist()):
                    other = self._met(one, found.u[k], end[k]) if found.there[k] and found.stable[k] else -1
                    if other >= 0 and self._links[-way][other] < 0:
                        self._link(one, other, way)
                    elif other < 0 and found.there[k] and found.stable[k]:
                        goes_on[k] = True
                        self.unseen.append(Unseen(one, int(end[k]), found.u[k], found.multiplier[k], found.exponent[k]))
                    else:
                        self._ends[way][one] = int(at[k]), int(end[k])
                some, at, u = some[goes_on], end[goes_on], found.u[goes_on]

    def _met(self, one: int, u: Float[np.ndarray, " d"], at: int) -> int:
        """The attractor at a value that an orbit is, with its kind and period; −1 where it is none."""
        there = self._there(at)
        chart = self._grid.batches[self._grid.row[at]].chart
        like = jax.tree.map(lambda leaf: leaf[one], self._every)._replace(u=u)
        hits = there[same_orbits(chart, like, picked(self._every, there), self._largest)]
        return int(hits[0]) if len(hits) else -1

    def _continued(
        self,
        some: Int[np.ndarray, " some"],
        u: Float[np.ndarray, "some d"],
        begin: Int[np.ndarray, " some"],
        end: Int[np.ndarray, " some"],
    ) -> _OrbitsBeyond:
        """Orbits of some attractors, through u at the values `begin`, at `end`: there only if they lead back to u."""
        found = self._newton(some, u, end)
        back = self._newton(some, found.u, begin)
        chart = self._grid.batches[0].chart
        with np.errstate(invalid="ignore"):
            returns = np.all(np.abs(chart.wrap(back.u - u)) <= same_within(self._largest), axis=1)
        return found._replace(there=found.there & back.there & returns)

    def _newton(
        self, some: Int[np.ndarray, " some"], u: Float[np.ndarray, "some d"], points: Int[np.ndarray, " some"]
    ) -> _OrbitsBeyond:
        """Newton from u for orbits with the periods of some attractors, at values of the parameters."""
        count = len(some)
        found = _OrbitsBeyond(np.zeros(count, bool), np.zeros(count, bool), u.copy(), *np.full((2, count), np.nan))
        finite = np.all(np.isfinite(u), axis=1)
        for here, batch in self._grid.at(points):
            for kind in (PERIODIC, EQUILIBRIUM):
                mine = (self._every.kind[some[here]] == kind) & finite[here]
                if not np.any(mine):
                    continue
                which, among = here[mine], batch.take(np.flatnonzero(mine))
                parts = (self._periodic if kind == PERIODIC else self._at_rest)(among, u[which], some[which])
                for whole, part in zip(found, parts, strict=True):
                    whole[which] = part
        return found

    def _periodic(
        self, batch: LaneBatch, u: Float[np.ndarray, "some d"], some: Int[np.ndarray, " some"]
    ) -> _OrbitsBeyond:
        period = self._every.period[some]
        orbit = orbits(self._lanes, batch.strobe(), u, dict(batch.p), period, self._every.size[some])
        multiplier = largest_multiplier(orbit.monodromy)
        with np.errstate(divide="ignore", invalid="ignore"):
            exponent = np.log(multiplier) / (period * batch.flow.period)
        return _OrbitsBeyond(orbit.residual < CONVERGED, multiplier < 1.0, orbit.u, multiplier, exponent)

    def _at_rest(
        self, batch: LaneBatch, u: Float[np.ndarray, "some d"], some: Int[np.ndarray, " some"]
    ) -> _OrbitsBeyond:
        size = np.broadcast_to(self._largest, u.shape)
        found = equilibria_from_starts(batch, self._lanes, u, size)
        return _OrbitsBeyond(found.found, found.stable, found.u, np.full(len(u), np.nan), found.exponent)

    # ---- all others

    def by_points(self, transient: int, longest: int) -> None:
        """Link what is left on both sides and leads to each other alone."""
        leads: dict[tuple[int, int], int] = {}
        for way in (1, -1):
            some = [k for k in np.flatnonzero(self._beside[way] >= 0).tolist() if k in self._open(self._point[k], way)]
            faced = [k for k in some if len(self._open(self._beside[way][k], -way))]
            to = self._led(np.array(faced, int), self._beside[way][faced], transient, longest)
            leads |= {(one, way): int(other) for one, other in zip(faced, to, strict=True)}
        for at in np.unique(self._point[[one for one, way in leads if way == 1]]).tolist():
            self._pair(self._open(at, 1), self._open(self._grid.beside(self._axis, np.array([at]), 1)[0], -1), leads)

    def _pair(
        self, ones: Int[np.ndarray, " ones"], others: Int[np.ndarray, " others"], leads: dict[tuple[int, int], int]
    ) -> None:
        """Link those of two neighbouring values that lead to each other, or one to the other, and to nothing else."""
        arrows = {(one, leads[one, 1]) for one in ones.tolist() if leads[one, 1] >= 0}
        arrows |= {(leads[other, -1], other) for other in others.tolist() if leads[other, -1] >= 0}
        for one, other in sorted(arrows):
            alone = all((a == one) == (b == other) for a, b in arrows)
            if alone and one in ones and other in others:
                self._link(one, other)

    def _open(self, at: int, way: int) -> Int[np.ndarray, " some"]:
        """Attractors at a value that end there, that way: linked to none, and Newton follows them no further."""
        there = self._there(at)
        ends = np.array([self._ends[way].get(one, (at, at))[0] == at for one in there.tolist()], bool)
        return there[(self._links[way][there] < 0) & ends]

    def _led(
        self, some: Int[np.ndarray, " some"], points: Int[np.ndarray, " some"], transient: int, longest: int
    ) -> Int[np.ndarray, " some"]:
        """The attractor at a value that most points of each of some attractors lead to, −1 where there is none."""
        to = np.full((len(some), _PROBES), -1)
        place = np.linspace(0, POINTS - 1, _PROBES).round().astype(int)
        for here, batch in self._grid.at(points):
            begun = self._every.points[some[here]][:, place]
            many = batch.take(np.repeat(np.arange(len(here)), _PROBES))
            many = scene_from(many, self._lanes, begun.reshape(-1, begun.shape[-1]))
            lot, at = settle(many, self._lanes, transient, longest), np.repeat(points[here], _PROBES)
            found = Assignment(np.full(many.count, -1), self._point, self._every)
            while True:
                match(many, self._lanes, lot, at, found)
                left = (found.number < 0) & np.isin(lot.known, (SETTLED, RESTLESS)) & (2 * lot.time <= longest)
                if not np.any(left):
                    break
                go_on(many, self._lanes, lot, np.flatnonzero(left), longest)
            to[here] = found.number.reshape(-1, _PROBES)
        most = [np.bincount(row[row >= 0], minlength=1) for row in to]
        return np.array([int(np.argmax(hits)) if hits.max() >= _MOST else -1 for hits in most], int)

    # ---- what has changed

    def changes(self) -> list[Change]:
        """Where attractors end, begin, or grow."""
        found = []
        for one, kind in enumerate(self._every.kind.tolist()):
            for way, change in ((-1, BIRTH), (1, DEATH)):
                begin, end = self._ends[way].get(one, (int(self._point[one]), int(self._beside[way][one])))
                if self._links[way][one] < 0 <= end:
                    found.append(Change(CRISIS if kind == CHAOTIC else change, one, self._axis, begin, end))
        chains, sizes = list(self._chaotic_chains()), [len(values) for values in self._grid.values]
        along = [np.unravel_index(self._point[chain], sizes)[self._axis] for chain in chains]
        values = self._grid.values[self._axis]
        grown = [sudden_growths(self._clouds(chain), values[at]) for chain, at in zip(chains, along, strict=True)]
        points = [self._point[chain].tolist() for chain in chains]
        grown = agreed(grown, points, [self._every.exponent[chain] for chain in chains])
        for chain, steps in zip(chains, grown, strict=True):
            for k in np.flatnonzero(steps).tolist():
                one, other = chain[k], chain[k + 1]
                found.append(Change(CRISIS, one, self._axis, int(self._point[one]), int(self._point[other])))
        return found

    def _chaotic_chains(self) -> Iterator[list[int]]:
        """Attractors that are linked one to the next, as far as they are chaotic: two at least."""
        chaotic = self._every.kind == CHAOTIC
        for one in np.flatnonzero(chaotic).tolist():
            before, chain = int(self._links[-1][one]), [one]
            if before >= 0 and chaotic[before]:
                continue
            while (other := int(self._links[1][chain[-1]])) >= 0 and chaotic[other]:
                chain.append(other)
            if len(chain) > 1:
                yield chain

    def _clouds(self, chain: Sequence[int]) -> list[Float[np.ndarray, "points k"]]:
        """Points of attractors, in the largest of their sizes."""
        size = np.max(self._every.size[chain], axis=0)
        turns = np.array(self._grid.batches[0].chart.angles)
        return [embedded(self._every.points[one], turns, np.where(size > 0.0, size, 1.0)) for one in chain]
