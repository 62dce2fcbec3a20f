"""Branches: curves of periodic orbits over a parameter, followed by arclength, many side by side. Host code.

Each step goes along the direction of the curve and comes back to it by Newton (`arclength`). Steps are as long as the
curve is straight: where it turns, or Newton goes far from the guess, they are taken anew and shorter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxnh.orbits.continuation.arclength import (
    CurveOrbits,
    Family,
    PathVector,
    along_parameter,
    correct,
    inner,
    length,
    minus,
    times,
)
from jaxnh.orbits.continuation.kinds import eigenvalues, odd, test_functions

ENDS = ("start", "range", "collapsed", "closed", "no_convergence", "most_points", "unbounded")
"""Why a branch ends: it was begun there, as at a bifurcation; the parameter leaves its range; the orbit is one of a
shorter period; the curve is closed; Newton does not converge at the smallest step; as many points are known as were
asked for; the orbit leaves all bounds."""

START, RANGE, COLLAPSED, CLOSED, NO_CONVERGENCE, MOST_POINTS, UNBOUNDED = range(len(ENDS))

_BENT = 0.97  # cosine of the angle between directions at the ends of a step, at least
_MISSED = 0.15  # of a step that Newton goes back, at most
_NEAR = 0.3  # of a step, that steps of Newton need not contract below
_WANTED = 0.04  # what steps are chosen for
_SMALLEST = 1e-7  # step
_GROWTH = 1.5  # of a step that went well
_FIRST = 0.1  # of the largest step
_FARTHEST = 1e3  # sizes of the motion
_SAME = 1e-6  # sizes: an orbit this near to one of a shorter period is that one
_LEAST_LOOP = 8  # points of a closed branch


class StepControl(NamedTuple):
    """Sizes and numbers of steps along branches.

    Attributes:
        largest: step, in sizes of the motion and widths of the range.
        most: points of a branch in either direction.
    """

    largest: float = 0.02
    most: int = 2000


STEPS = StepControl()
"""Default steps."""


_Leaves = TypeVar("_Leaves", CurveOrbits, PathVector)

Wanted = Callable[[Sequence["Branch"], int], bool]
"""Decides whether the orbit of a number is still to be followed, with the branches that are whole by now."""


@dataclass(frozen=True)
class Branch:
    """A branch, point by point.

    Attributes:
        points: of its orbits, section coordinates with angles that go on, (k, n, d).
        value: of the parameter, (k,).
        way: direction of the curve, (k, n, d) and (k,).
        tests: test functions of the kinds of the family, (k, kinds).
        multipliers: (k, d).
        residual: largest component of P(u_i) − u_{i+1} in sizes of the motion, (k,).
        ends: why it ends where it begins, and at its end, numbers in `ENDS`. A collapsed one goes on to a point beyond.
    """

    points: Float[np.ndarray, "k n d"]
    value: Float[np.ndarray, " k"]
    way: PathVector
    tests: Float[np.ndarray, "k kinds"]
    multipliers: Complex[np.ndarray, "k d"]
    residual: Float[np.ndarray, " k"]
    ends: tuple[int, int]

    @property
    def period(self) -> int:
        """Points of an orbit."""
        return self.points.shape[1]

    def ending(self, reason: int) -> Branch:
        """The branch with one reason for both of its ends."""
        return replace(self, ends=(reason, reason))

    def reversed(self, odd: Bool[np.ndarray, " kinds"]) -> Branch:
        """The branch from its end, with test functions that change sign with the direction (`odd`)."""
        way = PathVector(-self.way.points[::-1], -self.way.value[::-1])
        tests = np.where(odd, -self.tests, self.tests)[::-1]
        back = (self.points[::-1], self.value[::-1], way, tests, self.multipliers[::-1], self.residual[::-1])
        return Branch(*back, ends=(self.ends[1], self.ends[0]))

    def joined(self, other: Branch) -> Branch:
        """This branch and one that begins where it ends."""

        def both(one: np.ndarray, more: np.ndarray) -> np.ndarray:
            return np.concatenate([one, more[1:]])

        return Branch(
            both(self.points, other.points),
            both(self.value, other.value),
            PathVector(both(self.way.points, other.way.points), both(self.way.value, other.way.value)),
            both(self.tests, other.tests),
            both(self.multipliers, other.multipliers),
            both(self.residual, other.residual),
            (self.ends[0], other.ends[1]),
        )


def follow_both_ways(
    family: Family,
    begun: CurveOrbits,
    steps: StepControl = STEPS,
    wanted: Wanted | None = None,
    at_once: int | None = None,
) -> dict[int, Branch]:
    """The branches through orbits, from one end to the other, by the orbits' numbers; of a closed one the loop.

    Lanes do not feel each other. Where one comes to its end the next in turn takes its place, so that few long branches
    keep none waiting.

    Args:
        family: the map.
        begun: orbits, with the directions in which branches are followed first.
        steps: how branches are followed.
        wanted: asked for each orbit as its turn comes, with the branches that have come to both of their ends and the
            orbit's number; by default all are.
        at_once: how many are followed at a time, by default all.
    """
    count = len(begun.value)
    back = begun._replace(way=PathVector(-begun.way.points, -begun.way.value), crossing=-begun.crossing)
    course = _Course(family, jax.tree.map(lambda *leaves: np.concatenate(leaves), begun, back), steps)
    branches, turn, followed = dict[int, Branch](), 0, 0
    while turn < count or len(course.open_):
        more = list[int]()
        while turn < count and (at_once is None or followed < at_once):
            if wanted is None or wanted(list(branches.values()), turn):
                more.append(turn)
                followed += 1
            turn += 1
        if more:
            course.begin(np.array([*more, *(count + k for k in more)], int))
        ended = course.step().tolist() if len(course.open_) else []
        for k in sorted({lane % count for lane in ended}):
            if course.is_done(k) and course.is_done(count + k):
                followed -= 1
                ahead, behind = course.branch(k), course.branch(count + k)
                loop = ahead.ends[1] == CLOSED
                branches[k] = ahead.ending(CLOSED) if loop else behind.reversed(odd(family)).joined(ahead)
    return {k: branches[k] for k in sorted(branches)}


class _Course:
    """Lanes on their way along branches, each to its end in the direction it has begun with.

    Attributes:
        open_: numbers of the lanes that are on their way.
    """

    def __init__(self, family: Family, begun: CurveOrbits, steps: StepControl) -> None:
        lanes = len(begun.value)
        self._family, self._begun, self._steps = family, begun, steps
        self.open_ = np.arange(0)
        self._now, self._bend = begun.take(self.open_), times(np.zeros(0), begun.take(self.open_).way)
        self._count, self._end = np.zeros(lanes, int), np.full(lanes, START)
        self._size = np.full(lanes, _FIRST * steps.largest)
        self._rows = [list[_Points]() for _ in range(lanes)]

    def begin(self, lanes: Int[np.ndarray, " some"]) -> None:
        """Set lanes on their way."""
        now = self._begun.take(lanes)
        self._keep(lanes, now)
        self.open_ = np.concatenate([self.open_, lanes])
        self._now = _join(self._now, now)
        self._bend = _join(self._bend, times(np.zeros(len(lanes)), now.way))

    def is_done(self, lane: int) -> bool:
        """Return whether a lane has come to its end."""
        return bool(self._end[lane] != START)

    def step(self) -> Int[np.ndarray, " some"]:
        """One step of all lanes on their way; those that have come to their ends by it."""
        family, steps, open_, now, bend = self._family, self._steps, self.open_, self._now, self._bend
        taken, step, at_end = _step_lanes(family, now, bend, np.minimum(self._size[open_], _room(family, now)))
        with np.errstate(invalid="ignore"):
            share = np.where(step > 0.0, taken.missed / np.maximum(step, _SMALLEST), 0.0)
            good = taken.converged & (inner(family, taken.way, now.way) >= _BENT) & (share <= _MISSED)
            good &= (taken.value >= family.low) & (taken.value <= family.high)
        collapsed, merged = (good & which for which in _collapses(family, now, taken))
        closed = good & (self._count[open_] > _LEAST_LOOP)
        closed &= _passes(family, self._begun.take(open_), now, taken, 2.0 * step)
        kept = good & ~merged & (step > 0.0)
        self._keep(open_[kept], taken.take(kept))
        factor = np.where(good, np.clip(_WANTED / np.maximum(share, _SMALLEST), 0.5, _GROWTH), 0.5)
        self._size[open_] = np.minimum(
            np.minimum(self._size[open_], np.maximum(step, _SMALLEST)) * factor, steps.largest
        )
        far = np.abs(now.points / family.size).max(axis=(1, 2)) > _FARTHEST
        done = np.zeros(len(open_), bool)
        for which, reason in (
            (self._count[open_] >= steps.most, MOST_POINTS),
            (~good & (self._size[open_] <= _SMALLEST), NO_CONVERGENCE),
            (far, UNBOUNDED),
            (good & at_end, RANGE),
            (closed, CLOSED),
            (collapsed, COLLAPSED),
        ):
            self._end[open_[which]] = reason
            done |= which
        turned = times(1.0 / np.maximum(step, _SMALLEST), minus(taken.way, np.ones(len(open_)), now.way))
        bend, now = _select(good, turned, bend), _select(good, taken, now)
        self._bend, self._now, self.open_ = _take(bend, ~done), now.take(~done), open_[~done]
        return open_[done]

    def branch(self, lane: int) -> Branch:
        """Return the branch that a lane has followed, and forget it."""
        rows, self._rows[lane] = self._rows[lane], []
        whole: _Points = jax.tree.map(lambda *leaves: np.stack(leaves), *rows)
        return Branch(*whole, ends=(START, int(self._end[lane])))

    def _keep(self, lanes: Int[np.ndarray, " some"], orbits: CurveOrbits) -> None:
        """Have points of lanes in their rows."""
        family = self._family
        tests, multipliers = test_functions(family, orbits), eigenvalues(family, orbits)
        whole = _Points(orbits.points, orbits.value, orbits.way, tests, multipliers, orbits.residual)
        for i, lane in enumerate(lanes.tolist()):
            self._rows[lane].append(whole.lane(i))
        self._count[lanes] += 1


class _Points(NamedTuple):
    """A point of a branch, or all of them, as `Branch` has them."""

    points: np.ndarray
    value: np.ndarray
    way: PathVector
    tests: np.ndarray
    multipliers: np.ndarray
    residual: np.ndarray

    def lane(self, i: int) -> _Points:
        """Return the point of one of several lanes."""
        way = PathVector(self.way.points[i], self.way.value[i])
        return _Points(self.points[i], self.value[i], way, self.tests[i], self.multipliers[i], self.residual[i])


def _join(one: _Leaves, more: _Leaves) -> _Leaves:
    return jax.tree.map(lambda a, b: np.concatenate([a, b]), one, more)


def _step_lanes(
    family: Family, now: CurveOrbits, bend: PathVector, size: Float[np.ndarray, " lanes"]
) -> tuple[CurveOrbits, Float[np.ndarray, " lanes"], Bool[np.ndarray, " lanes"]]:
    """Orbits a step further, the lengths of the steps, and whether they end where the range does.

    The guess is of second order, with the direction's change over the step before (`bend`): where the map expands much,
    Newton needs it.
    """
    ahead = now.value + size * now.way.value
    at_end = (ahead >= family.high) | (ahead <= family.low)
    edge = np.where(ahead >= family.high, family.high, family.low)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(at_end, np.maximum((edge - now.value) / now.way.value, 0.0), size)
    more = times(0.5 * step**2, bend)
    points = now.points + step[:, None, None] * now.way.points + more.points
    value = np.where(at_end, edge, ahead + more.value)
    straight = along_parameter(family, len(value), now.points.shape[1])
    sign = np.where(now.way.value < 0.0, -1.0, 1.0)
    across = PathVector(
        np.where(at_end[:, None, None], straight.points, now.way.points),
        np.where(at_end, sign * straight.value, now.way.value),
    )
    return correct(family, points, value, across, near=_NEAR * step), step, at_end


def _gap(points: np.ndarray) -> np.ndarray:
    """Differences from each point (or vector) to the one half a period later."""
    return points - np.roll(points, points.shape[1] // 2, 1)


def _room(family: Family, now: CurveOrbits) -> Float[np.ndarray, " lanes"]:
    """Largest steps of orbits that have just been born in a doubling: half of what they are apart from its orbit."""
    none = np.zeros(len(now.value))
    if now.points.shape[1] % 2:
        return none + np.inf
    gap, change = (PathVector(leaf, none) for leaf in (family.wrap(_gap(now.points)), _gap(now.way.points)))
    return np.where(inner(family, gap, change) > 0.0, 0.5 * length(family, gap), np.inf)


def _collapses(
    family: Family, now: CurveOrbits, taken: CurveOrbits
) -> tuple[Bool[np.ndarray, " lanes"], Bool[np.ndarray, " lanes"]]:
    """Return whether orbits are, or have been on the way, ones of a shorter period; and whether they still are.

    That is a doubling that the branch is born in. Beyond it, it has the same orbits again, half a period on.
    """
    n = now.points.shape[1]
    collapsed, merged = np.zeros((2, len(now.value)), bool)
    none = np.zeros(len(collapsed))
    for m in (n // q for q in range(2, n + 1) if n % q == 0 and all(q % r for r in range(2, q))):
        before, after = (PathVector(family.wrap(o.points - np.roll(o.points, -m, 1)), none) for o in (now, taken))
        merged |= length(family, after) < _SAME
        collapsed |= merged | (inner(family, before, after) <= 0.0)
    return collapsed, merged


def _passes(
    family: Family, begun: CurveOrbits, now: CurveOrbits, taken: CurveOrbits, near: Float[np.ndarray, " lanes"]
) -> Bool[np.ndarray, " lanes"]:
    """Return whether a step passes the orbit that its branch has begun with, whichever of its points comes first."""
    passes = np.zeros(len(now.value), bool)
    for m in range(now.points.shape[1]):
        points, way = np.roll(begun.points, m, 1), PathVector(np.roll(begun.way.points, m, 1), begun.way.value)
        before, after = (PathVector(family.wrap(o.points - points), o.value - begun.value) for o in (now, taken))
        passed = (inner(family, before, way) < 0.0) & (inner(family, after, way) >= 0.0)
        passes |= passed & (length(family, after) <= near)
    return passes


def _select(which: Bool[np.ndarray, " lanes"], one: _Leaves, other: _Leaves) -> _Leaves:
    """Select one or the other for each lane."""

    def leaf(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return jax.tree.map(leaf, one, other)


def _take(way: PathVector, lanes: Bool[np.ndarray, " lanes"]) -> PathVector:
    return PathVector(way.points[lanes], way.value[lanes])
