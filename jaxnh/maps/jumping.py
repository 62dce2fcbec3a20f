"""Maps of flows whose state jumps at walls and whose field changes at surfaces, on a grid of steps.

A step keeps to the branch of the field that it begins with, so that it is a step of a smooth field, whose order it has.
After it, heights of walls and surfaces and their rates at both ends say whether one has been passed, as in `crossings`;
the step is then taken anew, shorter, to end at the first of them. There the state jumps, or the field changes, and the
rest of the step follows. Tangents pass by saltation matrices (`saltation`). What holds a motion, which slides along it
or rests on it, has the side 0, and in place of its height that of the release, which is located like any other event.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.batching import as_batched
from jaxnh.maps.crossings import MOST_SHOTS, SETTLED, improve_share
from jaxnh.maps.event_heights import Heights, heights_of, numbers_of, pick, separate_sides
from jaxnh.maps.general_flow import (
    Moving,
    first_of_stack,
    lanes_per_tile,
    linearise_all,
    own_parameters,
    roomy_grid,
    stack_leaves,
    stacked_tangents,
    stages_in_loop,
    unstacked_tangents,
)
from jaxnh.maps.passages import March, Passages, Trials, at_one_time, is_on_section_first, passages_within
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.saltation import AfterEvent, Arrival, EventPassage, Reading, side_from
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import WrittenOutRungeKutta
from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth
from jaxnh.systems.status import CHATTERING, CODIMENSION_TWO
from jaxnh.systems.tracing import traced_once

_MOST_EVENTS = 64
"""Jumps and switches in one step; a lane that has more is taken to have infinitely many in finite time."""

_MOST_IMPACTS = 4096
"""Events in one step where motions may rest on walls, which they come to by many impacts."""

_ON_WALL = 1e-12  # of a period's way: with its end a motion there has arrived, and where it begins it leaves


class JumpingStrobe(ReturnMap):
    """P of a piecewise smooth flow by steps on a grid.

    One loop takes all trials of all steps, and lanes do not wait for each other within a map.

    Attributes:
        system: the flow.
        solver: a Runge–Kutta method of the package.
        grid: ends of the steps, (capacity + 1,); the last one repeats where not all are in use.
        steps: how many are in use.
    """

    system: PiecewiseSmooth
    solver: WrittenOutRungeKutta = eqx.field(static=True)
    grid: ArrayLike
    steps: ArrayLike

    @property
    def most_lanes(self) -> int | None:
        """Number of lanes whose stages fit in a core's nearest caches."""
        return lanes_per_tile(8 * (self.solver.stages + 2) * len(self.system.coordinates))

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the loop over steps, those to walls left out, and of the loop over stages, where it is one."""
        system = first_of_stack(self.system, np.ndim(self.steps))
        inner = (float(self.solver.stages),) if stages_in_loop(self.solver, lambda: time_split(system).size) else ()
        return float(np.mean(self.steps)), *inner

    def __call__(self, state: PiecewisePoint, p: Parameters) -> PiecewisePoint:
        return self._marched(Moving(state), p, []).state

    def pushforward(
        self, state: PiecewisePoint, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        """Push tangents as every map does; the volume is the modulus of the determinant."""
        own = own_parameters(self.system, p)
        by_p: list[Any] = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]
        zero, moved = jnp.zeros_like(state.y[0]), tuple(t.state for t in tangents)
        if stacked := self.system.many_surfaces and len(tangents) > 1:
            moved, by_p = ([each] for each in stacked_tangents(moved, own, by_p))
        ended = self._marched(Moving(state, tuple(moved), zero if volume else None), p, by_p, stacked=stacked)
        each = unstacked_tangents(ended.tangents[0], len(tangents)) if stacked else ended.tangents
        pushed = tuple(Tangent(dz, t.p) for dz, t in zip(each, tangents, strict=True))
        return Pushforward(ended.state, pushed, ended.log_volume if volume else zero)

    def end_of(self, step: Array) -> Array:
        """Time at the end of a step."""
        return jnp.asarray(self.grid)[step + 1]

    def lane(self, p: Parameters, by_p: list[Any], *, volume: bool, stacked: bool = False) -> _Lane:
        """The steps of one lane.

        Args:
            by_p: of each tangent its derivative in the parameters, or None.
            stacked: whether tangents are a single one that has all of them stacked.
        """
        own = own_parameters(self.system, p)
        return _Lane(self, EventPassage(self.system, own, by_p, volume=volume, stacked=stacked))

    def trials(self, state: PiecewisePoint, p: Parameters) -> Trials:
        """All trials of a period from a state on."""
        lane, grid = self.lane(p, [], volume=False), jnp.asarray(self.grid)
        first, surfaces = lane.begin(Moving(state), grid), len(self.system.jumps) + self.system.switches
        end = grid[-1]
        return Trials(first, lane.unfinished, lane.trial_and_arrival, lambda march: march, lambda _: end, surfaces)

    def _marched(self, start: Moving, p: Parameters, by_p: list[Any], *, stacked: bool = False) -> Moving:
        """All steps."""
        lane = self.lane(p, by_p, volume=start.log_volume is not None, stacked=stacked)
        first = as_batched(lane.begin(start, jnp.asarray(self.grid)), start.state.y[0])
        ended = lax.while_loop(lane.unfinished, lane.trial, first)
        stuck = ended.events > lane.most_events
        watch, reason = ended.moving.state.watch, ended.moving.state.reason
        reason = jnp.where(stuck & (reason == 0.0), 1.0 * CHATTERING, reason)
        kept = jax.tree.map(lambda x: jnp.where(stuck | ended.lost, jnp.nan, x), ended.moving)
        return kept._replace(state=PiecewisePoint(kept.state.y, reason, watch))


class _Lane:
    """The steps of one lane, of a map and the parameters of the lane.

    Attributes:
        strobe: the map.
        most_events: a lane with more in one step is taken to have infinitely many in finite time.
    """

    def __init__(self, strobe: JumpingStrobe, passage: EventPassage) -> None:
        self.strobe, self._passage = strobe, passage
        system = self._system = strobe.system
        self._jumps, self._holding = len(system.jumps), system.holding
        self._numbers, self._section = numbers_of(system), system.section_number
        self._kept_side = -1.0 if system.arrives_at_ends else 1.0  # of a wall that a motion comes to at the end
        self._either = [way == "both" for way in system.jumps] + [True] * (len(self._numbers) - self._jumps)
        self.most_events = _MOST_IMPACTS if any(system.holds[: self._jumps]) else _MOST_EVENTS

    # ---- the loop

    def unfinished(self, march: March) -> Array:
        """Return whether steps are left that can be taken."""
        return (march.step < self.strobe.steps) & ~march.lost & (march.events <= self.most_events)

    def begin(self, moving: Moving, grid: Array) -> March:
        """A lane at the beginning of the first step."""
        t, length, state = grid[0], grid[1] - grid[0], moving.state
        height = heights_of(self._system, t, state, self._passage.own)
        signs = tuple(jnp.where(h >= 0.0, 1.0, -1.0) for h in height)
        reading = self._passage.read(t, moving, signs)
        zero, none, no = jnp.zeros_like(state.y[0]), jnp.int32(0), jnp.bool_(False)
        side = tuple(
            side_from(h, r, _near_wall(r, grid), sign if either else -jnp.ones_like(sign))
            for h, r, sign, either in zip(height, reading.rate, signs, self._either, strict=True)
        )
        if self._system.constrained:
            reading = self._passage.read(t, self._passage.project(t, moving, side, begin=True), side)
        rounding = (jnp.zeros_like(height[0]),) if self._system.many_surfaces else (zero,) * len(height)
        if self._jumps and not self._system.arrives_at_ends:
            after = self._begin_after_jump(reading, side, grid)
            reading, side, rounding = self._passage.read(t, after.moving, after.side), after.side, after.rounding
        lost = ~_finite(reading.moving.state)
        if self._holding:
            reading, side, twice = self._begin_held(reading, side)
            lost |= twice
        return March(
            moving=reading.moving,
            t=zero + t,
            step=none,
            height=reading.height,
            rate=reading.rate,
            side=side,
            rounding=rounding,
            stretch=zero + length,
            share=zero + 1.0,
            low=zero,
            high=zero + 1.0,
            shots=none,
            sought=none,
            sure=no,
            settled=no,
            again=no,
            events=none,
            lost=lost,
        )

    def field(self, march: March) -> PiecewisePoint:
        """Time derivative of a lane's state by the branch of the field that it is in."""
        return self._system.branch(
            march.t, march.moving.state, self._passage.own, separate_sides(self._system, march.side)
        )

    def trial(self, march: March) -> March:
        """Take one step: a whole one, one that locates a passage within it, or the one that ends there."""
        return self.trial_and_arrival(march)[0]

    def trial_and_arrival(self, march: March) -> tuple[March, Arrival]:
        """Take one step, and say at which event it has arrived, if at one."""
        seeking, end = march.shots == 0, self.strobe.end_of(march.step)
        stretch = jnp.where(seeking, end - march.t, march.stretch)
        share = jnp.where(seeking, 1.0, march.share)
        h = share * stretch
        t = jnp.where(seeking, end, march.t + h)
        ahead = self._restore(t, self._advance(march.t, h, march.side, march.moving), march.side)
        reading, finite = self._passage.read(t, ahead, march.side), _finite(ahead.state)
        before = self._sides_of_heights(march.side)
        passages = self._passages(march, reading, h, before, seeking, finite)
        seen, sought = passages.seen, march.sought
        pausing = ~seen & jnp.isfinite(passages.turn)
        fresh = seen | pausing  # a passage or a turn to go to

        # Newton on the one that is sought.
        either = pick(sought, [jnp.bool_(x) for x in self._either])
        side = pick(sought, before)
        rising = jnp.where(either, -side, 1.0)
        sought_height, sought_rate = pick(sought, reading.height), pick(sought, reading.rate)
        better, *bracket = improve_share(share, sought_height, sought_rate * stretch, rising, march.low, march.high)
        better = jnp.minimum(better, 1.0)
        beyond = sought_height * rising >= 0.0
        sure = march.sure | jnp.where(~either & (side > 0.0), ~beyond, beyond)
        near = (jnp.abs(better - share) <= SETTLED) | (march.shots >= MOST_SHOTS)

        arrived = ~seeking & march.settled & ~seen
        onwards = seeking & ~seen & ~pausing
        moved = onwards | arrived
        event = arrived & march.sure & (sought_rate * rising > 0.0)
        arrival = Arrival(event, event, sought, side, stretch, stretch)
        after, sound = self._after(march, reading, passages, arrived, arrival)
        if self._section is not None:
            back = event & self._is_on_section_first(march, reading, after)
            passages = passages.to_end(self._section, back)
            moved, arrived, seen, fresh = moved & ~back, arrived & ~back, seen | back, fresh | back

        cleared = after._replace(rounding=jax.tree.map(lambda r: jnp.where(onwards, 0.0, r), after.rounding))
        as_it_was = AfterEvent(march.moving, march.height, march.rate, march.side, march.rounding)
        lane = jax.tree.map(lambda n, o: jnp.where(moved, n, o), cleared, as_it_was)
        ended = March(
            **lane._asdict(),
            t=jnp.where(moved, t, march.t),
            step=jnp.where(onwards, march.step + 1, march.step),
            stretch=jnp.where(seen, h, stretch),
            share=jnp.where(moved, 1.0, jnp.where(seen, passages.guess, jnp.where(pausing, passages.turn, better))),
            low=jnp.where(fresh, passages.low, bracket[0]),
            high=jnp.where(fresh, passages.high, bracket[1]),
            shots=jnp.where(moved, 0, jnp.where(fresh, 1, march.shots + 1)),
            sought=jnp.where(seen, passages.first, jnp.where(pausing, self._jumps + self._system.switches, sought)),
            sure=jnp.where(seen, passages.sure, jnp.where(pausing, False, sure)),
            settled=jnp.where(moved | seen, False, pausing | (~seeking & near)),
            again=jnp.where(moved, False, march.again | (seen & ~seeking)),
            events=jnp.where(onwards, 0, jnp.where(arrived, march.events + 1, march.events)),
            lost=moved & ~(finite & sound),
        )
        return ended, arrival

    # ---- parts of a trial

    def _is_on_section_first(self, march: March, reading: Reading, after: AfterEvent) -> Array:
        """Return whether a motion is on the section before it jumps at the wall that a trial has ended at."""
        assert self._section is not None
        once_more = self._system.arrives_at_ends
        at_wall = march.sought < self._jumps
        return at_wall & is_on_section_first(self._section, march, reading, after, once_more=once_more)

    def _passages(
        self, march: March, reading: Reading, h: Array, before: Heights, seeking: Array, finite: Array
    ) -> Passages:
        """Passages within what a trial of length h has gone over (`passages_within`)."""
        last, grid = seeking & (march.step == self.strobe.steps - 1), jnp.asarray(self.strobe.grid)
        near = [jnp.where(last, _near_wall(rate, grid), -1.0) for rate in reading.rate]
        earlier = [k < march.sought for k in self._numbers]
        if self._section is not None:
            there = march.settled & (march.sought == self._section)
            for k in range(self._jumps):
                if self._system.arrives_at_ends:
                    near[k] = jnp.where(there, at_one_time(reading.rate[k], march.stretch), near[k])
                else:
                    earlier[k] &= ~there
        return passages_within(
            march, reading, h, before, self._numbers, self._either, seeking, finite, near, self._kept_side, earlier
        )

    def _begin_after_jump(self, reading: Reading, sides: Heights, grid: Array) -> AfterEvent:
        """A lane at the beginning, after the jumps of walls that it begins on."""
        zero, length = jnp.zeros_like(reading.height[0]), grid[1] - grid[0]
        after = AfterEvent(reading.moving, reading.height, reading.rate, sides, (zero,) * len(sides))
        for k in range(self._jumps):
            now = self._passage.read(reading.t, after.moving, after.side)
            on = jnp.abs(now.height[k]) <= _near_wall(now.rate[k], grid)
            arrival = Arrival(on, on, jnp.int32(k), after.side[k], length, length)
            after = self._passage.after_event(now, after.side, after.rounding, arrival)
        return after

    def _restore(self, t: Array, moving: Moving, side: Heights) -> Moving:
        """Bring what is held back to where it is held, and velocities to the constraints that act."""
        if self._holding:
            moving = self._passage.bring_back(t, moving, side)
        return self._passage.project(t, moving, side) if self._system.constrained else moving

    def _advance(self, t: Array, h: Array, sides: Heights, moving: Moving) -> Moving:
        """One Runge–Kutta step, on one branch of the field."""
        system, solver, c = self._system, self.strobe.solver, jnp.asarray(self.strobe.solver.c)
        lane, count = self._passage, sum(jnp.size(dz.y[0]) for dz in moving.tangents)

        @traced_once
        def derivatives(system: PiecewiseSmooth, t: Array, y: Moving, sides: Heights, own: Any, by_p: Any) -> Moving:
            def rate(z: PiecewisePoint, own: Any) -> PiecewisePoint:
                return system.branch(t, z, own, separate_sides(system, sides))

            divergence = system.reduction.divergence_of(lambda z: rate(z, own), y.state) if lane.volume else None
            return Moving(*linearise_all(rate, y.state, own, y.tangents, by_p, stacked=lane.stacked), divergence)

        def rates(stage: Any, y: Moving) -> Moving:
            return derivatives(system, t + c[stage] * h, y, sides, lane.own, lane.by_p)

        in_loop = stages_in_loop(solver, lambda: time_split(system).size * (1 + count + lane.volume))
        return (solver.rolled_stages if in_loop else solver.written_stages)(rates, h, moving)

    def _sides_of_heights(self, sides: Heights) -> Heights:
        """The sides on which heights are, that of a release, which is below zero up to it, included."""
        if not self._holding:
            return sides
        return tuple(
            jnp.where(side == 0.0, -1.0, side) if holds else side
            for side, holds in zip(sides, self._system.holds, strict=True)
        )

    def _after(
        self, march: March, reading: Reading, passages: Passages, arrived: Array, arrival: Arrival
    ) -> tuple[AfterEvent, Array]:
        """The lane after a trial, and after an event that it may have ended at; and whether it can go on."""
        if self._holding:
            grid = jnp.asarray(self.strobe.grid)
            met = arrival.event & (pick(arrival.sought, march.side) != 0.0)
            arrival = arrival._replace(passes=met, step=grid[march.step + 1] - grid[march.step])
        after = self._passage.after_event(reading, self._sides_after(march, passages, arrived), march.rounding, arrival)
        sound = _finite(after.moving.state)
        return after, sound & (after.moving.state.reason != CODIMENSION_TWO) if self._holding else sound

    def _sides_after(self, march: March, passages: Passages, arrived: Array) -> Heights:
        """Sides at the end of a trial, before the event that it may end with."""
        sides = tuple(
            jnp.where(arrived & hit, old, new)
            for hit, old, new in zip(passages.passed, march.side, passages.sides, strict=True)
        )
        if not self._holding:
            return sides
        return tuple(
            jnp.where(old == 0.0, 0.0, new) if holds else new
            for old, new, holds in zip(march.side, sides, self._system.holds, strict=True)
        )

    def _begin_held(self, reading: Reading, sides: Heights) -> tuple[Reading, Heights, Array]:
        """A lane at the beginning, on what holds it; its sides, and whether it is held twice."""
        passage, (t, moving) = self._passage, reading[:2]
        held = self._system.held_sides(t, moving.state, passage.own, sides)
        twice = jnp.sum(jnp.stack(held) == 0.0, axis=0) > 1
        reason = jnp.where(twice, 1.0 * CODIMENSION_TWO, moving.state.reason)
        moving = moving._replace(state=moving.state._replace(reason=reason))
        return passage.read(t, passage.bring_back(t, moving, held), held), held, twice


def _near_wall(rate: Array, grid: Array) -> Array:
    """Height below which a motion is on a wall at the ends of a period."""
    return _ON_WALL * jnp.abs(rate) * (grid[-1] - grid[0])


def _finite(state: PiecewisePoint) -> Array:
    return jnp.isfinite(sum(x * x for x in state.y))


def jumping_strobe(system: PiecewiseSmooth, solver: WrittenOutRungeKutta, grid: np.ndarray) -> JumpingStrobe:
    """The map over a grid (steps + 1,), or stacked maps over grids (parts, steps + 1)."""
    count, parts = grid.shape[-1] - 1, grid.shape[:-1]
    return JumpingStrobe(stack_leaves(system, parts), solver, roomy_grid(grid), np.full(parts, count, np.int32))
