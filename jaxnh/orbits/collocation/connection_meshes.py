"""Meshes and durations of connecting orbits, and the errors of their parameters. Host code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.exceptions import InputError
from jaxnh.orbits.collocation.adjoint import AdjointSolution, adjoint_solution
from jaxnh.orbits.collocation.equations import (
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    direction_without,
    fixed,
    orthonormal,
    phase_condition,
)
from jaxnh.orbits.collocation.homoclinic import SaddlePoint, projections, saddle_at, with_ends
from jaxnh.orbits.collocation.newton import correct, remeshed
from jaxnh.orbits.collocation.paths import DEGREE, halved, on_mesh

MOST_INTERVALS = 480
"""Most intervals of a mesh."""

_NEAR = 1e-5  # sizes: distance of the ends from their saddles, whose square is what projections leave
_RESOLVED = 1e-8  # widths: error of parameters, beyond which a mesh is made finer
_LONGER = 1.5  # duration, by which what the ends cut off is told
_HALVED = 1 / (2**DEGREE - 1)  # error on halves of the intervals, of what they change; between ends, at least
_ROUNDINGS = 2 * DEGREE  # of the state, in an interval


class Connection(NamedTuple):
    """An orbit from a saddle to a saddle, one lane.

    Attributes:
        solution: the path, which begins and ends near them, and both parameters.
        departure, arrival: the saddles; the same for a homoclinic orbit.
        residual: largest component of the equations, in sizes.
    """

    solution: BoundarySolution
    departure: SaddlePoint
    arrival: SaddlePoint
    residual: float = np.nan

    @property
    def values(self) -> Float[np.ndarray, " 2"]:
        """Both parameters."""
        return self.solution.values[0]


class RefinedConnection(NamedTuple):
    """An orbit with longer rests on half of the intervals.

    Attributes:
        orbit: the orbit.
        error: of both parameters, (2,).
        longer: time by which each rest is longer.
    """

    orbit: Connection
    error: Float[np.ndarray, " 2"]
    longer: float


def refined(problem: Problem, point: Connection) -> RefinedConnection | None:
    """The orbit with longer rests on half of the intervals, across the curve, and the error of both parameters.

    What the ends cut off goes by the squares of their distances from the saddles, what the mesh leaves by a power of
    the intervals' lengths. Rounding moves parameters by its share in the adjoint solution. None where Newton does not
    confirm the orbit.
    """
    try:
        more = 0.5 * (_LONGER - 1.0) * point.solution.duration[0]
        saddles = point.departure, point.arrival
        longer = across_curve(problem, point, with_ends(problem, point.solution, *saddles, (more, more)))
        finer = None if longer is None else _on_halves(problem, longer)
        if longer is None or finer is None:
            return None
        adjoint = adjoint_solution(problem, finer.solution, finer.departure, finer.arrival)
    except (InputError, np.linalg.LinAlgError):
        return None
    nearer = (_away(problem, longer) / _away(problem, point)).max() ** 2
    error = _HALVED * np.abs(finer.values - longer.values) + nearer * np.abs(longer.values - point.values)
    return RefinedConnection(finer, error + _rounding(problem, finer, adjoint), float(more))


def _rounding(problem: Problem, orbit: Connection, adjoint: AdjointSolution) -> Float[np.ndarray, " 2"]:
    """Distances by which the rounding of all states moves the parameters, across the curve."""
    states = np.abs(orbit.solution.path.ends[0] / problem.size)
    share = np.sum(np.abs(adjoint.psi) * states) / np.sum(adjoint.normal**2)
    return np.finfo(float).eps * (_ROUNDINGS * share * np.abs(adjoint.normal) * problem.widths + np.abs(orbit.values))


def _away(problem: Problem, point: Connection) -> Float[np.ndarray, " 2"]:
    """Distances of both ends from their saddles, in sizes."""
    gaps = point.solution.path.ends[0, [0, -1]] - [point.departure.state, point.arrival.state]
    return np.linalg.norm(gaps / problem.size, axis=1)


# ---- meshes and rests


def adapted(problem: Problem, point: Connection, n: int | None = None, held: int | None = None) -> Connection:
    """The orbit with rests as long as they must be, on a mesh adapted to it, as fine as its parameters need.

    Across the curve, or at the value of the parameter of a number that is held.
    """
    intervals = point.solution.path.stages.shape[1] if n is None else n
    saddles = point.departure, point.arrival
    more = [_missing_rest(problem, point, k) for k in range(2)]
    solution = with_ends(problem, point.solution, *saddles, (more[0], more[1]))
    while True:
        new = across_curve(problem, point, remeshed(problem, solution, intervals, cyclic=False), held)
        if new is not None:
            new = across_curve(problem, new, remeshed(problem, new.solution, intervals, cyclic=False), held) or new
            finer = _on_halves(problem, new, held)
            if finer is not None and np.all(np.abs(finer.values - new.values) <= _RESOLVED * problem.widths):
                return new
        if 2 * intervals > MOST_INTERVALS:
            return new or point
        intervals *= 2


def _on_halves(problem: Problem, point: Connection, held: int | None = None) -> Connection | None:
    path = point.solution.path
    return across_curve(problem, point, point.solution._replace(path=on_mesh(path, halved(path.mesh))), held)


def _missing_rest(problem: Problem, point: Connection, end: int) -> float:
    """The time by which an end is to be later (or earlier) so that it is as near to its saddle as is asked for."""
    saddle, path = (point.departure, point.arrival)[end], point.solution.path
    real = np.real(saddle.eigenvalues)
    rate = real[real > 0.0].min() if end == 0 else -real[real < 0.0].max()
    away = np.linalg.norm((path.ends[0] - saddle.state) / problem.size, axis=1)
    if away[-end] >= _NEAR:
        return float(np.log(away[-end] / _NEAR) / rate)
    beyond = np.flatnonzero(away > _NEAR)
    times = point.solution.duration[0] * path.mesh[0]
    return -float(times[beyond[0] - 1] if end == 0 else times[-1] - times[beyond[-1] + 1])


def across_curve(
    problem: Problem, point: Connection, guess: BoundarySolution, held: int | None = None
) -> Connection | None:
    """The orbit near a guess whose parameters differ from those of a point across the curve, or one is as it is."""
    boundary = projections(problem, point.departure, point.arrival)

    def hold(line: NewtonSystem, lanes: np.ndarray) -> list[Variation]:
        if held is not None:
            return [fixed(line, -1), fixed(line, held)]
        line = orthonormal(guess.path, line)
        return [fixed(line, -1), direction_without(guess.path, line, [phase_condition(problem, line), fixed(line, -1)])]

    corrected = correct(problem, guess, boundary, hold)
    if not corrected.converged[0]:
        return None
    orbit = corrected.solution
    if held is not None:
        orbit.values[0, held] = guess.values[0, held]  # but for rounding
    return with_own_saddles(problem, Connection(orbit, point.departure, point.arrival, float(corrected.residual[0])))


def with_own_saddles(problem: Problem, point: Connection) -> Connection:
    """The orbit with the saddles at its own parameters."""
    saddles = [saddle_at(problem, end.state, point.values) for end in (point.departure, point.arrival)]
    return point._replace(departure=saddles[0], arrival=saddles[1])
