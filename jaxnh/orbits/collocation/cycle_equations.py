"""Cycles on one mesh as equations of the core of continuation, and points of their branches. Host code.

Lengths are those of `equations.inner`: of the orbit in sizes of the motion, of the logarithm of its duration, and of
the parameters in the widths of their ranges. With conditions on cycles there is a parameter more for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Complex, Float

from jaxnh.orbits.collocation.cycles import closure
from jaxnh.orbits.collocation.equations import (
    BoundarySolution,
    Functional,
    NewtonSystem,
    PointCondition,
    Problem,
    Variation,
    bordered_sign,
    combination,
    direction_of,
    inner,
    linearise,
    phase_condition,
    step_of,
)
from jaxnh.orbits.collocation.floquet import cycle_multipliers
from jaxnh.orbits.collocation.paths import PiecewisePath, adapted_mesh, interpolation_errors, on_mesh, values_at
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import EquationsOfPaths, Evaluation, LinearSolution, Solution
from jaxnh.orbits.continuation.paths import CLOSED, COLLAPSED, INFINITE_PERIOD, UNBOUNDED
from jaxnh.systems.rows import select

_RESOLVED = 1e-4  # error of a multiplier, relative to it or absolute where it is small, at which meshes are fine enough
_SMOOTH = 1e-5  # error of polynomials within intervals, likewise
_UNEVEN, _EVEN_ENOUGH = 100.0, 0.1  # times the median error, and of the error above: a mesh is adapted beyond both
_FARTHEST = 1e3  # sizes of the motion
_LEAST_LOOP = 8  # points of a closed branch
_STILL = 1e-10  # of the extent a duration: the least speed of a cycle that has come to an equilibrium


Ends = tuple[float, float] | tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]
"""Ends of the range of a parameter, or of the ranges of k, the lower ones first."""


class CyclePoint(NamedTuple):
    """A point of a branch, one lane.

    Attributes:
        solution: the cycle.
        way: direction of the branch.
        multipliers, errors: Floquet multipliers, not numbers where they are not known, and how far the mesh is from
            resolving each, (e,).
        bends: errors of the polynomials in each interval, in sizes, (n,).
        residual: largest component of the equations, in sizes.
    """

    solution: BoundarySolution
    way: Variation
    multipliers: Complex[np.ndarray, " e"]
    errors: Float[np.ndarray, " e"]
    bends: Float[np.ndarray, " n"]
    residual: float

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


class CycleConditions(Protocol):
    """Conditions on cycles, as many as make a curve of those over all parameters.

    Attributes:
        begins: whether they say where cycles begin, or with a clock how long they take; else that is the integral
            phase condition.
    """

    begins: bool

    def at(self, solution: BoundarySolution, /) -> Sequence[PointCondition]:
        """The conditions, linearised at cycles."""
        ...

    def endings(self, solution: BoundarySolution, /) -> Mapping[int, Bool[np.ndarray, " lanes"]]:
        """Cycles beyond the end of a curve, by number in `paths.ENDS`."""
        ...

    def nodes(self, solution: BoundarySolution, /) -> Float[np.ndarray, " k"]:
        """Shares of the duration after the first state, of one lane, whose states the conditions are on too."""
        ...


class CollocationEquations(EquationsOfPaths):
    """Cycles on one mesh as `core.CurveEquations`: states, the logarithm of the duration, and the parameters.

    Orbits are not shifted along themselves against one of them, which is the integral phase condition: without a fixed
    reference the shifts of points would grow from one prediction through them to the next. States at the ends of
    intervals follow from those inside, and count in no length.

    Args:
        problem: the field, with one parameter, or with conditions more.
        near: the cycle that is the reference, one lane, on the mesh.
        lift: of the end of an orbit over its beginning.
        ends: of the ranges of the last parameters, the lower ones first; by default there are none.
        passed: points of the branch so far, the first of which tell where it closes.
        conditions: on cycles, beside what they are.
    """

    def __init__(
        self,
        problem: Problem,
        near: BoundarySolution,
        lift: Float[np.ndarray, " d"],
        ends: Ends = (-np.inf, np.inf),
        passed: Sequence[CyclePoint] = (),
        conditions: CycleConditions | None = None,
    ) -> None:
        path, self._extra, self._conditions = near.path, 1 + len(problem.widths), conditions
        self._problem, self._mesh, self._lift, self._range, self._passed = problem, path.mesh, lift, ends, passed
        self._ends, self._stages = path.ends.shape[1:], path.stages.shape[1:]
        inside = (problem.size / np.sqrt(path.measure[..., None])).ravel()
        self.unit = np.concatenate([np.full(path.ends.size, np.inf), inside, [1.0], problem.widths])
        self.low, self.high = np.atleast_1d(ends[0]), np.atleast_1d(ends[1])
        self._near, self._shift = self.unknowns(near), phase_condition(problem, self._linear(near))

    def unknowns(self, solution: BoundarySolution) -> Float[np.ndarray, "lanes N"]:
        """Unknowns of cycles on this mesh."""
        path, lanes = solution.path, len(solution.duration)
        states = (path.ends.reshape(lanes, -1), path.stages.reshape(lanes, -1))
        return np.concatenate([*states, np.log(solution.duration)[:, None], solution.values], axis=1)

    def solution(self, z: Float[np.ndarray, "lanes N"]) -> BoundarySolution:
        """Cycles of unknowns."""
        ends, stages = self._states(z)
        mesh = np.broadcast_to(self._mesh, (len(z), self._mesh.shape[1]))
        extra = z[:, -self._extra :]
        return BoundarySolution(PiecewisePath(mesh, ends, stages), np.exp(extra[:, 0]), extra[:, 1:])

    def direction(self, way: Variation) -> Float[np.ndarray, "lanes N"]:
        """A direction of cycles as one of unknowns."""
        size, lanes = self._problem.size, len(way.extra)
        states = ((way.ends * size).reshape(lanes, -1), (way.stages * size).reshape(lanes, -1))
        return np.concatenate([*states, way.extra[:, :1], way.extra[:, 1:] * self._problem.widths], axis=1)

    def variation(self, z: Float[np.ndarray, "lanes N"]) -> Variation:
        """A direction of unknowns as one of cycles."""
        ends, stages = self._states(z)
        extra = z[:, -self._extra :] / np.append(1.0, self._problem.widths)
        return Variation(ends / self._problem.size, stages / self._problem.size, extra)

    def adapted(self, near: BoundarySolution, n: int) -> CollocationEquations:
        """The equations near a cycle on a mesh of n intervals that suits it."""
        path = on_mesh(near.path, adapted_mesh(near.path, self._problem.size, n))
        near = near._replace(path=path)
        return CollocationEquations(self._problem, near, self._lift, self._range, self._passed, self._conditions)

    def carried(self, z: Float[np.ndarray, "lanes N"], others: CollocationEquations) -> Float[np.ndarray, "lanes M"]:
        """Unknowns or directions as those on the mesh of other equations."""
        mesh, other = (np.broadcast_to(mesh_of, (len(z), mesh_of.shape[1])) for mesh_of in (self._mesh, others._mesh))
        path = on_mesh(PiecewisePath(mesh, *self._states(z)), other)
        states = (path.ends.reshape(len(z), -1), path.stages.reshape(len(z), -1))
        return np.concatenate([*states, z[:, -self._extra :]], axis=1)

    def of_point(self, point: CyclePoint) -> tuple[Float[np.ndarray, "1 N"], Float[np.ndarray, "1 N"]]:
        """Unknowns of a point on any mesh, and its direction."""
        path, way = point.solution.path, point.way
        if path.mesh is not self._mesh:
            moved = on_mesh(PiecewisePath(path.mesh, way.ends, way.stages), self._mesh)
            path, way = on_mesh(path, self._mesh), Variation(moved.ends, moved.stages, way.extra)
        return self.unknowns(point.solution._replace(path=path)), self.direction(way)

    def points(self, orbits: Solution) -> list[CyclePoint]:
        """Points of the branch with their multipliers, from solutions."""
        solution, way = self.solution(orbits.z), self.variation(orbits.way)
        lanes, (n, m, d) = len(orbits.z), self._stages
        blocks, divergence = np.split(orbits.blocks[:, :-1], [n * d * d], axis=1)
        blocks, divergence = blocks.reshape(lanes, n, d, d), divergence.reshape(lanes, n, m)
        values, errors = cycle_multipliers(self._problem, solution, blocks, divergence)
        bends = interpolation_errors(solution.path, self._problem.size)
        return [
            CyclePoint(
                select(solution, [k]), select(way, [k]), values[k], errors[k], bends[k], float(orbits.residual[k])
            )
            for k in range(len(values))
        ]

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """Residuals; and what Newton's equations have as solutions; not finite where they are singular."""
        lanes, solution = len(z), self.solution(z)
        try:
            line = self._linear(solution)
            rows, gone = self._rows(solution, z)
            way = direction_of(solution.path, line, rows)
            rows = [*rows, partial(inner, solution.path, way)]
            step = step_of(line, rows, np.stack([*gone, 0.0 * gone[0]], axis=1))
        except np.linalg.LinAlgError:
            n, m, d = self._stages
            count = n * d * d + n * m + 1
            shapes = ((1 + len(self._problem.widths),), (count,), (3, z.shape[1]))
            return Evaluation(*(np.full((lanes, *shape), np.nan) for shape in shapes))
        slowest = np.linalg.norm(line.rate, axis=3).min(axis=(1, 2))
        kept = [line.blocks.reshape(lanes, -1), line.divergence.reshape(lanes, -1), slowest[:, None]]
        sign = np.broadcast_to(bordered_sign(line, rows)[:, None], z.shape)
        slopes = np.stack([self.direction(step), self.direction(way), sign], axis=1)
        return Evaluation(np.stack([line.residual, *gone], axis=1), np.concatenate(kept, axis=1), slopes)

    def solve(self, at: Evaluation, /) -> LinearSolution:
        """The step and the direction, with the sign of the bordered determinant."""
        return super().solve(at)._replace(determinant=at.slopes[:, 2, 0])

    def _rows(
        self, solution: BoundarySolution, z: Float[np.ndarray, "lanes N"]
    ) -> tuple[list[Functional], list[Float[np.ndarray, " lanes"]]]:
        """Functionals that conditions are, of length one, and how far cycles are from each."""
        lanes, conditions = len(z), self._conditions
        rows, gone = list[Functional](), list[np.ndarray]()
        if conditions is None or not conditions.begins:
            size = np.sqrt(inner(solution.path, self._shift, self._shift))
            phase = Variation(*(np.repeat(leaf / size, lanes, axis=0) for leaf in self._shift))
            rows.append(partial(inner, solution.path, phase))
            gone.append(rows[0](self.variation(z - self._near)))
        for condition in () if conditions is None else conditions.at(solution):
            scaled = condition.scaled()
            rows.append(scaled.change)
            gone.append(scaled.missing)
        return rows, gone

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterable[Float[np.ndarray, "lanes N"]]:
        """None: the first point of a cycle is anywhere on it, and `invariants` tell where a branch closes."""
        return ()

    def endings(self, now: Solution, taken: Solution, /) -> tuple[Mapping[int, np.ndarray], Bool[np.ndarray, " lanes"]]:
        """Cycles that have become ones of half the duration or equilibria, rest at one, are far or close the branch."""
        before, after = self.solution(now.z), self.solution(taken.z)
        with np.errstate(invalid="ignore"):
            far = np.abs(after.path.ends / self._problem.size).max(axis=(1, 2)) > _FARTHEST
            collapsed = _collapses(self._problem, before, after)
            closed = self._closes(before, after, core.norm(self.unit, taken.z - now.z))
            extent = np.linalg.norm(np.ptp(after.path.ends, axis=1) / self._problem.size, axis=1)
            rests = (taken.blocks[:, -1] <= _STILL * extent) & (not self._problem.clock)
        endings = {COLLAPSED: collapsed, CLOSED: closed, UNBOUNDED: far, INFINITE_PERIOD: rests}
        beyond = {} if self._conditions is None else self._conditions.endings(after)
        return {**endings, **beyond}, np.any([collapsed, *beyond.values()], axis=0)

    def _linear(self, solution: BoundarySolution) -> NewtonSystem:
        lanes = len(solution.duration)
        boundary = closure(self._problem, np.broadcast_to(self._lift, (lanes, len(self._lift))))
        return linearise(self._problem, solution, boundary(solution, np.arange(lanes)))

    def _closes(
        self, before: BoundarySolution, after: BoundarySolution, step: Float[np.ndarray, " lanes"]
    ) -> Bool[np.ndarray, " lanes"]:
        """Return whether steps pass the first point."""
        if len(self._passed) <= _LEAST_LOOP:
            return np.zeros(len(step), bool)
        first, second = (invariants(self._problem, point.solution)[0] for point in self._passed[:2])
        gone, come = (invariants(self._problem, part) - first for part in (before, after))
        passes = (gone @ (second - first) < 0.0) & (come @ (second - first) >= 0.0)
        return passes & (np.linalg.norm(come, axis=1) <= 2.0 * step)

    def _states(self, z: Float[np.ndarray, "lanes N"]) -> tuple[np.ndarray, np.ndarray]:
        count = self._ends[0] * self._ends[1]
        return z[:, :count].reshape(-1, *self._ends), z[:, count : -self._extra].reshape(-1, *self._stages)


def point_at(
    problem: Problem, solution: BoundarySolution, lift: Float[np.ndarray, " d"], along: Variation | None
) -> CyclePoint:
    """The point of a branch at a cycle, with the direction with a positive share of another one or the parameter."""
    equations = CollocationEquations(problem, solution, lift)
    corrected = core.correct(equations, equations.unknowns(solution), tolerance=np.inf)
    [point] = equations.points(corrected)
    share = point.way.extra[:, 1] if along is None else inner(solution.path, point.way, along)
    return reversed_way(point) if share[0] < 0.0 else point


def reversed_way(point: CyclePoint) -> CyclePoint:
    """The point on the way back."""
    return point._replace(way=combination([(-1.0, point.way)]))


def remeshed_point(problem: Problem, point: CyclePoint, n: int) -> CyclePoint:
    """The point with its direction on a mesh of n intervals adapted to it."""
    mesh = adapted_mesh(point.solution.path, problem.size, n)
    path = on_mesh(point.solution.path, mesh)
    way = on_mesh(PiecewisePath(point.solution.path.mesh, *point.way[:2]), mesh)
    variation = Variation(way.ends, way.stages, point.way.extra)
    return point._replace(solution=point.solution._replace(path=path), way=variation)


def invariants(problem: Problem, solution: BoundarySolution) -> Float[np.ndarray, "lanes k"]:
    """Numbers that tell cycles apart, whatever point comes first: parameters, duration, and moments of states."""
    path, weights = solution.path, solution.path.measure[..., None]
    states = path.stages / problem.size
    means = np.sum(weights * states, axis=(1, 2))
    gaps = states - means[:, None, None]
    spreads = np.sqrt(np.sum(weights * gaps**2, axis=(1, 2)))
    skew = np.sum(weights * gaps**3, axis=(1, 2))
    extra = [solution.values / problem.widths, np.log(solution.duration)[:, None]]
    return np.concatenate([*extra, means, spreads, skew], axis=1)


def _collapses(problem: Problem, now: BoundarySolution, taken: BoundarySolution) -> Bool[np.ndarray, " lanes"]:
    """Return whether cycles have on the way become ones of half their duration, or equilibria.

    Beyond that the branch has the same cycles again, half a turn on. States are those at the ends of intervals, which
    are close where cycles move, however short a part of the duration that is.
    """
    gaps = []
    for path in (now.path, taken.path):
        gaps.append((path.ends[:, :-1] - values_at(path, (path.mesh[:, :-1] + 0.5) % 1.0)) / problem.size)
    return np.sum(gaps[0] * gaps[1], axis=(1, 2)) <= 0.0
