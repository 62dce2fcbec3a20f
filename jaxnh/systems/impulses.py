"""Sudden changes of velocity: projections on constraints, constraints that begin, and impacts on walls.

An impulse along Aᵀ Λ changes velocities by M⁻¹ Aᵀ Λ. A constraint that begins brings the velocity to the nearest one
that keeps it, in the metric of the mass, and of constraints linear and homogeneous in the velocity the kinetic energy
that is lost is that of the velocity lost (Carnot's theorem; Pars, A Treatise on Analytical Dynamics, 1965, ch. 14).
An impact on a wall of height h turns ḣ over to −r ḣ, r being the coefficient of restitution, by an impulse along ∂ḣ/∂v
that respects the constraints (Brogliato, Nonsmooth Mechanics, 2016).

Everything here is a function of one lane, as in `jourdain`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxnh.systems.elimination import largest_of
from jaxnh.systems.jourdain import (
    Equations,
    along_motion,
    constraint_functions,
    matrices,
    solve_bordered,
)
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import slope

LARGEST_DRIFT = 1e-9
"""Largest f after a projection, in units of |A v| + 1."""

_PROJECTIONS = 2  # the first leaves the square of the drift, the second its cube: rounding, for any drift worth having
_APPROACHES = 24  # to constraints that are not linear, each nearer by the share that their curvature leaves

Active = Sequence[Number] | None
"""1 for each constraint that holds and 0 for one that does not; None: all hold."""


class Projection(NamedTuple):
    """Velocities on the constraints, and what they were off them.

    Attributes:
        v: velocities.
        drift: largest |f| before, of the constraints that hold.
        left: largest |f| after, in units of |A v| + 1.
        singular: whether the constraints are not independent.
    """

    v: Vector
    drift: Number
    left: Number
    singular: Number


def project_velocities(equations: Equations, q: Vector, v: Vector, t: Number, active: Active = None) -> Projection:
    """The velocities brought back to f = 0 along M⁻¹ Aᵀ: Newton on the multipliers with the matrix of the state itself.

    Args:
        equations: T, Q and f; there are some constraints.
        active: of the constraints.
    """
    f, n = _holding(equations, len(q), active), len(v)
    mass, slopes = matrices(equations, (*q, *v, t), len(q))
    ends = [[float(i == n + j) for i in range(n + len(slopes))] for j in range(len(slopes))]
    ways, singular = solve_bordered(equations, mass, slopes, ends, active)
    residuals = f(*q, *v, t)
    drift = largest_of(list(residuals))
    for _ in range(_PROJECTIONS):
        v = tuple(v[i] - sum(r * way[i] for r, way in zip(residuals, ways, strict=True)) for i in range(n))
        residuals = f(*q, *v, t)
    sizes = [1.0 + sum(jnp.abs(a * vi) for a, vi in zip(row, v, strict=True)) for row in slopes]
    left = largest_of([r / size for r, size in zip(residuals, sizes, strict=True)])
    return Projection(v, drift, left, singular)


def constrained_velocities(
    equations: Equations, q: Vector, v: Vector, t: Number, active: Active, *, linear: bool
) -> Vector:
    """The velocities on f = 0 that are nearest to those of a state in the metric of the mass.

    Args:
        linear: whether f is linear in the velocities, so that one step leads there.
    """
    f, n = _holding(equations, len(q), active), len(v)

    def nearer(_: Number, u: Vector) -> Vector:
        at = (*q, *u, t)
        mass, slopes = matrices(equations, at, len(q))
        ways = [sum(a * (x - y) for a, x, y in zip(row, v, u, strict=True)) for row in slopes]
        if active is not None:
            ways = [w * x for w, x in zip(active, ways, strict=True)]
        right = [0.0] * n + [value + way for value, way in zip(f(*at), ways, strict=True)]
        (less,), _ = solve_bordered(equations, mass, slopes, [right], active)
        return tuple(x - dx for x, dx in zip(v, less, strict=False))

    return nearer(0, v) if linear else lax.fori_loop(0, _APPROACHES, nearer, tuple(v))


def reflected_velocities(
    equations: Equations,
    wall: Callable[[Vector, Vector, Number], Number],
    restitution: Number,
    q: Vector,
    v: Vector,
    t: Number,
    active: Active,
) -> Vector:
    """The velocities after an impact on a wall, a height (q, v, t) that does not depend on v."""
    at, k = (*q, *v, t), len(q)

    def speed(*at: Number) -> Number:
        q, v, t = at[:k], at[k:-1], at[-1]
        return along_motion(lambda *at: wall(at[:k], at[k:-1], at[-1]), at, equations.rates(q, v, t))

    mass, slopes = matrices(equations, at, k)
    normal = [slope(speed, at, k + j) for j in range(len(v))]
    right = [*normal, *[0.0] * len(slopes)]
    (way,), _ = solve_bordered(equations, mass, slopes, [right], active)
    change = (1.0 + restitution) * speed(*at) / sum(n * w for n, w in zip(normal, way, strict=False))
    return tuple(x - change * w for x, w in zip(v, way, strict=False))


def _holding(equations: Equations, k: int, active: Active) -> Callable[..., Vector]:
    """f of its components, zero where a constraint does not hold."""
    f = constraint_functions(equations, k)
    if active is None:
        return f
    return lambda *at: tuple(weight * value for weight, value in zip(active, f(*at), strict=True))
