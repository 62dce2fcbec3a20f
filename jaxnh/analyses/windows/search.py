"""Windows of stable orbits along the first axis: orbits of runs of lanes, followed both ways to their bifurcations.

A run is neighbouring lanes whose periods differ by powers of two. Orbits of the shortest period of a run are followed
(`continuation.family_tree`), those of half of it where they were born in a doubling, as far as they are stable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from jaxnh.analyses.cascade.plateaus import PeriodScan
from jaxnh.analyses.continuation.family_tree import Bifurcation, SeedOrbit, Stage, Tree, grow
from jaxnh.analyses.continuation.known_branches import is_on_branch, same_orbit
from jaxnh.orbits.continuation import paths
from jaxnh.orbits.continuation.arclength import Family, PathVector, length
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.kinds import BRANCH_POINT, KINDS, kinds, stable
from jaxnh.orbits.continuation.paths import StepControl

ENDS = ("fold", "branch_point", "range", "not_located", "neimark_sacker", "period_doubling")
"""Ends of ranges in which orbits attract: a bifurcation, the range of the sweep, a place not located. Of two ends the
one that is earlier here is the begin."""

_RANGE, _NOT_LOCATED, DOUBLED = (ENDS.index(kind) for kind in ("range", "not_located", "period_doubling"))

_STEPS = StepControl(0.04)  # of a branch, which is not kept: what is located does not depend on it
_WIDER = 1.0  # widths of a range that it grows by to either side, where an orbit is stable to the end of it
_SAME = 1e-6  # of the width of the sweep: ends this near are of twins, or one
_NEAR = 1e-3  # lengths: an orbit at a bifurcation this near to another is that one


class End(NamedTuple):
    """An end of the stretch of a branch where its orbits attract.

    Attributes:
        kind: number in `ENDS`.
        value, error: of the parameter; NaN where there is no bifurcation.
        at: the value of the parameter next to it that is known to attract.
        points: the orbit there, or the last one that attracts, (n, d).
        multipliers: of it, (d,).
    """

    kind: int
    value: float
    error: float
    at: float
    points: Float[np.ndarray, "n d"]
    multipliers: Complex[np.ndarray, " d"]


class Window(NamedTuple):
    """A stretch of a branch where orbits of one period attract; next to it those of twice, four times, … of it may.

    Attributes:
        period: of the orbits.
        lanes: numbers of the lanes that have settled there, or beyond its doublings, in the order of the axis.
        begin, end: where the orbits of the period itself begin and cease to attract.
        inside: the last orbit known before the end, a line of one lane.
        beyond: the value next to it, beyond the end.
    """

    period: int
    lanes: Int[np.ndarray, " some"]
    begin: End
    end: End
    inside: PeriodScan
    beyond: float


def search(
    line: PeriodScan,
    max_period: int,
    orbits: Callable[[Int[np.ndarray, " some"]], Sequence[SeedOrbit]],
    families: Callable[[float, float], Sequence[Family]],
    stage: Stage = nullcontext,
) -> list[list[Window]]:
    """Return all windows that two lanes or more have settled in; twins by a symmetry, of the same ends, are together.

    Args:
        line: what lanes have settled on, at rising values.
        max_period: largest period of a window.
        orbits: all points of the orbits of lanes, by their numbers, in the order in which they are looked at.
        families: the map on a range of the parameter, and the same with 2 and 4 times the steps.
        stage: shows what is done inside, by its label.
    """
    ends = float(line.value[0]), float(line.value[-1])
    whole, groups = families(*ends)[0], list[list[Window]]()
    for first, last in period_runs(line.period):
        left = np.arange(first, last + 1)
        if _odd(line.period[left]).max() > max_period:
            continue
        while len(left):  # lanes of another attractor may lie among those of a window
            least = line.period[left] == line.period[left].min()
            new = _follow_windows(line, left[least], left[~least].tolist(), orbits, families, stage)
            for window in new:
                _add(whole, groups, window)
            left = np.setdiff1d(left[~least], [k for window in new for k in window.lanes])
    return [group for group in groups if group[0].period <= max_period and len(all_lanes(group)) > 1]


def _follow_windows(
    line: PeriodScan,
    mine: Int[np.ndarray, " some"],
    others: Sequence[int],
    orbits: Callable[[Int[np.ndarray, " some"]], Sequence[SeedOrbit]],
    families: Callable[[float, float], Sequence[Family]],
    stage: Stage,
) -> list[Window]:
    """Return the windows of orbits of lanes of one period, with other lanes on doubled orbits."""
    ends = float(line.value[0]), float(line.value[-1])
    every = orbits(mine)
    settled = {int(np.searchsorted(line.value, orbit.value)): orbit for orbit in every}
    # Most lanes are on the branch of the first, or on its twin: those of a wave are followed side by side.
    waves = [every[:1], *(every[1 << k : 2 << k] for k in range(len(every).bit_length()))]
    low, high = (float(line.value[k]) for k in (max(mine[0] - 1, 0), min(mine[-1] + 1, len(line.value) - 1)))
    while True:
        levels = families(low, high)
        new = _windows(levels[0], grow(levels, waves, int(line.period[mine[0]]), _STEPS, stage), line, settled, others)
        unknown = {end.at for window in new for end in (window.begin, window.end) if np.isnan(end.value)}
        if unknown <= set(ends) or (low, high) == ends:
            return new
        wider = _WIDER * (high - low)
        low, high = max(low - wider, ends[0]), min(high + wider, ends[1])


def all_lanes(group: Sequence[Window]) -> Int[np.ndarray, " some"]:
    """Return the numbers of the lanes of a window and its twins."""
    return np.unique(np.concatenate([window.lanes for window in group]))


def period_runs(period: Int[np.ndarray, " lanes"]) -> list[tuple[int, int]]:
    """Return first and last of neighbouring lanes, two or more, whose periods have the same odd factor."""
    cuts = [0, *(np.flatnonzero(np.diff(_odd(period))) + 1).tolist(), len(period)]
    return [(first, end - 1) for first, end in pairwise(cuts) if period[first] and end - first > 1]


def _odd(period: Int[np.ndarray, " lanes"]) -> Int[np.ndarray, " lanes"]:
    """Return the odd factor of periods; 0 of 0, which stands for none."""
    return period // np.maximum(period & -period, 1)


# ---- stretches of branches


def _windows(
    family: Family, tree: Tree, line: PeriodScan, settled: Mapping[int, SeedOrbit], doubled: Sequence[int]
) -> list[Window]:
    """Return the windows of a tree that lanes have settled in.

    Args:
        family: the map.
        tree: branches and their bifurcations.
        line: what lanes have settled on.
        settled: the orbits of lanes of the shortest period, by number of the lane.
        doubled: numbers of the lanes of twice, four times, … of it.
    """
    windows, origins = list[Window](), list[Bifurcation | None]()
    for number, branch in enumerate(tree.branches):
        for stretch, *outside in _stretches(family, branch):
            doubled_there = _born_in_doubling(branch, stretch, outside)
            origin = None if doubled_there is None else _origin(family, tree, branch, doubled_there)
            if doubled_there is not None and origin is None:
                continue
            ends = [(stretch[0], outside[0]), (stretch[-1], outside[1])]
            ends = [(_end(family, tree, number, *pair), *pair) for pair in ends]
            (begin, *_), (end, at, beyond) = sorted(ends, key=lambda end: end[0].kind)
            part = [_part(branch, stretch)]
            mine = [k for k, orbit in settled.items() if is_on_branch(family, part, orbit.points, orbit.value)]
            inside = PeriodScan(branch.value[[at]], np.array([branch.period]), branch.points[at, :1])
            to = float(branch.value[at if beyond is None else beyond])
            windows.append(Window(branch.period, np.array(mine, int), begin, end, inside, to))
            origins.append(origin)
    for k in [*doubled, *(k for k in settled if not any(k in window.lanes for window in windows))]:
        _assign(windows, line, k)
    return [window for window in _merge_doubled(windows, origins) if len(window.lanes)]


def _born_in_doubling(branch: Branch, stretch: Int[np.ndarray, " some"], outside: Sequence[int | None]) -> int | None:
    """Return the end of a branch, 0 or −1, where a stretch begins in a doubling of the orbit of half the period.

    A branch goes on to a point beyond the doubling, which is on the stretch or next to it.
    """
    at = {0: 0, -1: len(branch.value) - 1}
    own = {int(stretch[0]), int(stretch[-1]), *outside}
    return next((k for k, place in at.items() if branch.ends[k] == paths.COLLAPSED and place in own), None)


def _origin(family: Family, tree: Tree, branch: Branch, end: int) -> Bifurcation | None:
    """Return the doubling, on another branch of the tree, that a branch ends in."""
    n = branch.period // 2
    last, before = (0, 1) if end == 0 else (-1, -2)
    near = _chord(family, branch, last, before) + _NEAR
    half = branch.points[last, :n] + 0.5 * family.wrap(branch.points[last, n:] - branch.points[last, :n])
    doublings = [
        doubling
        for doubling in tree.bifurcations
        if KINDS[doubling.kind] == ENDS[DOUBLED]
        and len(doubling.points) == n
        and abs(doubling.value - branch.value[last]) <= near * family.width
        and same_orbit(family, doubling.points, half, near)
    ]
    return min(doublings, key=lambda doubling: abs(doubling.value - branch.value[last]), default=None)


def _merge_doubled(windows: Sequence[Window], origins: Sequence[Bifurcation | None]) -> list[Window]:
    """Return windows not born in a doubling, each with the lanes of all windows doubled from it."""
    lanes = [set(window.lanes.tolist()) for window in windows]
    for k in sorted(range(len(windows)), key=lambda k: -windows[k].period):  # the longest first
        for place, window in enumerate(windows):
            if (origin := origins[k]) is not None and 2 * window.period == windows[k].period:
                ends = [end for end in (window.begin, window.end) if end.kind == DOUBLED and end.value == origin.value]
                lanes[place] |= lanes[k] if any(end.points is origin.points for end in ends) else set()
    return [
        window._replace(lanes=np.array(sorted(mine), int))
        for window, mine, origin in zip(windows, lanes, origins, strict=True)
        if origin is None
    ]


def _stretches(family: Family, branch: Branch) -> Iterator[tuple[Int[np.ndarray, " some"], int | None, int | None]]:
    """Yield places of points of a branch that attract between two bifurcations, and those before and after.

    Another branch that crosses ends a stretch: this is where an orbit with a symmetry goes over to the pair without.
    """
    attracts, count = stable(family, branch.multipliers), len(branch.value)
    side = np.signbit(branch.tests[:, kinds(family).index(BRANCH_POINT)])
    closed = branch.ends[0] == paths.CLOSED
    order = np.roll(np.arange(count), -int(np.argmin(attracts)) if closed else 0)
    cuts = np.flatnonzero(np.diff(attracts[order]) | np.diff(side[order])) + 1
    for first, end in pairwise([0, *cuts.tolist(), count]):
        if attracts[order[first]]:
            before = int(order[first - 1]) if first or closed else None
            yield order[first:end], before, int(order[end % count]) if end < count or closed else None


def _part(branch: Branch, stretch: Int[np.ndarray, " some"]) -> Branch:
    """Return a stretch of a branch, with a point more at either end."""
    first, last = max(int(stretch.min()) - 1, 0), int(stretch.max()) + 2
    way = PathVector(branch.way.points[first:last], branch.way.value[first:last])
    return replace(branch, points=branch.points[first:last], value=branch.value[first:last], way=way)


def _end(family: Family, tree: Tree, number: int, inside: int, outside: int | None) -> End:
    """Return the end between the last point of a stretch and the next one, or at the end of the branch."""
    branch = tree.branches[number]
    known = float(branch.value[inside]), branch.points[inside], branch.multipliers[inside]
    if outside is None:
        beyond = branch.ends[0 if inside == 0 else 1] == paths.RANGE
        return End(_RANGE if beyond else _NOT_LOCATED, np.nan, np.nan, *known)
    place, chord = min(inside, outside), _chord(family, branch, inside, outside)
    near = [event for event in tree.bifurcations if event.branch == number and abs(event.place - place) <= 1]
    if not near:  # listed with a branch that crosses, or the same one from another lane
        changes = np.signbit(branch.tests[inside]) != np.signbit(branch.tests[outside])
        shown = [kind for kind, change in zip(kinds(family), changes, strict=True) if change]
        events = [event for event in tree.bifurcations if event.kind in shown]
        near = [event for event in events if _is_near(family, event, branch, inside, chord)]
    if not near:
        return End(_NOT_LOCATED, np.nan, np.nan, *known)
    event = min(near, key=lambda event: abs(event.place - place))
    return End(ENDS.index(KINDS[event.kind]), event.value, event.error, known[0], event.points, event.multipliers)


def _chord(family: Family, branch: Branch, first: int, second: int) -> float:
    """Return the length from one point of a branch to another."""
    gap = PathVector(branch.points[[second]] - branch.points[[first]], branch.value[[second]] - branch.value[[first]])
    return float(length(family, gap)[0])


def _is_near(family: Family, point: Bifurcation, branch: Branch, place: int, chord: float) -> bool:
    """Return whether a bifurcation is no further from a point of a branch than a step."""
    off = abs(point.value - branch.value[place]) / family.width
    return off <= 2.0 * chord and same_orbit(family, branch.points[place], point.points, 2.0 * chord)


def _assign(windows: list[Window], line: PeriodScan, k: int) -> None:
    """Assign a lane of a doubled orbit to the window whose doubling is nearest, and to its twin."""
    away = list[float]()
    for window in windows:
        doublings = [end for end in (window.begin, window.end) if end.kind == DOUBLED]
        away.append(min((_distance_beyond(end, line, k, window.period) for end in doublings), default=np.inf))
    nearest = min(away, default=np.inf)
    for place, window in enumerate(windows):
        if away[place] <= nearest + _SAME * abs(line.value[-1] - line.value[0]) < np.inf:
            windows[place] = window._replace(lanes=np.append(window.lanes, k))


def _distance_beyond(end: End, line: PeriodScan, k: int, period: int) -> float:
    """Return the distance of a lane beyond a doubling; infinite where doubled orbits may not reach to it."""
    value = float(line.value[k])
    low, high = sorted((end.value, value))
    between = line.period[(line.value >= low) & (line.value <= high)]
    there = np.sign(value - end.value) == np.sign(end.value - end.at) and np.all(between % (2 * period) == 0)
    return abs(value - end.value) if there else np.inf


# ---- twins


def _add(family: Family, groups: list[list[Window]], new: Window) -> None:
    """Add a window: to the lanes of a known one, to its twins, or by itself."""
    for group in groups:
        for place, window in enumerate(group):
            if _same_orbits(family, window, new):
                group[place] = window._replace(lanes=np.union1d(window.lanes, new.lanes))
                return
        if _are_twins(family, group[0], new):
            group.append(new)
            return
    groups.append([new])


def _same_orbits(family: Family, first: Window, second: Window) -> bool:
    """Return whether two windows are of one orbit: its orbits at both ends are the same."""
    ends = (first.begin, second.begin), (first.end, second.end)
    return first.period == second.period and all(
        a.kind == b.kind and same_orbit(family, a.points, b.points, _NEAR) for a, b in ends
    )


def _are_twins(family: Family, first: Window, second: Window) -> bool:
    """Return whether two windows begin and end at the same values."""
    ends = (first.begin, second.begin), (first.end, second.end)
    located = [(a, b) for a, b in ends if np.isfinite(a.value + b.value)]
    near = all(abs(a.value - b.value) <= _SAME * family.width + a.error + b.error for a, b in located)
    return first.period == second.period and all(a.kind == b.kind for a, b in ends) and bool(located) and near
