"""State and tangents of a lane at a jump, or a switch of the field: saltation matrices.

    S = Dg + (F(g(y)) − Dg F(y) − ∂g/∂t) nᵀ / (nᵀ F(y) + ∂h/∂t),   n = ∂h/∂y of the height h

(Aizerman and Gantmakher, Prikl. Mat. Mekh. 22 (1958) 658; Müller, Chaos Solitons Fractals 5 (1995) 1671; di Bernardo,
Budd, Champneys and Kowalczyk, Piecewise-smooth Dynamical Systems, 2008), g being the jump, or the identity at a switch.
A tangent arrives dt later, is moved there along the field before, jumps, and is moved back along the field after.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxnh.maps.general_flow import Moving, linearise
from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth

_ON_WALL = 1e-9  # a state as near as this after its jump is on the wall: of a step's way across
_BOTH_ROUNDINGS = 4.0  # times the height at which a wall was met, for that of the state after

Heights = tuple[Array, ...]
"""A number for each jump, then for each switch."""


class AfterEvent(NamedTuple):
    """A lane after an event.

    Attributes:
        moving: the state after it, with tangents and volume.
        height, rate: of walls and surfaces, and their rates.
        side: +1 above, −1 below.
        rounding: height below which the side is as it was.
    """

    moving: Moving
    height: Heights
    rate: Heights
    side: Heights
    rounding: Heights


class EventPassage:
    """Events of one lane.

    Attributes:
        system: the flow.
        own: parameters of the lane.
        by_p: of each tangent its derivative in them, or None.
        volume: whether the volume is asked for.
    """

    def __init__(self, system: PiecewiseSmooth, own: Parameters, by_p: list[Any], *, volume: bool) -> None:
        self.system, self.own, self.by_p, self.volume = system, own, by_p, volume
        self._jumps = len(system.jumps)

    def branch(self, t: Array, state: PiecewisePoint, sides: Sequence[Array]) -> PiecewisePoint:
        """Time derivative of a state by the branch of the field on these sides of walls and surfaces."""
        return self.system.branch(t, state, self.own, tuple(sides[self._jumps :]))

    def rates_of_heights(self, t: Array, state: PiecewisePoint, field: PiecewisePoint) -> Heights:
        """Time derivatives of all heights along a branch of the field."""
        return jax.jvp(
            lambda z, t: self.system.heights(t, z, self.own), (state, jnp.asarray(t)), (field, jnp.ones_like(t))
        )[1]

    def after_event(
        self,
        t: Array,
        ahead: Moving,
        field: PiecewisePoint,
        height: Heights,
        rate: Heights,
        sides: Heights,
        rounding: Heights,
        length: Array,
        sought: Array,
        side: Array,
        event: Array,
    ) -> AfterEvent:
        """Follow a trial by a jump or a change of the field where there is an event; else keep the state as it is.

        Args:
            t, ahead, field, height, rate: at the end of the trial.
            sides, rounding: there, before the event.
            length: of time in which the event was looked for.
            sought: number of the wall or surface.
            side: of it, before.
            event: whether it is passed there.
        """
        system = self.system
        units = self._unit_vectors(ahead.state) if self.volume and self._jumps else []
        along = [*ahead.tangents, *units]
        by_p = [*self.by_p, *[None] * len(units)]
        met_height, met_rate = pick(sought, height), pick(sought, rate)
        delays: list[Array] = []
        if along:
            zero = jnp.zeros_like(t)
            slopes = linearise(
                lambda at, own: system.heights(at[1], at[0], own),
                (ahead.state, t), self.own, [(dz, zero) for dz in along], by_p,
            )[1]  # fmt: skip
            delays = [jnp.where(event, -pick(sought, slope) / met_rate, 0.0) for slope in slopes]
        carried = [_added(dz, field, dt) for dz, dt in zip(along, delays, strict=True)]

        # The state after, and what becomes of tangents at the moment of the event.
        after, pushed, jumps = ahead.state, carried, jnp.bool_(False)
        for k in range(self._jumps):
            jumps_here = event & (sought == k)
            jumps |= jumps_here
            image, moved = linearise(
                lambda at, own, k=k: system.jumped(k, at[1], at[0], own),
                (ahead.state, t), self.own, list(zip(carried, delays, strict=True)), by_p,
            )  # fmt: skip
            after = _select(jumps_here, image, after)
            pushed = [_select(jumps_here, new, old) for new, old in zip(moved, pushed, strict=True)]

        # Sides: those of surfaces first, which decide the field there.
        heights = system.heights(t, after, self.own) if self._jumps else height
        new_sides: list[Array] = []
        for k, (old, new, now) in enumerate(zip(height, heights, sides, strict=True)):
            if k >= self._jumps:
                now = jnp.where(event & (sought == k), -side, now)
            leapt = jumps & (sought != k) & (jnp.sign(old) != jnp.sign(new))
            new_sides.append(jnp.where(leapt, jnp.where(new >= 0.0, 1.0, -1.0), now))
        field_after = self.branch(t, after, new_sides)
        rates = self.rates_of_heights(t, after, field_after)
        roundings = list(rounding)
        for k in range(len(heights)):
            here = event & (sought == k)
            roundings[k] = jnp.where(here, _BOTH_ROUNDINGS * jnp.abs(met_height), roundings[k])
            if k < self._jumps:
                way = (jnp.abs(met_rate) + jnp.abs(rates[k])) * length
                on_wall = _BOTH_ROUNDINGS * jnp.abs(met_height) + _ON_WALL * way
                left = side_from(heights[k], rates[k], on_wall, side)
                new_sides[k] = jnp.where(here, left, new_sides[k])
                near = here & (jnp.abs(heights[k]) <= on_wall)
                roundings[k] = jnp.where(near, roundings[k] + _BOTH_ROUNDINGS * jnp.abs(heights[k]), roundings[k])

        pushed = [_added(dz, field_after, -dt) for dz, dt in zip(pushed, delays, strict=True)]
        count, volume = len(ahead.tangents), ahead.log_volume
        if self.volume:
            growth = jnp.where(event & ~jumps, pick(sought, rates) / met_rate, 1.0)
            if units:
                columns = [jnp.stack(dz.y) for dz in pushed[count:]]
                growth = jnp.where(jumps, jnp.linalg.det(jnp.stack(columns, axis=-1)), growth)
            volume = volume + jnp.log(jnp.abs(growth))
        return AfterEvent(
            Moving(after, tuple(pushed[:count]), volume), heights, rates, tuple(new_sides), tuple(roundings)
        )

    def _unit_vectors(self, state: PiecewisePoint) -> list[PiecewisePoint]:
        zero, count = jnp.zeros_like(state.reason), len(state.y)
        return [PiecewisePoint(tuple(zero + float(i == j) for i in range(count)), zero) for j in range(count)]


def side_from(height: Array, rate: Array, near: Array, otherwise: Array) -> Array:
    """The side that a motion is on: by its height, on the wall by its rate, at rest there as is said."""
    by_rate = jnp.where(rate == 0.0, otherwise, jnp.sign(rate))
    return jnp.where(jnp.abs(height) <= near, by_rate, jnp.where(height >= 0.0, 1.0, -1.0))


def pick(number: Array, values: Sequence[Array]) -> Array:
    """The value with a number; the first where there is none."""
    picked = values[0]
    for k, value in enumerate(values[1:], 1):
        picked = jnp.where(number == k, value, picked)
    return picked


def _added(dz: PiecewisePoint, field: PiecewisePoint, dt: Array) -> PiecewisePoint:
    """A tangent moved along the flow for a time."""
    return jax.tree.map(lambda x, f: x + f * dt, dz, field)


def _select(condition: Array, one: Any, other: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), one, other)
