"""Maps of a flow without a clock: over a time in equal steps, and from one crossing of a section to the next.

All steps are one step's coefficients, whatever its length. A crossing is met by going on until the section lies between
the ends of a step, and stepping from its beginning onto the section: the same method by a shorter step (after Hénon,
Physica D 5 (1982) 412), of no larger error, whose length Newton finds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.protocol import Pushed, Strobe, Tangent
from jaxnh.maps.section import NO_RETURN, NOT_FINITE, Crossing, SectionedFlow
from jaxnh.systems.flow import Flow, Parameters, State

_ON_SECTION = 1e-9  # a state as near as this is on the section, and leaves it: of its value and of a step's way across
_GUESSES = 6  # Newton steps on the cubic through the ends of a step
_SETTLED = 1e-9  # a step of Newton below this, as a share of the step, leaves its square
_MOST_SHOTS = 40

Carried = State | Pushed
"""What goes from step to step: a state, alone or with tangents."""


class SteppedStrobe(Strobe):
    """P over a stretch of time by equal steps.

    Attributes:
        system: the flow.
        one: the map of one step.
        steps: how many.
    """

    system: Flow
    one: Strobe
    steps: ArrayLike

    @property
    def most_lanes(self) -> int | None:
        """Those of a step."""
        return self.one.most_lanes

    @property
    def turns(self) -> tuple[float, ...]:
        """Of the loop over steps, and those of a step."""
        return (float(np.mean(self.steps)), *self.one.turns)

    def __call__(self, state: State, p: Parameters) -> State:
        return lax.fori_loop(0, self.steps, lambda _, z: self.one(z, p), state)

    def push(self, state: State, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushed:
        begun = Pushed(state, tangents, jnp.ones_like(state[0][0]))
        return lax.fori_loop(0, self.steps, lambda _, pushed: _pushed_on(self.one, pushed, p), begun)


class _Search(NamedTuple):
    """On the way to a crossing, before the step that has it.

    Attributes:
        carried: the state, alone or with tangents, at the beginning of the next step.
        side: +1 above the section, −1 below.
        steps: taken so far.
        low, high: part of the next step that has the crossing, if it has.
        found: whether it has.
        lost: whether the state is not finite.
    """

    carried: Carried
    side: Array
    steps: Array
    low: Array
    high: Array
    found: Array
    lost: Array


class EventStrobe(Strobe):
    """From crossing to crossing. Lanes need different numbers of steps, and wait for the one that needs most.

    A passage to the other side and back within one step is seen where the cubic through its ends shows it.

    Attributes:
        system: the flow and its section.
        unit: the map of one step as long as the unit of time.
        step: length of a step.
        most_steps: without a crossing in so many a lane has failed.
    """

    system: SectionedFlow
    unit: Strobe
    step: ArrayLike
    most_steps: ArrayLike

    @property
    def most_lanes(self) -> int | None:
        """Those of a step."""
        return self.unit.most_lanes

    @property
    def turns(self) -> tuple[float, ...]:
        """Of the loop over steps in a period of time, and those of a step."""
        return (self.system.period / float(np.mean(self.step)), *self.unit.turns)

    def __call__(self, state: Crossing, p: Parameters) -> Crossing:
        search = self._search(state.state, p, lambda one, z: one(z, p), lambda carried: carried)
        share = self._locate(search.carried, search, p)
        return self._arrived(state, search, self._partly(share)(search.carried, p), share)

    def push(self, state: Crossing, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushed:
        flow_tangents = tuple(Tangent(t.state.state, t.p) for t in tangents)
        begun = Pushed(state.state, flow_tangents, jnp.ones_like(state.t))
        search = self._search(begun, p, lambda one, pushed: _pushed_on(one, pushed, p), lambda pushed: pushed.state)
        before = search.carried.state
        share = self._locate(before, search, p)
        last = _pushed_on(self._partly(share), search.carried, p)
        moving = jax.jvp(lambda share: self._partly(share)(before, p), (share,), (jnp.ones_like(share),))[1]
        speed = self.system.across(moving)
        pushed = []
        for old, new in zip(tangents, last.tangents, strict=True):
            later = -self.system.across(new.state) / speed  # of the step, that all stays on the section
            moved = jax.tree.map(lambda dz, v, later=later: dz + v * later, new.state, moving)
            pushed.append(Tangent(Crossing(moved, old.state.t + later * self.step, jnp.zeros_like(later)), old.p))
        volume = last.volume * self.system.rate(state.state, p) / self.system.rate(last.state, p)
        return Pushed(self._arrived(state, search, last.state, share), tuple(pushed), volume)

    def _partly(self, share: ArrayLike) -> Strobe:
        """The map of a part of a step."""
        return self.unit.stretched(self.step * share)

    def _search(
        self,
        begun: Carried,
        p: Parameters,
        advance: Callable[[Strobe, Carried], Carried],
        state_of: Callable[[Carried], State],
    ) -> _Search:
        """Steps until the next one has a crossing, or there is no hope of one."""
        whole = self._partly(1.0)
        state = state_of(begun)
        height, rate = self.system.height(state), self.system.rate(state, p)
        near = _ON_SECTION * (abs(self.system.value) + jnp.abs(rate) * self.step)
        side = jnp.sign(jnp.where(jnp.abs(height) < near, rate, height))

        def step(search: _Search) -> _Search:
            ahead = advance(whole, search.carried)
            side, low, high, found = self._between(state_of(search.carried), search.side, state_of(ahead), p)
            lost = ~_finite(state_of(ahead))
            found &= ~lost
            carried = jax.tree.map(lambda old, new: jnp.where(found, old, new), search.carried, ahead)
            return _Search(
                carried,
                jnp.where(found, search.side, side),
                jnp.where(found, search.steps, search.steps + 1),
                low,
                high,
                found,
                lost,
            )

        def unfinished(search: _Search) -> Array:
            return ~search.found & ~search.lost & (search.steps < self.most_steps)

        zero = jnp.zeros_like(height)
        first = _Search(begun, side, jnp.int32(0), zero, zero + 1.0, jnp.bool_(False), ~_finite(state))
        return lax.while_loop(unfinished, step, first)

    def _between(self, before: State, side: Array, after: State, p: Parameters) -> tuple[Array, Array, Array, Array]:
        """The side after a step, the part of it that has a crossing, and whether there is one."""
        ends = self._ends(before, after, p)
        now = jnp.where(ends[2] >= 0.0, 1.0, -1.0)
        turn = ends[1] / (ends[1] - ends[3])
        turns = ends[1] * ends[3] < 0.0
        away = turns & (ends[1] * side > 0.0)  # first away from the section, then towards it
        crossed = side != now
        touched = ~crossed & turns & ~away & (_cubic(ends, turn)[0] * side < 0.0)
        low, high = jnp.where(crossed & away, turn, 0.0), jnp.where(touched, turn, 1.0)
        if self.system.direction != "both":
            second = touched & (side > 0.0)  # down and up again
            low, high = jnp.where(second, turn, low), jnp.where(second, 1.0, high)
            return now, low, high, (crossed & (side < 0.0)) | touched
        return now, low, high, crossed | touched

    def _ends(self, before: State, after: State, p: Parameters) -> tuple[Array, Array, Array, Array]:
        """Heights and their rates a step at both ends of it."""
        heights = self.system.height(before), self.system.height(after)
        rates = self.system.rate(before, p) * self.step, self.system.rate(after, p) * self.step
        return heights[0], rates[0], heights[1], rates[1]

    def _locate(self, before: State, search: _Search, p: Parameters) -> Array:
        """The share of a step after which the state is on the section, to rounding."""
        rising = jnp.ones_like(search.side) if self.system.direction != "both" else -search.side

        def improve(share: Array, height: Array, rate: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
            short = height * rising < 0.0
            low, high = jnp.where(short, share, low), jnp.where(short, high, share)
            better = share - height / rate
            inside = (better >= low) & (better <= high)
            return jnp.where(inside, better, 0.5 * (low + high)), low, high

        ends = self._ends(before, self._partly(1.0)(before, p), p)
        share, low, high = 0.5 * (search.low + search.high), search.low, search.high
        for _ in range(_GUESSES):
            share, low, high = improve(share, *_cubic(ends, share), low, high)

        def shoot(carry: tuple[Array, Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array, Array]:
            share, low, high, _, shots = carry
            state = self._partly(share)(before, p)
            rate = self.system.rate(state, p) * self.step
            better, low, high = improve(share, self.system.height(state), rate, low, high)
            return better, low, high, jnp.abs(better - share), shots + 1

        def unsettled(carry: tuple[Array, Array, Array, Array, Array]) -> Array:
            return search.found & (carry[3] > _SETTLED) & (carry[4] < _MOST_SHOTS)

        begun = (share, search.low, search.high, jnp.ones_like(share), jnp.int32(0))
        return lax.while_loop(unsettled, shoot, begun)[0]

    def _arrived(self, start: Crossing, search: _Search, state: State, share: Array) -> Crossing:
        """The crossing, or a lane that has failed and says why."""
        why = jnp.where(search.lost, 1.0 * NOT_FINITE, 1.0 * NO_RETURN)
        reason = jnp.where(search.found, start.reason, jnp.where(start.reason > 0.0, start.reason, why))
        t = start.t + (search.steps.astype(share.dtype) + share) * self.step
        state = self.system.inner.blanked(state, search.found)
        return Crossing(state, jnp.where(search.found, t, jnp.nan), reason)


def _pushed_on(one: Strobe, pushed: Pushed, p: Parameters) -> Pushed:
    """State and tangents one map later, volumes multiplied."""
    after = one.push(pushed.state, p, pushed.tangents)
    return after._replace(volume=pushed.volume * after.volume)


def _finite(state: State) -> Array:
    return jnp.isfinite(sum(x * x for component in state[:2] for x in component))


def _cubic(ends: tuple[Array, Array, Array, Array], share: Array) -> tuple[Array, Array]:
    """Value and slope at a share of the cubic with these values and slopes at both ends."""
    y0, d0, y1, d1 = ends
    second, third = 3.0 * (y1 - y0) - 2.0 * d0 - d1, d0 + d1 - 2.0 * (y1 - y0)
    value = y0 + share * (d0 + share * (second + share * third))
    return value, d0 + share * (2.0 * second + 3.0 * share * third)
