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
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.event_heights import Heights, any_of, heights_of, numbers_of, pick, separate_sides, sides_after_leaps
from jaxnh.maps.general_flow import Moving, linearise, linearise_all
from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth
from jaxnh.systems.sliding import HeldMotion, is_on, without_rounding
from jaxnh.systems.status import CODIMENSION_TWO
from jaxnh.systems.tracing import traced_once

_ON_WALL = 1e-9  # a state as near as this after its jump is on the wall: of a step's way across
_BOTH_ROUNDINGS = 4.0  # times the height at which a wall was met, for that of the state after
_AT_REST = 1e-6  # of a step: impacts that would all have been by then are over
_UNSEEN_BOUNCE = 16.0  # times the height at which a wall was met: a bounce no higher is rounding
_NOWHERE = 1e-300  # height of a state that is on a surface, to keep its side


class Reading(NamedTuple):
    """A lane at the end of a trial.

    Attributes:
        t: time.
        moving: the state, with tangents and volume.
        field: its time derivative.
        height, rate: of walls and surfaces, and their rates; of what holds the motion its release.
    """

    t: Array
    moving: Moving
    field: PiecewisePoint
    height: Heights
    rate: Heights


class Arrival(NamedTuple):
    """An event that a trial may end at.

    Attributes:
        event: whether there is one.
        passes: whether a wall or a surface is met from one of its sides, and does not release a motion that it held.
        sought: number of the wall or surface.
        side: of it, before.
        length: of time in which the event was looked for.
        step: length of the whole step, where motions may be held.
    """

    event: Array
    passes: Array
    sought: Array
    side: Array
    length: Array
    step: Array

    def at(self, k: ArrayLike) -> Array:
        """Return whether the wall or surface with a number is met from one of its sides."""
        return self.passes & (self.sought == k)


class AfterEvent(NamedTuple):
    """A lane after an event.

    Attributes:
        moving: the state after it, with tangents and volume.
        height, rate: of walls and surfaces, and their rates; of what holds the motion its release.
        side: +1 above, −1 below, 0 held.
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
        stacked: whether tangents are a single one that has all of them stacked.
    """

    def __init__(
        self, system: PiecewiseSmooth, own: Parameters, by_p: list[Any], *, volume: bool, stacked: bool
    ) -> None:
        self.system, self.own, self.by_p, self.volume, self.stacked = system, own, by_p, volume, stacked
        self._jumps, self._numbers = len(system.jumps), numbers_of(system)
        self._rising = traced_once(_heights_with_rates) if system.many_surfaces else _heights_with_rates
        self._changes = [k for k, begins in enumerate(system.begins) if begins or k < self._jumps]

    def read(self, t: Array, moving: Moving, sides: Heights) -> Reading:
        """Field, heights and rates of a lane that is on these sides of walls and surfaces."""
        system, state = self.system, moving.state
        field = system.branch(t, state, self.own, separate_sides(system, sides))
        height, rate = self._rising(system, jnp.asarray(t), state, self.own, field, sides if system.leaps else None)
        if system.holding:
            release, change = jax.jvp(
                lambda z, t: system.held(t, z, self.own, sides).release,
                (state, jnp.asarray(t)), (field, jnp.ones_like(t)),
            )  # fmt: skip
            held = [holds & (side == 0.0) for holds, side in zip(system.holds, sides, strict=True)]
            height = tuple(jnp.where(on, release, h) for on, h in zip(held, height, strict=True))
            rate = tuple(jnp.where(on, change, r) for on, r in zip(held, rate, strict=True))
        return Reading(t, moving, field, height, rate)

    def bring_back(self, t: Array, moving: Moving, sides: Heights) -> Moving:
        """A lane on what holds it, where all states that are off it by a little come to; where nothing does as it is.

        The derivative of that has less than full rank, and volume zero.
        """
        system, state, tangents, volume = self.system, moving.state, moving.tangents, moving.log_volume

        def constraints(z: PiecewisePoint, own: Parameters) -> Any:
            return system.held(t, z, own, sides).constraints

        first = constraints(state, self.own)
        for k, constraint in enumerate(first):
            slopes = linearise(lambda z, own, k=k: constraints(z, own)[k].value, state, self.own, tangents, self.by_p)[
                1
            ]
            tangents = tuple(
                _less(dz, constraint.direction, slope / constraint.gain)
                for dz, slope in zip(tangents, slopes, strict=True)
            )
        for _ in range(2):  # of Newton, whose derivative is that of the first
            for k, constraint in enumerate(first):
                off = constraints(state, self.own)[k].value
                state = _less(state, constraint.direction, off / constraint.gain)
        if self.volume:
            volume = jnp.where(any_of([side == 0.0 for side in sides]), -jnp.inf, volume)
        return Moving(state, tuple(tangents), volume)

    def project(self, t: Array, moving: Moving, sides: Heights, *, begin: bool = False) -> Moving:
        """A lane on the constraints that hold on these sides; its volume is zero where one of them comes and goes.

        Args:
            begin: whether they may have begun there.
        """
        system = self.system
        change = system.constrain if begin else system.on_constraints
        state, tangents = linearise(
            lambda z, own: change(t, z, own, sides), moving.state, self.own, moving.tangents, self.by_p
        )
        volume = moving.log_volume
        if self.volume and any(system.begins):
            hold = any_of([side > 0.0 for side, begins in zip(sides, system.begins, strict=True) if begins])
            volume = jnp.where(hold, -jnp.inf, volume)
        return Moving(state, tangents, volume)

    def after_event(self, end: Reading, sides: Heights, rounding: Heights, arrival: Arrival) -> AfterEvent:
        """Follow a trial by a jump or a change of the field where there is an event; else keep the state as it is.

        Args:
            end: of the trial.
            sides, rounding: there, before the event.
        """
        ahead, holding = end.moving, self.system.holding
        units = self._unit_vectors(ahead.state) if self.volume and self._jumps else []
        along, by_p = [*ahead.tangents, *units], [*self.by_p, *[None] * len(units)]
        delays = self._delays(end, along, by_p, arrival)
        carried = [_added(dz, end.field, dt) for dz, dt in zip(along, delays, strict=True)]
        after, pushed, jumps, begins = self._jump(end, sides, carried, delays, by_p, arrival)

        # Sides: those of surfaces first, which decide the field there.
        heights = heights_of(self.system, end.t, after, self.own) if self._changes else end.height
        changes = jumps if begins is None else jumps | begins
        new_sides = self._crossed(end, heights, sides, arrival, changes)
        if self.system.leaps:
            new_sides = sides_after_leaps(self.system, end.t, after, self.own, new_sides, arrival.at)
        left: Heights = ()
        if holding:
            new_sides, left = self._hold(end, after, sides, new_sides, arrival, jumps)
        reading = self.read(end.t, Moving(after), new_sides)
        new_sides, roundings = self._bounce(end, reading, new_sides, rounding, arrival)

        pushed = [_added(dz, reading.field, -dt) for dz, dt in zip(pushed, delays, strict=True)]
        count, volume = len(ahead.tangents), ahead.log_volume
        if self.volume:
            growth = jnp.where(
                arrival.passes & ~jumps, pick(arrival.sought, reading.rate) / pick(arrival.sought, end.rate), 1.0
            )
            if units:
                columns = [jnp.stack(dz.y) for dz in pushed[count:]]
                growth = jnp.where(jumps, jnp.linalg.det(jnp.stack(columns, axis=-1)), growth)
            volume = volume + jnp.log(jnp.abs(growth))
            volume = volume if begins is None else jnp.where(begins, -jnp.inf, volume)
        moving = Moving(after, tuple(pushed[:count]), volume)
        if holding:
            return self._on_what_holds(reading._replace(moving=moving), sides, new_sides, roundings, left, arrival)
        return AfterEvent(moving, reading.height, reading.rate, new_sides, roundings)

    # ---- parts of an event

    def _delays(self, end: Reading, along: list[PiecewisePoint], by_p: list[Any], arrival: Arrival) -> list[Array]:
        """The delay with which each tangent arrives; a release changes no field, and needs none."""
        if not along:
            return []
        system, met_rate = self.system, pick(arrival.sought, end.rate)
        slopes = linearise_all(
            lambda at, own: pick(arrival.sought, heights_of(system, at[1], at[0], own)),
            (end.moving.state, end.t), self.own, [(dz, jnp.zeros_like(dz.y[0])) for dz in along], by_p,
            stacked=self.stacked,
        )[1]  # fmt: skip
        return [jnp.where(arrival.passes, -slope / met_rate, 0.0) for slope in slopes]

    def _jump(
        self,
        end: Reading,
        sides: Heights,
        carried: list[PiecewisePoint],
        delays: list[Array],
        by_p: list[Any],
        arrival: Arrival,
    ) -> tuple[PiecewisePoint, list[PiecewisePoint], Array, Array | None]:
        """The state after, what becomes of tangents then, and whether the event is a jump, or begins a constraint."""
        system, state = self.system, end.moving.state
        after, pushed, jumps = state, carried, jnp.bool_(False)
        begins = jnp.bool_(False) if any(system.begins) else None
        for k in self._changes:
            arrived = arrival.at(k)
            if begins is None or k < self._jumps:
                jumps |= arrived
            else:
                arrived &= arrival.side < 0.0
                begins |= arrived
            image, moved = linearise(
                lambda at, own, k=k: system.jumped(k, at[1], at[0], own, sides),
                (state, end.t), self.own, list(zip(carried, delays, strict=True)), by_p,
            )  # fmt: skip
            after = _select(arrived, image, after)
            pushed = [_select(arrived, new, old) for new, old in zip(moved, pushed, strict=True)]
        return after, pushed, jumps, begins

    def _crossed(self, end: Reading, after: Heights, sides: Heights, arrival: Arrival, jumps: Array) -> Heights:
        """Sides after an event, of a surface that is passed, and of what the jump has leapt over."""
        crossed: list[Array] = []
        for i, (k, old, new, now) in enumerate(zip(self._numbers, end.height, after, sides, strict=True)):
            if i >= self._jumps:
                now = jnp.where(arrival.at(k), -arrival.side, now)
            leapt = jumps & (arrival.sought != k) & (jnp.sign(old) != jnp.sign(new))
            if i == self.system.section_number:  # on it, no jump leaps over it
                leapt &= jnp.abs(old) > _ON_WALL * jnp.abs(end.rate[i]) * arrival.length
            crossed.append(jnp.where(leapt, jnp.where(new >= 0.0, 1.0, -1.0), now))
        return tuple(crossed)

    def _bounce(
        self, end: Reading, after: Reading, sides: Heights, rounding: Heights, arrival: Arrival
    ) -> tuple[Heights, Heights]:
        """Sides of walls after an event, and heights below which sides are as they are."""
        new_sides, roundings = list(sides), list(rounding)
        met_height, met_rate = pick(arrival.sought, end.height), pick(arrival.sought, end.rate)
        for k in range(len(sides)):
            bounces = arrival.at(self._numbers[k])
            roundings[k] = jnp.where(bounces, _BOTH_ROUNDINGS * jnp.abs(met_height), roundings[k])
            if k < self._jumps:
                way = (jnp.abs(met_rate) + jnp.abs(after.rate[k])) * arrival.length
                on_wall = _BOTH_ROUNDINGS * jnp.abs(met_height) + _ON_WALL * way
                side = side_from(after.height[k], after.rate[k], on_wall, arrival.side)
                free = bounces & (sides[k] != 0.0) if self.system.holds[k] else bounces
                new_sides[k] = jnp.where(free, side, new_sides[k])
                near = bounces & (jnp.abs(after.height[k]) <= on_wall)
                roundings[k] = jnp.where(near, roundings[k] + _BOTH_ROUNDINGS * jnp.abs(after.height[k]), roundings[k])
        return tuple(new_sides), tuple(roundings)

    def _unit_vectors(self, state: PiecewisePoint) -> list[PiecewisePoint]:
        still = jax.tree.map(jnp.zeros_like, state)
        count = len(state.y)
        return [still._replace(y=tuple(z + float(i == j) for i, z in enumerate(still.y))) for j in range(count)]

    # ---- motions that are held

    def _hold(
        self, end: Reading, after: PiecewisePoint, before: Heights, crossed: Heights, arrival: Arrival, jumps: Array
    ) -> tuple[Heights, Heights]:
        """Sides after an event, 0 of what holds the motion then, and which walls and surfaces have released it there.

        Args:
            after: the state.
            before, crossed: sides before the event, and after it where nothing holds the motion.
        """
        holds, count = self.system.holds, len(before)
        elsewhere = any_of([(before[k] == 0.0) & ~arrival.at(k) for k in range(count)])
        held = [(before[k] == 0.0) if holds[k] else jnp.bool_(False) for k in range(count)]
        tried = [held[k] | (arrival.at(k) & ~elsewhere) if holds[k] else held[k] for k in range(count)]
        motion = self.system.held(
            end.t, after, self.own, tuple(jnp.where(k, 0.0, s) for k, s in zip(tried, crossed, strict=True))
        )
        on = ~jumps | is_on(motion, after.y, arrival.step)
        heights = self.system.heights(end.t, after, self.own)
        sides, released = list(crossed), [jnp.bool_(False)] * count
        for k in range(count):
            if holds[k]:
                arrived, freed = arrival.at(k), arrival.event & ~arrival.passes & (arrival.sought == k)
                settles = self._settles(k, end, heights[k], motion, arrival)
                stays = jnp.where(arrived, settles, ~arrival.event | (motion.holds & on)) & ~freed
                beside = jnp.where(on | arrived, motion.leaves, jnp.where(heights[k] >= 0.0, 1.0, -1.0))
                sides[k] = jnp.where(tried[k], jnp.where(stays, 0.0, beside), crossed[k])
                released[k] = held[k] & ~stays & on
        return tuple(sides), tuple(released)

    def _settles(self, k: int, end: Reading, height: Array, motion: HeldMotion, arrival: Arrival) -> Array:
        """Return whether a motion that meets a wall or a surface is held there: of impacts, whether they are over.

        With rates v before and −r v after the impact, and an acceleration a towards the wall, those that follow are
        2 r v / a apart, and each r times nearer: all of them take 2 r v / (a (1 − r)).
        """
        if k >= self._jumps:
            return motion.holds
        met_height, met_rate = jnp.abs(pick(arrival.sought, end.height)), pick(arrival.sought, end.rate)
        speed, towards = -motion.constraints[-1].value, motion.pull
        over = 2.0 * speed <= _AT_REST * arrival.step * towards * (1.0 - speed / met_rate)
        unseen = speed * speed <= 2.0 * towards * _UNSEEN_BOUNCE * met_height
        near = jnp.abs(height) <= _BOTH_ROUNDINGS * met_height + _ON_WALL * met_rate * arrival.length
        return motion.holds & near & (speed >= 0.0) & (speed < met_rate) & (over | unseen)

    def _on_what_holds(
        self, after: Reading, before: Heights, sides: Heights, rounding: Heights, released: Heights, arrival: Arrival
    ) -> AfterEvent:
        """A lane after an event, kept on what holds it; one that two surfaces hold at once has failed."""
        jumps, holds = self._jumps, self.system.holds
        elsewhere = any_of([side == 0.0 for side in sides])
        twice = any_of(
            [arrival.at(k) & elsewhere & (sides[k] * after.rate[k] < 0.0) for k in range(jumps, len(sides)) if holds[k]]
            or [jnp.bool_(False)]
        )
        moving = self.bring_back(after.t, after.moving, sides)
        height = self.system.heights(after.t, moving.state, self.own)
        now = self.read(after.t, moving, sides)
        begins = [(new == 0.0) & (old != 0.0) for new, old in zip(sides, before, strict=True)]
        heights = tuple(jnp.where(r, _NOWHERE * s, h) for r, s, h in zip(released, sides, now.height, strict=True))
        rates = tuple(
            jnp.where(r, jnp.maximum(rate * s, 0.0) * s, rate)
            for r, s, rate in zip(released, sides, now.rate, strict=True)
        )
        roundings = tuple(
            jnp.where(b, 0.0, jnp.where(r, _BOTH_ROUNDINGS * jnp.abs(h), o))
            for b, r, h, o in zip(begins, released, height, rounding, strict=True)
        )
        state = moving.state._replace(reason=jnp.where(twice, 1.0 * CODIMENSION_TWO, moving.state.reason))
        return AfterEvent(moving._replace(state=state), heights, rates, sides, roundings)


def _heights_with_rates(
    system: PiecewiseSmooth,
    t: Array,
    state: PiecewisePoint,
    own: Parameters,
    field: PiecewisePoint,
    sides: Heights | None,
) -> tuple[Heights, Heights]:
    return jax.jvp(lambda z, t: heights_of(system, t, z, own, sides), (state, t), (field, jnp.ones_like(t)))


def side_from(height: Array, rate: Array, near: Array, otherwise: Array) -> Array:
    """The side that a motion is on: by its height, on the wall by its rate, at rest there as is said."""
    by_rate = jnp.where(rate == 0.0, otherwise, jnp.sign(rate))
    return jnp.where(jnp.abs(height) <= near, by_rate, jnp.where(height >= 0.0, 1.0, -1.0))


def _less(y: PiecewisePoint, direction: Sequence[Array], length: Array) -> PiecewisePoint:
    """A state, or a tangent, less so much of a direction."""
    moved = (without_rounding(x, -length * step) for x, step in zip(y.y, direction, strict=True))
    return y._replace(y=tuple(moved))


def _added(dz: PiecewisePoint, field: PiecewisePoint, dt: Array) -> PiecewisePoint:
    """A tangent moved along the flow for a time."""
    return jax.tree.map(lambda x, f: x + f * dt, dz, field)


def _select(condition: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), yes, no)
