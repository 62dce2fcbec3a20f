"""Motions that are held: sliding along a surface towards which the field points from both sides, and rest on a wall.

On a surface of height h, between the fields F₊ above it and F₋ below, a motion slides by the combination of both that
keeps h, until one of them no longer points to it (Filippov, Differential Equations with Discontinuous Righthand Sides,
1988):

    ẏ = F₋ + λ (F₊ − F₋),   λ = −ḣ₋ / (ḣ₊ − ḣ₋),   while ḣ₊ < 0 < ḣ₋

A ball that bounces ever lower has infinitely many impacts in a finite time, and then rests on its wall as long as the
field alone would press it there. The impulses of its impacts y → g(y) have become a force in their direction:

    ẏ = F + λ R,   R = (Dg − 1) ∇ḣ,   λ = −ḧ / (R · ∇ḣ),   while ḧ > 0,

h rising towards the wall, its rates those along F (di Bernardo, Budd, Champneys and Kowalczyk, Piecewise-smooth
Dynamical Systems, 2008). Of an impact that reverses ḣ any coefficient of restitution gives the same force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from jaxnh.systems.state import Number, Vector

_ULPS = 16.0  # of a coordinate, by which a state may be off a surface that it is on
_CANCELLED = 4.0 * np.finfo(float).eps  # of two numbers, is their difference rounding
_EARLY = 1e-14  # of the unit of time, within which a motion would be there

Field = Callable[[Vector, Number], Vector]
"""(y, t) to the rates of the d coordinates, or to their values after a jump."""

Height = Callable[[Vector, Number], Number]
"""(y, t) to a number."""


class Constraint(NamedTuple):
    """A function of the state that a held motion keeps at zero, at one state.

    Attributes:
        value: of the function.
        direction: in which a state is brought back to it, (d,).
        gain: derivative of the function in that direction.
    """

    value: Number
    direction: Vector
    gain: Number


class HeldMotion(NamedTuple):
    """A motion that a surface or a wall holds, at one state.

    Attributes:
        field: rates of the d coordinates.
        holds: whether the state is held there.
        release: negative as long as it is, and rises through zero where it ends.
        leaves: side of the surface that a state goes to which is not held: +1 above, −1 below.
        pull: rate at which the last constraint would go to zero if it were off it.
        constraints: of orders …, 2, 1 in the unit of time, those before the last none where they are not needed.
    """

    field: Vector
    holds: Array
    release: Number
    leaves: Number
    pull: Number
    constraints: tuple[Constraint, ...]


def free_motion(field: Vector, constraints: int) -> HeldMotion:
    """A motion that is not held, with so many constraints that say nothing."""
    zero = jnp.zeros_like(field[0])
    nothing = Constraint(zero, (zero,) * len(field), zero + 1.0)
    return HeldMotion(field, jnp.bool_(False), zero, zero + 1.0, zero, (nothing,) * constraints)


def sliding_motion(above: Field, below: Field, height: Height, t: Number, y: Vector) -> HeldMotion:
    """The motion along a surface between two fields, of one constraint."""
    upper, lower = above(y, t), below(y, t)
    up, down = (_value_and_slope(height, t, y, rates, 1.0)[1] for rates in (upper, lower))
    across = tuple(a - b for a, b in zip(upper, lower, strict=True))
    gain = up - down
    weight = -down / jnp.where(gain == 0.0, 1.0, gain)
    field = tuple(without_rounding(b, weight * r) for b, r in zip(lower, across, strict=True))
    leaves = jnp.where(up + down >= 0.0, 1.0, -1.0)
    constraint = Constraint(height(y, t), across, jnp.where(gain == 0.0, 1.0, gain))
    return HeldMotion(field, (up < 0.0) & (down > 0.0), up * down, leaves, -gain, (constraint,))


def resting_motion(field: Field, jump: Field, height: Height, t: Number, y: Vector) -> HeldMotion:
    """The motion on a wall that the height rises to, of two constraints: the height, and its rate."""

    def speed(y: Vector, t: Number) -> Number:
        return _value_and_slope(height, t, y, field(y, t), 1.0)[1]

    rates, slope = field(y, t), jax.grad(speed)(y, t)
    turned = jax.jvp(lambda y: jump(y, t), (y,), (slope,))[1]
    reaction = tuple(a - b for a, b in zip(turned, slope, strict=True))
    value, towards = _value_and_slope(speed, t, y, rates, 1.0)
    gain = _value_and_slope(speed, t, y, reaction, 0.0)[1]
    moved = jax.jvp(lambda y: field(y, t), (y,), (reaction,))[1]
    above, closing = _value_and_slope(height, t, y, moved, 0.0)
    held = tuple(without_rounding(f, -towards / gain * r) for f, r in zip(rates, reaction, strict=True))
    constraints = (Constraint(above, moved, closing), Constraint(value, reaction, gain))
    return HeldMotion(held, towards > 0.0, -towards, -jnp.ones_like(value), towards, constraints)


def is_on(held: HeldMotion, y: Vector, unit: Number) -> Array:
    """Return whether a state keeps all constraints, to rounding, or would within a unit of time's rounding."""
    kept = jnp.bool_(True)
    for order, constraint in zip(range(len(held.constraints), 0, -1), held.constraints, strict=True):
        early = _EARLY * jnp.abs(held.pull) * unit**order
        for x, direction in zip(y, constraint.direction, strict=True):
            share = jnp.abs(direction / constraint.gain)
            kept &= share * jnp.abs(constraint.value) <= _ULPS * np.finfo(float).eps * jnp.abs(x) + share * early
    return kept


def without_rounding(first: Number, second: Number) -> Number:
    """The sum of two numbers, zero where it is what their rounding leaves, with the derivatives of the sum."""
    total = first + second
    rounding = jnp.abs(total) <= _CANCELLED * (jnp.abs(first) + jnp.abs(second))
    return total - lax.stop_gradient(jnp.where(rounding, total, 0.0))


def _value_and_slope(function: Height, t: Number, y: Vector, rates: Vector, by_t: float) -> tuple[Number, Number]:
    """Value of a function of (y, t), and its derivative along rates of both."""
    t = jnp.asarray(t, jnp.float64)
    return jax.jvp(function, (tuple(y), t), (tuple(rates), by_t * jnp.ones_like(t)))


def held_value(sides: Sequence[Number], values: Sequence[Number]) -> Number:
    """The value of what holds a motion, whose side is 0; 0 where nothing does."""
    return sum(jnp.where(side == 0.0, value, 0.0) for side, value in zip(sides, values, strict=True))
