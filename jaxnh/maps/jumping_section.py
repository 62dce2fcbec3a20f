"""The map from crossing to crossing of a section, of flows whose state jumps or whose field changes.

The section is one more surface that steps end on (`jumping`), at which nothing changes. So crossings lie between
events, and a jump that carries a motion over the section is none. On a wall that lies on the section a motion is at a
crossing as it arrives, before it jumps, and at another one as it leaves, if it goes back over the section.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.batching import as_batched
from jaxnh.maps.crossings import near_section, side_of_section
from jaxnh.maps.general_flow import Moving, lanes_per_tile, own_parameters, stages_in_loop
from jaxnh.maps.jumping import JumpingStrobe
from jaxnh.maps.passages import March, Trials
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.saltation import Arrival
from jaxnh.maps.section import Crossing, Section
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import WrittenOutRungeKutta
from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth
from jaxnh.systems.sliding import HeldMotion
from jaxnh.systems.state import Number
from jaxnh.systems.status import CHATTERING, NO_RETURN, NOT_FINITE


class _WithSection(PiecewiseSmooth):
    """A flow with one more switch, on its section, which its field does not read.

    Attributes:
        as_it_is: the flow without that.
        section: its section.
    """

    as_it_is: PiecewiseSmooth
    section: Section

    def heights(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...] | None = None
    ) -> tuple[Number, ...]:
        """Heights of the flow, then that above the section."""
        return *self.as_it_is.heights(t, y, p, sides and sides[:-1]), self.section.smooth_height(y)

    def branch(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """Time derivative of a state by a branch of the field of the flow."""
        return self.as_it_is.branch(t, y, p, sides[:-1])

    @property
    def many_surfaces(self) -> bool:
        """Return false: the height above the section is read by itself."""
        return False

    @property
    def constrained(self) -> bool:
        """Return whether states are brought back to constraints after each step."""
        return self.as_it_is.constrained

    @property
    def section_number(self) -> int | None:
        """Return the number of the section, where there are walls."""
        return len(self.jumps) + self.switches - 1 if self.jumps else None

    @property
    def begins(self) -> tuple[bool, ...]:
        """Return where constraints of the flow begin."""
        return *self.as_it_is.begins, False

    def jumped(
        self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state after a jump of the flow, or where one of its constraints has begun."""
        return self.as_it_is.jumped(number, t, y, p, sides[:-1])

    def constrain(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """The state after the constraints of the flow have begun."""
        return self.as_it_is.constrain(t, y, p, sides[:-1])

    def on_constraints(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state brought back to the constraints of the flow."""
        return self.as_it_is.on_constraints(t, y, p, sides[:-1])

    @jax.jit
    def held(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> HeldMotion:
        """The motion on the wall or surface whose side is 0, which the section never is."""
        return self.as_it_is.held(t, y, p, sides[:-1])


class _EqualSteps(JumpingStrobe):
    """Equal steps, as long as the first one on the grid, however many."""

    def end_of(self, step: Array) -> Array:
        """Time at the end of a step."""
        return jnp.asarray(self.grid)[1] * (step + 1).astype(float)


class _Approach(NamedTuple):
    """State of a march to the next crossing.

    Attributes:
        march: since the crossing before.
        t: time of the flow since the start at that crossing.
        by_tangent: what each tangent changes in it.
        left: crossings.
        leaving: rate of the height at the crossing before.
    """

    march: March
    t: Array
    by_tangent: tuple[Array, ...]
    left: Array
    leaving: Array


class JumpingSection(ReturnMap):
    """The map from crossing to crossing, in one loop over all trials of all steps.

    Attributes:
        system: the flow and its section.
        solver: a Runge–Kutta method of the package.
        step: length of a step.
        most_steps: without a crossing in so many a lane has failed.
        backward: whether the flow is one back in time: it goes on from time to time, and crossings have that of the
            motion, which falls.
    """

    system: Section
    solver: WrittenOutRungeKutta = eqx.field(static=True)
    step: ArrayLike
    most_steps: ArrayLike
    backward: bool = eqx.field(static=True, default=False)

    @property
    def most_lanes(self) -> int | None:
        """Number of lanes whose stages fit in a core's nearest caches."""
        return lanes_per_tile(8 * (self.solver.stages + 2) * len(self.system.flow.coordinates))

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the loop over steps in a period of time, and of the loop over stages, where it is one."""
        inner = (
            (float(self.solver.stages),)
            if stages_in_loop(self.solver, lambda: time_split(self.system.flow).size)
            else ()
        )
        return self.system.flow.period / float(np.mean(self.step)), *inner

    def __call__(self, state: Crossing, p: Parameters) -> Crossing:
        return self.iterate(1, state, p)

    def iterate(self, n: ArrayLike, state: Crossing, p: Parameters) -> Crossing:
        return self._arrived(state, _last_of(*self._approach(n, state, Moving(state.state), (), p, [])))

    def pushforward(
        self, state: Crossing, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        """Push tangents as every map does, then along the flow onto the section."""
        own, zero = own_parameters(self.system.flow, p), jnp.zeros_like(state.t)
        by_p: list[Any] = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]
        start = Moving(state.state, tuple(t.state.state for t in tangents), zero if volume else None)
        ended = _last_of(*self._approach(1, state, start, tuple(self._turned(t.state.t) for t in tangents), p, by_p))
        moving = ended.march.moving
        pushed = tuple(
            Tangent(Crossing(dz, self._turned(later), zero), t.p)
            for dz, later, t in zip(moving.tangents, ended.by_tangent, tangents, strict=True)
        )
        grown = moving.log_volume if volume else zero
        return Pushforward(self._arrived(state, ended), pushed, grown)

    def trials(self, state: Crossing, p: Parameters) -> Trials:
        """All trials from a crossing to the next one."""
        first, unfinished, advance = self._approach(1, state, Moving(state.state), (), p, [])
        surfaces = len(first.march.side) - 1
        return Trials(first, unfinished, advance, lambda search: search.march, lambda search: search.t, surfaces)

    def _approach(
        self,
        n: ArrayLike,
        start: Crossing,
        at_begin: Moving,
        by_tangent: tuple[Array, ...],
        p: Parameters,
        by_p: list[Any],
    ) -> tuple[_Approach, Callable[[_Approach], Array], Callable[[_Approach], tuple[_Approach, Arrival]]]:
        """Trials until n crossings are met, or there is no hope of the next one.

        The first of them, whether one is left, and one of them with the event that it may have ended at.
        """
        grid = jnp.stack([jnp.zeros_like(jnp.asarray(self.step)), jnp.asarray(self.step)])
        lane = _EqualSteps(_with_section(self.system), self.solver, grid, self.most_steps).lane(
            p, by_p, volume=at_begin.log_volume is not None
        )
        march = lane.begin(at_begin, grid)
        march = self._on_side(march, p)
        first = _Approach(march, self._turned(start.t), by_tangent, jnp.asarray(n, jnp.int32), march.rate[-1])

        def unfinished(search: _Approach) -> Array:
            return (search.left > 0) & lane.unfinished(search.march)

        def advance(search: _Approach) -> tuple[_Approach, Arrival]:
            before, (after, arrival) = search.march, lane.trial_and_arrival(search.march)
            met = (after.events > before.events) & (before.sought == len(before.side) - 1)
            met &= after.side[-1] != before.side[-1]
            if self.system.direction != "both":
                met &= after.side[-1] * self.system.slope(after.moving.state) > 0.0
            met &= ~after.lost
            moving, later = self._on_section(after.moving, lane.field(after), search.leaving, after.rate[-1])
            again = after._replace(
                moving=moving,
                t=jnp.zeros_like(after.t),
                step=jnp.zeros_like(after.step),
                stretch=jnp.zeros_like(after.stretch) + grid[1],
                events=jnp.zeros_like(after.events),
            )
            approach = _Approach(
                jax.tree.map(lambda new, old: jnp.where(met, new, old), again, after),
                jnp.where(met, search.t + after.t, search.t),
                tuple(jnp.where(met, x + dt, x) for x, dt in zip(search.by_tangent, later, strict=True)),
                jnp.where(met, search.left - 1, search.left),
                jnp.where(met, after.rate[-1], search.leaving),
            )
            return approach, arrival

        return first, unfinished, advance

    @property
    def _walls(self) -> tuple[str, ...]:
        """Directions in which walls are passed."""
        flow = self.system.flow
        assert isinstance(flow, PiecewiseSmooth)
        return flow.jumps

    def _on_side(self, march: March, p: Parameters) -> March:
        """A lane at the beginning, on the side that it leaves for, and before a jump that it comes to."""
        height, rate = march.height[-1], march.rate[-1]
        side, near = side_of_section(self.system, height, rate, self.step), near_section(self.system, rate, self.step)
        if not (count := len(self._walls)):
            return march._replace(side=(*march.side[:-1], side))
        on = jnp.abs(height) < near
        walls = [
            jnp.where(on & (jnp.abs(h * rate) < near * jnp.abs(r)) & self._jumps_at(k, march, p), -jnp.sign(r), s)
            for k, (h, r, s) in enumerate(zip(march.height[:count], march.rate, march.side, strict=False))
        ]
        rounding = (*march.rounding[:-1], jnp.where(on, 2.0 * jnp.abs(height), 0.0))
        return march._replace(side=(*walls, *march.side[count:-1], side), rounding=rounding)

    def _jumps_at(self, wall: int, march: March, p: Parameters) -> Array:
        """Return whether a motion that begins on a wall on the section has come to it, and has not come from it."""
        flow, section = self.system.flow, self.system
        assert isinstance(flow, PiecewiseSmooth)
        arrives = march.rate[wall] > 0.0 if flow.jumps[wall] != "both" else jnp.bool_(True)
        after = flow.jumped(wall, march.t, march.moving.state, p, march.side[:-1])
        rate = section.across(flow.branch(march.t, after, p, march.side[:-1])) * section.slope(after)
        near = near_section(section, rate, self.step)
        goes_on = (jnp.abs(section.smooth_height(after)) < near) & (rate * march.rate[-1] > 0.0)
        return arrives & ~goes_on

    def _on_section(
        self, moving: Moving, field: PiecewisePoint, leaving: Array, rate: Array
    ) -> tuple[Moving, tuple[Array, ...]]:
        """Tangents moved along the flow onto the section, with the volume; and how much later each arrives."""
        speed = self.system.across(field)
        later = tuple(-self.system.across(dz) / speed for dz in moving.tangents)
        tangents = tuple(
            jax.tree.map(lambda x, f, dt=dt: x + f * dt, dz, field)
            for dz, dt in zip(moving.tangents, later, strict=True)
        )
        grown = None if moving.log_volume is None else moving.log_volume + jnp.log(jnp.abs(leaving / rate))
        return Moving(moving.state, tangents, grown), later

    def _arrived(self, start: Crossing, ended: _Approach) -> Crossing:
        """The crossing, or a lane that has failed and says why."""
        march, crossed = ended.march, ended.left <= 0
        unmet = jnp.where(march.step < self.most_steps, 1.0 * CHATTERING, 1.0 * NO_RETURN)
        why = jnp.where(march.lost, 1.0 * NOT_FINITE, unmet)
        why = jnp.where(march.moving.state.reason > 0.0, march.moving.state.reason, why)
        reason = jnp.where(crossed, start.reason, jnp.where(start.reason > 0.0, start.reason, why))
        y = tuple(jnp.where(crossed, x, jnp.nan) for x in march.moving.state.y)
        t = jnp.where(crossed, self._turned(ended.t), jnp.nan)
        return Crossing(march.moving.state._replace(y=y, reason=reason), t, reason)

    def _turned(self, t: Array) -> Array:
        """Time of the motion as that of the flow, or the other way round."""
        return -t if self.backward else t


def _last_of(
    first: _Approach,
    unfinished: Callable[[_Approach], Array],
    advance: Callable[[_Approach], tuple[_Approach, Arrival]],
) -> _Approach:
    """The last of all trials."""
    return lax.while_loop(unfinished, lambda search: advance(search)[0], as_batched(first, first.t))


def _with_section(section: Section) -> _WithSection:
    """The flow of a section with the section among its surfaces."""
    flow: Any = section.flow
    parts = {field.name: getattr(flow, field.name) for field in dataclasses.fields(PiecewiseSmooth)}
    return _WithSection(
        **{
            **parts,
            "switches": flow.switches + 1,
            "holds": (*flow.holds, False),
            "leaps": (*flow.leaps, ()) if flow.leaps else (),
        },
        as_it_is=flow,
        section=section,
    )
