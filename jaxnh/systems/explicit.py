"""Velocities that constraints give by themselves, and equations of motion without them.

Where m constraints f(q, q̇, t) = 0 are linear in m of the velocities, with constant coefficients C, these are functions
of the others: w = g(q, u, t) = −C⁻¹ f(q, q̇ with w = 0, t). With S = ∂q̇/∂u the motions that the constraints allow are
those of Jourdain's principle, (Sᵀ M S) u̇ = Sᵀ (F − M γ), γ the part of q̈ without u̇: k − m equations in place of k + m,
in a state that cannot leave f = 0. They hold on the constraints, where the bordered system says the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.elimination import eliminate, is_positive_definite, is_zero, minus, times
from jaxnh.systems.jourdain import Equations, applied_forces, constraint_functions, matrices, slope
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import constants

_MOST = 6  # velocities among which those are looked for that constraints give


class Explicit(NamedTuple):
    """The velocities that constraints give.

    Attributes:
        given: their numbers.
        free: those of the others.
        inverse: C⁻¹, a row a given velocity.
    """

    given: tuple[int, ...]
    free: tuple[int, ...]
    inverse: tuple[tuple[float, ...], ...]


def explicit_velocities(equations: Equations, k: int) -> Explicit | None:
    """Velocities that the constraints of a system give; None where they give none, or its mass matrix is not constant.

    To be called while the program of a lane is traced, with what lanes and flows have of their own as its arguments.
    """
    f = constraint_functions(equations, k)
    at = tuple(jnp.zeros(()) for _ in range(2 * k + 1))
    m = len(jax.eval_shape(f, *at))
    if not 0 < m < k <= _MOST:
        return None
    mass, _ = constants(lambda *at: matrices(equations, at, k), *at)
    if any(entry is None for row in mass for entry in row) or not is_positive_definite(mass):
        return None
    columns = constants(lambda *at: [slope(f, at, k + j) for j in range(k)], *at)
    for given in itertools.combinations(range(k), m):
        c = [[columns[j][i] for j in given] for i in range(m)]
        if any(entry is None for row in c for entry in row):
            continue
        matrix = np.array(c)
        if abs(np.linalg.det(matrix)) > 1e-6 * np.abs(matrix).max() ** m > 0.0:
            free = tuple(j for j in range(k) if j not in given)
            return Explicit(given, free, tuple(map(tuple, np.linalg.inv(matrix).tolist())))
    return None


def all_velocities(equations: Equations, explicit: Explicit, q: Vector, u: Vector, t: Number) -> Vector:
    """q̇ of a state on the constraints, from the velocities that are free."""
    v: list[Any] = [jnp.zeros_like(q[0])] * len(q)
    for j, velocity in zip(explicit.free, u, strict=True):
        v[j] = velocity
    left = constraint_functions(equations, len(q))(*q, *v, t)
    for j, row in zip(explicit.given, explicit.inverse, strict=True):
        v[j] = minus(0.0, _dot(row, left))
    return tuple(v)


def free_accelerations(equations: Equations, explicit: Explicit, q: Vector, u: Vector, t: Number) -> Vector:
    """u̇ at a state of the constraints."""
    k, free = len(q), explicit.free

    def given(q: Vector, u: Vector, t: Number) -> list[Any]:
        v = all_velocities(equations, explicit, q, u, t)
        return [v[j] for j in explicit.given]

    v = all_velocities(equations, explicit, q, u, t)
    mass, _ = matrices(equations, (*q, *v, t), k)
    forces = applied_forces(equations, q, v, t)
    rest = jax.jvp(lambda q, t: given(q, u, t), (q, t), (v, jnp.ones_like(q[0])))[1]
    gamma: list[Any] = [0.0] * k
    for j, rate in zip(explicit.given, rest, strict=True):
        gamma[j] = rate
    forces = [minus(force, _dot(row, gamma)) for force, row in zip(forces, mass, strict=True)]
    by_u = [jax.jvp(lambda u: given(q, u, t), (u,), (_unit(u, i),))[1] for i in range(len(free))]
    ways = []
    for i, j in enumerate(free):  # rows of Sᵀ
        way: list[Any] = [0.0] * k
        way[j] = 1.0
        for g, rate in zip(explicit.given, by_u[i], strict=True):
            way[g] = rate
        ways.append(way)
    small = [[_dot([_dot(row, way) for row in mass], other) for other in ways] for way in ways]
    (coefficients,), _ = eliminate(small, [[_dot(way, forces) for way in ways]], len(free))
    return tuple(x + jnp.zeros_like(q[0]) for x in coefficients)


def _dot(one: Sequence[Number], other: Sequence[Number]) -> Number:
    """Σ one · other, nothing where one of both is known to vanish."""
    total: Number = 0.0
    for x, y in zip(one, other, strict=True):
        product = times(x, y)
        total = product if is_zero(total) else total if is_zero(product) else total + product
    return total


def _unit(u: Vector, i: int) -> Vector:
    return tuple(jnp.full_like(x, float(i == j)) for j, x in enumerate(u))
