"""Periodic orbits that touch a wall or a surface, as arcs between events. Host code.

A map of a period is not smooth where an orbit grazes: its derivative goes like one over the square root of the distance
(Nordmark, J. Sound Vib. 145 (1991) 279). In place of it are arcs, each up to the next event by one branch of the field,
with states, times and lengths as unknowns. Where an arc is to end, a height is zero; where the orbit touches, its rate
is, and the height itself is one condition more. All of that is smooth (Thota and Dankowicz, Physica D 214 (2006) 187).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxnh.orbits.continuation.core import DenseEquations, EquationsOfPaths, Evaluation, Solution
from jaxnh.orbits.continuation.paths import BEYOND

_NEWTON_STEPS = 20
_SMALL = 1e-7  # step of Newton, in units, from which on steps have to become shorter
_NO_TIME = 1e-9  # of a period, as of an orbit that touches where its period begins
_BEYOND = 1e-7  # of the range of a height along an arc, that rounding does not explain


class ArcSequence(NamedTuple):
    """The arcs of an orbit, in order from the beginning of a period.

    Attributes:
        event: that each ends at, as `maps.event_arcs.arc_end` counts them, (m,).
        side: of walls and surfaces along each, (m, k).
        touch: number of the arc that ends where the orbit touches.
    """

    event: Int[np.ndarray, " m"]
    side: Float[np.ndarray, "m k"]
    touch: int

    @property
    def surface(self) -> int:
        """Number of the wall or surface that is touched."""
        return int(self.event[self.touch]) % self.side.shape[1]

    @property
    def first(self) -> Int[np.ndarray, " n"]:
        """Numbers of the arcs that begin with a period."""
        ends = np.flatnonzero(self.event == 2 * self.side.shape[1])
        return np.concatenate([[0], ends[:-1] + 1])

    @property
    def events(self) -> int:
        """Number of walls and surfaces that the orbit passes."""
        return int(np.sum(self.event < self.side.shape[1]))

    def same_as(self, other: ArcSequence) -> bool:
        """Return whether another orbit has the same events on the same sides, and touches at the same of them."""
        return (
            self.touch == other.touch
            and np.array_equal(self.event, other.event)
            and np.array_equal(self.side, other.side)
        )


class ArcEnds(NamedTuple):
    """Ends of arcs, or derivatives of them: what is after each, what is missing to its event, and the height."""

    after: np.ndarray
    missing: np.ndarray
    height: np.ndarray


class ArcPlaces(NamedTuple):
    """States along arcs, (arcs, places, d), with heights of walls and surfaces and their rates, (arcs, places, k)."""

    state: np.ndarray
    height: np.ndarray
    rate: np.ndarray


class ArcProblem(NamedTuple):
    """Arcs of a flow with a clock, or of one without from crossing to crossing of a section.

    Attributes:
        ends: of arcs that begin at (arcs, d + 1), of lengths (arcs,), with sides (arcs, k) and events (arcs,), at
            values of parameters (arcs, q): they, and their derivatives in the beginning, the length and the values.
        places: along arcs with the same arguments but for events.
        rising: which walls are met only where their heights rise, (k,).
        wrap: angles in differences of states.
        size: of the motion, (d,).
        period: of the clock; without one the longest return.
        low, high: ends of the ranges of the parameters, (q,).
        given: number of the coordinate that the section gives; none with a clock.
    """

    ends: Callable[..., tuple[ArcEnds, ArcEnds, ArcEnds, ArcEnds]]
    places: Callable[..., ArcPlaces]
    rising: Bool[np.ndarray, " k"]
    wrap: Callable[[np.ndarray], np.ndarray]
    size: Float[np.ndarray, " d"]
    period: float
    low: Float[np.ndarray, " q"]
    high: Float[np.ndarray, " q"]
    given: int | None = None


class GrazingOrbit(NamedTuple):
    """A periodic orbit that touches.

    Attributes:
        sequence: its arcs.
        start: coordinates and times where they begin, (m, d + 1).
        length: of them, (m,).
        values: of the parameters, (q,).
        points: where periods begin, by section coordinates, (n, e).
        multipliers: those of the side on which the orbit does not reach what it touches, (e,).
        rounding: of the parameters, by what Newton's steps come down to, (q,).
    """

    sequence: ArcSequence
    start: Float[np.ndarray, "m more"]
    length: Float[np.ndarray, " m"]
    values: Float[np.ndarray, " q"]
    points: Float[np.ndarray, "n e"]
    multipliers: Complex[np.ndarray, " e"]
    rounding: Float[np.ndarray, " q"]

    def turned(self) -> Iterator[GrazingOrbit]:
        """The same orbit from each of its periods on."""
        (event, side, touch), m = self.sequence, len(self.length)
        for number, k in enumerate(self.sequence.first.tolist()):
            sequence = ArcSequence(np.roll(event, -k), np.roll(side, -k, axis=0), (touch - k) % m)
            start, length = np.roll(self.start, -k, axis=0), np.roll(self.length, -k)
            yield self._replace(
                sequence=sequence, start=start, length=length, points=np.roll(self.points, -number, axis=0)
            )


class GrazingEquations(DenseEquations, EquationsOfPaths):
    """Orbits that touch as `core.CurveEquations`, unknowns in their units: arcs, their lengths, and parameters.

    Args:
        problem: the flow.
        sequence: of the arcs.
    """

    def __init__(self, problem: ArcProblem, sequence: ArcSequence) -> None:
        self._problem, self._sequence, self._d = problem, sequence, len(problem.size)
        self._m, width = len(sequence.event), problem.high - problem.low
        state = np.append(problem.size, problem.period)
        self._size = np.concatenate([np.tile(state, self._m), np.full(self._m, problem.period), width])
        self._rows = np.concatenate([np.tile(state, self._m), np.ones(self._m + 1)])
        self.unit = np.ones(len(self._size))
        self.low, self.high = problem.low / width, problem.high / width

    def unknowns(self, start: np.ndarray, length: np.ndarray, values: np.ndarray) -> Float[np.ndarray, " N"]:
        """Unknowns of an orbit."""
        return np.concatenate([start.ravel(), length, values]) / self._size

    def parts(self, z: Float[np.ndarray, "lanes N"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Beginnings, lengths and parameters of unknowns."""
        whole, cut = z * self._size, self._m * (self._d + 1)
        return whole[:, :cut].reshape(len(z), self._m, -1), whole[:, cut : cut + self._m], whole[:, cut + self._m :]

    def orbit(
        self, z: Float[np.ndarray, " N"], blocks: Float[np.ndarray, "m e e"], step: Float[np.ndarray, " N"]
    ) -> GrazingOrbit:
        """The orbit of unknowns, with what is left of Newton's steps."""
        (start,), (length,), (values,) = self.parts(z[None])
        (left,) = self.parts(step[None])[2]
        rounding = np.abs(left) + np.spacing(np.abs(values))
        points, given = start[self._sequence.first, :-1], self._problem.given
        points = points if given is None else np.delete(points, given, axis=1)
        return GrazingOrbit(self._sequence, start, length, values, points, self.multipliers(blocks[None])[0], rounding)

    def missing(self, orbit: GrazingOrbit) -> Float[np.ndarray, " rows"]:
        """Residual at an orbit of another problem, in its units."""
        return self.evaluate(self.unknowns(orbit.start, orbit.length, orbit.values)[None]).residual[0]

    def rate(
        self, orbit: GrazingOrbit, change: Float[np.ndarray, " rows"], error: Float[np.ndarray, " rows"]
    ) -> tuple[float, float]:
        """The derivative of the first parameter in another one, by the implicit function theorem, and its error.

        Args:
            orbit: one that touches, of a problem with one parameter.
            change: derivative of what is missing at it in the other one.
            error: of that.
        """
        at = self.evaluate(self.unknowns(orbit.start, orbit.length, orbit.values)[None])
        try:
            row = np.linalg.solve(at.slopes[0].T, np.eye(len(change))[-1]) * self._size[-1]
        except np.linalg.LinAlgError:
            return np.nan, np.nan
        return float(-row @ change), float(np.abs(row) @ error)

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """Residual of an orbit, derivatives of each arc, and those of all in the unknowns."""
        start, length, values = self.parts(z)
        (lanes, m, e), q, sequence = start.shape, values.shape[1], self._sequence
        flat = (start.reshape(-1, e), length.ravel(), np.tile(sequence.side, (lanes, 1)))
        at = self._problem.ends(*flat, np.tile(sequence.event, lanes), np.repeat(values, m, axis=0))
        end, by_start, by_length, by_values = (
            ArcEnds(*(leaf.reshape(lanes, m, *leaf.shape[1:]) for leaf in part)) for part in at
        )
        gap = end.after - np.roll(start, -1, axis=1)
        gap[..., :-1] = self._problem.wrap(gap[..., :-1])
        residual = np.concatenate([gap.reshape(lanes, -1), end.missing, end.height[:, [sequence.touch]]], axis=1)
        slopes, cut = np.zeros((lanes, m * e + m + 1, m * e + m + q)), m * e
        for k in range(m):
            own, ahead = slice(k * e, (k + 1) * e), (k + 1) % m * e
            slopes[:, own, own] += by_start.after[:, k]
            slopes[:, own, ahead : ahead + e] -= np.eye(e)
            slopes[:, own, cut + k] = by_length.after[:, k]
            slopes[:, own, cut + m :] = by_values.after[:, k]
            rows = [(cut + k, "missing")] + ([(cut + m, "height")] if k == sequence.touch else [])
            for row, name in rows:
                slopes[:, row, own] = getattr(by_start, name)[:, k]
                slopes[:, row, cut + k] = getattr(by_length, name)[:, k]
                slopes[:, row, cut + m :] = getattr(by_values, name)[:, k]
        with np.errstate(all="ignore"):
            onwards = by_length.after[..., None] / by_length.missing[..., None, None]
            blocks = by_start.after - onwards * by_start.missing[..., None, :]
        return Evaluation(residual / self._rows, blocks, slopes * self._size / self._rows[:, None])

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterable[Float[np.ndarray, "lanes N"]]:
        """The orbit as it is: where it begins with another of its periods, another of its arcs touches."""
        return (z,)

    def endings(
        self, now: Solution, taken: Solution, /
    ) -> tuple[dict[int, Bool[np.ndarray, " lanes"]], Bool[np.ndarray, " lanes"]]:
        """Curves that have come to orbits with an arc beyond its event."""
        beyond = self.passes_beyond(taken.z)
        return {BEYOND: beyond}, beyond

    def passes_beyond(self, z: Float[np.ndarray, "lanes N"]) -> Bool[np.ndarray, " lanes"]:
        """Return whether arcs go beyond walls or surfaces before their events, or take less than no time."""
        start, length, values = self.parts(z)
        (lanes, m, e), side = start.shape, np.tile(self._sequence.side, (len(z), 1))
        known = np.isfinite(z).all(axis=1)
        flat = (start.reshape(-1, e), length.ravel(), side, np.repeat(values, m, axis=0))
        height = self._problem.places(*flat).height
        with np.errstate(invalid="ignore"):
            near = _BEYOND * np.ptp(height, axis=1)[:, None]
            risen = (np.minimum.accumulate(height, axis=1) < -near) & (height > near)
            over = np.where(self._problem.rising, risen, height * side[:, None] < -near)
        return (
            ~known | np.any(over.reshape(lanes, -1), axis=1) | np.any(length < -_NO_TIME * self._problem.period, axis=1)
        )

    def multipliers(self, blocks: Float[np.ndarray, "lanes m e e"]) -> Complex[np.ndarray, "lanes e"]:
        """Multipliers of the points at the beginning of a period, whose time does not vary.

        Without a clock what is off the section ends on it, so that one of all eigenvalues is zero, and none of these.
        """
        whole: np.ndarray = np.tile(np.eye(self._d + 1), (len(blocks), 1, 1))
        for k in range(blocks.shape[1]):
            whole = blocks[:, k] @ whole
        known = np.asarray(np.isfinite(whole).all(axis=(1, 2)))
        values = np.linalg.eigvals(np.where(known[:, None, None], whole, 0.0)[:, :-1, :-1]).astype(complex)
        values = np.take_along_axis(values, np.lexsort((np.imag(values), -np.abs(values)), axis=-1), axis=-1)
        values = values if self._problem.given is None else values[:, :-1]
        return np.where(known[:, None], values, np.nan)


def grazing_orbit(
    problem: ArcProblem,
    sequence: ArcSequence,
    start: Float[np.ndarray, "m more"],
    length: Float[np.ndarray, " m"],
    values: Float[np.ndarray, " 1"],
) -> GrazingOrbit | None:
    """The orbit that touches, near a guess, of a problem with one parameter; None where Newton does not come to one."""
    equations = GrazingEquations(problem, sequence)
    z, last = equations.unknowns(start, length, values)[None], np.inf
    for _ in range(_NEWTON_STEPS):
        at = equations.evaluate(z)
        if not all(np.isfinite(leaf).all() for leaf in at):
            return None
        try:
            step = -np.linalg.solve(at.slopes[0], at.residual[0])
        except np.linalg.LinAlgError:
            return None
        size = float(np.linalg.norm(step))
        if size >= last and last < _SMALL:  # rounding
            return equations.orbit(z[0], at.blocks[0], step)
        z, last = z + step, size
    return None


def touching(
    sequence: ArcSequence,
    start: np.ndarray,
    length: np.ndarray,
    arc: int,
    share: float,
    state: np.ndarray,
    surface: int,
) -> tuple[ArcSequence, np.ndarray, np.ndarray]:
    """Arcs with one of them cut where it comes near a surface, at a share of it and at a state (d,)."""
    at = arc + 1
    count, time = sequence.side.shape[1], start[arc, -1] + share * length[arc]
    event = np.insert(sequence.event, arc, count + surface)
    side = np.insert(sequence.side, at, sequence.side[arc], axis=0)
    lengths = np.insert(length, at, (1.0 - share) * length[arc])
    lengths[arc] = share * length[arc]
    return ArcSequence(event, side, arc), np.insert(start, at, np.append(state, time), axis=0), lengths
