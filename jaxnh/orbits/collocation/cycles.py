"""Cycles of flows, with a clock and without one: orbits, durations and multipliers, each with its error. Host code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxnh.orbits.collocation.equations import (
    BoundaryConditions,
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    fixed,
    linearise,
)
from jaxnh.orbits.collocation.floquet import cycle_multipliers
from jaxnh.orbits.collocation.newton import BoundaryOf, correct, on_adapted_mesh
from jaxnh.orbits.collocation.paths import halved, on_mesh
from jaxnh.systems.rows import select, write_rows

_MOST = 6400  # intervals of a mesh
_OF_MULTIPLIERS = 100.0
_FLOOR = 4 * np.finfo(float).eps


class CycleSolution(NamedTuple):
    """Cycles, a lane each.

    Attributes:
        solution: orbits, with durations.
        multipliers: Floquet multipliers, without the one along the flow if there is no clock, not numbers where the
            mesh does not tell them, (lanes, e).
        error: of states at the ends of intervals, in sizes, (lanes,).
        duration_error: of the duration, (lanes,).
        multiplier_error: of each multiplier, (lanes, e).
        residual: largest component of the equations, in sizes, (lanes,).
        converged: whether Newton has come to rest, (lanes,).
    """

    solution: BoundarySolution
    multipliers: Complex[np.ndarray, "lanes e"]
    error: Float[np.ndarray, " lanes"]
    duration_error: Float[np.ndarray, " lanes"]
    multiplier_error: Float[np.ndarray, "lanes e"]
    residual: Float[np.ndarray, " lanes"]
    converged: Bool[np.ndarray, " lanes"]


def closure(problem: Problem, lift: Float[np.ndarray, "lanes d"]) -> BoundaryOf:
    """The condition that a path ends where it begins, or angles whole turns further.

    Args:
        problem: whose sizes are the units.
        lift: of the end over the beginning.
    """

    def boundary(solution: BoundarySolution, lanes: Int[np.ndarray, " lanes"]) -> BoundaryConditions:
        ends = solution.path.ends
        d = ends.shape[2]
        identity = np.broadcast_to(np.eye(d), (len(lanes), d, d))
        extra = np.zeros((len(lanes), d, 1 + solution.values.shape[1]))
        return BoundaryConditions(-identity, identity, extra, (ends[:, 0] + lift[lanes] - ends[:, -1]) / problem.size)

    return boundary


def hold_parameters(line: NewtonSystem, lanes: Int[np.ndarray, " lanes"]) -> Sequence[Variation]:
    """The directions of all parameters, which are then known."""
    return [fixed(line, number) for number in range(line.particular.extra.shape[1] - 1)]


def solve_cycles(
    problem: Problem,
    guess: BoundarySolution,
    tolerance: float,
    lift: Float[np.ndarray, "lanes d"] | None = None,
    most: int = _MOST,
) -> list[CycleSolution]:
    """The cycles near guesses at the parameters of these, one a lane, on meshes as fine as an error needs.

    Errors are differences of two solutions, one on the halves of the other's intervals: that of the finer one, which
    is given, is less by a factor 2^(2m) once meshes are fine (de Boor and Swartz, SIAM J. Numer. Anal. 10 (1973) 582).

    Args:
        problem: the field.
        guess: paths, durations (of a flow with a clock the known ones) and parameters.
        tolerance: error, in sizes of the motion and relative to the duration, at which meshes are fine enough; that of
            multipliers, relative to those above one, may be a hundred times as large.
        lift: of the end over the beginning, for angles that turn.
        most: intervals of the finer mesh.
    """
    lanes = len(guess.duration)
    lift = np.zeros((lanes, guess.path.ends.shape[2])) if lift is None else lift
    cycles, open_, guess = dict[int, CycleSolution](), np.arange(lanes), jax.tree.map(np.array, guess)
    while len(open_):
        n = guess.path.stages.shape[1]
        part, coarse = _on_two_meshes(problem, guess, closure(problem, lift[open_]), n)
        shares = part.multiplier_error / np.maximum(1.0, np.abs(part.multipliers))
        errors = [part.error, part.duration_error / guess.duration, shares.max(axis=1, initial=0.0) / _OF_MULTIPLIERS]
        good = part.converged & (np.max(errors, axis=0) <= tolerance)
        again = ~good & (4 * n <= most)
        for k in np.flatnonzero(~again).tolist():
            cycles[int(open_[k])] = select(part, slice(k, k + 1))
        write_rows(guess, np.flatnonzero(part.converged), select(coarse, part.converged))
        guess, open_ = select(guess, again), open_[again]
        guess = guess._replace(path=on_mesh(guess.path, halved(guess.path.mesh)))
    return [cycles[lane] for lane in range(lanes)]


def _on_two_meshes(
    problem: Problem, guess: BoundarySolution, boundary: BoundaryOf, n: int
) -> tuple[CycleSolution, BoundarySolution]:
    """The cycles on the halves of the intervals of adapted meshes, and those on the whole, which tell errors."""
    coarse = on_adapted_mesh(problem, guess, boundary, hold_parameters, n)
    path = coarse.solution.path
    halves = coarse.solution._replace(path=on_mesh(path, halved(path.mesh)))
    fine = correct(problem, halves, boundary, hold_parameters)
    (values, missing), (before, _) = (_multipliers(problem, part.solution, boundary) for part in (fine, coarse))
    apart = np.abs(fine.solution.path.ends[:, ::2] - path.ends).max(axis=1) / problem.size
    shift = np.abs(fine.solution.duration - coarse.solution.duration)
    rounding = fine.rounding + _FLOOR
    missing = missing + np.abs(values - before) + rounding[:, None] * np.abs(values)
    cycles = CycleSolution(
        fine.solution,
        values,
        apart.max(axis=1) + rounding,
        shift + (fine.extra_rounding[:, 0] + _FLOOR) * fine.solution.duration,
        missing,
        fine.residual,
        coarse.converged & fine.converged,
    )
    return cycles, coarse.solution


def _multipliers(problem: Problem, solution: BoundarySolution, boundary: BoundaryOf) -> tuple[np.ndarray, np.ndarray]:
    """`cycle_multipliers` of solutions; not a number where these are not finite."""
    lanes, e = len(solution.duration), solution.path.ends.shape[2] - (not problem.clock)
    values, errors = np.full((lanes, e), np.nan, complex), np.full((lanes, e), np.inf)
    finite = np.flatnonzero(np.isfinite(solution.path.stages).all(axis=(1, 2, 3)) & np.isfinite(solution.duration))
    if len(finite):
        part = select(solution, finite)
        line = linearise(problem, part, boundary(part, finite))
        values[finite], errors[finite] = cycle_multipliers(problem, part, line.blocks, line.divergence)
    return values, errors
