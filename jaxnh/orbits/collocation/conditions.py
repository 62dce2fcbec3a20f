"""Conditions on cycles over two parameters: how long they take, an extremum or the mean of a function. Host code.

A cycle with an extremum begins there, so that the condition is one on its first state, which is known to a higher order
than states between the ends of intervals. With a clock the time of the extremum is a parameter more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.orbits.collocation.cycle_equations import CollocationEquations, CycleConditions, CyclePoint, Ends
from jaxnh.orbits.collocation.equations import (
    BoundarySolution,
    PointCondition,
    Problem,
    Variation,
    combination,
    state_gradient,
)
from jaxnh.orbits.collocation.paths import adapted_mesh, halved, on_mesh, rotated, values_at
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.paths import BEYOND

_ROUNDS, _PLACES = 2, 9  # to find a least value: places between samples of a cycle, and again between two of these
_SAME_NODE = 1e-6  # of the duration: a place this near an end of an interval is one
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
        path, extra = solution.path, np.zeros((len(solution.duration), 1 + solution.values.shape[1]))
        extra[:, 0] = 1.0
        gradient = Variation(np.zeros_like(path.ends), np.zeros_like(path.stages), extra)
        return [PointCondition(gradient, np.log(solution.duration / self.duration))]

    def endings(self, solution: BoundarySolution) -> Mapping[int, Bool[np.ndarray, " lanes"]]:
        """None."""
        return {}

    def nodes(self, solution: BoundarySolution) -> Float[np.ndarray, " 0"]:
        """None."""
        return np.zeros(0)

    def excess(self, solution: BoundarySolution) -> float:
        """The distance of a cycle, one lane, from the condition: the sign changes where a branch meets it."""
        return float(np.log(solution.duration[0] / self.duration))

    def rotate_to_start(self, solution: BoundarySolution) -> BoundarySolution:
        """The same cycle."""
        return solution


_Watched = tuple[Height, Float[np.ndarray, "lanes 1"] | float, float]
"""A function, the level that it stays on one side of, and the sign of what is beyond."""


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
        rows = [(first[:, k], extra[:, k], missing[:, k]) for k in range(2)]
        if problem.clock:
            held = np.broadcast_to(np.eye(extra.shape[2])[0], (lanes, extra.shape[2]))
            rows.append((np.zeros_like(first[:, 0]), held, np.zeros(lanes)))
        return [PointCondition(state_gradient(path, np.zeros(lanes), *by), missing) for *by, missing in rows]

    def endings(self, solution: BoundarySolution) -> Mapping[int, Bool[np.ndarray, " lanes"]]:
        """Cycles that go beyond the level elsewhere, or beyond what guards them."""
        return {BEYOND: _passes_surfaces(solution, self._watched(solution))}

    def nodes(self, solution: BoundarySolution) -> Float[np.ndarray, " k"]:
        """None: cycles begin at the extremum."""
        return np.zeros(0)

    def excess(self, solution: BoundarySolution) -> float:
        """The height of a cycle, one lane, above the level; not a number where it is beyond what guards it."""
        states, shares = _sampled(solution)
        if _meets(solution, self._guards):
            return np.nan
        values = self._sign * (_values(self._height, solution, states, shares) - self._level)
        return float(values.max())

    def rotate_to_start(self, solution: BoundarySolution) -> BoundarySolution:
        """The cycle, one lane, from its extremum on."""
        states, shares = _sampled(solution)
        values = self._sign * _values(self._height, solution, states, shares)[0]
        share = float(shares[0, np.argmax(values)]) % 1.0
        mesh = np.unique(np.concatenate([[0.0, 1.0], (solution.path.mesh[0] - share) % 1.0]))
        parameters = solution.values.copy()
        if self._problem.clock:
            parameters[0, 0] += share * solution.duration[0]
        return solution._replace(path=rotated(solution.path, share, mesh), values=parameters)

    def _watched(self, solution: BoundarySolution) -> list[_Watched]:
        """Functions, the levels that they stay on one side of, and the signs of what is beyond."""
        return [(self._height, self._level, self._sign), *((height, 0.0, sign) for height, sign in self._guards)]


class AmplitudeCondition(ExtremumCondition):
    """Cycles along which the largest value of a function less its least one is a level; they begin at the largest.

    The least value is that of the polynomial of an interval: between the ends of intervals it is of a lower order, so
    that meshes for the last digits have one of them there (`nodes`).
    """

    def __init__(
        self, problem: Problem, height: Height, level: float, guards: Sequence[tuple[Height, float]] = ()
    ) -> None:
        super().__init__(problem, height, level, 1.0, guards)

    def at(self, solution: BoundarySolution) -> list[PointCondition]:
        """Conditions of the largest value, which is the level above the least one."""
        [first, *others] = super().at(solution)
        places = self._least(solution)
        states = values_at(solution.path, places)[:, 0]
        known = self._height(states, solution.duration * places[:, 0], solution.values)
        by_extra = np.concatenate([np.zeros((len(places), 1)), known.by_values[:, 0] * self._problem.widths], axis=1)
        least = state_gradient(solution.path, places[:, 0], known.by_state[:, 0] * self._problem.size, by_extra)
        gradient = combination([(1.0, first.gradient), (-1.0, least)])
        return [PointCondition(gradient, first.missing - known.value[:, 0]), *others]

    def nodes(self, solution: BoundarySolution) -> Float[np.ndarray, " 1"]:
        """The place of the least value."""
        return self._least(solution)[0]

    def excess(self, solution: BoundarySolution) -> float:
        """The amplitude of a cycle, one lane, above the level; not a number where it is beyond what guards it."""
        values = _values(self._height, solution, *_sampled(solution))
        return super().excess(solution) - float(values.min())

    def _watched(self, solution: BoundarySolution) -> list[_Watched]:
        """The function, which stays below its first value, and the guards."""
        first = _values(self._height, solution, solution.path.ends[:, :1], np.zeros((len(solution.duration), 1)))
        [(height, _, sign), *guards] = super()._watched(solution)
        return [(height, first, sign), *guards]

    def _least(self, solution: BoundarySolution) -> Float[np.ndarray, "lanes 1"]:
        """Places of least values, where the function's rate changes its sign between samples next to the least one."""
        states, shares = _sampled(solution)
        row, order = np.arange(len(shares)), np.argsort(shares, axis=1)
        states, shares = states[row[:, None], order], shares[row[:, None], order]
        number = np.argmin(_values(self._height, solution, states, shares), axis=1)
        shares = np.concatenate([np.zeros((len(row), 1)), shares], axis=1)  # numbers are those of the sample before
        low, high = shares[row, number], shares[row, np.minimum(number + 2, shares.shape[1] - 1)]
        before, after = np.full((2, len(row)), np.nan)
        for _ in range(_ROUNDS):
            places = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, _PLACES)
            rates = _values(self._height, solution, values_at(solution.path, places), places, 1)
            k = np.clip(np.argmax(rates > 0.0, axis=1), 1, _PLACES - 1)
            low, high, before, after = places[row, k - 1], places[row, k], rates[row, k - 1], rates[row, k]
        share = np.where(before * after < 0.0, before / np.where(before == after, 1.0, before - after), 0.5)
        return (low + share * (high - low))[:, None]


class MeanCondition:
    """Cycles along which the mean of a function in time is a level, as one of Floquet's exponents is that of a rate.

    With a clock cycles begin when they have begun, and take as long.

    Args:
        problem: the field, whose first parameter with a clock is the time when cycles begin.
        height: the function; its rate is not asked for.
        level: the value.
        guards: other functions with their signs that have to stay below zero along the cycle.
    """

    def __init__(
        self, problem: Problem, height: Height, level: float, guards: Sequence[tuple[Height, float]] = ()
    ) -> None:
        self._problem, self._height, self._level, self._guards = problem, height, level, guards
        self.begins = problem.clock

    def at(self, solution: BoundarySolution) -> list[PointCondition]:
        """The mean by the Gauss points is the level; with a clock the duration and the first time are known."""
        path, problem, weights = solution.path, self._problem, solution.path.measure
        (lanes, _, _, d), q = path.stages.shape, len(problem.widths)
        states, times = path.stages.reshape(-1, d), solution.duration[:, None, None] * path.places
        many = np.repeat(solution.values, weights[0].size, axis=0)
        known = self._height(states, times.ravel(), many)
        stages = weights[..., None] * known.by_state[:, 0].reshape(path.stages.shape) * problem.size
        by_values = known.by_values[:, 0].reshape(*weights.shape, q) * problem.widths
        extra = np.zeros((lanes, 1 + q))
        extra[:, 1:] = np.sum(weights[..., None] * by_values, axis=(1, 2))
        missing = np.sum(weights * known.value[:, 0].reshape(weights.shape), axis=(1, 2)) - self._level
        none = np.zeros_like(path.ends)
        conditions = [PointCondition(Variation(none, stages, extra), missing)]
        for column in range(2 if problem.clock else 0):
            held = Variation(none, np.zeros_like(stages), np.tile(np.eye(1 + q)[column], (lanes, 1)))
            conditions.append(PointCondition(held, np.zeros(lanes)))
        return conditions

    def endings(self, solution: BoundarySolution) -> Mapping[int, Bool[np.ndarray, " lanes"]]:
        """Cycles that go beyond what guards them."""
        return {BEYOND: _passes_surfaces(solution, [(height, 0.0, sign) for height, sign in self._guards])}

    def nodes(self, solution: BoundarySolution) -> Float[np.ndarray, " 0"]:
        """None: the mean is of the order of the ends of intervals."""
        return np.zeros(0)

    def excess(self, solution: BoundarySolution) -> float:
        """The mean along a cycle, one lane, above the level; not a number where it is beyond what guards it."""
        return np.nan if _meets(solution, self._guards) else float(self.at(solution)[0].missing[0])

    def rotate_to_start(self, solution: BoundarySolution) -> BoundarySolution:
        """The same cycle."""
        return solution


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
        start = core.correct(equations, z, across, FINE)
        if not start.converged[0]:
            return None
        [point] = equations.points(start)
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
    mesh = point.solution.path.mesh
    more = [place for place in conditions.nodes(point.solution) if np.abs(mesh - place).min() > _SAME_NODE]
    if more:
        mesh = np.sort(np.append(mesh[0], more))[None]
        point = _solved_on(problem, point, lift, conditions, mesh) or point
    both, finer = point.solution.values[0, -2:], _solved_on(problem, point, lift, conditions, halved(mesh))
    if finer is None:
        none = np.full(2, np.nan)
        return none, none, np.array(np.nan), np.full_like(point.multipliers, np.nan)
    values, count = finer.solution.values[0, -2:], finer.solution.path.stages.shape[1]
    rounding = count * np.finfo(float).eps * problem.widths[-2:]
    errors = np.abs(values - both) + np.spacing(np.abs(values)) + rounding
    return values, errors, finer.solution.duration[0], finer.multipliers


def _solved_on(
    problem: Problem,
    point: CyclePoint,
    lift: Float[np.ndarray, " d"],
    conditions: CycleConditions,
    mesh: Float[np.ndarray, "1 n+1"],
) -> CyclePoint | None:
    """A point of a curve on another mesh; None where Newton does not confirm it."""
    near = point.solution._replace(path=on_mesh(point.solution.path, mesh))
    equations = CollocationEquations(problem, near, lift, conditions=conditions)
    solved = core.correct(equations, *equations.of_point(point), FINE)
    return equations.points(solved)[0] if solved.converged[0] else None


def _sampled(solution: BoundarySolution) -> tuple[Float[np.ndarray, "lanes k d"], Float[np.ndarray, "lanes k"]]:
    """States of cycles at the Gauss points and the ends of intervals, and their shares of the duration."""
    path = solution.path
    lanes, count, m, d = path.stages.shape
    states = np.concatenate([path.stages.reshape(lanes, count * m, d), path.ends[:, 1:]], axis=1)
    return states, np.concatenate([path.places.reshape(lanes, count * m), path.mesh[:, 1:]], axis=1)


def _values(
    height: Height,
    solution: BoundarySolution,
    states: Float[np.ndarray, "lanes k d"],
    shares: Float[np.ndarray, "lanes k"],
    which: int = 0,
) -> Float[np.ndarray, "lanes k"]:
    """A function at states along cycles, or its rate."""
    (lanes, k, d), times = states.shape, solution.duration[:, None] * shares
    values = height(states.reshape(-1, d), times.ravel(), np.repeat(solution.values, k, axis=0)).value
    return np.asarray(values)[:, which].reshape(lanes, k)


def _passes_surfaces(solution: BoundarySolution, watched: Sequence[_Watched]) -> Bool[np.ndarray, " lanes"]:
    """Return whether cycles go beyond levels by more than the polynomials of intervals are wrong."""
    beyond = np.zeros(len(solution.duration), bool)
    with np.errstate(invalid="ignore"):
        for height, level, sign in watched:
            values = sign * (_values(height, solution, *_sampled(solution)) - level)
            beyond |= values.max(axis=1) > _BEYOND * np.ptp(values, axis=1)
    return beyond


def _meets(solution: BoundarySolution, guards: Sequence[tuple[Height, float]]) -> bool:
    """Return whether a cycle, one lane, goes beyond what guards it."""
    return any((sign * _values(height, solution, *_sampled(solution))).max() > 0.0 for height, sign in guards)
