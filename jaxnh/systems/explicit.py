"""Velocities that constraints give by themselves, and equations of motion without them.

Where m constraints f(q, q̇, t) = 0 are linear in m of the velocities, with constant coefficients C, these are functions
of the others: w = g(q, u, t) = −C⁻¹ f(q, q̇ with w = 0, t). With S = ∂q̇/∂u the motions that the constraints allow are
those of Jourdain's principle, (Sᵀ M S) u̇ = Sᵀ (F − M γ), γ the part of q̈ without u̇: k − m equations in place of k + m,
in a state that cannot leave f = 0. They hold on the constraints, where the bordered system says the same. Of
quasi-velocities a definition may name w itself: C may then depend on the state.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.elimination import eliminate, is_positive_definite, is_zero, minus, times
from jaxnh.systems.flow import Flow, Parameters, Reduction
from jaxnh.systems.jourdain import (
    Accelerations,
    Equations,
    applied_forces,
    constraint_functions,
    matrices,
)
from jaxnh.systems.motion import Motion, ReducedMotion
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import constants, slope

_MOST = 6  # velocities among which those are looked for that constraints give


class Explicit(NamedTuple):
    """The velocities that constraints give.

    Attributes:
        given: their numbers.
        free: those of the others.
        inverse: C⁻¹, a row a given velocity; None where C is no constant, and solved for at each state.
        definite: whether M is known to be positive definite.
    """

    given: tuple[int, ...]
    free: tuple[int, ...]
    inverse: tuple[tuple[float, ...], ...] | None
    definite: bool = True


def explicit_velocities(equations: Equations, k: int, n: int) -> Explicit | None:
    """Velocities that the constraints of a system give; None where they give none, or its mass matrix is not constant.

    To be called while the program of a lane is traced, with what lanes and flows have of their own as its arguments.

    Args:
        equations: T, Q and f.
        k, n: numbers of coordinates and of velocities.
    """
    f = constraint_functions(equations, k)
    at = tuple(jnp.zeros(()) for _ in range(k + n + 1))
    m = len(jax.eval_shape(f, *at))
    if not 0 < m < n <= _MOST or not _has_constant_mass(equations, at, k):
        return None
    columns = constants(lambda *at: [slope(f, at, k + j) for j in range(n)], *at)
    for given in itertools.combinations(range(n), m):
        inverse = _inverse(columns, given)
        if inverse is not None:
            return Explicit(given, _others(given, n), inverse)
    return None


def dependent_velocities(equations: Equations, k: int, n: int, given: tuple[int, ...]) -> Explicit:
    """Velocities that a definition names, in which the constraints are linear; called as `explicit_velocities` is."""
    f = constraint_functions(equations, k)
    at = tuple(jnp.zeros(()) for _ in range(k + n + 1))
    columns = constants(lambda *at: [slope(f, at, k + j) for j in range(n)], *at)
    return Explicit(given, _others(given, n), _inverse(columns, given), _has_constant_mass(equations, at, k))


def _others(given: tuple[int, ...], n: int) -> tuple[int, ...]:
    return tuple(j for j in range(n) if j not in given)


def _has_constant_mass(equations: Equations, at: Vector, k: int) -> bool:
    """Return whether a mass matrix is positive definite wherever a lane may be."""
    if equations.definite:
        return True
    mass, _ = constants(lambda *at: matrices(equations, at, k), *at)
    return all(entry is not None for row in mass for entry in row) and is_positive_definite(mass)


def _inverse(columns: list[list[float | None]], given: tuple[int, ...]) -> tuple[tuple[float, ...], ...] | None:
    """C⁻¹ of the columns of some velocities; None where it is no constant, or there is none."""
    m = len(given)
    c = [[columns[j][i] for j in given] for i in range(m)]
    if any(entry is None for row in c for entry in row):
        return None
    matrix = np.array(c, float)
    if not abs(np.linalg.det(matrix)) > 1e-6 * np.abs(matrix).max() ** m > 0.0:
        return None
    return tuple(map(tuple, np.linalg.inv(matrix).tolist()))


def all_velocities(equations: Equations, explicit: Explicit, q: Vector, u: Vector, t: Number) -> Vector:
    """All velocities of a state on the constraints, from those that are free."""
    return _completed(equations, explicit, q, u, t)[0]


def _completed(
    equations: Equations, explicit: Explicit, q: Vector, u: Vector, t: Number
) -> tuple[Vector, Number | None]:
    """All velocities, and whether C is singular, where C is solved for."""
    v: list[Any] = [jnp.zeros_like(q[0])] * (len(explicit.given) + len(u))
    for j, velocity in zip(explicit.free, u, strict=True):
        v[j] = velocity
    f, at, singular = constraint_functions(equations, len(q)), (*q, *v, t), None
    left = f(*at)
    if explicit.inverse is not None:
        solution = [_dot(row, left) for row in explicit.inverse]
    else:
        columns = [slope(f, at, len(q) + j) for j in explicit.given]
        matrix = [[column[i] for column in columns] for i in range(len(left))]
        (solution,), singular = eliminate(matrix, [list(left)])
    for j, velocity in zip(explicit.given, solution, strict=True):
        v[j] = minus(0.0, velocity)
    return tuple(v), singular


def free_accelerations(equations: Equations, explicit: Explicit, q: Vector, u: Vector, t: Number) -> Vector:
    """u̇ at a state of the constraints."""
    return maggi_accelerations(equations, explicit, q, u, t).a


def maggi_accelerations(equations: Equations, explicit: Explicit, q: Vector, u: Vector, t: Number) -> Accelerations:
    """u̇ at a state of the constraints (Maggi, Atti Accad. Lincei 10 (1901) 287), without multipliers."""
    k, free = len(q), explicit.free

    def given(q: Vector, u: Vector, t: Number) -> list[Any]:
        v = all_velocities(equations, explicit, q, u, t)
        return [v[j] for j in explicit.given]

    v, lost = _completed(equations, explicit, q, u, t)
    mass, _ = matrices(equations, (*q, *v, t), k)
    forces = applied_forces(equations, q, v, t)
    rates = equations.rates(q, v, t)
    rest = jax.jvp(lambda q, t: given(q, u, t), (q, t), (rates, jnp.ones_like(q[0])))[1]
    gamma: list[Any] = [0.0] * len(v)
    for j, rate in zip(explicit.given, rest, strict=True):
        gamma[j] = rate
    forces = [minus(force, _dot(row, gamma)) for force, row in zip(forces, mass, strict=True)]
    by_u = [jax.jvp(lambda u: given(q, u, t), (u,), (_unit(u, i),))[1] for i in range(len(free))]
    ways = []
    for i, j in enumerate(free):  # rows of Sᵀ
        way: list[Any] = [0.0] * len(v)
        way[j] = 1.0
        for g, rate in zip(explicit.given, by_u[i], strict=True):
            way[g] = rate
        ways.append(way)
    momenta = [[_dot(row, way) for row in mass] for way in ways]
    upper = {(i, j): _dot(momenta[i], ways[j]) for j in range(len(ways)) for i in range(j + 1)}
    small = [[upper[min(i, j), max(i, j)] for j in range(len(ways))] for i in range(len(ways))]
    right = [_dot(way, forces) for way in ways]
    (solution,), singular = eliminate(small, [right], definite=explicit.definite)
    if lost is not None:
        singular |= lost
    return Accelerations(tuple(x + jnp.zeros_like(q[0]) for x in solution), (), singular)


class ExplicitReduction(Reduction):
    """Coordinates and the free velocities of a motion whose constraints give the others.

    Attributes:
        equations: of the motion, of a lane's parameters.
        explicit: the velocities that are given.
        left_out: whether states have no others than the free ones.
    """

    leaves_constraints = False

    def __init__(
        self, flow: Flow, equations: Callable[[Parameters], Equations], explicit: Explicit, left_out: bool
    ) -> None:
        super().__init__(flow)
        self.equations, self.explicit, self.left_out = equations, explicit, left_out

    def reduce(self, y: Motion) -> ReducedMotion:
        return ReducedMotion(y.q, y.v if self.left_out else tuple(y.v[j] for j in self.explicit.free))

    def rhs(self, t: ArrayLike, z: ReducedMotion, p: Parameters) -> ReducedMotion:
        equations = self.equations(p)
        v = all_velocities(equations, self.explicit, z.q, z.u, t)
        return ReducedMotion(equations.rates(z.q, v, t), free_accelerations(equations, self.explicit, z.q, z.u, t))

    def restore(self, t: ArrayLike, z: ReducedMotion, y: Motion, p: Parameters) -> Motion:
        v = z.u if self.left_out else all_velocities(self.equations(p), self.explicit, z.q, z.u, t)
        return Motion(z.q, v, y.watch)


def _dot(first: Sequence[Number], second: Sequence[Number]) -> Number:
    """Σ one · other, nothing where one of both is known to vanish."""
    total: Number = 0.0
    for x, y in zip(first, second, strict=True):
        product = times(x, y)
        total = product if is_zero(total) else total if is_zero(product) else total + product
    return total


def _unit(u: Vector, i: int) -> Vector:
    return tuple(jnp.full_like(x, float(i == j)) for j, x in enumerate(u))
