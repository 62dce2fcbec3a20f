"""Orbits homoclinic to saddles and saddle-foci by projection boundary conditions, from long cycles. Host code.

A path of finite duration begins in the unstable eigenspace of the equilibrium and ends in its stable one (Beyn, IMA J.
Numer. Anal. 10 (1990) 379; Champneys, Kuznetsov and Sandstede, Int. J. Bifurcation Chaos 6 (1996) 867). The equilibrium
and its eigenspaces go with the parameters. What the ends cut off falls exponentially with the duration.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.linalg import schur

from jaxnh.exceptions import InputError
from jaxnh.orbits.collocation.equations import (
    BoundaryConditions,
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    fixed,
)
from jaxnh.orbits.collocation.newton import BoundaryOf
from jaxnh.orbits.collocation.paths import PiecewisePath, gauss_rule, on_mesh

_STEPS = 30
_DIFFERENCE = 1e-5  # of the widths of parameters: cubes of it are rounding
_MOVED = 1e-3  # sizes: saddles go no further in such a difference
_DURATION = -1  # of what `fixed` counts
_FLOOR = 1e-13
_QUADRATIC = 1e-6  # step, in sizes, from where on steps fall fast, down to rounding
_STALLED = 0.25  # of the step before: rounding, which is large beside a fold


class SaddlePoint(NamedTuple):
    """An equilibrium at parameters, in sizes of the motion.

    Attributes:
        state: the equilibrium, (d,), in the coordinates.
        eigenvalues: of the field's derivative, largest real part first, (d,).
        stable, unstable: left eigenspaces, their bases as rows.
        jacobian: the field's derivative, in sizes, (d, d).
        drift: derivatives of the state over the parameters, in sizes and widths, (d, q).
    """

    state: Float[np.ndarray, " d"]
    eigenvalues: Complex[np.ndarray, " d"]
    stable: Float[np.ndarray, "s d"]
    unstable: Float[np.ndarray, "u d"]
    jacobian: Float[np.ndarray, "d d"]
    drift: Float[np.ndarray, "d q"]


def saddle_at(problem: Problem, guess: Float[np.ndarray, " d"], values: Float[np.ndarray, " q"]) -> SaddlePoint:
    """The equilibrium near a state, by Newton.

    Raises:
        InputError: Newton does not converge, or the equilibrium is no hyperbolic saddle.
    """
    return saddles_at(problem, guess, values[None])[0]


def saddles_at(problem: Problem, guess: Float[np.ndarray, " d"], values: Float[np.ndarray, "k q"]) -> list[SaddlePoint]:
    """The equilibrium near a state at several parameters, by Newton; raises as `saddle_at`."""
    size, zero = problem.size, np.zeros(len(values))
    states, last = np.tile(np.asarray(guess, float), (len(values), 1)), np.inf
    for _ in range(_STEPS):
        at = problem.field(states, zero, values)
        rate, jacobian = np.asarray(at.rate), np.asarray(at.jacobian)
        if not (np.isfinite(rate).all() and np.isfinite(jacobian).all()):
            raise InputError(f"the field is not finite near {guess.tolist()} at parameters {values[0].tolist()}")
        steps = -(np.linalg.pinv(jacobian) @ rate[..., None])[..., 0]
        states, length = states + steps, float(np.abs(steps / size).max())
        if length <= _FLOOR or (last <= _QUADRATIC and length >= _STALLED * last):
            break
        last = length
    else:
        raise InputError(f"no equilibrium near {guess.tolist()} at parameters {values[0].tolist()}")
    at = problem.field(states, zero, values)
    jacobians = np.asarray(at.jacobian) * (size / size[:, None])
    slopes = np.asarray(at.by_parameters) * (problem.widths / size[:, None])
    return [_saddle(*each) for each in zip(states, jacobians, slopes, strict=True)]


def _saddle(
    state: Float[np.ndarray, " d"], jacobian: Float[np.ndarray, "d d"], slopes: Float[np.ndarray, "d q"]
) -> SaddlePoint:
    eigenvalues = np.linalg.eigvals(jacobian).astype(complex)
    eigenvalues = eigenvalues[np.lexsort((np.imag(eigenvalues), -np.real(eigenvalues)))]
    stable, unstable = (_eigenspace(jacobian.T, side).T for side in ("lhp", "rhp"))
    if not 0 < len(stable) < len(state) or len(stable) + len(unstable) != len(state):
        raise InputError(f"the equilibrium {state.tolist()} is no saddle, its eigenvalues are {eigenvalues.tolist()}")
    return SaddlePoint(state, eigenvalues, stable, unstable, jacobian, -np.linalg.solve(jacobian, slopes))


def projections(problem: Problem, departure: SaddlePoint, arrival: SaddlePoint) -> BoundaryOf:
    """The projection boundary conditions of an orbit from the saddle near one to that near another; of lanes the same.

    Both may be the same; the first must have as many unstable directions as the second.
    """

    def boundary(solution: BoundarySolution, lanes: Int[np.ndarray, " lanes"]) -> BoundaryConditions:
        rows = [
            _boundary_of_lane(problem, departure, arrival, path, values)
            for path, values in zip(solution.path.ends[:, [0, -1]], solution.values, strict=True)
        ]
        return BoundaryConditions(*(np.stack(leaves) for leaves in zip(*rows, strict=True)))

    return boundary


def hold_duration(line: NewtonSystem, lanes: Int[np.ndarray, " lanes"]) -> Sequence[Variation]:
    """The direction of the duration, which is then known."""
    return [fixed(line, _DURATION)]


def _boundary_of_lane(
    problem: Problem,
    departure: SaddlePoint,
    arrival: SaddlePoint,
    ends: Float[np.ndarray, "2 d"],
    values: Float[np.ndarray, " q"],
) -> BoundaryConditions:
    """The conditions at one solution; derivatives in parameters are central differences.

    Beside a fold, where saddles go far, these are over less of the parameters.
    """
    d, q = len(problem.size), len(values)
    moves = np.abs(np.concatenate([departure.drift, arrival.drift]))[:, :q].max(axis=0)
    shares = np.minimum(_DIFFERENCE, _MOVED / np.maximum(moves, 1e-300))
    shifts = np.diag(shares * problem.widths)
    many = np.concatenate([values[None], values + shifts, values - shifts])
    rows = _rows(problem, departure, ends[0], many, "stable"), _rows(problem, arrival, ends[1], many, "unstable")
    missing = np.concatenate([gaps for _, gaps in rows], axis=1)
    (start, _), (end, _) = rows
    first = np.concatenate([start[0], np.zeros((len(end[0]), d))])
    last = np.concatenate([np.zeros((len(start[0]), d)), end[0]])
    extra = np.zeros((d, 1 + q))
    extra[:, 1:] = (missing[1 : 1 + q] - missing[1 + q :]).T / (2.0 * shares)
    return BoundaryConditions(first, last, extra, -missing[0])


def _rows(
    problem: Problem, guess: SaddlePoint, end: np.ndarray, values: Float[np.ndarray, "k q"], side: str
) -> tuple[Float[np.ndarray, "k s d"], Float[np.ndarray, "k s"]]:
    """The left eigenspace that an end has no share of, at several parameters, and the shares that it has."""
    saddles = saddles_at(problem, guess.state, values)
    bases = np.stack([_aligned(getattr(saddle, side), getattr(guess, side)) for saddle in saddles])
    gaps = np.stack([(end - saddle.state) / problem.size for saddle in saddles])
    return bases, (bases @ gaps[..., None])[..., 0]


def _eigenspace(matrix: Float[np.ndarray, "d d"], side: str) -> Float[np.ndarray, "d k"]:
    """An orthonormal basis of the eigenspace of one half plane, "lhp" or "rhp", as columns."""
    _, basis, count = schur(matrix, sort=side)  # pyright: ignore[reportAssignmentType]
    return np.asarray(basis)[:, :count]


def _aligned(rows: Float[np.ndarray, "k d"], reference: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k d"]:
    """The basis of a space of rows that goes smoothly with the space, whatever basis it comes with."""
    return np.linalg.solve(rows @ reference.T, rows)


def cut_open(
    cycle: BoundarySolution, state: Float[np.ndarray, " d"], size: Float[np.ndarray, " d"]
) -> BoundarySolution:
    """The cycle as a path that begins and ends where it is nearest to a state."""
    path, n = cycle.path, cycle.path.stages.shape[1]
    at = int(np.argmin(np.linalg.norm((path.ends[0, :-1] - state) / size, axis=1)))
    mesh = np.concatenate([path.mesh[0, at:], 1.0 + path.mesh[0, 1 : at + 1]]) - path.mesh[0, at]
    ends = np.concatenate([path.ends[0, at:], path.ends[0, 1 : at + 1]])
    whole = PiecewisePath(mesh[None], ends[None], np.roll(path.stages, -at, axis=1)[:, :n])
    return cycle._replace(path=whole)


def with_ends(
    problem: Problem,
    solution: BoundarySolution,
    departure: SaddlePoint,
    arrival: SaddlePoint,
    more: tuple[float, float],
) -> BoundarySolution:
    """The path with longer rests at both ends, of these times, where it goes exponentially to the saddles.

    Negative times are cut off. One lane.
    """
    times, path = solution.duration[0] * solution.path.mesh[0], solution.path
    first, last = max(0.0, -more[0]), solution.duration[0] - max(0.0, -more[1])
    mesh = np.concatenate([[first], times[(times > first) & (times < last)], [last]])
    path = on_mesh(path, mesh[None] / solution.duration[0])
    parts = [(mesh, path.ends[0], path.stages[0])]
    count, m = max(4, path.stages.shape[1] // 8), path.stages.shape[2]
    if more[0] > 0.0:
        parts.insert(0, _rest(problem, departure, path.ends[0, 0], np.linspace(-more[0], 0.0, count + 1), "rhp", m))
        parts[0] = (first + parts[0][0], *parts[0][1:])
    if more[1] > 0.0:
        rest = _rest(problem, arrival, path.ends[0, -1], np.linspace(0.0, more[1], count + 1), "lhp", m)
        parts.append((last + rest[0], *rest[1:]))
    joined = np.concatenate([parts[0][0], *(part[0][1:] for part in parts[1:])])
    ends = np.concatenate([parts[0][1], *(part[1][1:] for part in parts[1:])])
    duration = joined[-1] - joined[0]
    mesh = (joined - joined[0]) / duration
    mesh[0], mesh[-1] = 0.0, 1.0
    whole = PiecewisePath(mesh[None], ends[None], np.concatenate([part[2] for part in parts])[None])
    return BoundarySolution(whole, np.array([duration]), solution.values)


def _rest(
    problem: Problem, saddle: SaddlePoint, end: np.ndarray, times: Float[np.ndarray, " k"], side: str, m: int
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k d"], Float[np.ndarray, "k-1 m d"]]:
    """Times, and states at these and between them, in an eigenspace of a saddle from an end near it."""
    basis = _eigenspace(saddle.jacobian, side)
    rates, vectors = np.linalg.eig(basis.T @ saddle.jacobian @ basis)
    shares = np.linalg.lstsq(vectors, basis.T @ ((end - saddle.state) / problem.size))[0]

    def states(times: np.ndarray) -> np.ndarray:
        inside = (shares * np.exp(times[..., None] * rates)) @ vectors.T
        return saddle.state + problem.size * (inside.real @ basis.T)

    return times, states(times), states(times[:-1, None] + np.diff(times)[:, None] * gauss_rule(m).points)
