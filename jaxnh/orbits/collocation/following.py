"""Branches of cycles over a parameter by pseudo-arclength, on meshes that are adapted on the way. Host code.

Each step goes along the direction of the branch and comes back to it by Newton, orthogonally (Keller, in Applications
of Bifurcation Theory, 1977, 359). Lengths are those of `equations.inner`: of the orbit in sizes of the motion, of the
logarithm of its duration, and of the parameter in the width of its range.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from jaxnh.orbits.collocation.cycles import closure, cycle_multipliers
from jaxnh.orbits.collocation.equations import (
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    combination,
    direction_without,
    fixed,
    inner,
    linearise,
    moved,
    phase_condition,
)
from jaxnh.orbits.collocation.newton import correct
from jaxnh.orbits.collocation.paths import PiecewisePath, adapted_mesh, interpolation_errors, on_mesh, values_at
from jaxnh.orbits.continuation.paths import (
    CLOSED,
    COLLAPSED,
    MOST_POINTS,
    NO_CONVERGENCE,
    RANGE,
    START,
    UNBOUNDED,
    StepControl,
)

_MOST = 400  # intervals of a mesh
_RESOLVED = 1e-4  # error of a multiplier, relative to it or absolute where it is small, at which meshes are fine enough
_SMOOTH = 1e-5  # error of polynomials within intervals, likewise
_UNEVEN, _EVEN_ENOUGH = 100.0, 0.1  # times the median error, and of the error above: a mesh is adapted beyond both
_COARSE = 1e-3  # of the largest step, below which the mesh is made finer
_BENT = 0.9  # cosine of the angle between directions at the ends of a step, at least
_MISSED = 0.3  # of a step that Newton goes back, at most
_WANTED = 0.1  # what steps are chosen for
_SMALLEST = 1e-7  # step
_GROWTH = 1.5  # of a step that went well
_FIRST = 0.1  # of the largest step
_FARTHEST = 1e3  # sizes of the motion
_LEAST_LOOP = 8  # points of a closed branch
_SAMPLED = 32  # points of an orbit that tell whether it has become one of half the duration


class CyclePoint(NamedTuple):
    """A point of a branch, one lane.

    Attributes:
        solution: the cycle.
        way: direction of the branch.
        multipliers, errors: Floquet multipliers, and how far the mesh is from resolving each, (e,).
        bends: errors of the polynomials in each interval, in sizes, (n,).
        residual: largest component of the equations, in sizes.
        step: length of the step that led to it.
    """

    solution: BoundarySolution
    way: Variation
    multipliers: Complex[np.ndarray, " e"]
    errors: Float[np.ndarray, " e"]
    bends: Float[np.ndarray, " n"]
    residual: float
    step: float = 0.0

    @property
    def resolved(self) -> bool:
        """Tell whether the multipliers are known well enough to see what changes along the branch."""
        return bool(np.all(self.errors <= _RESOLVED * np.maximum(1.0, np.abs(self.multipliers))))

    @property
    def fine(self) -> bool:
        """Tell whether its mesh is fine enough."""
        return self.resolved and bool(self.bends.max() <= _SMOOTH)

    @property
    def even(self) -> bool:
        """Tell whether errors are spread over its mesh evenly enough to stay on it."""
        return bool(self.bends.max() <= max(_UNEVEN * np.median(self.bends), _EVEN_ENOUGH * _SMOOTH))

    @property
    def value(self) -> float:
        """Value of the parameter."""
        return float(self.solution.values[0, 0])


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


def point_at(
    problem: Problem, solution: BoundarySolution, lift: Float[np.ndarray, " d"], along: Variation | None
) -> CyclePoint:
    """The point of a branch at a cycle, with the direction with a positive share of another one or the parameter."""
    line = linearise(problem, solution, closure(problem, lift[None])(solution, np.zeros(1, int)))
    phase = phase_condition(problem, line)
    way = direction_without(solution.path, line, [phase, phase])
    share = way.extra[:, 1] if along is None else inner(solution.path, way, along)
    way = combination([(np.where(share < 0.0, -1.0, 1.0), way)])
    values, errors = cycle_multipliers(problem, solution, line.blocks)
    bends = interpolation_errors(solution.path, problem.size)[0]
    return CyclePoint(solution, way, values[0], errors[0], bends, float(line.residual[0]))


def reversed_way(point: CyclePoint) -> CyclePoint:
    """The point on the way back."""
    return point._replace(way=Variation(*(-leaf for leaf in point.way)))


def follow_cycles(
    problem: Problem,
    begun: CyclePoint,
    lift: Float[np.ndarray, " d"],
    ends: tuple[float, float],
    steps: StepControl,
    begin: int = START,
) -> CycleBranch:
    """The branch from a cycle in the direction of its point, to where it ends.

    Args:
        problem: the field, with one parameter.
        begun: the first point.
        lift: of the end of an orbit over its beginning.
        ends: of the range of the parameter, the lower one first.
        steps: how long steps are, and how many there may be.
        begin: why the branch begins there.
    """
    points, size = [begun], _FIRST * steps.ds_max
    while len(points) <= steps.max_steps:
        now = points[-1]
        if now.value in ends and (now.value == ends[0]) == (now.way.extra[0, 1] < 0.0):
            return CycleBranch(points, (begin, RANGE))
        n = now.solution.path.stages.shape[1]
        taken, missed = step_along(problem, now, lift, size, ends)
        if taken is None or missed > _MISSED:
            size *= 0.5
            if size < _COARSE * steps.ds_max and 2 * n <= _MOST:
                points[-1], size = remeshed_point(problem, now, 2 * n), _FIRST * steps.ds_max
            elif size < _SMALLEST:
                return CycleBranch(points, (begin, NO_CONVERGENCE))
            continue
        if not taken.fine and 2 * n <= _MOST:
            points[-1] = remeshed_point(problem, now, 2 * n)
            continue
        if (end := _end(problem, points, taken, size)) != COLLAPSED:
            points.append(taken)
        if end is not None:
            return CycleBranch(points, (begin, end))
        size = min(size * min(_GROWTH, max(0.5, _WANTED / max(missed, _SMALLEST))), steps.ds_max)
    return CycleBranch(points, (begin, MOST_POINTS))


def step_along(
    problem: Problem, now: CyclePoint, lift: Float[np.ndarray, " d"], size: float, ends: tuple[float, float]
) -> tuple[CyclePoint | None, float]:
    """The point a step further, or at the end of the range, or None; and how far Newton went, of the step."""
    if not now.even:
        now = _on_even_mesh(problem, now, lift)
    guess = moved(problem, now.solution, combination([(size, now.way)]))
    at_end = not ends[0] < float(guess.values[0, 0]) < ends[1]
    if at_end:
        edge = ends[0] if guess.values[0, 0] <= ends[0] else ends[1]
        rate = float(now.way.extra[0, 1]) * problem.widths[0]
        size = max((edge - now.value) / rate, 0.0)
        guess = moved(problem, now.solution, combination([(size, now.way)]))
        guess.values[0, 0] = edge

    def hold(line: NewtonSystem, lanes: Int[np.ndarray, " lanes"]) -> Sequence[Variation]:
        return [fixed(line, 0) if at_end else now.way]

    corrected = correct(problem, guess, closure(problem, lift[None]), hold)
    if not corrected.converged[0]:
        return None, np.inf
    solution = corrected.solution._replace(values=guess.values) if at_end else corrected.solution
    missed = difference(problem, solution, guess)
    try:
        taken = point_at(problem, solution, lift, now.way)
    except np.linalg.LinAlgError:
        return None, np.inf
    if inner(guess.path, taken.way, now.way)[0] < _BENT:
        return None, np.inf
    far = np.sqrt(inner(guess.path, missed, missed)[0])
    return taken._replace(step=size), float(far / max(size, _SMALLEST))


def _on_even_mesh(problem: Problem, point: CyclePoint, lift: Float[np.ndarray, " d"]) -> CyclePoint:
    """The point on a mesh adapted to it, the point as it is where Newton does not come back."""
    again = remeshed_point(problem, point, point.solution.path.stages.shape[1])
    corrected = correct(problem, again.solution, closure(problem, lift[None]), lambda line, lanes: [again.way])
    return again._replace(solution=corrected.solution) if corrected.converged[0] else point


def difference(problem: Problem, one: BoundarySolution, other: BoundarySolution) -> Variation:
    """The variation from another solution on the same mesh to one."""
    ends, stages = ((a - b) / problem.size for a, b in zip(one.path[1:], other.path[1:], strict=True))
    extra = [np.log(one.duration / other.duration)[:, None], (one.values - other.values) / problem.widths]
    return Variation(ends, stages, np.concatenate(extra, axis=1))


def remeshed_point(problem: Problem, point: CyclePoint, n: int) -> CyclePoint:
    """The point with its direction on a mesh of n intervals adapted to it."""
    mesh = adapted_mesh(point.solution.path, problem.size, n)
    path = on_mesh(point.solution.path, mesh)
    way = on_mesh(PiecewisePath(point.solution.path.mesh, *point.way[:2]), mesh)
    variation = Variation(way.ends, way.stages, point.way.extra)
    return point._replace(solution=point.solution._replace(path=path), way=variation)


def _end(problem: Problem, points: Sequence[CyclePoint], taken: CyclePoint, size: float) -> int | None:
    """Return why a branch ends with a step, or None."""
    if np.abs(taken.solution.path.ends / problem.size).max() > _FARTHEST:
        return UNBOUNDED
    if _collapses(problem, points[-1].solution, taken.solution):
        return COLLAPSED
    if len(points) > _LEAST_LOOP:
        begun, before, after = (invariants(problem, p.solution) for p in (points[0], points[-1], taken))
        first = invariants(problem, points[1].solution) - begun
        if (before - begun) @ first < 0.0 <= (after - begun) @ first and np.linalg.norm(after - begun) <= 2.0 * size:
            return CLOSED
    return None


def _collapses(problem: Problem, now: BoundarySolution, taken: BoundarySolution) -> bool:
    """Return whether a cycle has on the way become one of half its duration, or an equilibrium.

    Beyond that the branch has the same cycles again, half a turn on.
    """
    grid = np.arange(_SAMPLED)[None] / _SAMPLED
    gaps = []
    for solution in (now, taken):
        states = values_at(solution.path, grid)[0] / problem.size
        gaps.append(states - np.roll(states, _SAMPLED // 2, 0))
    return float(np.sum(gaps[0] * gaps[1])) <= 0.0


def invariants(problem: Problem, solution: BoundarySolution) -> Float[np.ndarray, " k"]:
    """Numbers that tell cycles apart, whatever point comes first: parameters, duration, and moments of states."""
    path, weights = solution.path, solution.path.measure[0, ..., None]
    states = path.stages[0] / problem.size
    means = np.sum(weights * states, axis=(0, 1))
    spreads = np.sqrt(np.sum(weights * (states - means) ** 2, axis=(0, 1)))
    skew = np.sum(weights * (states - means) ** 3, axis=(0, 1))
    return np.concatenate([solution.values[0] / problem.widths, np.log(solution.duration), means, spreads, skew])
