"""Heights of walls and surfaces: a number each, or those of many surfaces as one vector.

What steps do with each height is some eighty equations. Of twenty surfaces, number by number, they are more than those
of the field, and are compiled for a minute; of a vector they are eighty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth
from jaxnh.systems.state import Number

Heights = tuple[Array, ...]
"""A number for each jump, then for each switch; or one vector of all."""


def numbers_of(system: PiecewiseSmooth) -> tuple[Any, ...]:
    """The numbers of walls and surfaces, as their heights are: one each, or a vector."""
    count = len(system.jumps) + system.switches
    return (jnp.arange(count, dtype=jnp.int32),) if system.many_surfaces else tuple(range(count))


def heights_of(
    system: PiecewiseSmooth, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: Heights | None = None
) -> Heights:
    """Heights of a state; those that leap as they are continued on sides."""
    heights = system.heights(t, y, p, sides and separate_sides(system, sides))
    return (jnp.stack(heights),) if system.many_surfaces else heights


def sides_after_leaps(
    system: PiecewiseSmooth,
    t: ArrayLike,
    y: PiecewisePoint,
    p: Parameters,
    sides: Heights,
    met: Callable[[int], Array],
) -> Heights:
    """Sides after an event past which heights leap: theirs are by where they have come to.

    Args:
        sides: after the event, of what it is on and of all whose heights do not leap.
        met: whether the event is on the wall or surface with a number.
    """
    leapt = [any_of([met(k) for k in others]) if others else jnp.bool_(False) for others in system.leaps]
    heights = heights_of(system, t, y, p, sides)
    return tuple(
        jnp.where(now, jnp.where(height >= 0.0, 1.0, -1.0), side)
        for now, height, side in zip([jnp.stack(leapt)] if system.many_surfaces else leapt, heights, sides, strict=True)
    )


def separate_sides(system: PiecewiseSmooth, sides: Heights) -> tuple[Number, ...]:
    """Sides as a flow reads them, a number each."""
    return tuple(sides[0][k] for k in range(system.switches)) if system.many_surfaces else sides


def pick(number: Array, values: Sequence[Array]) -> Array:
    """The value with a number; the first where there is none."""
    if jnp.ndim(values[0]):
        return values[0][jnp.where(number < values[0].shape[-1], number, 0)]
    picked = values[0]
    for k, value in enumerate(values[1:], 1):
        picked = jnp.where(number == k, value, picked)
    return picked


def as_vector(values: Sequence[Array]) -> Array:
    """All values as one vector."""
    return values[0] if jnp.ndim(values[0]) else jnp.stack(values)


def any_of(flags: Sequence[Array]) -> Array:
    """Return whether one of the flags is set."""
    if jnp.ndim(flags[0]):
        return jnp.any(flags[0])
    flag = flags[0]
    for other in flags[1:]:
        flag |= other
    return flag
