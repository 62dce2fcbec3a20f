"""Equations of motion from T, Q and f, by Jourdain's principle and automatic differentiation.

A system has k coordinates q, kinetic energy T(q, q̇, t), generalised forces Q(q, q̇, t) and m constraints
f(q, q̇, t) = 0, linear or nonlinear in q̇. With A = ∂f/∂q̇ (m, k) and M = ∂²T/∂q̇² (k, k), equations (3) to (6) of the
paper and df/dt = 0 are one bordered system for the accelerations and the multipliers:

    M q̈ − Aᵀ λ = Q + ∂T/∂q − (∂²T/∂q̇∂q) q̇ − ∂²T/∂q̇∂t
    A q̈        = −(∂f/∂q) q̇ − ∂f/∂t

With quasi-velocities u, q̇ = A(q, t) u (`kinematics`), the same stands for u in place of q̇: M = ∂²T/∂u², the
constraints are f(q, u, t) = 0, and the right side has the forces of Boltzmann and Hamel.

Everything here is a function of one lane, with a component an array of its own: under `jax.vmap` no batch of small
matrices is ever formed, and no library is called to solve them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.core import Tracer

from jaxnh.systems.elimination import as_float, eliminate, is_positive_definite, minus, times
from jaxnh.systems.kinematics import Kinematics
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import constants, slope

Energy = Callable[[Vector, Vector, Number], Number]
"""(q, q̇, t) to a number."""
Components = Callable[[Vector, Vector, Number], Number]
"""(q, q̇, t) to a sequence of numbers."""


class Equations(NamedTuple):
    """Equations of a system: kinetic energy, generalised forces, and constraints (none where it is free).

    Attributes:
        T: kinetic energy, (q, q̇, t) to a number.
        Q: generalised forces, (q, q̇, t) to k numbers.
        f: constraint functions, (q, q̇, t) to m numbers that are to be zero.
        kinematics: of quasi-velocities, which T, Q and f then have in place of q̇; None where velocities are q̇.
        definite: whether M is known to be positive definite, though not constant.
    """

    T: Energy
    Q: Components
    f: Components | None = None
    kinematics: Kinematics | None = None
    definite: bool = False

    def rates(self, q: Vector, v: Vector, t: Number) -> Vector:
        """q̇ at a state."""
        return tuple(v) if self.kinematics is None else self.kinematics.rates(q, v, t)


class Accelerations(NamedTuple):
    """Solution of the bordered system of one state.

    Attributes:
        a: k accelerations q̈.
        multipliers: m multipliers λ.
        singular: whether the matrix has no inverse in double precision.
    """

    a: Vector
    multipliers: Vector
    singular: Number


def _flat(function: Callable[[Vector, Vector, Number], Number], k: int) -> Callable[..., Number]:
    """Return the function of its components (q, q̇, t), k of them coordinates."""
    return lambda *at: function(at[:k], at[k:-1], at[-1])


def along_motion(function: Callable[..., Number], at: Vector, rates: Vector) -> Number:
    """(∂/∂q) q̇ + ∂/∂t of a function at components `at` = (q, q̇, t), or (q, u, t)."""
    k = len(rates)
    v = at[k:-1]

    def moved(*q_and_t: Number) -> Number:
        return function(*q_and_t[:k], *v, q_and_t[k])

    return jax.jvp(moved, (*at[:k], at[-1]), (*rates, jnp.ones_like(at[-1])))[1]


def constraint_functions(equations: Equations, k: int) -> Callable[..., Vector]:
    """f of its components (q, q̇, t), k of them coordinates, as a tuple; empty where the system is free."""
    f = equations.f
    return (lambda *at: ()) if f is None else (lambda *at: tuple(f(at[:k], at[k:-1], at[-1])))


def mass_matrix(equations: Equations, at: Vector, k: int) -> list[list[Number]]:
    """M = ∂²T/∂q̇², a row a velocity, at components (q, q̇, t), k of them coordinates."""
    energy, n = _flat(equations.T, k), len(at) - k - 1

    def momentum(j: int) -> Callable[..., Number]:
        return lambda *at: slope(energy, at, k + j)

    upper = {(i, j): slope(momentum(j), at, k + i) for j in range(n) for i in range(j + 1)}
    return [[upper[min(i, j), max(i, j)] for j in range(n)] for i in range(n)]


def constraint_slopes(equations: Equations, at: Vector, k: int) -> list[Vector]:
    """A = ∂f/∂q̇, m rows, at components (q, q̇, t), k of them coordinates."""
    f = constraint_functions(equations, k)
    columns = [slope(f, at, j) for j in range(k, len(at) - 1)]
    return [tuple(column[i] for column in columns) for i in range(len(columns[0]))]


def accelerations(
    equations: Equations, q: Vector, v: Vector, t: Number, active: Sequence[Number] | None = None
) -> Accelerations:
    """q̈ and λ at a state by one bordered solve; components of any one shape.

    The multipliers are those of (6): the reaction on coordinate i is Σ_j λ_j ∂f_j/∂q̇_i.

    Args:
        active: 1 for each constraint that holds and 0 for one that does not, whose multiplier is 0; None: all hold.
    """
    k, n = len(q), len(v)
    at = (*q, *v, t)
    f = constraint_functions(equations, k)
    mass, slopes = matrices(equations, at, k)
    right = applied_forces(equations, q, v, t)
    turning = [-rate for rate in (along_motion(f, at, equations.rates(q, v, t)) if slopes else ())]
    right += turning if active is None else [_share(w, rate) for w, rate in zip(active, turning, strict=True)]
    (solution,), singular = solve_bordered(equations, mass, slopes, [right], active)
    solution = [x + jnp.zeros_like(q[0]) if isinstance(x, float) else x for x in solution]
    return Accelerations(tuple(solution[:n]), tuple(-x for x in solution[n:]), singular)


def applied_forces(equations: Equations, q: Vector, v: Vector, t: Number) -> list[Number]:
    """Forces without those of the constraints, a component a velocity.

    Q + ∂T/∂q − (∂²T/∂q̇∂q) q̇ − ∂²T/∂q̇∂t; with quasi-velocities those of Boltzmann and Hamel are added.
    """
    k, n, kinematics = len(q), len(v), equations.kinematics
    energy = _flat(equations.T, k)

    def parts(*at: Number) -> tuple[list[Number], ...]:
        momenta = [lambda *at, i=i: slope(energy, at, k + i) for i in range(n)]
        rates = equations.rates(at[:k], at[k:-1], at[-1])
        inertia = [along_motion(momentum, at, rates) for momentum in momenta]
        if kinematics is None:
            return inertia, [slope(energy, at, i) for i in range(k)]
        pull = kinematics.directional_slopes(energy, at, k)
        return inertia, pull, kinematics.hamel_forces([momentum(*at) for momentum in momenta], at, k)

    forces = [as_float(force) for force in equations.Q(q, v, t)]
    inertia, *added = _read(parts, (*q, *v, t))
    total = []
    for j, force in enumerate(forces):
        for each in added:
            inertia[j] = minus(inertia[j], each[j])
        total.append(minus(force, inertia[j]))
    return total


def matrices(equations: Equations, at: Vector, k: int) -> tuple[list[list[Number]], list[list[Number]]]:
    """M and A at components (q, q̇, t), floats where they are known while the program is traced."""
    return _read(
        lambda *at: (mass_matrix(equations, at, k), [list(a) for a in constraint_slopes(equations, at, k)]), at
    )


def _read(function: Callable[..., Any], at: Vector) -> Any:
    """A function's results at components, as floats where they are known while a program is traced.

    What does not depend on the state is then a number, and no part of the program. Outside of one everything is known,
    and nothing is to be kept of it.
    """
    result = function(*at)
    if not isinstance(at[0], Tracer):
        return result
    known, leaves = constants(function, *at), jax.tree.leaves(result)
    kept = jax.tree.leaves(known, is_leaf=lambda leaf: leaf is None)
    values = [leaf if number is None else number for leaf, number in zip(leaves, kept, strict=True)]
    return jax.tree.unflatten(jax.tree.structure(result), values)


def solve_bordered(
    equations: Equations,
    mass: list[list[Number]],
    slopes: list[list[Number]],
    rights: list[list[Number]],
    active: Sequence[Number] | None = None,
) -> tuple[list[list[Number]], Number]:
    """Solutions (x, −λ) of [M, Aᵀ; A, 0] for right sides of k + m components, and whether it is singular.

    The row and the column of a constraint that is not active are those of λ = 0.
    """
    m, ends = len(slopes), [0.0] * len(slopes)
    if active is not None:
        slopes = [[_share(w, a) for a in row] for w, row in zip(active, slopes, strict=True)]
        size = sum(jnp.abs(row[i]) for i, row in enumerate(mass))
        ends = [0.0 if isinstance(w, float) and w == 1.0 else -size * (1.0 - w) for w in active]
    matrix = [[*row, *(a[i] for a in slopes)] for i, row in enumerate(mass)]
    matrix += [[*a, *(ends[j] if i == j else 0.0 for i in range(m))] for j, a in enumerate(slopes)]
    return eliminate(matrix, rights, definite=equations.definite or is_positive_definite(mass))


def _share(weight: Number, x: Number) -> Number:
    return x if isinstance(weight, float) and weight == 1.0 else times(weight, x)
