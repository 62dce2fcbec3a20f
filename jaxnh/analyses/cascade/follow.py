"""The cascade of period doublings along the first axis that the start state leads to: its points, each with an error.

A survey sends thousands of lanes to their attractors and finds the period of each: candidates come from the strobe
    points, the decision from Newton on the orbit and its multipliers, so that slow convergence near a doubling does not
    bias it. Wherever a run of equal periods ends a cascade may begin (`plateaus`), and each is tried, the most
    promising first. Between neighbouring lanes the orbit is followed by Newton to where its multiplier passes −1
    (`periodic.location`). Where the survey is too coarse for the next level, the orbit of twice the period is looked
    for where the distances so far put it (`doubled_orbit`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.cascade.doubled_orbit import doubled_lanes, long_doubled_orbit, window
from jaxnh.analyses.cascade.plateaus import PeriodScan, Start, describe_periods, starts
from jaxnh.analyses.periodic.attractor_survey import survey
from jaxnh.analyses.periodic.location import LocatedDoubling, locate, period_map, refined_maps
from jaxnh.analyses.periodic.newton_on_lanes import section_distance
from jaxnh.analyses.section_points import first_points
from jaxnh.orbits.bifurcations.doubling_points import FEIGENBAUM, DoublingPoint
from jaxnh.systems.rows import concatenate

TRANSIENT = 512
"""Periods before the last look at the strobe points."""

_SMALLEST_LIMIT = 16  # periods looked for even where few levels are asked for: the cascade may begin at 2 or 3
_OUTSIDE = 64  # lanes of a survey on either side of the sweep
_ENDS = 16  # runs tried that no run of twice the period follows
_FURTHER, _CLOSER = 4, 3  # windows of distances beyond a doubling, each 32 times as far or as near as the one before
_LONGEST_SEEN = 64  # period that a survey looks for, whatever the cascade comes to
_LONG = 32  # periods above are followed by multiple shooting alone, from one level to the next
_BEYOND, _UP_TO = 0.4, 1.5  # shares of the distance expected to the next doubling
_EARLY, _LATER = 10.0, 3.0  # times that the ratio of distances between doublings may be off what is usual
_SHOWN = 6  # tries in words
_SELDOM = 0.5  # of the lanes that have a period: motions may settle on no orbit, as conservative ones


class Cascade(NamedTuple):
    """Doublings of the periods n, 2n, 4n, … along the first axis.

    Attributes:
        period: n.
        doublings: each with its place on the axis.
        size: of the motion in each section coordinate, (d,).
        end: where there are fewer than were looked for, how it ended; what was searched stands in a second line.
        outside: whether a doubling lies beyond the lanes' values of the first axis.
    """

    period: int
    doublings: tuple[LocatedDoubling, ...]
    size: Float[np.ndarray, " d"]
    end: str
    outside: bool = False

    @property
    def points(self) -> tuple[DoublingPoint, ...]:
        """The doublings."""
        return tuple(located.point for located in self.doublings)


def follow(batch: LaneBatch, lanes: LaneRunner, levels: int, *, search: bool = False) -> Cascade:
    """The doublings that the start state leads to along the first axis, at most so many.

    Args:
        batch: lanes along the first axis.
        lanes: runs lanes.
        levels: doublings looked for.
        search: whether to look as far as the lanes reach beyond either end as well, where they have fewer.
    """
    steps = _Steps(batch, lanes, survey_limit(levels))
    inside = line = steps.survey(np.unique(batch.first_axis.values), "doubling")
    if batch.first_axis.values[-1] < batch.first_axis.values[0]:
        inside = line = line.take(slice(None, None, -1))
    cascade = _best(steps, line, levels)
    if len(cascade.points) < levels and search and len(line.value) > 1:
        line = line.joined(_lanes_outside(steps, line))
        wider = _best(steps, line, levels)
        same = [point.value for point in cascade.points[:1]] == [point.value for point in wider.points[:1]]
        cascade = wider if same or len(wider.points) > len(cascade.points) else cascade
    low, high = inside.value.min(), inside.value.max()
    outside = any(not low <= point.value <= high for point in cascade.points)
    end = f"{cascade.end}\n{steps.searched(line)}" if cascade.end else ""
    return cascade._replace(end=end, outside=outside)


def follow_line(
    batch: LaneBatch, lanes: LaneRunner, line: PeriodScan, levels: int, size: Float[np.ndarray, " d"]
) -> tuple[LocatedDoubling, ...]:
    """The doublings, at most so many, of the orbit of the first lane of a line and those born from it, along it.

    Args:
        batch: lanes along the first axis; its own values of it play no part here.
        lanes: runs lanes.
        line: the first of its lanes has an orbit that attracts, the others the results of a survey there.
        levels: doublings looked for.
        size: of the motion in each section coordinate.
    """
    steps = _Steps(batch, lanes, _LONGEST_SEEN)
    steps.size = size
    first = (start for start in starts(line) if start.line.sign == line.sign and start.runs[0].first == 0)
    start = next(first, None)
    return _follow_run(steps, start, levels).doublings if start is not None else ()


def survey_limit(levels: int) -> int:
    """The longest period that a survey looks for where so many doublings are asked for."""
    return min(max(_SMALLEST_LIMIT, 2**levels), _LONGEST_SEEN)


def _lanes_outside(steps: _Steps, line: PeriodScan) -> PeriodScan:
    """Lanes beyond either end of a line, as far as it is long."""
    low, high = line.value.min(), line.value.max()
    far = (high - low) * np.arange(1, _OUTSIDE + 1) / _OUTSIDE
    return steps.survey(np.concatenate([low - far[::-1], high + far]), "doubling, beyond the sweep")


def _best(steps: _Steps, line: PeriodScan, levels: int) -> Cascade:
    """The first cascade along a line that has so many doublings, or else the one that has most."""
    name, ends = steps.batch.first_axis.name, 0
    none = f"no doubling was located between {name} = {line.value[0]:.9g} and {line.value[-1]:.9g}"
    best = Cascade(1, (), steps.size, none)
    for start in starts(line):
        ends += len(start.runs) == 1
        if ends > _ENDS:
            break
        cascade = _follow_run(steps, start, levels)
        if len(cascade.points) > len(best.points):
            best = cascade
        if len(cascade.points) == levels:
            break
    return best


def _follow_run(steps: _Steps, start: Start, levels: int) -> Cascade:
    """The cascade that begins at the end of a run, one level after the other."""
    located: list[_Level] = []
    while len(located) < levels and (level := _next_level(steps, start, located)) is not None:
        located.append(level)
    steps.tried[start.period, start.value, start.line.sign] = len(located)
    end = ""
    if len(located) < levels:
        n, last = start.period << len(located), located[-1].located.point.value if located else start.value
        where = f"{steps.batch.first_axis.name} = {last:.9g} and {start.line.value[-1]:.9g}"
        end = f"{n} → {2 * n} was not located between {where}"
    return Cascade(start.period, tuple(level.located for level in located), steps.size, end)


def _next_level(steps: _Steps, start: Start, known: list[_Level]) -> _Level | None:
    """The next doubling beyond those known from a start."""
    n, sign = start.period << len(known), start.line.sign
    if n > _LONG and len(known) > 1:
        level = _level_by_shooting(steps, start, known)
        if level is not None or n > 4 * _LONG:
            return level
    values = [level.located.point.value for level in known]
    for bracket in _brackets(steps, start, known, n):
        after = known[-1].located.point.value if known else -sign * np.inf
        located = steps.locate(bracket, n) if sign * (bracket.value[0] - after) > 0 else None
        if located is not None and sign * (located.point.value - after) > 0 and follows([*values, located.point.value]):
            return _Level(located, float(abs(bracket.value[1] - bracket.value[0])))
    return _level_by_shooting(steps, start, known) if len(known) > 1 else None  # where no orbit of its period is seen


def _level_by_shooting(steps: _Steps, start: Start, known: list[_Level]) -> _Level | None:
    """The next doubling by multiple shooting, where the last distance over δ puts it."""
    values = [level.located.point.value for level in known]
    gap = (values[-1] - values[-2]) / FEIGENBAUM
    if start.line.sign * (start.line.value[-1] - values[-1] - gap) <= 0:
        return None
    located = steps.long(known[-1].located.point, gap)
    if located is None or not follows([*values, located.point.value]):
        return None
    return _Level(located, abs(gap))


def follows(values: Sequence[float]) -> bool:
    """Return whether the last of some doublings is as far from the one before as that of its daughter may be.

    Distances fall in a ratio that tends to a limit, δ of a quadratic extremum and twice that where area is kept: the
    first by a tenth to ten times it, later ones by a third to three times the ratio before.
    """
    if len(values) < 3:
        return True
    gaps = np.abs(np.diff(values))
    usual, reach = (gaps[-3] / gaps[-2], _LATER) if len(gaps) > 2 else (FEIGENBAUM, _EARLY)
    return bool(usual / reach <= gaps[-2] / gaps[-1] <= usual * reach)


def _brackets(steps: _Steps, start: Start, known: list[_Level], n: int) -> Iterator[PeriodScan]:
    """Lines of two lanes between which the period-n orbit may double: of the survey, then of the daughter orbit.

    The next doubling is expected at the last distance over δ; beyond the first, where the survey has lost the orbit.
    Further out it is looked for where the daughter is stable as far as this was seen, closer where nowhere so. At last
    the daughter is followed from where it was seen furthest.
    """
    yield from start.brackets(n)
    if not known:
        return
    born, end = known[-1].located.point, float(start.line.value[-1]) - known[-1].located.point.value
    expected = (
        (born.value - known[-2].located.point.value) / FEIGENBAUM
        if len(known) > 1
        else start.line.sign * known[0].width
    )
    near: PeriodScan | None = None
    for number in (*range(_FURTHER), *range(-1, -_CLOSER, -1)):
        if near is not None and (near.period[-1] != n if number > 0 else near.period[0] == n):
            continue
        if len(distances := window(expected, number, end)):
            further = steps.daughters(born, start.line, distances)
            near = further if near is None else near.joined(further)
            for run in near.runs():
                if run.period == n and run.last + 1 < len(near.value):
                    yield near.take(np.array([run.last, run.last + 1]))
    yield from _rest(start, near, n)


def _rest(start: Start, near: PeriodScan | None, n: int) -> Iterator[PeriodScan]:
    """From where the period-n orbit was seen furthest to the end of the line, as others escape or are elsewhere."""
    seen = [start.line.take(slice(run.last, run.last + 1)) for run in start.runs if run.period == n]
    if near is not None:
        last = np.flatnonzero(near.period == n)[-1:]
        seen += [near.take(last)] if len(last) else []
    if seen:
        furthest = max(seen, key=lambda lane: start.line.sign * lane.value[0])
        yield concatenate([furthest, start.line.take(slice(-1, None))])


class _Level(NamedTuple):
    """A doubling, and how wide the bracket was that it was located in."""

    located: LocatedDoubling
    width: float


class _Steps:
    """The steps of a search, none of which is done twice: surveys, doublings located, orbits of twice the period.

    Each is a function of numbers, and its result a record of arrays.

    Attributes:
        batch: lanes along the first axis; its own values of it play no part here.
        limit: largest period that surveys look for.
        size: of the motion in each section coordinate, (d,).
        tried: number of doublings from the end of a run, by its period, value and direction.
    """

    def __init__(self, batch: LaneBatch, lanes: LaneRunner, limit: int) -> None:
        self.batch, self.limit = batch, limit
        self.tried: dict[tuple[int, float, float], int] = {}
        self._lanes = lanes
        self.size = np.ones(batch.chart.dimension)
        self._located: dict[tuple[int, float, float], LocatedDoubling | None] = {}
        self._daughters: dict[tuple[int, float, float, float], PeriodScan] = {}

    def survey(self, values: Float[np.ndarray, " lanes"], label: str) -> PeriodScan:
        """Lanes at these values of the first axis, on their attractors."""
        row = self.batch.at_values(values)
        start = first_points(row, self._lanes)
        attractors = survey(row, self._lanes, start, self.limit, label, TRANSIENT, only_doublings=True)
        if not attractors.failed.all():
            self.size = np.median(attractors.size[~attractors.failed], axis=0)
        return PeriodScan(values, attractors.period, attractors.u)

    def locate(self, bracket: PeriodScan, n: int) -> LocatedDoubling | None:
        """The doubling of the period-n orbit between two lanes."""
        near, far = bracket.value.tolist()
        if (key := (n, near, far)) not in self._located:
            with self._lanes.stage(f"doubling: period {n} → {2 * n}", 0):
                located = locate(self.batch, self._lanes, bracket.u[:1], near, far, n)
            if located is not None and abs(located.point.value - near) > 2 * abs(far - near):
                located = None  # Newton has gone to another doubling
            self._located[key] = located
        return self._located[key]

    def daughters(
        self, born: DoublingPoint, line: PeriodScan, distances: Float[np.ndarray, " distances"]
    ) -> PeriodScan:
        """Lanes at distances beyond a doubling, on the stable orbit of twice its period where there is one."""
        key = len(born.orbit), born.value, float(distances[0]), float(distances[-1])
        if key not in self._daughters:
            points = np.concatenate([line.u, first_points(self.batch, self._lanes)])
            largest = float(np.nanmax(section_distance(self.batch.chart, points, born.orbit[0], self.size)))
            where = f"{self.batch.first_axis.name} = {born.value:.9g}"
            label = f"doubling: orbits of period {2 * len(born.orbit)} beyond {where}"
            with self._lanes.stage(label, 0):
                self._daughters[key] = doubled_lanes(self.batch, self._lanes, born, largest, self.size, distances)
        return self._daughters[key]

    def long(self, born: DoublingPoint, gap: float) -> LocatedDoubling | None:
        """The doubling of the long orbit that is born at one, about so far beyond it."""
        n = 2 * len(born.orbit)
        stop = born.value + _UP_TO * gap
        if (key := (n, born.value, stop)) not in self._located:
            near = _BEYOND * gap
            with self._lanes.stage(f"doubling: period {n} → {2 * n}", 0):
                period = period_map(self.batch, self._lanes, refined_maps(self.batch)[0])
                points = long_doubled_orbit(period, born, near, gap, self.size, self.batch.chart.wrap)
                has_points = points is not None
                located = locate(self.batch, self._lanes, points, born.value + near, stop, n) if has_points else None
            beyond = located is not None and (located.point.value - born.value) / gap > _BEYOND
            self._located[key] = located if beyond else None
        return self._located[key]

    def searched(self, line: PeriodScan) -> str:
        """Describe the periods of a survey, and where cascades were looked for."""
        name = self.batch.first_axis.name
        words = [
            f"{n} → {2 * n} {'up' if sign > 0 else 'down'} from {value:.6g} ({count or 'none'} located)"
            for (n, value, sign), count in sorted(self.tried.items(), key=lambda item: -item[1])
        ]
        more = [f"{len(words) - _SHOWN} more"] if len(words) > _SHOWN else []
        tried = ", ".join([*words[:_SHOWN], *more]) or f"nothing, as no period ends between two values of {name}"
        seldom = np.mean(line.period > 0) < _SELDOM and not any(self.tried.values())
        advice = "; orbits that no motion settles on are followed by branches with n_starts" if seldom else ""
        return f"{describe_periods(line, name, self.limit)}; tried: {tried}{advice}"
