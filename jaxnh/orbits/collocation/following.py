"""Branches of cycles over a parameter by the core of continuation, on meshes that are adapted on the way. Host code.

Where a mesh no longer suits the orbits, the branch goes on over another one, with the predictor through its last
points.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.collocation.cycle_equations import CollocationEquations, CycleConditions, CyclePoint, Ends
from jaxnh.orbits.collocation.equations import Problem
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import Solution
from jaxnh.orbits.continuation.paths import NO_CONVERGENCE, START, Path, StepControl

_MOST = 400  # intervals of a mesh


class CycleBranch(NamedTuple):
    """A branch of cycles, point by point.

    Attributes:
        points: in their order.
        ends: why it ends where it begins, and at its end, numbers in `continuation.paths.ENDS`.
    """

    points: list[CyclePoint]
    ends: tuple[int, int]

    @property
    def value(self) -> Float[np.ndarray, " k"]:
        """Values of the parameter."""
        return np.array([point.value for point in self.points])


def follow_cycles(
    problem: Problem,
    start: CyclePoint,
    lift: Float[np.ndarray, " d"],
    ends: Ends,
    steps: StepControl,
    conditions: CycleConditions | None = None,
) -> CycleBranch:
    """The branch from a cycle in the direction of its point, to where it ends.

    Args:
        problem: the field, with one parameter, or with conditions more.
        start: the first point.
        lift: of the end of an orbit over its beginning.
        ends: of the ranges of the last parameters, the lower ones first.
        steps: how long steps are, and how many there may be.
        conditions: on cycles, beside what they are.
    """
    points = [start]
    equations = CollocationEquations(problem, start.solution, lift, ends, points, conditions)
    path = _path(equations, core.correct(equations, *equations.of_point(start), np.inf), steps)
    while True:
        end, n = _steps(path, equations, points), _intervals(points[-1])
        if end is not None and (end != NO_CONVERGENCE or 2 * n > _MOST):
            return CycleBranch(points, (START, end))
        finer = 2 * n <= _MOST and (end is not None or not points[-1].fine)
        new = equations.adapted(points[-1].solution, 2 * n if finer else n)
        now = core.correct(new, *new.of_point(points[-1]))
        if not now.converged[0]:
            return CycleBranch(points, (START, NO_CONVERGENCE))
        points[-1:] = new.points(now)
        if end is None:
            path.move(new, now, partial(equations.carried, others=new))
        else:
            path = _path(new, now, steps._replace(max_steps=max(steps.max_steps - len(points) + 1, 1)))
        equations = new


def _steps(path: Path, equations: CollocationEquations, points: list[CyclePoint]) -> int | None:
    """Follow a branch while its mesh suits it; why it ends, or None where another mesh is needed."""
    while points[-1].fine or 2 * _intervals(points[-1]) > _MOST:
        ended = path.step()
        met = path.met(0)
        if met:
            points += equations.points(path.track(0))
        if len(ended):
            return int(path.end[0])
        if met and not points[-1].even:
            return None
    return None


def _path(equations: CollocationEquations, first: Solution, steps: StepControl) -> Path:
    """The path from a point that is known."""
    path = Path(equations, first, steps)
    path.begin(np.zeros(1, int))
    path.track(0)
    return path


def _intervals(point: CyclePoint) -> int:
    return point.solution.path.stages.shape[1]
