"""Orbits homoclinic to saddles and saddle-foci by projection boundary conditions, from long cycles. Host code.

A path of finite duration begins in the unstable eigenspace of the equilibrium and ends in its stable one (Beyn, IMA J.
Numer. Anal. 10 (1990) 379; Champneys, Kuznetsov and Sandstede, Int. J. Bifurcation Chaos 6 (1996) 867). The equilibrium
and its eigenspaces go with the parameters. What the ends cut off falls exponentially with the duration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.linalg import expm, schur

from jaxnh.exceptions import InputError
from jaxnh.orbits.collocation.equations import (
    BoundaryConditions,
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    fixed,
)
from jaxnh.orbits.collocation.newton import BoundaryOf, correct, on_adapted_mesh
from jaxnh.orbits.collocation.paths import PiecewisePath, halved, on_mesh

_STEPS = 30
_DIFFERENCE = 1e-5  # of the widths of parameters: cubes of it are rounding
_LONGER = 1.5  # duration, by which what the ends cut off is told
_DURATION = -1  # of what `fixed` counts
_FLOOR = 1e-13


class SaddlePoint(NamedTuple):
    """An equilibrium at parameters, in sizes of the motion.

    Attributes:
        state: the equilibrium, (d,), in the coordinates.
        eigenvalues: of the field's derivative, largest real part first, (d,).
        stable, unstable: left eigenspaces, their bases as rows.
    """

    state: Float[np.ndarray, " d"]
    eigenvalues: Complex[np.ndarray, " d"]
    stable: Float[np.ndarray, "s d"]
    unstable: Float[np.ndarray, "u d"]


class Homoclinic(NamedTuple):
    """A homoclinic orbit.

    Attributes:
        solution: one lane; the first parameter is that of the orbit.
        saddle: the equilibrium.
        error: of the parameter, from the mesh, the duration and rounding.
    """

    solution: BoundarySolution
    saddle: SaddlePoint
    error: float


def saddle_at(problem: Problem, guess: Float[np.ndarray, " d"], values: Float[np.ndarray, " q"]) -> SaddlePoint:
    """The equilibrium near a state, by Newton.

    Raises:
        InputError: Newton does not converge, or the equilibrium is no hyperbolic saddle.
    """
    state, zero, size = guess[None].astype(float), np.zeros(1), problem.size
    for _ in range(_STEPS):
        at = problem.field(state, zero, values[None])
        step = np.linalg.lstsq(np.asarray(at.jacobian)[0], -np.asarray(at.rate)[0])[0]
        state = state + step
        if np.abs(step / size).max() <= _FLOOR:
            break
    else:
        raise InputError(f"no equilibrium near {guess.tolist()} at parameters {values.tolist()}")
    jacobian = np.asarray(problem.field(state, zero, values[None]).jacobian)[0] * (size / size[:, None])
    eigenvalues = np.linalg.eigvals(jacobian).astype(complex)
    eigenvalues = eigenvalues[np.lexsort((eigenvalues.imag, -eigenvalues.real))]
    stable, unstable = (_eigenspace(jacobian.T, side).T for side in ("lhp", "rhp"))
    if not 0 < len(stable) < len(size) or len(stable) + len(unstable) != len(size):
        raise InputError(
            f"the equilibrium {state[0].tolist()} is no saddle, its eigenvalues are {eigenvalues.tolist()}"
        )
    return SaddlePoint(state[0], eigenvalues, stable, unstable)


def projections(problem: Problem, guess: SaddlePoint) -> BoundaryOf:
    """The projection boundary conditions of a homoclinic orbit to the saddle near one; of lanes the same."""

    def conditions(ends: Float[np.ndarray, "2 d"], values: Float[np.ndarray, " q"]) -> Float[np.ndarray, " d"]:
        saddle = saddle_at(problem, guess.state, values)
        first, last = (ends - saddle.state) / problem.size
        bases = _aligned(saddle.stable, guess.stable), _aligned(saddle.unstable, guess.unstable)
        return np.concatenate([bases[0] @ first, bases[1] @ last])

    def boundary(solution: BoundarySolution, lanes: Int[np.ndarray, " lanes"]) -> BoundaryConditions:
        rows = [
            _boundary_of_lane(problem, guess, conditions, path, values)
            for path, values in zip(solution.path.ends[:, [0, -1]], solution.values, strict=True)
        ]
        return BoundaryConditions(*(np.stack(leaves) for leaves in zip(*rows, strict=True)))

    return boundary


def homoclinic_orbit(
    problem: Problem, cycle: BoundarySolution, near: Float[np.ndarray, " d"], n: int | None = None
) -> Homoclinic:
    """The homoclinic orbit near a cycle of long duration, and the parameter where it is.

    Args:
        problem: the field, with one parameter.
        cycle: one lane.
        near: a state near the equilibrium.
        n: intervals of the mesh, by default those of the cycle.

    Raises:
        InputError: there is no saddle near the state, or Newton comes to no homoclinic orbit.
    """
    intervals = cycle.path.stages.shape[1] if n is None else n
    saddle = saddle_at(problem, near, cycle.values[0])
    solution = _solve(problem, _cut_open(cycle, saddle.state, problem.size), saddle, intervals)
    saddle = saddle_at(problem, saddle.state, solution.values[0])
    longer = _solve(problem, _extended(problem, solution, saddle), saddle, intervals)
    finer = longer._replace(path=on_mesh(longer.path, halved(longer.path.mesh)))
    corrected = correct(problem, finer, projections(problem, saddle), hold_duration)
    if not corrected.converged[0]:
        raise InputError("Newton comes to no homoclinic orbit on the halves of the mesh; begin with more intervals")
    value = corrected.solution.values[0, 0]
    error = abs(value - longer.values[0, 0]) + abs(longer.values[0, 0] - solution.values[0, 0])
    rounding = (corrected.extra_rounding[0, 1] + _FLOOR) * problem.widths[0]
    return Homoclinic(
        corrected.solution, saddle_at(problem, saddle.state, corrected.solution.values[0]), error + rounding
    )


def hold_duration(line: NewtonSystem, lanes: Int[np.ndarray, " lanes"]) -> Sequence[Variation]:
    """The direction of the duration, which is then known."""
    return [fixed(line, _DURATION)]


def _solve(problem: Problem, guess: BoundarySolution, saddle: SaddlePoint, n: int) -> BoundarySolution:
    corrected = on_adapted_mesh(problem, guess, projections(problem, saddle), hold_duration, n, cyclic=False)
    if not corrected.converged[0]:
        raise InputError(
            "Newton comes to no homoclinic orbit; begin with a cycle of longer duration, or more intervals"
        )
    return corrected.solution


def _boundary_of_lane(
    problem: Problem,
    guess: SaddlePoint,
    conditions: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ends: Float[np.ndarray, "2 d"],
    values: Float[np.ndarray, " q"],
) -> BoundaryConditions:
    """The conditions at one solution; derivatives in parameters are central differences."""
    saddle, d = saddle_at(problem, guess.state, values), len(problem.size)
    stable, unstable = _aligned(saddle.stable, guess.stable), _aligned(saddle.unstable, guess.unstable)
    first = np.concatenate([stable, np.zeros((d - len(stable), d))])
    last = np.concatenate([np.zeros((len(stable), d)), unstable])
    extra = np.zeros((d, 1 + len(values)))
    for k, width in enumerate(problem.widths):
        shift = np.zeros(len(values))
        shift[k] = _DIFFERENCE * width
        change = conditions(ends, values + shift) - conditions(ends, values - shift)
        extra[:, 1 + k] = change / (2.0 * _DIFFERENCE)
    return BoundaryConditions(first, last, extra, -conditions(ends, values))


def _eigenspace(matrix: Float[np.ndarray, "d d"], side: str) -> Float[np.ndarray, "d k"]:
    """An orthonormal basis of the eigenspace of one half plane, "lhp" or "rhp", as columns."""
    _, basis, count = schur(matrix, sort=side)  # pyright: ignore[reportAssignmentType]
    return np.asarray(basis)[:, :count]


def _aligned(rows: Float[np.ndarray, "k d"], reference: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k d"]:
    """The basis of a space of rows that goes smoothly with the space, whatever basis it comes with."""
    return np.linalg.solve(rows @ reference.T, rows)


def _cut_open(
    cycle: BoundarySolution, state: Float[np.ndarray, " d"], size: Float[np.ndarray, " d"]
) -> BoundarySolution:
    """The cycle as a path that begins and ends where it is nearest to a state."""
    path, n = cycle.path, cycle.path.stages.shape[1]
    at = int(np.argmin(np.linalg.norm((path.ends[0, :-1] - state) / size, axis=1)))
    mesh = np.concatenate([path.mesh[0, at:], 1.0 + path.mesh[0, 1 : at + 1]]) - path.mesh[0, at]
    ends = np.concatenate([path.ends[0, at:], path.ends[0, 1 : at + 1]])
    whole = PiecewisePath(mesh[None], ends[None], np.roll(path.stages, -at, axis=1)[:, :n])
    return cycle._replace(path=whole)


def _extended(problem: Problem, solution: BoundarySolution, saddle: SaddlePoint) -> BoundarySolution:
    """The path with longer rests at both ends, where it goes exponentially to the saddle."""
    path, duration = solution.path, solution.duration[0]
    more, count = 0.5 * (_LONGER - 1.0), max(4, path.stages.shape[1] // 8)
    size, values = problem.size, solution.values
    jacobian = np.asarray(problem.field(saddle.state[None], np.zeros(1), values).jacobian)[0] * (size / size[:, None])
    mesh = np.linspace(0.0, more, count + 1)
    places = PiecewisePath(mesh[None], np.zeros((1, count + 1, 1)), path.stages[:, :1].repeat(count, axis=1)).places[0]

    def rest(times: np.ndarray, end: np.ndarray, side: str) -> np.ndarray:
        """States at times after an end near the saddle, in an eigenspace of it."""
        basis = _eigenspace(jacobian, side)
        flow = expm(times[..., None, None] * (basis.T @ jacobian @ basis))
        gone = flow @ (basis.T @ ((end - saddle.state) / size))
        return saddle.state + size * (gone @ basis.T)

    first, last = path.ends[0, 0], path.ends[0, -1]
    before, after = (mesh - more) * duration, mesh * duration
    inside = more + path.mesh[0]
    whole = PiecewisePath(
        np.concatenate([mesh[:-1], inside, 1.0 + more + mesh[1:]])[None] / _LONGER,
        np.concatenate([rest(before, first, "rhp")[:-1], path.ends[0], rest(after, last, "lhp")[1:]])[None],
        np.concatenate(
            [rest((places - more) * duration, first, "rhp"), path.stages[0], rest(places * duration, last, "lhp")]
        )[None],
    )
    whole.mesh[:, -1] = 1.0
    return BoundarySolution(whole, _LONGER * solution.duration, values)
