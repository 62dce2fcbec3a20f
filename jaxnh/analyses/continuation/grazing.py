"""Grazing along branches of a flow with walls or surfaces: where an orbit touches one more of them, or one less.

Shooting ends there, or steps over it. So the events of the orbits of a branch are counted: between points with
different ones, and where a branch ends because Newton does not converge, the orbit that touches is looked for as arcs
between events (`orbits.bifurcations.grazing`). It begins with that of fewer events, cut where it comes nearest to a
wall or surface, or with one whose slowest impact is taken for a touch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.family_tree import Bifurcation, Tree, new_bifurcations
from jaxnh.analyses.periodic.sensitivities import (
    ROUNDING,
    SMALLEST_SHIFT,
    Sensitivities,
    parameter_names,
    scale_of,
    shifted_batch,
)
from jaxnh.maps.event_arcs import EventSequence, arc_end, arc_samples, event_sequence
from jaxnh.maps.jumping import JumpingStrobe
from jaxnh.maps.jumping_section import JumpingSection
from jaxnh.maps.section import Section
from jaxnh.orbits.bifurcations.grazing import (
    ArcEnds,
    ArcPlaces,
    ArcProblem,
    ArcSequence,
    GrazingEquations,
    GrazingOrbit,
    grazing_orbit,
    touching,
)
from jaxnh.orbits.bifurcations.sensitivities import difference
from jaxnh.orbits.continuation.arclength import Family, PathVector, length
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.kinds import GRAZING
from jaxnh.orbits.continuation.paths import GRAZES, NO_CONVERGENCE, NO_RETURN
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

_ROOM = 32  # events of a period
_TILE = 32
_ARCS = 8  # of an orbit that touches, that are computed at once: few orbits have more
_TRIED = 4  # places of an orbit that may touch, those nearest first
_REACH = 2.0  # chords between two points of a branch, within which the orbit that touches is
_END = 1e-2  # lengths from the end of a branch, within which it is
REFINEMENTS = (1, 2, 4)
"""Steps of arcs for errors, in those of the map."""


class Arcs(NamedTuple):
    """The arcs of an orbit, without one that touches: beginnings, lengths, events and sides (`ArcSequence`)."""

    start: Float[np.ndarray, "m more"]
    length: Float[np.ndarray, " m"]
    sequence: ArcSequence


class _Change(NamedTuple):
    """A place of a branch, with the points to begin with, and the lengths within which an orbit touches.

    Attributes:
        place, end: as of `Grazing`.
        seeds: numbers of the points.
        reach: the lengths.
    """

    place: int
    end: int | None
    seeds: Sequence[int]
    reach: float


class _TouchGuess(NamedTuple):
    """Arcs near those of an orbit that touches, and how far above or below the surface it is there."""

    away: float
    sequence: ArcSequence
    start: Float[np.ndarray, "m more"]
    length: Float[np.ndarray, " m"]


def may_graze(batch: LaneBatch) -> bool:
    """Return whether a batch has walls or surfaces that orbits may graze, with a clock or section, and not held."""
    flow, sectioned = batch.flow, isinstance(batch.system, Section)
    if not isinstance(flow, PiecewiseSmooth) or batch.family is not None or flow.autonomous != sectioned:
        return False
    plain = type(flow).branch is PiecewiseSmooth.branch and not (flow.holding or flow.constrained or flow.many_surfaces)
    returns = JumpingSection if sectioned else JumpingStrobe
    return plain and batch.precision == "float64" and isinstance(batch.strobe(), returns)


class Grazing(NamedTuple):
    """An orbit of a branch that touches.

    Attributes:
        branch, place: number of the branch, and of the point of it that comes before.
        end: number of the end of the branch that it is at, 0 or 1; none where the branch goes on.
        orbits: it, by arcs of once, twice and four times the steps.
    """

    branch: int
    place: int
    end: int | None
    orbits: Sequence[GrazingOrbit]

    @property
    def bifurcation(self) -> Bifurcation:
        """The orbit as a bifurcation, the error from step refinement and rounding."""
        (first, second, third), middle = (float(orbit.values[0]) for orbit in self.orbits), self.orbits[1]
        rounding = max(float(orbit.rounding[0]) for orbit in self.orbits[1:])
        error = abs(second - first) + abs(third - second) + rounding
        return Bifurcation(
            GRAZING, second, error, self.branch, self.place, middle.points, middle.multipliers, np.nan, 0, self.orbits
        )


def with_grazing(
    batch: LaneBatch, lanes: LaneRunner, family: Family, tree: Tree, size: Float[np.ndarray, " d"]
) -> Tree:
    """A tree with the orbits of its branches that graze, as bifurcations of kind `GRAZING` and ends of branches."""
    branches, grazing = list(tree.branches), grazing_orbits(batch, lanes, family, tree, size)
    for orbit in grazing:
        if orbit.end is not None:
            ends = tuple(GRAZES if k == orbit.end else end for k, end in enumerate(branches[orbit.branch].ends))
            branches[orbit.branch] = replace(branches[orbit.branch], ends=ends)
    points = [orbit.bifurcation for orbit in grazing]
    points = [points[k] for k in new_bifurcations(family, [], points)]
    return Tree(branches, [*tree.bifurcations, *points], tree.lost)


def grazing_orbits(
    batch: LaneBatch, lanes: LaneRunner, family: Family, tree: Tree, size: Float[np.ndarray, " d"]
) -> list[Grazing]:
    """The orbits that touch along branches; that of two branches with each of them."""
    name, ends = batch.first_axis.name, (np.array([family.low]), np.array([family.high]))
    events_of_all, grazing = [_events(batch, lanes, branch) for branch in tree.branches], list[Grazing]()
    longest = max((float(np.nanmax(events.duration)) for events in events_of_all), default=batch.flow.period)
    problems = [arc_problem(batch, lanes, (name,), ends, size, longest, more) for more in REFINEMENTS]
    for number, (branch, events) in enumerate(zip(tree.branches, events_of_all, strict=True)):
        for change in _changes(family, branch, events):
            orbit = _first_grazing(problems[0], batch, family, branch, events, change)
            orbits = orbit and _refined(problems, orbit)
            grazing += [Grazing(number, change.place, change.end, orbits)] if orbits else []
    return grazing


def arc_problem(
    batch: LaneBatch,
    lanes: LaneRunner,
    names: tuple[str, ...],
    ends: tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]],
    size: Float[np.ndarray, " d"],
    longest: float,
    refinement: int = 1,
) -> ArcProblem:
    """Arcs of the flow of a batch over parameters with names, between the ends of their ranges.

    Args:
        size: of the motion in section coordinates.
        longest: time of a return; with a clock every one takes its period.
    """
    flow, system, solver = batch.flow, batch.system, batch.solver
    given, period = (system.number, longest) if isinstance(system, Section) else (None, float(flow.period))
    steps = math.ceil(period / flow.period * batch.steps) * refinement
    few = -(-steps // 16)  # between the places of samples, of which there are more

    def ends_of(start: np.ndarray, length: np.ndarray, side: np.ndarray, event: np.ndarray, values: np.ndarray):
        own = (start, length, side, event.astype(np.int32), values, batch.parameters_at(names, values))
        shared = (system, solver, np.int32(steps), period)
        known = lanes(arc_end, shared, own, tile=_ARCS, static=(names,))
        end, by_start, by_length, by_values = (ArcEnds(*map(np.array, part)) for part in known)
        return end, by_start, by_length, by_values

    def places_of(start: np.ndarray, length: np.ndarray, side: np.ndarray, values: np.ndarray):
        own = start, length, side, batch.parameters_at(names, values)
        known = lanes(arc_samples, (flow, solver, np.int32(few)), own, tile=_ARCS)
        return ArcPlaces(*map(np.asarray, known))

    assert isinstance(flow, PiecewiseSmooth)
    rising = np.array([way != "both" for way in flow.jumps] + [False] * flow.switches)
    size = size if given is None else np.insert(size, given, size.max())
    return ArcProblem(ends_of, places_of, rising, flow.chart.wrap, size, period, *ends, given)


# ---- derivatives in all other parameters


def grazing_sensitivities(
    batch: LaneBatch, lanes: LaneRunner, grazing: Sequence[Sequence[GrazingOrbit]]
) -> Sensitivities:
    """Derivatives of the first axis where orbits touch in all other parameters, with steps of half the length.

    Their errors are those of the differences, and the distance to what the steps themselves say.

    Args:
        batch: a flow that may graze (`may_graze`).
        lanes: runs lanes.
        grazing: each orbit by arcs of once, twice and four times the steps.
    """
    first, *names = parameter_names(batch)
    ends, size = (np.array([-1.0]), np.array([1.0])), np.ones(batch.chart.dimension)
    longest = max((float(np.sum(orbit[0].length)) / len(orbit[0].points) for orbit in grazing), default=1.0)
    absent, results = dict[str, str](), np.full((2, 2, len(grazing), len(names)), np.nan)
    for column, name in enumerate(names):

        def shifted(shift: float, refinement: int, name: str = name) -> ArcProblem:
            near = shifted_batch(batch, name, shift)
            return arc_problem(near, lanes, (first,), ends, size, longest, refinement)

        try:
            shifted(SMALLEST_SHIFT * scale_of(batch, name), 1)
        except ValueError as error:
            absent[name] = str(error)
            continue
        for finer, refinement in enumerate(REFINEMENTS[:2]):
            for row, orbits in enumerate(grazing):
                orbit = orbits[finer]

                def missing(shift: float, orbit: GrazingOrbit = orbit, refinement: int = refinement) -> np.ndarray:
                    return GrazingEquations(shifted(shift, refinement), orbit.sequence).missing(orbit)

                change = difference(missing, scale_of(batch, name))
                at = GrazingEquations(shifted(0.0, refinement), orbit.sequence)
                results[finer, :, row, column] = at.rate(orbit, *change)
    (coarse, _), (fine, error) = results
    rounding = ROUNDING * np.abs(fine)
    return Sensitivities(tuple(names), fine, error + np.abs(fine - coarse) + rounding, absent)


# ---- orbits of a branch


def _events(batch: LaneBatch, lanes: LaneRunner, branch: Branch) -> EventSequence:
    """The events of all orbits of a branch, period by period, (k, n, ...)."""
    k, n, d = branch.points.shape
    p = batch.at_values(np.repeat(branch.value, n)).p
    known = lanes(event_sequence, (batch.strobe(),), (branch.points.reshape(-1, d), p), tile=_TILE, static=(_ROOM,))
    return EventSequence(*(np.asarray(leaf).reshape(k, n, *leaf.shape[1:]) for leaf in known))  # pyright: ignore[reportArgumentType]


def _changes(family: Family, branch: Branch, events: EventSequence) -> list[_Change]:
    """Places of a branch where the events change, or where it ends because Newton does not converge."""
    count, surfaces = np.asarray(events.met), events.side.shape[-1]
    number = np.where(np.arange(_ROOM) < count[..., None], events.number, -1)
    known = np.all(count <= _ROOM, axis=1)
    met = np.stack([np.sum(number == k, axis=(1, 2)) for k in range(surfaces)], axis=1)
    chords = length(family, PathVector(np.diff(branch.points, axis=0), np.diff(branch.value)))
    lost, last = [end in (NO_CONVERGENCE, NO_RETURN) for end in branch.ends], len(branch.value) - 1
    changes = [_Change(0, 0, [0], _END)] if lost[0] and known[0] else []
    for k in np.flatnonzero(known[1:] & known[:-1] & np.any(np.diff(met, axis=0) != 0, axis=1)).tolist():
        seeds = [k, k + 1] if met[k].sum() < met[k + 1].sum() else [k + 1, k]
        changes.append(_Change(k, None, seeds, _REACH * float(chords[k])))
    return [*changes, *([_Change(max(last - 1, 0), 1, [last], _END)] if lost[1] and known[-1] else [])]


def arcs_of(events: EventSequence, place: int, n: int) -> Arcs | None:
    """The arcs of an orbit of n periods from the events of all orbits of a branch; None where events coincide."""
    start, lengths, numbers, sides, surfaces = [], [], [], [], events.side.shape[-1]
    for i in range(n):
        k = int(events.met[place, i])
        time = np.concatenate([[0.0], events.time[place, i, :k], events.duration[place, i, None]])
        start.append(np.concatenate([events.state[place, i, : k + 1], time[: k + 1, None]], axis=1))
        lengths.append(np.diff(time))
        numbers.append(np.append(events.number[place, i, :k], 2 * surfaces))
        sides.append(events.side[place, i, : k + 1])
    length = np.concatenate(lengths)
    sequence = ArcSequence(np.concatenate(numbers), np.concatenate(sides), 0)
    return Arcs(np.concatenate(start), length, sequence) if np.all(length > 0.0) else None


# ---- orbits that touch


def _first_grazing(
    problem: ArcProblem,
    batch: LaneBatch,
    family: Family,
    branch: Branch,
    events: EventSequence,
    change: _Change,
) -> GrazingOrbit | None:
    """The orbit that touches near the first of some points of a branch that has one; or None."""
    for seed in change.seeds:
        arcs, values = arcs_of(events, seed, branch.period), branch.value[[seed]]
        for guess in _guesses(problem, batch, arcs, values)[:_TRIED] if arcs else []:
            orbit = grazing_orbit(problem, guess.sequence, guess.start, guess.length, values)
            if orbit is None or not _is_near(family, branch, seed, orbit, change.reach):
                continue
            equations = GrazingEquations(problem, orbit.sequence)
            if not equations.passes_beyond(equations.unknowns(orbit.start, orbit.length, orbit.values)[None])[0]:
                return orbit
    return None


def _guesses(problem: ArcProblem, batch: LaneBatch, arcs: Arcs, values: Float[np.ndarray, " 1"]) -> list[_TouchGuess]:
    """Places where an orbit may touch, those nearest first: turns before a wall or surface, and slow impacts."""
    flow, (start, length, sequence) = batch.flow, arcs
    assert isinstance(flow, PiecewiseSmooth)
    event, side = sequence.event, sequence.side
    m, surfaces = side.shape
    places = problem.places(start, length, side, np.tile(values, (m, 1)))
    size = np.maximum(np.ptp(places.height, axis=(0, 1)), np.finfo(float).tiny)
    count = places.height.shape[1]
    part = length / count
    # An arc that begins with a period goes on from the end of the one before: the orbit may touch just there.
    smooth = np.roll(event == 2 * surfaces, 1)[:, None, None]
    state, height, rate = (
        np.concatenate([np.where(smooth, np.roll(leaf[:, -1:], 1, axis=0), np.nan), leaf], axis=1) for leaf in places
    )
    guesses = list[_TouchGuess]()
    for j in range(m):
        for k in range(surfaces):
            above, falling = side[j, k] * height[j, :, k], side[j, k] * rate[j, :, k]
            turns = (falling[:-1] < 0.0) & (falling[1:] >= 0.0)
            if problem.rising[k]:  # met from below, it is left upwards without an event, and touched from there
                turns |= (falling[:-1] > 0.0) & (falling[1:] <= 0.0)
            for i in np.flatnonzero(turns).tolist():
                share = falling[i] / (falling[i] - falling[i + 1])
                away = above[i] + 0.5 * falling[i] * share * part[j]
                there = (1.0 - share) * state[j, i] + share * state[j, i + 1]
                new = touching(sequence, start, length, j, (i + share) / count, there, k)
                guesses.append(_TouchGuess(abs(away) / size[k], *new))
        k = int(event[j])
        if k < len(flow.jumps):
            bend = abs(rate[j, -1, k] - rate[j, -2, k]) / part[j]
            away = 0.5 * rate[j, -1, k] ** 2 / max(bend, np.finfo(float).tiny)
            touched, ahead = event.copy(), start.copy()
            touched[j] = surfaces + k
            ahead[(j + 1) % m, :-1] = state[j, -1]
            guesses.append(_TouchGuess(abs(away) / size[k], ArcSequence(touched, side, j), ahead, length))
    return sorted(guesses, key=lambda guess: guess.away)


def _is_near(family: Family, branch: Branch, seed: int, orbit: GrazingOrbit, reach: float) -> bool:
    """Return whether an orbit that touches is within lengths of one of a branch, in the parameter's range."""
    gap = PathVector((orbit.points - branch.points[seed])[None], orbit.values - branch.value[seed])
    inside = family.low <= orbit.values[0] <= family.high
    return inside and bool(length(family, gap)[0] <= reach)


def _refined(problems: Sequence[ArcProblem], first: GrazingOrbit) -> list[GrazingOrbit] | None:
    """The orbit by arcs of once, twice and four times the steps; None where Newton does not come to it with these."""
    orbits = [first]
    for finer in problems[1:]:
        last = orbits[-1]
        orbit = grazing_orbit(finer, last.sequence, last.start, last.length, last.values)
        if orbit is None:
            return None
        orbits.append(orbit)
    return orbits
