"""Piecewise polynomials on meshes of their own, side by side: values, and meshes that suit them. Host code.

On every interval a path is the polynomial of degree m through its value at the beginning and those at m Gauss points.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

DEGREE = 4
"""Gauss points of an interval, by default."""

_FLOOR = 0.1  # of the mean density of a mesh, at least
_SMOOTHING = 2  # times that densities of neighbouring intervals are averaged


class GaussRule(NamedTuple):
    """Collocation at the zeros of Legendre's polynomial on [0, 1] (Ascher, Mattheij and Russell 1995, 5.1.2).

    Attributes:
        points: c_j, (m,).
        weights: b_j of quadrature, exact to degree 2m − 1, (m,).
        integrals: a_jk, integral from 0 to c_j of the Lagrange polynomial of c_k, (m, m).
        last: shares of the values at 0, c_1, …, c_m in the value at 1, (m + 1,).
        highest: shares of these in the m-th derivative, which is constant, (m + 1,).
    """

    points: Float[np.ndarray, " m"]
    weights: Float[np.ndarray, " m"]
    integrals: Float[np.ndarray, "m m"]
    last: Float[np.ndarray, " m+1"]
    highest: Float[np.ndarray, " m+1"]


@functools.cache
def gauss_rule(m: int) -> GaussRule:
    """Return the rule of m points."""
    zeros, weights = np.polynomial.legendre.leggauss(m)
    points, powers = 0.5 * (zeros + 1.0), np.arange(m)
    # Powers of numbers in [0, 1] up to a handful: the condition of the matrix is a few hundred.
    integrals = (points[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(points[:, None] ** powers)
    nodes = np.concatenate([[0.0], points])
    differences = nodes[:, None] - nodes + np.eye(m + 1)
    highest = math.factorial(m) / np.prod(differences, axis=1)
    return GaussRule(points, 0.5 * weights, integrals, lagrange(m, np.ones(1))[0], highest)


@functools.cache
def _nodes(m: int) -> tuple[float, ...]:
    """Return 0, c_1, …, c_m."""
    return (0.0, *(0.5 * (np.polynomial.legendre.leggauss(m)[0] + 1.0)).tolist())


def lagrange(m: int, at: Float[np.ndarray, ...]) -> Float[np.ndarray, "... m+1"]:
    """Shares of the values at 0, c_1, …, c_m in the value of their polynomial at places in [0, 1]."""
    nodes = _nodes(m)
    shares = np.ones((*at.shape, m + 1))
    for k in range(m + 1):
        for j in range(m + 1):
            if j != k:
                shares[..., k] *= (at - nodes[j]) / (nodes[k] - nodes[j])
    return shares


class PiecewisePath(NamedTuple):
    """Paths over [0, 1], a lane each.

    Attributes:
        mesh: ends of the intervals, from 0 to 1, (lanes, n + 1).
        ends: values there, (lanes, n + 1, d).
        stages: values at the Gauss points, (lanes, n, m, d).
    """

    mesh: Float[np.ndarray, "lanes n+1"]
    ends: Float[np.ndarray, "lanes n+1 d"]
    stages: Float[np.ndarray, "lanes n m d"]

    @property
    def steps(self) -> Float[np.ndarray, "lanes n"]:
        """Lengths of the intervals."""
        return np.diff(self.mesh, axis=1)

    @property
    def places(self) -> Float[np.ndarray, "lanes n m"]:
        """Places of the Gauss points."""
        return _places(self.mesh, self.stages.shape[2])

    @property
    def nodes(self) -> Float[np.ndarray, "lanes n m+1 d"]:
        """Values that give the polynomial of each interval."""
        return np.concatenate([self.ends[:, :-1, None], self.stages], axis=2)

    @property
    def measure(self) -> Float[np.ndarray, "lanes n m"]:
        """Weights of the Gauss points in integrals over the path."""
        return self.steps[..., None] * gauss_rule(self.stages.shape[2]).weights


def values_at(path: PiecewisePath, at: Float[np.ndarray, "lanes k"]) -> Float[np.ndarray, "lanes k d"]:
    """Values of paths at places in [0, 1]."""
    n, m = path.stages.shape[1:3]
    values = np.empty((*at.shape, path.ends.shape[2]))
    for lane, (mesh, nodes) in enumerate(zip(path.mesh, path.nodes, strict=True)):
        interval = np.clip(np.searchsorted(mesh, at[lane], side="right") - 1, 0, n - 1)
        share = (at[lane] - mesh[interval]) / (mesh[interval + 1] - mesh[interval])
        values[lane] = np.sum(lagrange(m, share)[..., None] * nodes[interval], axis=1)
    return values


def on_mesh(path: PiecewisePath, mesh: Float[np.ndarray, "lanes k+1"]) -> PiecewisePath:
    """Paths on other meshes."""
    places, ends = _places(mesh, path.stages.shape[2]), values_at(path, mesh)
    ends[:, -1] = path.ends[:, -1]
    lanes, n, m = places.shape
    stages = values_at(path, places.reshape(lanes, n * m)).reshape(lanes, n, m, path.ends.shape[2])
    return PiecewisePath(mesh, ends, stages)


def rotated(path: PiecewisePath, share: float, mesh: Float[np.ndarray, " k+1"]) -> PiecewisePath:
    """A closed path of one lane from another of its places on, over a mesh that begins there.

    Args:
        path: from a state to the same, or one that lies whole turns of angles further.
        share: the place, in [0, 1).
        mesh: places after it, from 0 to 1.
    """
    lift = path.ends[0, -1] - path.ends[0, 0]

    def states(places: np.ndarray) -> np.ndarray:
        turns = np.floor(share + places)
        return values_at(path, (share + places - turns)[None])[0] + turns[:, None] * lift

    inside = _places(mesh[None], path.stages.shape[2])[0]
    stages = states(inside.ravel()).reshape(1, *inside.shape, -1)
    return PiecewisePath(mesh[None], states(mesh)[None], stages)


def path_through(
    times: Float[np.ndarray, " k"], states: Float[np.ndarray, "k d"], n: int
) -> tuple[PiecewisePath, float]:
    """Return a path of one lane through states at times, linear between them, and its duration.

    The intervals of its mesh are even in the share of the time, of the length in coordinates' ranges and of the number
    of states together: steps of an integrator are short where the path needs it.
    """
    duration, extent = float(times[-1] - times[0]), np.ptp(states, axis=0)
    share = (times - times[0]) / duration
    chords = np.linalg.norm(np.diff(states, axis=0) / np.where(extent > 0.0, extent, 1.0), axis=1)
    density = np.diff(share) + chords / np.sum(chords) + 1.0 / len(chords)
    passed = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, passed[-1], n + 1), passed, share)[None]
    places = _places(mesh, DEGREE)

    def between(at: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(at, share, column) for column in states.T], axis=-1)

    return PiecewisePath(mesh, between(mesh), between(places)), duration


def halved(mesh: Float[np.ndarray, "lanes n+1"]) -> Float[np.ndarray, "lanes 2n+1"]:
    """The meshes with all intervals halved."""
    lanes, points = mesh.shape
    finer = np.empty((lanes, 2 * points - 1))
    finer[:, ::2], finer[:, 1::2] = mesh, 0.5 * (mesh[:, :-1] + mesh[:, 1:])
    return finer


def adapted_mesh(
    path: PiecewisePath, size: Float[np.ndarray, " d"], n: int | None = None, *, cyclic: bool = True
) -> Float[np.ndarray, "lanes n+1"]:
    """Meshes on which the derivatives of degree m + 1 are spread evenly (de Boor, Lect. Notes Math. 363 (1973) 12).

    Derivatives of degree m are constant in an interval; the next ones are estimated by their jumps.

    Args:
        path: the paths.
        size: of the motion in each coordinate.
        n: number of intervals; by default as many as there are.
        cyclic: whether the last interval is a neighbour of the first.
    """
    lanes, intervals = len(path.mesh), path.stages.shape[1] if n is None else n
    density, steps = _mesh_density(path, size, cyclic), path.steps
    for _ in range(_SMOOTHING):
        density = 0.5 * density + 0.25 * (np.roll(density, 1, 1) + np.roll(density, -1, 1))
    mean = np.sum(density * steps, axis=1, keepdims=True)
    density = np.maximum(density, _FLOOR * np.where(mean > 0.0, mean, 1.0))
    mesh = np.empty((lanes, intervals + 1))
    for lane in range(lanes):
        total = np.concatenate([[0.0], np.cumsum(density[lane] * steps[lane])])
        mesh[lane] = np.interp(np.linspace(0.0, total[-1], intervals + 1), total, path.mesh[lane])
    mesh[:, 0], mesh[:, -1] = 0.0, 1.0
    return mesh


def interpolation_errors(path: PiecewisePath, size: Float[np.ndarray, " d"]) -> Float[np.ndarray, "lanes n"]:
    """Errors of the polynomials of closed paths between their ends, in sizes, as derivatives of degree m + 1 tell."""
    m = path.stages.shape[2]
    nodes = np.concatenate([[0.0], gauss_rule(m).points])
    largest = np.abs(np.prod(np.linspace(0.0, 1.0, 64)[:, None] - nodes, axis=1)).max() / math.factorial(m + 1)
    return largest * (_mesh_density(path, size, True) * path.steps) ** (m + 1)


def _mesh_density(path: PiecewisePath, size: Float[np.ndarray, " d"], cyclic: bool) -> Float[np.ndarray, "lanes n"]:
    """Roots of degree m + 1 of the derivatives of this degree, in sizes, of each interval."""
    m, steps = path.stages.shape[2], path.steps
    highest = np.tensordot(path.nodes / size, gauss_rule(m).highest, axes=(2, 0)) / steps[..., None] ** m
    jump = np.linalg.norm(np.diff(highest, axis=1, append=highest[:, :1]), axis=2)
    after = jump / (0.5 * (steps + np.roll(steps, -1, 1)))
    if not cyclic:
        after[:, -1] = after[:, -2]
    before = np.roll(after, 1, 1)
    if not cyclic:
        before[:, 0] = after[:, 0]
    return np.maximum(after, before) ** (1.0 / (m + 1))


def _places(mesh: Float[np.ndarray, "lanes n+1"], m: int) -> Float[np.ndarray, "lanes n m"]:
    """Places of the Gauss points of meshes."""
    return mesh[:, :-1, None] + np.diff(mesh, axis=1)[..., None] * gauss_rule(m).points
