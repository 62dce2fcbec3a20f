"""The cascade of period doublings along the first axis that the start state leads to: its points, each with an error.

A survey sends thousands of lanes to their attractors and finds the period of each: candidates come from the strobe
points, the decision from Newton on the orbit and its multipliers, so that slow convergence near a doubling does not
bias it. Between neighbouring lanes the orbit is followed by Newton to where its multiplier passes −1 (`locating`).
Where the survey is too coarse for the next level, a new one looks closer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.base import LaneRunner, Scene, section_points
from jaxnh.analyses.locating import locate
from jaxnh.analyses.period import Survey, survey
from jaxnh.orbits.doubling_points import DoublingPoint

TRANSIENT = 512
"""Periods before the strobe points are looked at."""

_SMALLEST_LIMIT = 16  # periods looked for even where few levels are asked for: the cascade may begin at 2 or 3
_CLOSER = 64  # lanes of a closer survey
_CLOSER_TRIES = 4


class Cascade(NamedTuple):
    """Doublings of the periods n, 2n, 4n, … along the first axis.

    Attributes:
        period: n.
        points: the doublings.
        errors: of the values of the first axis there.
        end: why there are fewer than were looked for, else empty.
    """

    period: int
    points: tuple[DoublingPoint, ...]
    errors: tuple[float, ...]
    end: str


class Line(NamedTuple):
    """Lanes along the first axis, on their attractors.

    Attributes:
        value: of the first axis, (lanes,).
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
    """

    value: Float[np.ndarray, " lanes"]
    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]

    def without_holes(self) -> Line:
        """The line without lanes that stand alone or in pairs and are no part of a cascade.

        Undecided ones lie in windows or at doublings; ones of another period than both neighbours, which have the
        same, are on a coexisting attractor.
        """
        starts = np.flatnonzero(np.diff(self.period, prepend=-1))
        lengths = np.diff(np.append(starts, len(self.period)))
        found = self.period[starts]
        before, after = np.append(-1, found[:-1]), np.append(found[1:], -2)
        keep = np.repeat((lengths > 2) | ((found != 0) & (before != after)), lengths)
        return Line(*(leaf[keep] for leaf in self))

    def run_end(self, first: int) -> int:
        """Last lane of the run of equal periods that begins at a lane."""
        other = np.flatnonzero(self.period[first:] != self.period[first])
        return first + int(other[0]) - 1 if len(other) else len(self.value) - 1


def follow(scene: Scene, lanes: LaneRunner, levels: int) -> Cascade:
    """The doublings that the start state leads to along the first axis, at most so many."""
    name = scene.line.name
    limit = max(_SMALLEST_LIMIT, 2**levels)
    found = survey(scene, lanes, section_points(scene), limit, "doubling", TRANSIENT, only_doublings=True)
    begun = _longest(_line(scene, found))
    if begun is None:
        return Cascade(
            1, (), (), f"no period doubling in this range of {name}: no two neighbouring values have periods n and 2n"
        )
    line, lane = begun
    period, end = int(line.period[lane]), float(line.value[-1])
    points: list[DoublingPoint] = []
    errors: list[float] = []
    reason = ""
    for level in range(levels):
        n = period << level
        located = _locate(scene, lanes, line, lane, n)
        if located is None:
            reason = f"the orbit of period {n} does not double before {name} = {end:g}"
            break
        points.append(located[0])
        errors.append(located[1])
        if level + 1 == levels:
            break
        ahead = _next_run(scene, lanes, line, points, 2 * n, max(limit, period << levels), end)
        if ahead is None:
            value = points[-1].value
            reason = f"no stable orbit of period {2 * n} was found beyond the doubling at {name} = {value:.9g}"
            break
        line, lane = ahead
    return Cascade(period, tuple(points), tuple(errors), reason)


def _line(scene: Scene, found: Survey) -> Line:
    """A survey of lanes along the first axis, at whatever values they are, without its holes."""
    return Line(np.asarray(scene.p[scene.line.name]), found.period, found.u).without_holes()


def _longest(found: Line) -> tuple[Line, int] | None:
    """The line in the direction in which a cascade goes furthest, and the lane where its first run begins.

    A cascade is a row of neighbouring runs of lanes, each with twice (or a higher power of two times, where the survey
    steps over a level) the period of the one before. A tie goes to the direction of the sweep, and there to the first.
    """
    best: tuple[int, Line, int] | None = None
    for ordered in (found, Line(*(leaf[::-1] for leaf in found))):
        starts = np.flatnonzero(np.diff(ordered.period, prepend=-1))
        periods = ordered.period[starts]
        for k in range(len(starts)):
            length = 0
            while k + length + 1 < len(starts) and _doubles(periods[k + length], periods[k + length + 1]):
                length += 1
            if length and (best is None or length > best[0]):
                best = length, ordered, int(starts[k])
    return None if best is None else best[1:]


def _doubles(n: np.integer, following: np.integer) -> np.bool:
    """Whether `following` is n times a power of two above one."""
    ratio = following // np.maximum(n, 1)
    return (n > 0) & (ratio > 1) & (ratio * n == following) & (ratio & (ratio - 1) == 0)


def _locate(scene: Scene, lanes: LaneRunner, found: Line, lane: int, n: int) -> tuple[DoublingPoint, float] | None:
    """The doubling of the stable period-n orbit that a lane of a line is on, and the error of its value."""
    last = found.run_end(lane)
    if last + 1 == len(found.value):
        return None
    start, stop = float(found.value[last]), float(found.value[last + 1])
    with lanes.stage(f"doubling: period {n} → {2 * n}", 0):
        return locate(scene, lanes, found.u[last], start, stop, n)


def _next_run(
    scene: Scene, lanes: LaneRunner, found: Line, points: list[DoublingPoint], n: int, limit: int, end: float
) -> tuple[Line, int] | None:
    """A line and the first lane in it that is on the period-n orbit born at the last doubling."""
    born = points[-1]
    sign = np.sign(found.value[-1] - found.value[0])
    ahead = np.flatnonzero(sign * (found.value - born.value) > 0)
    if len(ahead) and found.period[ahead[0]] == n and found.run_end(int(ahead[0])) > ahead[0]:
        return found, int(ahead[0])
    spacing = abs(found.value[1] - found.value[0])
    reach = 0.5 * abs(born.value - points[-2].value) if len(points) > 1 else 8 * spacing
    for _ in range(_CLOSER_TRIES):
        stop = born.value + sign * min(reach, abs(end - born.value))
        near = scene.at(np.linspace(born.value, stop, _CLOSER + 1)[1:])
        start = np.broadcast_to(born.orbit[0] + 0.01 * born.vector[0], (_CLOSER, born.orbit.shape[1]))
        label = f"doubling, beyond {scene.line.name} = {born.value:.9g}"
        closer = survey(near, lanes, start, limit, label, TRANSIENT, least=n, only_doublings=True)
        closer = _line(near, closer)
        first = np.flatnonzero(closer.period == n)
        if len(first):
            return closer, int(first[0])
        reach /= 8
    return None
