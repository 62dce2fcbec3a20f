"""Periodic orbits of the strobe map: Newton for many lanes at once, and doubling points by multiple shooting.

Lane functions here are pure and run under `jax.vmap`; the solution of the one large system of a doubling point, whose
size changes with the period, is host code.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import Strobe
from jaxnh.systems.elimination import eliminate
from jaxnh.systems.flow import Parameters

_NEWTON_STEPS = 12
_NEWTON_TOLERANCE = 1e-9  # residual after which one more step reaches the rounding floor
_LARGEST_STEP = 0.25
_PATIENCE, _NEAR = 4, 1e-2  # after so many steps a lane with a residual above this is given up


class Orbit(NamedTuple):
    """A point of a period-n orbit of one lane.

    Attributes:
        u: section coordinates, shape (d,).
        residual: largest component of Pⁿ(u) − u.
        monodromy: ∂Pⁿ/∂u, shape (d, d).
        steps: Newton steps taken.
    """

    u: Any
    residual: Any
    monodromy: Any
    steps: Any


def find_orbit(strobe: Strobe, n: ArrayLike, u: Float[Array, " d"], p: Parameters) -> Orbit:
    """Newton on Pⁿ(u; p) = u for one lane, from u of shape (d,); n may be traced.

    Stops by itself; a lane that does not converge shows it by its residual (NaN where its state is not finite).
    Newton does not care whether the orbit is stable, nor how slowly the map itself would approach it.
    """

    wrap, one = strobe.system.wrap, jnp.eye(strobe.system.dimension)

    def look(u: Array, steps: Array) -> tuple[Orbit, Array]:
        image, monodromy, _ = derivatives(strobe, n, u, p)
        return Orbit(u, jnp.max(jnp.abs(wrap(image - u))), monodromy, steps), image

    def improve(carry: tuple[Orbit, Array, Array]) -> tuple[Orbit, Array, Array]:
        orbit, image, _ = carry
        step = solve(orbit.monodromy - one, wrap(orbit.u - image))
        step = step * jnp.minimum(1.0, _LARGEST_STEP / jnp.max(jnp.abs(step)))
        last = orbit.residual < _NEWTON_TOLERANCE
        return *look(orbit.u + step, orbit.steps + 1), last

    def unfinished(carry: tuple[Orbit, Array, Array]) -> Array:
        orbit, _, last = carry
        hopeless = (orbit.steps >= _PATIENCE) & (orbit.residual > _NEAR)
        return ~last & (orbit.steps < _NEWTON_STEPS) & jnp.isfinite(orbit.residual) & ~hopeless

    return lax.while_loop(unfinished, improve, (*look(u, jnp.int32(0)), jnp.bool_(False)))[0]


def solve(matrix: Array, right: Array) -> Array:
    """Solution of a small system, (d, d) and (d,) to (d,): batched LAPACK calls are slow on these."""
    d = len(right)
    if d == 3:
        return solve3(matrix, right)
    (solution,), _ = eliminate([[matrix[i, j] for j in range(d)] for i in range(d)], [[right[i] for i in range(d)]])
    return jnp.stack(solution)


def solve3(matrix: Array, right: Array) -> Array:
    """Solution of a 3×3 system by cofactors, (3, 3) and (3,) to (3,)."""
    r0, r1, r2 = matrix
    c0, c1, c2 = jnp.cross(r1, r2), jnp.cross(r2, r0), jnp.cross(r0, r1)
    return (c0 * right[0] + c1 * right[1] + c2 * right[2]) / jnp.dot(r0, c0)
