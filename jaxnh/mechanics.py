"""Equations of motion of any mechanical system from T, Q and f, by Jourdain's principle and automatic differentiation.

A system has k coordinates q, kinetic energy T(q, q̇, t), generalised forces Q(q, q̇, t) and m constraints
f(q, q̇, t) = 0, linear or nonlinear in q̇. With A = ∂f/∂q̇ (m, k) and M = ∂²T/∂q̇² (k, k), equations (3) to (6) of the
paper and df/dt = 0 are one bordered system for the accelerations and the multipliers:

    M q̈ − Aᵀ λ = Q + ∂T/∂q − (∂²T/∂q̇∂q) q̇ − ∂²T/∂q̇∂t
    A q̈        = −(∂f/∂q) q̇ − ∂f/∂t

Its exact flow keeps f, on the constraint and off it. A computed step leaves f = 0 by the error of the method, and
`NonholonomicSystem.project` goes back along M⁻¹ Aᵀ, which is orthogonal in the metric of the mass.

Everything here is a function of one lane, with a component an array of its own: under `jax.vmap` no batch of small
matrices is ever formed, and no library is called to solve them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.systems import Vector

Energy = Callable[[Vector, Vector, Any], Any]
"""(q, q̇, t) to a number."""
Components = Callable[[Vector, Vector, Any], Any]
"""(q, q̇, t) to a sequence of numbers."""

FAULTS = ("none", "singular", "off_constraint", "not_finite")
"""Meanings of the codes in `Motion.watch`: why a lane has failed, 0 where it has not."""

_SINGULAR, _OFF, _NOT_FINITE = 1.0, 2.0, 3.0
_SMALLEST_PIVOT = 64 * np.finfo(float).eps  # of the largest entry of the matrix: below it, the pivot is rounding
_PROJECTIONS = 2  # the first leaves the square of the drift, the second its cube: rounding, for any drift worth having
_LARGEST_DRIFT = 1e-9  # of f after projection, in units of |A q̇| + 1


class Equations(NamedTuple):
    """What a system is: kinetic energy, generalised forces, and constraints (none where it is free).

    Attributes:
        T: kinetic energy, (q, q̇, t) to a number.
        Q: generalised forces, (q, q̇, t) to k numbers.
        f: constraint functions, (q, q̇, t) to m numbers that are to be zero.
    """

    T: Energy
    Q: Components
    f: Components | None = None


class Motion(NamedTuple):
    """State of a lane.

    Attributes:
        q: k coordinates.
        v: k velocities q̇.
        watch: largest |f| before a projection so far, and the reason of its failure, a number of `FAULTS`.
    """

    q: Vector
    v: Vector
    watch: Vector


class Accelerations(NamedTuple):
    """Solution of the bordered system of one state.

    Attributes:
        a: k accelerations q̈.
        multipliers: m multipliers λ.
        singular: whether the matrix has no inverse in double precision.
    """

    a: Vector
    multipliers: Vector
    singular: Any


def slope(function: Callable[..., Any], at: Vector, i: int) -> Any:
    """∂function/∂at[i] at components `at`, the others being constants of the program."""
    one = jnp.ones_like(at[i])
    return jax.jvp(lambda x: function(*at[:i], x, *at[i + 1 :]), (at[i],), (one,))[1]


def _flat(function: Callable[[Vector, Vector, Any], Any], k: int) -> Callable[..., Any]:
    """The same function of its 2k + 1 components."""
    return lambda *at: function(at[:k], at[k : 2 * k], at[2 * k])


def _along_motion(function: Callable[..., Any], at: Vector, k: int) -> Any:
    """(∂/∂q) q̇ + ∂/∂t of a function at components `at` = (q, q̇, t)."""
    v = at[k : 2 * k]

    def moved(*q_and_t: Any) -> Any:
        return function(*q_and_t[:k], *v, q_and_t[k])

    return jax.jvp(moved, (*at[:k], at[2 * k]), (*v, jnp.ones_like(at[2 * k])))[1]


def _constraints(equations: Equations, k: int) -> Callable[..., Vector]:
    """f of its 2k + 1 components, as a tuple; empty where the system is free."""
    f = equations.f
    return (lambda *at: ()) if f is None else (lambda *at: tuple(f(at[:k], at[k : 2 * k], at[2 * k])))


def mass_matrix(equations: Equations, at: Vector, k: int) -> list[list[Any]]:
    """M = ∂²T/∂q̇², k rows of k, at components (q, q̇, t)."""
    energy = _flat(equations.T, k)

    def momentum(j: int) -> Callable[..., Any]:
        return lambda *at: slope(energy, at, k + j)

    upper = {(i, j): slope(momentum(j), at, k + i) for j in range(k) for i in range(j + 1)}
    return [[upper[min(i, j), max(i, j)] for j in range(k)] for i in range(k)]


def constraint_slopes(equations: Equations, at: Vector, k: int) -> list[Vector]:
    """A = ∂f/∂q̇, m rows of k, at components (q, q̇, t)."""
    f = _constraints(equations, k)
    columns = [slope(f, at, k + j) for j in range(k)]
    return [tuple(column[i] for column in columns) for i in range(len(columns[0]))]


def accelerations(equations: Equations, q: Vector, v: Vector, t: Any) -> Accelerations:
    """q̈ and λ at a state by one bordered solve; components of any one shape.

    The multipliers are those of (6): the reaction on coordinate i is Σ_j λ_j ∂f_j/∂q̇_i.
    """
    k = len(q)
    at = (*q, *v, t)
    energy, f = _flat(equations.T, k), _constraints(equations, k)
    forces = tuple(equations.Q(q, v, t))
    right = []
    for i in range(k):
        inertia = _along_motion(lambda *at, i=i: slope(energy, at, k + i), at, k)
        right.append(forces[i] + slope(energy, at, i) - inertia)
    slopes = constraint_slopes(equations, at, k)
    right += [-rate for rate in (_along_motion(f, at, k) if slopes else ())]
    (solution,), smallest = eliminate(_bordered(mass_matrix(equations, at, k), slopes), [right])
    return Accelerations(tuple(solution[:k]), tuple(solution[k:]), ~(smallest > _SMALLEST_PIVOT))


def _bordered(mass: list[list[Any]], slopes: list[Vector]) -> list[list[Any]]:
    """[M, −Aᵀ; A, 0]."""
    m = len(slopes)
    top = [[*row, *(-a[i] for a in slopes)] for i, row in enumerate(mass)]
    return top + [[*a, *[0.0] * m] for a in slopes]


def eliminate(matrix: list[list[Any]], rights: list[list[Any]]) -> tuple[list[list[Any]], Any]:
    """Solutions of a linear system for several right sides, by Gauss with partial pivoting, components of any shape.

    Rows change places by selection, lane by lane, so that the program has no branch and no indexing.

    Args:
        matrix: n rows of n components.
        rights: right sides of n components each.

    Returns:
        The solutions, and the smallest pivot in units of the matrix's largest entry. At zero they are not finite.
    """
    n = len(matrix)
    rows = [[*row, *(right[i] for right in rights)] for i, row in enumerate(matrix)]
    largest = _largest([entry for row in matrix for entry in row])
    smallest = None
    for c in range(n):
        for r in range(c + 1, n):
            swap = jnp.abs(rows[r][c]) > jnp.abs(rows[c][c])
            pairs = [(rows[c][j], rows[r][j]) for j in range(c, n + len(rights))]
            rows[c][c:] = [jnp.where(swap, lower, upper) for upper, lower in pairs]
            rows[r][c:] = [jnp.where(swap, upper, lower) for upper, lower in pairs]
        size = jnp.abs(rows[c][c])
        smallest = size if smallest is None else jnp.minimum(smallest, size)
        for r in range(c + 1, n):
            factor = rows[r][c] / rows[c][c]
            rows[r][c + 1 :] = [x - factor * y for x, y in zip(rows[r][c + 1 :], rows[c][c + 1 :], strict=True)]
    solutions = []
    for s in range(n, n + len(rights)):
        solution: list[Any] = [None] * n
        for c in reversed(range(n)):
            known = sum((rows[c][j] * solution[j] for j in range(c + 1, n)), start=0.0)
            solution[c] = (rows[c][s] - known) / rows[c][c]
        solutions.append(solution)
    return solutions, smallest / largest


def _largest(values: list[Any]) -> Any:
    """Largest modulus of some components."""
    largest = jnp.abs(values[0])
    for value in values[1:]:
        largest = jnp.maximum(largest, jnp.abs(value))
    return largest


# ---- a system of lanes


class NonholonomicSystem(eqx.Module):
    """Any system of T, Q and f whose lanes differ in one parameter; made by `nonholonomic_system`.

    Attributes:
        define: parameters by name to the system's definition, whose `T`, `Q` and `f` are read; called in every lane.
        parameters: all parameters by name; that of the sweep is replaced by the lane's own.
        swept: name of the parameter that differs from lane to lane.
        names: names of the k coordinates.
        constraints: number m of constraints.
        period: strobe period.
    """

    define: Callable[..., Mapping[str, Any]] = eqx.field(static=True)
    parameters: dict[str, ArrayLike]
    swept: str = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    constraints: int = eqx.field(static=True)
    period: float = eqx.field(static=True)

    def equations(self, b: ArrayLike) -> Equations:
        """T, Q and f of a lane, whose swept parameter is b."""
        definition = self.define(**{**self.parameters, self.swept: b})
        return Equations(definition["T"], definition["Q"], definition.get("f"))

    def vector_field(self, t: ArrayLike, state: Motion, b: ArrayLike) -> Motion:
        """Time derivative of a state; a singular matrix makes the rate of the reason not a number."""
        solved = accelerations(self.equations(b), state.q, state.v, t)
        zero = jnp.zeros_like(state.q[0])
        return Motion(state.v, solved.a, (zero, jnp.where(solved.singular, jnp.nan, zero)))

    def divergence(self, t: ArrayLike, state: Motion, b: ArrayLike) -> Any:
        """Σ ∂q̈_i/∂q̇_i; its mean is the sum of the 2k − m Lyapunov exponents, as those across f = 0 are zero."""
        equations, k = self.equations(b), len(state.q)

        def acceleration(i: int) -> Callable[..., Any]:
            return lambda *v: accelerations(equations, state.q, v, t).a[i]

        return sum(slope(acceleration(i), tuple(state.v), i) for i in range(k))

    def multipliers(self, t: ArrayLike, state: Motion, b: ArrayLike) -> Vector:
        """The m multipliers λ of (6)."""
        return accelerations(self.equations(b), state.q, state.v, t).multipliers

    def residuals(self, t: ArrayLike, state: Motion, b: ArrayLike) -> Vector:
        """The m values of f, zero on the constraints."""
        return _constraints(self.equations(b), len(state.q))(*state.q, *state.v, t)

    def project(self, t: ArrayLike, state: Motion, b: ArrayLike) -> Motion:
        """The state brought back to f = 0 along M⁻¹ Aᵀ, or marked as failed: not a number from there on.

        Newton on the multipliers with the matrix of the state itself. The largest |f| found here is kept in `watch`.
        """
        equations, k = self.equations(b), len(state.q)
        q, v, (drift, reason) = state
        f = _constraints(equations, k)
        finite = jnp.isfinite(sum(x * x for x in (*q, *v)))
        singular = jnp.isnan(reason)
        off = ~finite
        residuals = f(*q, *v, t)
        if residuals:
            at = (*q, *v, t)
            slopes = constraint_slopes(equations, at, k)
            ends = [[float(i == k + j) for i in range(k + len(slopes))] for j in range(len(slopes))]
            ways, smallest = eliminate(_bordered(mass_matrix(equations, at, k), slopes), ends)
            singular |= smallest <= _SMALLEST_PIVOT
            found = _largest(list(residuals))
            drift = jnp.where(found > drift, found, drift)
            for _ in range(_PROJECTIONS):
                v = tuple(v[i] - sum(r * way[i] for r, way in zip(residuals, ways, strict=True)) for i in range(k))
                residuals = f(*q, *v, t)
            sizes = [1.0 + sum(jnp.abs(a * vi) for a, vi in zip(row, v, strict=True)) for row in slopes]
            off = ~(_largest([r / size for r, size in zip(residuals, sizes, strict=True)]) < _LARGEST_DRIFT)
        code = jnp.where(off, jnp.where(finite, _OFF, _NOT_FINITE), jnp.zeros_like(drift))
        code = jnp.where(singular, _SINGULAR, code)
        reason = jnp.where(reason > 0.0, reason, code)
        q, v = (tuple(jnp.where(reason > 0.0, jnp.nan, x) for x in side) for side in (q, v))
        return Motion(q, v, lax.stop_gradient((drift, reason)))


def nonholonomic_system(
    define: Callable[..., Mapping[str, Any]], parameters: Mapping[str, float], swept: str
) -> NonholonomicSystem:
    """The system that a function of its parameters defines.

    Args:
        define: parameters by name to a mapping with `T`, `Q` and, unless the system is free, `f`: functions of
            (q, q̇, t), with q and q̇ tuples of k numbers; `coordinates`, their k names; and `period`, that of the strobe.
        parameters: values of all parameters, that of the sweep included.
        swept: name of the parameter that differs from lane to lane.
    """
    definition = define(**parameters)
    names = tuple(definition["coordinates"])
    zeros = (jnp.zeros(()),) * len(names)
    equations = Equations(definition["T"], definition["Q"], definition.get("f"))
    m = len(jax.eval_shape(lambda q, t: _constraints(equations, len(q))(*q, *q, t), zeros, zeros[0]))
    return NonholonomicSystem(define, dict(parameters), swept, names, m, float(definition["period"]))


def at_rest(k: int) -> Motion:
    """All zero: k coordinates and velocities of floats, and nothing to report."""
    return Motion((0.0,) * k, (0.0,) * k, (0.0, 0.0))
