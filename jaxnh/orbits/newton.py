"""Periodic orbits of the strobe map: Newton for many lanes at once, near a doubling too.

Lane functions here are pure and run under `jax.vmap`; which lanes take another step is for the host to say.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxnh.maps.batching import as_batched
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import ReturnMap
from jaxnh.systems.elimination import eliminate
from jaxnh.systems.flow import Parameters

_NEWTON_STEPS = 12
# Residuals and steps in sizes of the motion.
_NEWTON_TOLERANCE = 1e-9  # residual after which one more step reaches the rounding floor
_LARGEST_STEP = 0.25
_PATIENCE, _NEAR = 4, 1e-2  # after so many steps a lane with a residual above this is given up
# Gauss–Lobatto rule of five points on [−1, 1], exact to degree 7.
_NODES, _WEIGHTS = (-1.0, -math.sqrt(3 / 7), 0.0, math.sqrt(3 / 7), 1.0), (0.1, 49 / 90, 32 / 45, 49 / 90, 0.1)
_DOUBLED_STEPS = 16


class Orbit(NamedTuple):
    """A point of a period-n orbit of one lane, or of many: each with the lanes as first axis.

    Attributes:
        u: section coordinates, shape (d,).
        residual: largest component of Pⁿ(u) − u, in the sizes of the motion that Newton was given.
        monodromy: ∂Pⁿ/∂u, shape (d, d).
        steps: Newton steps taken.
    """

    u: Any
    residual: Any
    monodromy: Any
    steps: Any


class NewtonStep(NamedTuple):
    """Newton's step on Pⁿ(u) = u and its residual, at a point of one lane.

    Attributes:
        residual: largest component of Pⁿ(u) − u, in sizes of the motion.
        monodromy: ∂Pⁿ/∂u, shape (d, d).
        step: to the next point, shape (d,).
    """

    residual: Any
    monodromy: Any
    step: Any


def look(
    strobe: ReturnMap, n: ArrayLike, u: Float[Array, " d"], p: Parameters, size: Float[Array, " d"] | float = 1.0
) -> NewtonStep:
    """The residual of Pⁿ at u of shape (d,), and Newton's step from there; n may be traced.

    Args:
        size: of the motion in each section coordinate, (d,): what is near is so in these units.
    """
    wrap, one = strobe.chart.wrap, jnp.eye(strobe.chart.dimension)
    image, monodromy, _ = derivatives(strobe, n, u, p)
    step = solve(monodromy - one, wrap(u - image))
    step = step * jnp.minimum(1.0, _LARGEST_STEP / jnp.max(_unscale(size, jnp.abs(step))))
    return NewtonStep(jnp.max(_unscale(size, jnp.abs(wrap(image - u)))), monodromy, step)


def find_orbits(
    look_at: Callable[[Float[np.ndarray, "some d"], Int[np.ndarray, " some"]], NewtonStep],
    u: Float[np.ndarray, "lanes d"],
) -> Orbit:
    """Newton on Pⁿ(u; p) = u for many lanes at once, from their points u; lanes that are done wait for no others.

    A lane that does not converge shows it by its residual (NaN where its state is not finite). Newton does not care
    whether the orbit is stable, nor how slowly the map itself would approach it.

    Args:
        look_at: `look` at points of some lanes, whose numbers it is given too.
        u: where to begin.
    """
    (lanes, d), u = u.shape, np.array(u)
    residual, monodromy, step = np.full(lanes, np.nan), np.full((lanes, d, d), np.nan), np.zeros((lanes, d))
    steps, last, open_ = np.zeros(lanes, np.int32), np.zeros(lanes, np.bool_), np.arange(lanes)
    while len(open_):
        residual[open_], monodromy[open_], step[open_] = look_at(u[open_], open_)
        hopeless = (steps >= _PATIENCE) & (residual > _NEAR)
        unfinished = ~last & (steps < _NEWTON_STEPS) & np.isfinite(residual) & ~hopeless
        open_ = open_[unfinished[open_]]
        last[open_] = residual[open_] < _NEWTON_TOLERANCE
        u[open_] += step[open_]
        steps[open_] += 1
    return Orbit(u, residual, monodromy, steps)


class _Branches(NamedTuple):
    """Newton's unknowns of `find_doubled` and how it goes: two points m ± a v, a², steps taken, last two step sizes."""

    m: Any
    v: Any
    square: Any
    steps: Any
    size: Any
    before: Any


def find_doubled(
    strobe: ReturnMap, n: ArrayLike, u: Float[Array, " d"], p: Parameters, size: Float[Array, " d"] | float = 1.0
) -> Orbit:
    """An orbit of period 2n near the doubling that it was born in, from a point of it that `find_orbits` gives.

    There P²ⁿ(u) = u has three roots that grow together, the orbits of period 2n and n: a residual of 10⁻⁹ is an error
    of 10⁻³ in u, and rounding alone leaves ε/√(1 − μ) in the multiplier. With Q = Pⁿ and the two points m ± a v of the
    orbit, ℓ·v = 1, the orbit of period n is divided out:

        ½ (Q(m + a v) + Q(m − a v)) = m,    A v = −v,  A = ½ ∫ DQ(m + a t v) dt over [−1, 1],

    since Q(m + a v) − Q(m − a v) = 2a A v. Both depend on a through a² alone, and Newton in (m, v, a²) is regular at
    a = 0, so that a² and with it 1 − μ are right to rounding. The integral is a Gauss–Lobatto sum, wrong by O(a⁸): for
    small a. Of the second and third derivatives, which only the steps need, finite differences over the first a do.

    Args:
        size: of the motion in each section coordinate, (d,): all is solved in these units.

    Returns:
        The orbit of period 2n; the residual is infinite where Newton has not settled.
    """
    chart, d = strobe.chart, strobe.chart.dimension
    one = jnp.eye(d)
    half = 0.5 * _unscale(size, chart.wrap(u - derivatives(strobe, n, u, p).image))
    first = jnp.sqrt(jnp.sum(half**2))
    normal = half / first
    _, around = _images_on_line(strobe, n, u - _scale(size, half), first * normal, p, size)
    bend = (around[-1] - around[0]) / (2.0 * first)
    cubic = (_mean(around) - around[2]) @ normal / first**2

    def improve(at: _Branches) -> _Branches:
        m, v, square, steps, last, _ = at
        image, matrices = _images_on_line(strobe, n, m, jnp.sqrt(square) * v, p, size)
        ends, whole = 0.5 * (matrices[0] + matrices[-1]), _mean(matrices)
        rows = [
            jnp.concatenate([ends - one, square * bend, 0.5 * (bend @ v)[:, None]], axis=1),
            jnp.concatenate([bend, whole + one, cubic[:, None]], axis=1),
            jnp.concatenate([jnp.zeros(d), normal, jnp.zeros(1)])[None],
        ]
        middle = 0.5 * _unscale(size, chart.wrap(image[0] - m) + chart.wrap(image[-1] - m))
        missing = jnp.concatenate([middle, whole @ v + v, (normal @ v - 1.0)[None]])
        step = solve(jnp.concatenate(rows), -missing)
        moved = square + step[-1]
        moved = jnp.where(moved > 0.0, moved, square / 16)
        return _Branches(m + _scale(size, step[:d]), v + step[d:-1], moved, steps + 1, jnp.max(jnp.abs(step)), last)

    def unfinished(at: _Branches) -> Array:
        settled = (at.size < _NEWTON_TOLERANCE) & (at.size >= 0.25 * at.before)
        return (at.steps < _DOUBLED_STEPS) & ~settled & ~jnp.isnan(at.size)

    far = jnp.full((), jnp.inf)
    begun = _Branches(u - _scale(size, half), normal, first**2, jnp.int32(0), far, far)
    final = lax.while_loop(unfinished, improve, as_batched(begun, u[0]))
    u = final.m + _scale(size, jnp.sqrt(final.square) * final.v)
    image, monodromy, _ = derivatives(strobe, 2 * jnp.asarray(n), u, p)
    residual = jnp.max(_unscale(size, jnp.abs(chart.wrap(image - u))))
    return Orbit(u, jnp.where(final.size < _NEWTON_TOLERANCE, residual, jnp.inf), monodromy, final.steps)


def _images_on_line(
    strobe: ReturnMap, n: ArrayLike, m: Array, way: Array, p: Parameters, size: Float[Array, " d"] | float
) -> tuple[Array, Array]:
    """Pⁿ and ∂Pⁿ/∂u at the nodes of the line from m − way to m + way: (5, d) and (5, d, d).

    The way and the derivatives are in units of the sizes (d,), m and Pⁿ are not.
    """
    way = _scale(size, way)
    image, matrices = jax.vmap(lambda t: derivatives(strobe, n, m + t * way, p)[:2])(jnp.array(_NODES))
    return image, matrices if isinstance(size, (int, float)) else matrices * jnp.outer(1.0 / size, size)[None]


def _unscale(size: Array | float, difference: Array) -> Array:
    """A difference (d,) in units of sizes; as it is where there are none, so that the program is as without."""
    return difference if isinstance(size, (int, float)) else difference / size


def _scale(size: Array | float, difference: Array) -> Array:
    """A difference (d,) given in units of sizes."""
    return difference if isinstance(size, (int, float)) else difference * size


def _mean(matrices: Array) -> Array:
    """Mean over the line of matrices at its nodes."""
    return 0.5 * jnp.tensordot(jnp.array(_WEIGHTS), matrices, axes=1)


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
