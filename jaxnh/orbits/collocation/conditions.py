"""Conditions on cycles over two parameters: how long they take, and an extremum of a function along them. Host code.

A cycle with an extremum begins there, so that the condition is one on its first state, which is known to a higher order
than states between the ends of intervals. With a clock the time of the extremum is a parameter more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.orbits.collocation.cycle_equations import CollocationEquations, CycleConditions, CyclePoint, Ends
from jaxnh.orbits.collocation.cycles import cycle_multipliers
from jaxnh.orbits.collocation.equations import BoundarySolution, PointCondition, Problem
from jaxnh.orbits.collocation.paths import adapted_mesh, halved, on_mesh, rotated
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.paths import BEYOND

_BEYOND = 1e-4  # of a function's range along a cycle, that the polynomials of intervals are known to


class HeightValues(NamedTuple):
    """A function of state, time and parameters along motions, and its derivatives.

    Attributes:
        value: the function and its rate, (points, 2).
        by_state: derivatives of both in the state, (points, 2, d).
        by_values: derivatives of both in the parameters of a problem, (points, 2, q).
    """

    value: Float[np.ndarray, "points 2"]
    by_state: Float[np.ndarray, "points 2 d"]
    by_values: Float[np.ndarray, "points 2 q"]


Height = Callable[[np.ndarray, np.ndarray, np.ndarray], HeightValues]
"""A function at states (points, d) after times (points,) with parameters of a problem (points, q)."""


class DurationCondition(NamedTuple):
    """Cycles of a flow without a clock that take a time.

    Attributes:
        duration: the time.
    """

    duration: float
    begins = False

    def at(self, solution: BoundarySolution) -> list[PointCondition]:
        """The logarithm of the duration is that of the time."""
        (lanes, _, d), extra = solution.path.ends.shape, 1 + solution.values.shape[1]
        by_extra = np.broadcast_to(np.eye(extra)[0], (lanes, extra))
        missing = np.log(solution.duration / self.duration)
        return [PointCondition(np.zeros((lanes, d)), by_extra, missing)]

    def endings(self, solution: BoundarySolution) -> Mapping[int, Bool[np.ndarray, " lanes"]]:
        """None."""
        return {}

    def excess(self, solution: BoundarySolution) -> float:
        """The distance of a cycle, one lane, from the condition: the sign changes where a branch meets it."""
        return float(np.log(solution.duration[0] / self.duration))

    def begun(self, solution: BoundarySolution) -> BoundarySolution:
        """The same cycle."""
        return solution


class ExtremumCondition:
    """Cycles along which a function's largest value, or its least one, is a level; they begin where they have it.

    Args:
        problem: the field, whose first parameter with a clock is the time when cycles begin.
        height: the function.
        level: the value.
        sign: +1 of the largest value, −1 of the least.
        guards: other functions with their signs that have to stay below zero along the cycle.
    """

    begins = True

    def __init__(
        self,
        problem: Problem,
        height: Height,
        level: float,
        sign: float,
        guards: Sequence[tuple[Height, float]] = (),
    ) -> None:
        self._problem, self._height, self._level, self._sign, self._guards = problem, height, level, sign, guards

    def at(self, solution: BoundarySolution) -> list[PointCondition]:
        """The function is the level, and its rate zero, in the first state; with a clock the duration is known."""
        path, problem = solution.path, self._problem
        lanes = len(solution.duration)
        known = self._height(path.ends[:, 0], np.zeros(lanes), solution.values)
        first = known.by_state * problem.size
        extra = np.concatenate([np.zeros((lanes, 2, 1)), known.by_values * problem.widths], axis=2)
        missing = known.value - np.array([self._level, 0.0])
        conditions = [PointCondition(first[:, k], extra[:, k], missing[:, k]) for k in range(2)]
        if problem.clock:
            held = np.broadcast_to(np.eye(extra.shape[2])[0], (lanes, extra.shape[2]))
            conditions.append(PointCondition(np.zeros_like(first[:, 0]), held, np.zeros(lanes)))
        return conditions

    def endings(self, solution: BoundarySolution) -> Mapping[int, Bool[np.ndarray, " lanes"]]:
        """Cycles that go beyond the level elsewhere, or beyond what guards them."""
        (states, shares), beyond = _sampled(solution), np.zeros(len(solution.duration), bool)
        with np.errstate(invalid="ignore"):
            for height, level, sign in self._watched:
                values = sign * (self._values(height, solution, states, shares) - level)
                beyond |= values.max(axis=1) > _BEYOND * np.ptp(values, axis=1)
        return {BEYOND: beyond}

    def excess(self, solution: BoundarySolution) -> float:
        """The height of a cycle, one lane, above the level; not a number where it is beyond what guards it."""
        states, shares = _sampled(solution)
        if any((sign * self._values(height, solution, states, shares)).max() > 0.0 for height, sign in self._guards):
            return np.nan
        values = self._sign * (self._values(self._height, solution, states, shares) - self._level)
        return float(values.max())

    def begun(self, solution: BoundarySolution) -> BoundarySolution:
        """The cycle, one lane, from its extremum on."""
        states, shares = _sampled(solution)
        values = self._sign * self._values(self._height, solution, states, shares)[0]
        share = float(shares[0, np.argmax(values)]) % 1.0
        mesh = np.unique(np.concatenate([[0.0, 1.0], (solution.path.mesh[0] - share) % 1.0]))
        parameters = solution.values.copy()
        if self._problem.clock:
            parameters[0, 0] += share * solution.duration[0]
        return solution._replace(path=rotated(solution.path, share, mesh), values=parameters)

    @property
    def _watched(self) -> list[tuple[Height, float, float]]:
        """Functions, the levels that they stay on one side of, and the signs of what is beyond."""
        return [(self._height, self._level, self._sign), *((height, 0.0, sign) for height, sign in self._guards)]

    def _values(
        self, height: Height, solution: BoundarySolution, states: np.ndarray, shares: np.ndarray
    ) -> Float[np.ndarray, "lanes k"]:
        (lanes, k, d), times = states.shape, solution.duration[:, None] * shares
        values = height(states.reshape(-1, d), times.ravel(), np.repeat(solution.values, k, axis=0)).value
        return np.asarray(values)[:, 0].reshape(lanes, k)


class RefinedPoints(NamedTuple):
    """Points of a curve on the halves of the intervals of its meshes.

    Attributes:
        values, errors: of the last two parameters, (k, 2).
        durations: (k,).
        multipliers: (k, e).
    """

    values: Float[np.ndarray, "k 2"]
    errors: Float[np.ndarray, "k 2"]
    durations: Float[np.ndarray, " k"]
    multipliers: np.ndarray


def first_point(
    problem: Problem, guess: BoundarySolution, lift: Float[np.ndarray, " d"], ends: Ends, conditions: CycleConditions
) -> CyclePoint | None:
    """The point of a curve at the last parameter of a cycle near by, in range; None where Newton does not confirm one.

    Args:
        problem: the field, with as many parameters more than one as there are conditions.
        guess: the cycle, one lane, near the condition.
        lift: of the end over the beginning.
        ends: of the ranges of the last two parameters.
        conditions: the condition.
    """
    point = None
    for _ in range(2):  # the second time on the mesh of the cycle itself
        path = on_mesh(guess.path, adapted_mesh(guess.path, problem.size))
        equations = CollocationEquations(problem, guess._replace(path=path), lift, ends, (), conditions)
        z = equations.unknowns(guess._replace(path=path))
        across = np.zeros_like(z)
        across[:, -1] = equations.unit[-1]
        begun = core.correct(equations, z, across, FINE)
        if not begun.converged[0]:
            return None
        [point] = equations.points(begun)
        guess = point.solution
    both, beyond = guess.values[0, -2:], conditions.endings(guess)
    outside = np.any((both < ends[0]) | (both > ends[1])) or any(each.any() for each in beyond.values())
    return None if outside else point


def refined_points(
    problem: Problem, points: Sequence[CyclePoint], lift: Float[np.ndarray, " d"], conditions: CycleConditions
) -> RefinedPoints:
    """Points of a curve on finer meshes, and errors by how far they are from those on the meshes themselves.

    What the finer ones leave is less by 2^(2m) with m Gauss points (de Boor and Swartz, SIAM J. Numer. Anal. 10 (1973)
    582). A point that Newton does not confirm there is not a number.
    """
    rows = [_refined(problem, point, lift, conditions) for point in points]
    return RefinedPoints(*(np.stack(column) for column in zip(*rows, strict=True)))


def _refined(
    problem: Problem, point: CyclePoint, lift: Float[np.ndarray, " d"], conditions: CycleConditions
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    path, both = point.solution.path, point.solution.values[0, -2:]
    finer = point.solution._replace(path=on_mesh(path, halved(path.mesh)))
    equations = CollocationEquations(problem, finer, lift, conditions=conditions)
    solved = core.correct(equations, *equations.of_point(point), FINE)
    if not solved.converged[0]:
        none = np.full(2, np.nan)
        return none, none, np.array(np.nan), np.full_like(point.multipliers, np.nan)
    solution, d = equations.solution(solved.z), len(problem.size)
    count = solution.path.stages.shape[1]
    blocks = solved.blocks[:, :-1].reshape(1, count, d, d)
    multipliers, _ = cycle_multipliers(problem, solution, blocks, solved.blocks[:, -1])
    values = solution.values[0, -2:]
    rounding = count * np.finfo(float).eps * problem.widths[-2:]
    return values, np.abs(values - both) + np.spacing(np.abs(values)) + rounding, solution.duration[0], multipliers[0]


def _sampled(solution: BoundarySolution) -> tuple[Float[np.ndarray, "lanes k d"], Float[np.ndarray, "lanes k"]]:
    """States of cycles at the Gauss points and the ends of intervals, and their shares of the duration."""
    path = solution.path
    lanes, count, m, d = path.stages.shape
    states = np.concatenate([path.stages.reshape(lanes, count * m, d), path.ends[:, 1:]], axis=1)
    return states, np.concatenate([path.places.reshape(lanes, count * m), path.mesh[:, 1:]], axis=1)
