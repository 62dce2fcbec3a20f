"""Motions on a manifold of dimension two, with their distance from it.

Along a motion goes what half as many steps leave at each part of it, by the linearised flow. Only what is across the
manifold is a distance from it. Its tangent plane is spanned by the field and by a tangent that goes along as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxnh.maps.section import rates
from jaxnh.solvers import RUNGE_KUTTA
from jaxnh.systems.flow import Flow, Parameters

_METHOD = RUNGE_KUTTA["dopri8"]
ORDER = _METHOD.convergence_order
"""Order of the steps."""

ROUNDING = 1e-15
"""Share of a point that a part of a motion leaves at most."""

_MORE = 64  # times the steps, where the field changes as fast as next to an equilibrium
_BENT = 1e-3  # of the chord of a part: where half the steps leave more, motions are not followed


AnyArray = Array | np.ndarray
"""Arrays of one lane in a program, or of many on the host."""


class Front(NamedTuple):
    """The end of a motion so far, in sizes of the coordinates.

    Attributes:
        point: (d,).
        tangent: of the manifold, not along the motion, (d,).
        error: from the manifold, (d,).
        normal: a direction that is not tangent, (d,).
        rounding: distance from the manifold that rounding may have made.
        part: length of a part.
        followed: whether the motion is followed on.
    """

    point: Float[AnyArray, " d"]
    tangent: Float[AnyArray, " d"]
    error: Float[AnyArray, " d"]
    normal: Float[AnyArray, " d"]
    rounding: Float[AnyArray, ""]
    part: Float[AnyArray, ""]
    followed: Bool[AnyArray, ""]


class MotionPoints(NamedTuple):
    """Points of a motion at the ends of its parts, the first left out, not numbers from where it is not followed.

    Attributes:
        points: (parts, d), in sizes.
        error: distance of each from the manifold, (parts,), in sizes.
        front: at the last one.
    """

    points: Float[Array, "parts d"]
    error: Float[Array, " parts"]
    front: Front


def follow_motion(
    flow: Flow,
    steps: ArrayLike,
    sign: ArrayLike,
    front: Front,
    size: Float[Array, " d"],
    p: Parameters,
    parts: int,
    timed: bool,
) -> MotionPoints:
    """Return the next points of a motion of one lane, with so many and twice as many steps for each part of it.

    Parts on which the field changes by more than itself have as many times the steps, as beside an equilibrium.

    Args:
        flow: without a clock.
        steps: of a part; points are those of twice as many.
        sign: 1 forward in time, −1 backward.
        front: where it begins.
        size: of the coordinates.
        p: parameters.
        parts: points of the motion.
        timed: whether parts are so long in time, and not as arcs.
    """

    def along(z: Float[AnyArray, " d"]) -> Float[Array, " d"]:
        rate = sign * jnp.stack(rates(flow, flow.chart.state(z * size), p)) / size
        return jnp.asarray(rate if timed else rate / jnp.linalg.norm(rate))

    def with_tangents(_: Any, y: tuple[Array, Array]) -> tuple[Array, Array]:
        rate, slope = jax.linearize(along, y[0])
        return rate, jax.vmap(slope)(y[1])

    def advanced(count: Any, field: Callable[[Any, Any], Any], y: Any) -> Any:
        step = front.part / jnp.asarray(count, front.part.dtype)
        return lax.fori_loop(0, count, lambda _, y: _METHOD.rolled_stages(field, step, y), y)

    def part(front: Front, _: None) -> tuple[Front, tuple[Array, Array]]:
        start = front.point, jnp.stack([front.tangent, front.error, front.normal])
        turned = front.part * jnp.linalg.norm(jax.jacfwd(along)(front.point))
        count = steps * jnp.clip(jnp.ceil(turned), 1, _MORE).astype(jnp.int32)
        coarse, (tangent, error, normal) = advanced(count, with_tangents, start)
        z = advanced(2 * count, lambda _, z: along(z), front.point)
        left = coarse - z
        tangent, error, normal = _frame(along(z), tangent, error + left, normal)
        grown = jnp.linalg.norm(normal)
        rounding = grown * front.rounding + ROUNDING * (1.0 + jnp.linalg.norm(z))
        followed = front.followed & (jnp.linalg.norm(left) < _BENT * jnp.linalg.norm(z - front.point))
        shown = z, jnp.linalg.norm(error) + rounding
        after = Front(z, tangent, error, normal / grown, rounding, front.part, followed)
        return after, tuple(jnp.where(followed, each, jnp.nan) for each in shown)  # pyright: ignore[reportReturnType]

    tangent, error, normal = _frame(along(front.point), front.tangent, front.error, front.normal)
    first = front._replace(tangent=tangent, error=error, normal=normal / jnp.linalg.norm(normal))
    end, (points, distance) = lax.scan(part, first, None, length=parts)
    return MotionPoints(points, distance, end)


def _frame(
    way: Float[AnyArray, " d"],
    tangent: Float[AnyArray, " d"],
    error: Float[AnyArray, " d"],
    normal: Float[AnyArray, " d"],
) -> tuple[Float[AnyArray, " d"], Float[AnyArray, " d"], Float[AnyArray, " d"]]:
    """Return the unit tangent at right angles to the motion, and the parts of two vectors across the tangent plane."""
    way = way / jnp.linalg.norm(way)
    tangent = _orthogonal_part(tangent, way)
    tangent = tangent / jnp.linalg.norm(tangent)
    return tangent, _orthogonal_part(error, way, tangent), _orthogonal_part(normal, way, tangent)


def _orthogonal_part(vector: Float[AnyArray, " d"], *units: Float[AnyArray, " d"]) -> Float[AnyArray, " d"]:
    """Return the part of a vector that is orthogonal to unit vectors, which are so to each other."""
    for unit in units:
        vector = vector - (vector @ unit) * unit
    return vector
