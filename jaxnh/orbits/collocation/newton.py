"""Newton on collocation equations of many lanes at once, and the choice of their meshes. Host code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.orbits.collocation.equations import (
    BoundaryConditions,
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    inner,
    linearise,
    moved,
    phase_condition,
    step_of,
)
from jaxnh.orbits.collocation.paths import adapted_mesh, on_mesh
from jaxnh.systems.rows import concatenate, select, write_rows

_STEPS = 40
_QUADRATIC = 1e-6  # step, in sizes, after which one more reaches the rounding floor
_LARGEST = 0.5  # step, likewise
_STALLED = 4  # steps that may be longer than the one before, all together
_REMESHINGS = 3

BoundaryOf = Callable[[BoundarySolution, Int[np.ndarray, " lanes"]], BoundaryConditions]
"""Boundary conditions at solutions of lanes with these numbers."""

Hold = Callable[[NewtonSystem, Int[np.ndarray, " lanes"]], Sequence[Variation]]
"""Directions, one a parameter, to which steps of lanes with these numbers are orthogonal."""


class NewtonSolution(NamedTuple):
    """Solutions that Newton has come to.

    Attributes:
        solution: path, duration and parameters of each lane.
        converged: whether Newton has come to rest, (lanes,).
        rounding: largest component of the last step, which is what rounding leaves, in sizes, (lanes,).
        extra_rounding: the same of the logarithm of the duration and of the parameters, in widths, (lanes, 1 + q).
        residual: largest component of the equations, in sizes, (lanes,).
    """

    solution: BoundarySolution
    converged: Bool[np.ndarray, " lanes"]
    rounding: Float[np.ndarray, " lanes"]
    extra_rounding: Float[np.ndarray, "lanes 1+q"]
    residual: Float[np.ndarray, " lanes"]


def correct(problem: Problem, guess: BoundarySolution, boundary: BoundaryOf, hold: Hold) -> NewtonSolution:
    """The solutions near guesses.

    Each step has no share of the shift along the orbit, which is the integral phase condition with the iterate before
    as reference. Long steps are shortened. A lane is given up where steps grow again and again.

    Args:
        problem: the field.
        guess: where to begin.
        boundary: the boundary conditions.
        hold: what else steps have no share of.
    """
    solution = jax.tree.map(np.array, guess)
    lanes = len(solution.duration)
    last, stalled, extra = (
        np.full(lanes, np.inf),
        np.zeros(lanes, int),
        np.full((lanes, 1 + len(problem.widths)), np.inf),
    )
    converged, residual, open_ = np.zeros(lanes, bool), np.full(lanes, np.nan), np.arange(lanes)
    for _ in range(_STEPS):
        part = select(solution, open_)
        try:
            line = linearise(problem, part, boundary(part, open_))
            directions = [phase_condition(problem, line), *hold(line, open_)]
            step = step_of(line, [partial(inner, part.path, direction) for direction in directions])
        except np.linalg.LinAlgError:
            if lanes == 1:
                break
            return _lane_by_lane(problem, guess, boundary, hold)
        length = np.maximum(np.abs(step.stages).max(axis=(1, 2, 3)), np.abs(step.extra).max(axis=1))
        residual[open_] = line.residual
        stalled[open_] += length > last[open_]
        good = np.isfinite(length) & (stalled[open_] <= _STALLED)
        factor = np.where(length > _LARGEST, _LARGEST / length, 1.0)
        step = Variation(*(factor.reshape(-1, *[1] * (leaf.ndim - 1)) * leaf for leaf in step))
        write_rows(solution, open_[good], select(moved(problem, part, step), good))
        at_rest = last[open_] <= _QUADRATIC
        converged[open_] = good & at_rest
        last[open_[good]], extra[open_[good]] = length[good], np.abs(step.extra[good])
        open_ = open_[good & ~at_rest]
        if not len(open_):
            break
    return NewtonSolution(solution, converged, last, extra, residual)


def _lane_by_lane(problem: Problem, guess: BoundarySolution, boundary: BoundaryOf, hold: Hold) -> NewtonSolution:
    """Solve lane by lane, where the equations of one lane are singular."""

    def one(lane: int) -> NewtonSolution:
        return correct(problem, select(guess, [lane]), *_of_lanes(boundary, hold, np.array([lane])))

    return concatenate(map(one, range(len(guess.duration))))


def _of_lanes(boundary: BoundaryOf, hold: Hold, lanes: Int[np.ndarray, " some"]) -> tuple[BoundaryOf, Hold]:
    """The conditions of a subset of lanes, which are numbered anew."""

    def own_boundary(solution: BoundarySolution, numbers: Int[np.ndarray, " lanes"]) -> BoundaryConditions:
        return boundary(solution, lanes[numbers])

    def own_hold(line: NewtonSystem, numbers: Int[np.ndarray, " lanes"]) -> Sequence[Variation]:
        return hold(line, lanes[numbers])

    return own_boundary, own_hold


def remeshed(
    problem: Problem, solution: BoundarySolution, n: int | None = None, *, cyclic: bool = True
) -> BoundarySolution:
    """The solutions on meshes adapted to them, of n intervals or as many as there are."""
    mesh = adapted_mesh(solution.path, problem.size, n, cyclic=cyclic)
    return solution._replace(path=on_mesh(solution.path, mesh))


def on_adapted_mesh(
    problem: Problem, guess: BoundarySolution, boundary: BoundaryOf, hold: Hold, n: int, *, cyclic: bool = True
) -> NewtonSolution:
    """The solutions near guesses on meshes of n intervals, adapted to them a few times."""
    if guess.path.stages.shape[1] != n:
        guess = remeshed(problem, guess, n, cyclic=cyclic)
    corrected = correct(problem, guess, boundary, hold)
    for _ in range(_REMESHINGS):
        lanes = np.flatnonzero(corrected.converged)
        if not len(lanes):
            break
        on_new = remeshed(problem, select(corrected.solution, lanes), cyclic=cyclic)
        again = correct(problem, on_new, *_of_lanes(boundary, hold, lanes))
        write_rows(corrected, lanes[again.converged], select(again, again.converged))
    return corrected
