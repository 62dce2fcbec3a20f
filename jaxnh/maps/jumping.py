"""Maps of flows whose state jumps at walls and whose field changes at surfaces, on a grid of steps.

A step keeps to the branch of the field that it begins with, so that it is a step of a smooth field, whose order it has.
After it, heights of walls and surfaces and their rates at both ends say whether one has been passed, as in `crossings`;
the step is then taken anew, shorter, to end at the first of them. There the state jumps, or the field changes, and the
rest of the step follows. Tangents pass by saltation matrices (`saltation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.batching import as_batched
from jaxnh.maps.crossings import MOST_SHOTS, SETTLED, crossing_between, improve_share, near_turn
from jaxnh.maps.general_flow import (
    Moving,
    lanes_per_tile,
    linearise,
    own_parameters,
    roomy_grid,
    stack_leaves,
    stages_in_loop,
)
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.saltation import EventPassage, Heights, pick, side_from
from jaxnh.solvers import WrittenOutRungeKutta
from jaxnh.systems.flow import CHATTERING, Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth

_MOST_EVENTS = 64
"""Jumps and switches in one step; a lane that has more is taken to have infinitely many in finite time."""

_BEGINS_ON_WALL = 1e-12  # of a step's way, where a period begins: a state there leaves, and does not arrive


class _March(NamedTuple):
    """On the way through the steps of a map.

    Attributes:
        moving: the state, with tangents and the logarithm of volume where they are asked for.
        t: time of it.
        step: number of the step that it is in.
        height, rate: of walls and surfaces, and their rates.
        side: +1 above, −1 below.
        rounding: height below which the side is as it was.
        stretch: length of time within which a passage is looked for.
        share: of it that the next trial goes over.
        low, high: part of it that has the passage, once it is seen.
        shots: trials at it; none before it is seen.
        sought: number of the wall or surface; one too many where the trial only ends where a height turns.
        sure: whether both its sides have been seen.
        settled: whether the next trial ends there.
        again: whether another wall has been seen before the one that was sought first.
        events: number of stops in this step.
        lost: whether the state is not finite.
    """

    moving: Moving
    t: Array
    step: Array
    height: Heights
    rate: Heights
    side: Heights
    rounding: Heights
    stretch: Array
    share: Array
    low: Array
    high: Array
    shots: Array
    sought: Array
    sure: Array
    settled: Array
    again: Array
    events: Array
    lost: Array


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
        inner = (float(self.solver.stages),) if stages_in_loop(self.system, self.solver, 0) else ()
        return float(np.mean(self.steps)), *inner

    def __call__(self, state: PiecewisePoint, p: Parameters) -> PiecewisePoint:
        return self._marched(Moving(state), p, []).state

    def pushforward(
        self, state: PiecewisePoint, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        """Push tangents as every map does; the volume is the modulus of the determinant."""
        own = own_parameters(self.system, p)
        by_p: list[Any] = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]
        zero = jnp.zeros_like(state.y[0])
        begun = Moving(state, tuple(t.state for t in tangents), zero if volume else None)
        ended = self._marched(begun, p, by_p)
        pushed = tuple(Tangent(dz, t.p) for dz, t in zip(ended.tangents, tangents, strict=True))
        return Pushforward(ended.state, pushed, jnp.exp(ended.log_volume) if volume else jnp.ones_like(zero))

    def end_of(self, step: Array) -> Array:
        """Time at the end of a step."""
        return jnp.asarray(self.grid)[step + 1]

    def lane(self, p: Parameters, by_p: list[Any], *, volume: bool) -> _Lane:
        """The steps of one lane.

        Args:
            by_p: of each tangent its derivative in the parameters, or None.
        """
        return _Lane(self, EventPassage(self.system, own_parameters(self.system, p), by_p, volume=volume))

    def _marched(self, begun: Moving, p: Parameters, by_p: list[Any]) -> Moving:
        """All steps."""
        lane = self.lane(p, by_p, volume=begun.log_volume is not None)
        first = as_batched(lane.begin(begun, jnp.asarray(self.grid)), begun.state.y[0])
        ended = lax.while_loop(lane.unfinished, lane.trial, first)
        stuck = ended.events > _MOST_EVENTS
        reason = ended.moving.state.reason
        reason = jnp.where(stuck & (reason == 0.0), 1.0 * CHATTERING, reason)
        kept = jax.tree.map(lambda x: jnp.where(stuck | ended.lost, jnp.nan, x), ended.moving)
        return kept._replace(state=PiecewisePoint(kept.state.y, reason))


class _Lane:
    """The steps of one lane, of a map and the parameters of the lane.

    Attributes:
        strobe: the map.
    """

    def __init__(self, strobe: JumpingStrobe, passage: EventPassage) -> None:
        self.strobe, self._passage = strobe, passage
        self._system, self._jumps = strobe.system, len(strobe.system.jumps)
        self._either = [way == "both" for way in strobe.system.jumps] + [True] * strobe.system.switches

    # ---- the loop

    def unfinished(self, march: _March) -> Array:
        """Return whether steps are left that can be taken."""
        return (march.step < self.strobe.steps) & ~march.lost & (march.events <= _MOST_EVENTS)

    def begin(self, moving: Moving, grid: Array) -> _March:
        """A lane at the beginning of the first step."""
        t, length, state = grid[0], grid[1] - grid[0], moving.state
        height = self._system.heights(t, state, self._passage.own)
        signs = tuple(jnp.where(h >= 0.0, 1.0, -1.0) for h in height)
        rate = self._passage.rates_of_heights(t, state, self._passage.branch(t, state, signs))
        zero, none, no = jnp.zeros_like(state.y[0]), jnp.int32(0), jnp.bool_(False)
        side = tuple(
            side_from(h, r, _BEGINS_ON_WALL * jnp.abs(r) * length, sign if either else -jnp.ones_like(sign))
            for h, r, sign, either in zip(height, rate, signs, self._either, strict=True)
        )
        return _March(
            moving=moving,
            t=zero + t,
            step=none,
            height=height,
            rate=rate,
            side=side,
            rounding=(zero,) * len(height),
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
            lost=~_finite(state),
        )

    def field(self, march: _March) -> PiecewisePoint:
        """Time derivative of a lane's state by the branch of the field that it is in."""
        return self._passage.branch(march.t, march.moving.state, march.side)

    def trial(self, march: _March) -> _March:
        """Take one step: a whole one, one that locates a passage within it, or the one that ends there."""
        count = len(march.height)
        seeking, end = march.shots == 0, self.strobe.end_of(march.step)
        stretch = jnp.where(seeking, end - march.t, march.stretch)
        share = jnp.where(seeking, 1.0, march.share)
        h = share * stretch
        t = jnp.where(seeking, end, march.t + h)
        ahead = self._advance(march.t, h, march.side[self._jumps :], march.moving)
        state, finite = ahead.state, _finite(ahead.state)
        field = self._passage.branch(t, state, march.side)
        height = self._system.heights(t, state, self._passage.own)
        rate = self._passage.rates_of_heights(t, state, field)

        # Passages within what this trial has gone over, and of heights that turn near zero the turns.
        kept = [
            jnp.where(jnp.abs(x) <= r, 1e-300 * s, x)
            for x, r, s in zip(height, march.rounding, march.side, strict=True)
        ]
        ends = [(a, b * h, c, d * h) for a, b, c, d in zip(march.height, march.rate, kept, rate, strict=True)]
        between = [
            crossing_between(e, side, either=either)
            for e, side, either in zip(ends, march.side, self._either, strict=True)
        ]
        passed = [part[3] & finite for part in between]
        looked_for = [(seeking | (march.settled & ~march.again)) & (march.sought != k) | seeking for k in range(count)]
        checked = [hit & looked for hit, looked in zip(passed, looked_for, strict=True)]
        guesses = [_guess(e, part[1], part[2]) for e, part in zip(ends, between, strict=True)]
        turns = [near_turn(e, side) for e, side in zip(ends, march.side, strict=True)]
        turns = [(turn, near & seeking & finite) for turn, near in turns]
        candidates = jnp.stack([jnp.where(hit, guess, jnp.inf) for hit, guess in zip(checked, guesses, strict=True)])
        first = jnp.argmin(candidates).astype(jnp.int32)
        seen = _any(checked)
        earliest = jnp.min(jnp.stack([jnp.where(near, turn, jnp.inf) for turn, near in turns]))
        pausing = ~seen & jnp.isfinite(earliest)

        # Newton on the one that is sought.
        sought = march.sought
        either = pick(sought, [jnp.bool_(x) for x in self._either])
        side = pick(sought, march.side)
        rising = jnp.where(either, -side, 1.0)
        sought_height, sought_rate = pick(sought, height), pick(sought, rate)
        better, *bracket = improve_share(share, sought_height, sought_rate * stretch, rising, march.low, march.high)
        beyond = sought_height * rising >= 0.0
        sure = march.sure | jnp.where(~either & (side > 0.0), ~beyond, beyond)
        near = (jnp.abs(better - share) <= SETTLED) | (march.shots >= MOST_SHOTS)

        arrived = ~seeking & march.settled & ~seen
        onwards = seeking & ~seen & ~pausing
        moved = onwards | arrived
        event = arrived & march.sure & (sought_rate * rising > 0.0)
        sides = tuple(
            jnp.where(arrived & hit, old, part[0]) for hit, old, part in zip(passed, march.side, between, strict=True)
        )
        after = self._passage.after_event(
            t, ahead, field, height, rate, sides, march.rounding, stretch, sought, side, event
        )

        def chosen(new: Any, old: Any) -> Any:
            return jax.tree.map(lambda n, o: jnp.where(moved, n, o), new, old)

        fresh = seen | pausing  # a passage or a turn to go to
        crossed = [part[0] != old for part, old in zip(between, march.side, strict=True)]
        return _March(
            moving=chosen(after.moving, march.moving),
            t=jnp.where(moved, t, march.t),
            step=jnp.where(onwards, march.step + 1, march.step),
            height=chosen(after.height, march.height),
            rate=chosen(after.rate, march.rate),
            side=chosen(after.side, march.side),
            rounding=jax.tree.map(
                lambda r, o: jnp.where(onwards, 0.0, jnp.where(moved, r, o)), after.rounding, march.rounding
            ),
            stretch=jnp.where(seen, h, stretch),
            share=jnp.where(moved, 1.0, jnp.where(seen, pick(first, guesses), jnp.where(pausing, earliest, better))),
            low=jnp.where(fresh, pick(first, [part[1] for part in between]), bracket[0]),
            high=jnp.where(fresh, pick(first, [part[2] for part in between]), bracket[1]),
            shots=jnp.where(moved, 0, jnp.where(fresh, 1, march.shots + 1)),
            sought=jnp.where(seen, first, jnp.where(pausing, count, sought)),
            sure=jnp.where(seen, pick(first, crossed), jnp.where(pausing, False, sure)),
            settled=jnp.where(moved | seen, False, pausing | (~seeking & near)),
            again=jnp.where(moved, False, march.again | (seen & ~seeking)),
            events=jnp.where(onwards, 0, jnp.where(arrived, march.events + 1, march.events)),
            lost=moved & ~(finite & _finite(after.moving.state)),
        )

    # ---- parts of a trial

    def _advance(self, t: Array, h: Array, sides: Heights, moving: Moving) -> Moving:
        """One Runge–Kutta step, on one branch of the field."""
        system, solver, c = self._system, self.strobe.solver, jnp.asarray(self.strobe.solver.c)
        lane = self._passage

        def rates(stage: Any, y: Moving) -> Moving:
            at = t + c[stage] * h

            def rate(z: PiecewisePoint, own: Parameters) -> PiecewisePoint:
                return system.branch(at, z, own, sides)

            divergence = system.divergence_of(lambda z: rate(z, lane.own), y.state) if lane.volume else None
            return Moving(*linearise(rate, y.state, lane.own, y.tangents, lane.by_p), divergence)

        in_loop = stages_in_loop(system, solver, len(moving.tangents) + lane.volume)
        return (solver.rolled_stages if in_loop else solver.written_stages)(rates, h, moving)


def _guess(ends: tuple[Array, Array, Array, Array], low: Array, high: Array) -> Array:
    """A first guess of where a height passes zero, by the straight line, within the part that has it."""
    straight = ends[0] / (ends[0] - ends[2])
    return jnp.where((straight > low) & (straight < high), straight, 0.5 * (low + high))


def _any(flags: Sequence[Array]) -> Array:
    flag = flags[0]
    for other in flags[1:]:
        flag |= other
    return flag


def _finite(state: PiecewisePoint) -> Array:
    return jnp.isfinite(sum(x * x for x in state.y))


def jumping_strobe(system: PiecewiseSmooth, solver: WrittenOutRungeKutta, grid: np.ndarray) -> JumpingStrobe:
    """The map over a grid (steps + 1,), or stacked maps over grids (parts, steps + 1)."""
    count, parts = grid.shape[-1] - 1, grid.shape[:-1]
    return JumpingStrobe(stack_leaves(system, parts), solver, roomy_grid(grid), np.full(parts, count, np.int32))
