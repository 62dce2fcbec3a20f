"""Pairs of bifurcations between two points of a branch, where a test function passes zero and comes back. Host code.

Two changes of sign within a step leave none to be seen. Where the parabola through a test function at three points of
a branch turns between two of them, close to zero or beyond it, the function is computed at the place of the turn, and
again where the parabola through that turns. If the sign has changed there, the branch gets the point, and each of the
two bifurcations has a bracket of its own (`location.brackets`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.bifurcations.location import critical
from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector, correct, length, times
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.kinds import HOPF, NEIMARK_SACKER, eigenvalues, kinds, test_functions
from jaxnh.orbits.continuation.paths import COLLAPSED, NEAR

_ROUNDS = 4  # parabolas, each through the place of the turn of the last
_CLOSE = 0.5  # of the lesser of both ends: a turn further from zero is not looked at
_INSIDE = 0.02  # of the stretch: a turn closer to an end than this shows no pair


class Turn(NamedTuple):
    """A turn of a test function between two points of a branch.

    Attributes:
        branch, place: number of the branch, and of the point before the turn.
        share: of the chord to the next point, at which the function turns.
    """

    branch: int
    place: int
    share: float


def with_close_pairs(family: Family, branches: Sequence[Branch]) -> list[Branch]:
    """The branches, of one period, with a point more between every two bifurcations that lie within one step.

    Of Neimark–Sacker points and Hopf points alone, as these begin what no branch of orbits shows.
    """
    column = kinds(family).index(HOPF if family.field else NEIMARK_SACKER)
    active = [turn for number, branch in enumerate(branches) for turn in _turns(family, number, branch, column)]
    more: dict[int, list[tuple[Turn, CurveOrbits]]] = {}
    for _ in range(_ROUNDS):
        if not active:
            break
        orbits = _orbits_at(family, branches, active)
        tests, pairs = _tests(family, orbits, column), np.isfinite(critical(family, eigenvalues(family, orbits)))
        next_turns = list[Turn]()
        for k, turn in enumerate(active):
            ends = branches[turn.branch].tests[turn.place : turn.place + 2, column]
            if not (orbits.converged[k] and pairs[k]):
                continue
            if tests[k] * ends[0] < 0.0:
                more.setdefault(turn.branch, []).append((turn, orbits.take(slice(k, k + 1))))
                continue
            share = _turn(np.array([0.0, turn.share, 1.0]), np.array([ends[0], tests[k], ends[1]]))
            next_turns += [] if share is None else [turn._replace(share=share)]
        active = next_turns
    return [_with_points(family, branch, more.get(number, [])) for number, branch in enumerate(branches)]


def _turns(family: Family, number: int, branch: Branch, column: int) -> list[Turn]:
    """Turns of a test function that parabolas through neighbours show between points where it has one sign."""
    tests, count = branch.tests[:, column], len(branch.value)
    chords = PathVector(np.diff(branch.points, axis=0), np.diff(branch.value))
    place = np.concatenate([[0.0], np.cumsum(length(family, chords))])
    first, last = int(branch.ends[0] == COLLAPSED), count - 1 - int(branch.ends[1] == COLLAPSED)
    turns = list[Turn]()
    for i in range(first, last):
        if not tests[i] * tests[i + 1] > 0.0:
            continue
        shares = [_turn(_shares(place, i, k), tests[k : k + 3]) for k in (i - 1, i) if 0 <= k <= count - 3]
        turns += [Turn(number, i, share) for share in shares if share is not None][:1]
    return turns


def _shares(place: Float[np.ndarray, " k"], i: int, k: int) -> Float[np.ndarray, " 3"]:
    """Places of three points from the k-th on, as shares of the chord from the i-th to the next."""
    return (place[k : k + 3] - place[i]) / (place[i + 1] - place[i])


def _turn(place: Float[np.ndarray, " 3"], tests: Float[np.ndarray, " 3"]) -> float | None:
    """Return the turn in (0, 1) of the parabola through three points, if it is near zero or beyond it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.diff(tests) / np.diff(place)
        bend = (slope[1] - slope[0]) / (place[2] - place[0])
        share = 0.5 * (place[0] + place[1] - slope[0] / bend)
        value = tests[0] + (share - place[0]) * (slope[0] + bend * (share - place[1]))
    if not (np.isfinite(value) and _INSIDE < share < 1.0 - _INSIDE):
        return None
    ends = tests[[int(np.argmin(np.abs(place - end))) for end in (0.0, 1.0)]]
    return float(share) if value * np.sign(ends[0]) < _CLOSE * np.abs(ends).min() else None


def _orbits_at(family: Family, branches: Sequence[Branch], turns: Sequence[Turn]) -> CurveOrbits:
    """The orbits at turns, across the chords; those that Newton has gone far to are none of the branch."""

    def at(step: int, way: bool = False) -> PathVector:
        parts = [(branches[turn.branch].way if way else branches[turn.branch], turn.place + step) for turn in turns]
        return PathVector(np.stack([p.points[i] for p, i in parts]), np.array([p.value[i] for p, i in parts]))

    start, end = at(0), at(1)
    chord = PathVector(end.points - start.points, end.value - start.value)
    size, s = length(family, chord), np.array([turn.share for turn in turns])
    first, second = times(s * (1.0 - s) ** 2 * size, at(0, True)), times(-s * s * (1.0 - s) * size, at(1, True))
    parts = start, times(s * s * (3.0 - 2.0 * s), chord), first, second
    points, value = sum(part.points for part in parts), sum(part.value for part in parts)
    orbits = correct(family, np.asarray(points), np.asarray(value), times(1.0 / size, chord), FINE)
    return orbits._replace(converged=orbits.converged & (orbits.missed <= NEAR * size))


def _tests(family: Family, orbits: CurveOrbits, column: int) -> Float[np.ndarray, " lanes"]:
    safe = orbits._replace(blocks=np.where(orbits.converged[:, None, None, None], orbits.blocks, 0.0))
    return test_functions(family, safe)[:, column]


def _with_points(family: Family, branch: Branch, more: Sequence[tuple[Turn, CurveOrbits]]) -> Branch:
    """The branch with orbits between its points, each behind the place of its turn."""
    for turn, orbit in sorted(more, key=lambda each: -each[0].place):
        at = turn.place + 1

        def put(whole: np.ndarray, part: np.ndarray, at: int = at) -> np.ndarray:
            return np.concatenate([whole[:at], part, whole[at:]])

        branch = replace(
            branch,
            points=put(branch.points, orbit.points),
            value=put(branch.value, orbit.value),
            way=PathVector(put(branch.way.points, orbit.way.points), put(branch.way.value, orbit.way.value)),
            tests=put(branch.tests, test_functions(family, orbit)),
            multipliers=put(branch.multipliers, eigenvalues(family, orbit)),
            residual=put(branch.residual, orbit.residual),
        )
    return branch
