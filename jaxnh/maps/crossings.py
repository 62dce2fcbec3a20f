"""Maps of a flow without a clock: over a time in equal steps, and from one crossing of a section to the next.

All steps are one step's coefficients, whatever its length. A crossing is met by going on until the section lies between
the ends of a step, and stepping from its beginning onto the section: the same method by a shorter step (after Hénon,
Physica D 5 (1982) 412), of no larger error, whose length Newton finds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.adaptive import AdaptiveStrobe
from jaxnh.maps.batching import as_batched
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.section import Crossing, Section
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State, error_components, masked
from jaxnh.systems.status import NO_RETURN, NOT_FINITE

_ON_SECTION = 1e-9  # a state as near as this is on the section, and leaves it: of its value and of a step's way across
SETTLED = 1e-9
"""A step of Newton below this, as a share of the step, leaves its square."""

MOST_SHOTS = 40
"""Steps of Newton, or halvings, at one crossing."""

_NEARLY = 0.1  # of the way that rates at both ends of a step make, for a height that turns near zero
_WITHIN = 0.02  # of a step, from its ends, is no turn within it

Carried = State | Pushforward
"""State carried from step to step, alone or with tangents."""


class SteppedStrobe(ReturnMap):
    """P over a stretch of time by equal steps.

    Attributes:
        system: the flow.
        step_map: the map of one step.
        steps: how many.
    """

    system: Flow
    step_map: ReturnMap
    steps: ArrayLike

    @property
    def most_lanes(self) -> int | None:
        """Largest number of lanes a tile for a single step."""
        return self.step_map.most_lanes

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the loop over steps and of the loops in a step."""
        return (float(np.mean(self.steps)), *self.step_map.trip_counts)

    def __call__(self, state: State, p: Parameters) -> State:
        return lax.fori_loop(0, self.steps, lambda _, z: self.step_map(z, p), state)

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        start = Pushforward(state, tangents, as_batched(jnp.zeros_like(state[0][0]), state[0][0]))
        return lax.fori_loop(0, self.steps, lambda _, pushed: _compose(self.step_map, pushed, p, volume), start)


class _Search(NamedTuple):
    """State of a search for the next crossing.

    Attributes:
        carried: the state, alone or with tangents, at the beginning of the next step.
        rate: of the height there.
        t: time since the start at the crossing before.
        by_tangent: what each tangent changes in it.
        left: crossings.
        leaving: rate of the height at the crossing before.
        side: +1 above the section, −1 below.
        steps: taken since.
        share: of a whole step that the next one is long: 1 until one is seen to have a crossing.
        low, high: part of the step that has it, once it is seen.
        shots: steps taken at it; none before it is seen.
        settled: whether the next step ends on the section.
        lost: whether the state is not finite.
    """

    carried: Carried
    rate: Array
    t: Array
    by_tangent: tuple[Array, ...]
    left: Array
    leaving: Array
    side: Array
    steps: Array
    share: Array
    low: Array
    high: Array
    shots: Array
    settled: Array
    lost: Array


class EventStrobe(ReturnMap):
    """The map from crossing to crossing. Lanes need different numbers of steps, and wait for the one that needs most.

    One loop takes all steps, whole ones and those that locate a crossing, and over several crossings (`iterate`) lanes
    go on without waiting for each other. A passage to the other side and back within one step is seen where the cubic
    through its ends shows it.

    Attributes:
        system: the flow and its section.
        unit: the map of one step as long as the unit of time.
        step: length of a step.
        most_steps: without a crossing in so many a lane has failed.
        backward: whether steps are of negative length, and the section is met in the direction opposite to its own.
    """

    system: Section
    unit: ReturnMap
    step: ArrayLike
    most_steps: ArrayLike
    backward: bool = eqx.field(static=True, default=False)

    @property
    def most_lanes(self) -> int | None:
        """Largest number of lanes a tile for a single step."""
        return self.unit.most_lanes

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the loop over steps in a period of time and of the loops in a step."""
        return (self.system.flow.period / float(np.mean(self.step)), *self.unit.trip_counts)

    def __call__(self, state: Crossing, p: Parameters) -> Crossing:
        return self.iterate(1, state, p)

    def iterate(self, n: ArrayLike, state: Crossing, p: Parameters) -> Crossing:
        def advance(step_map: ReturnMap, carried: Carried) -> Carried:
            assert not isinstance(carried, Pushforward)
            return step_map(carried, p)

        ended = self._searched(n, state, (), state.state, p, advance)
        return self._arrived(state, ended, _state_of(ended.carried))

    def pushforward(
        self, state: Crossing, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        """Push tangents as every map does, then along the flow onto the section, with the field's rate."""
        flow_tangents = tuple(Tangent(t.state.state, t.p) for t in tangents)
        start = Pushforward(state.state, flow_tangents, jnp.zeros_like(state.t))

        def advance(step_map: ReturnMap, carried: Carried) -> Carried:
            assert isinstance(carried, Pushforward)
            return _compose(step_map, carried, p, volume)

        ended = self._searched(1, state, tuple(t.state.t for t in tangents), start, p, advance)
        last = ended.carried
        assert isinstance(last, Pushforward)
        pushed = tuple(
            Tangent(Crossing(new.state, later, jnp.zeros_like(later)), new.p)
            for new, later in zip(last.tangents, ended.by_tangent, strict=True)
        )
        return Pushforward(self._arrived(state, ended, last.state), pushed, last.log_volume)

    def _searched(
        self,
        n: ArrayLike,
        start: Crossing,
        by_tangent: tuple[Array, ...],
        at_begin: Carried,
        p: Parameters,
        advance: Callable[[ReturnMap, Carried], Carried],
    ) -> _Search:
        """Steps until n crossings are met, or there is no hope of the next one."""
        state = start.state
        rate = self.system.rate(state, p)
        zero, none = jnp.zeros_like(rate), jnp.int32(0)
        first = _Search(
            carried=at_begin,
            rate=rate,
            t=start.t,
            by_tangent=by_tangent,
            left=jnp.asarray(n, jnp.int32),
            leaving=rate,
            side=self._side(state, rate),
            steps=none,
            share=zero + 1.0,
            low=zero,
            high=zero + 1.0,
            shots=none,
            settled=jnp.bool_(False),
            lost=~_finite(state),
        )

        def unfinished(search: _Search) -> Array:
            return (search.left > 0) & ~search.lost & (search.steps < self.most_steps)

        return lax.while_loop(unfinished, lambda search: self._stepped(search, p, advance), as_batched(first, rate))

    def _stepped(self, search: _Search, p: Parameters, advance: Callable[[ReturnMap, Carried], Carried]) -> _Search:
        """Take one step: a whole one, one that locates the crossing within it, or the one that ends there."""
        partly, before = self.unit.rescaled_time(self.step * search.share), _state_of(search.carried)
        ahead = advance(partly, search.carried)
        after = _state_of(ahead)
        rate, finite = self.system.rate(after, p), _finite(after)
        heights = self.system.heights(before, after)
        ends = heights[0], search.rate * self.step, heights[1], rate * self.step
        left = search.side
        if self.system.turn:  # the side of another turn is not that of this one
            other = (search.steps > 0) | (jnp.abs(heights[0]) > 0.25 * self.system.turn)
            left = jnp.where(other, jnp.where(heights[0] >= 0.0, 1.0, -1.0), left)
        rising = jnp.ones_like(left) if self.system.direction != "both" else -left

        seeking = search.shots == 0
        side, low, high, seen = crossing_between(ends, left, either=self.system.direction == "both")
        seen &= seeking & finite
        guess = straight_share(ends, low, high)
        better, *bracket = improve_share(search.share, *ends[2:], rising, search.low, search.high)

        near = (jnp.abs(better - search.share) <= SETTLED) | (search.shots >= MOST_SHOTS)
        onwards, arrived = seeking & ~seen, search.settled
        moved = onwards | arrived
        t = search.t + (search.steps.astype(search.t.dtype) + search.share) * self.step
        on_section, later = self._on_section(ahead, search, p)
        ahead = jax.tree.map(lambda whole, part: jnp.where(arrived, part, whole), ahead, on_section)
        return _Search(
            carried=jax.tree.map(lambda old, new: jnp.where(moved, new, old), search.carried, ahead),
            rate=jnp.where(moved, rate, search.rate),
            t=jnp.where(arrived, t, search.t),
            by_tangent=tuple(jnp.where(arrived, x + dt, x) for x, dt in zip(search.by_tangent, later, strict=True)),
            left=jnp.where(arrived & finite, search.left - 1, search.left),
            leaving=jnp.where(arrived, rate, search.leaving),
            side=jnp.where(arrived, self._side(after, rate), jnp.where(onwards, side, search.side)),
            steps=jnp.where(arrived, 0, jnp.where(onwards, search.steps + 1, search.steps)),
            share=jnp.where(moved, 1.0, jnp.where(seen, guess, better)),
            low=jnp.where(seen, low, bracket[0]),
            high=jnp.where(seen, high, bracket[1]),
            shots=jnp.where(moved, 0, search.shots + 1),
            settled=~seeking & ~arrived & near,
            lost=moved & ~finite,
        )

    def _side(self, state: State, rate: Array) -> Array:
        """The side that a motion leaves for."""
        height = self.system.height(state)
        if self.backward:
            return side_of_section(self.system, height, -rate, -jnp.asarray(self.step))
        return side_of_section(self.system, height, rate, self.step)

    def _on_section(self, ahead: Carried, search: _Search, p: Parameters) -> tuple[Carried, tuple[Array, ...]]:
        """State and tangents moved along the flow onto the section, and how much later each arrives."""
        if not isinstance(ahead, Pushforward):
            return ahead, ()
        moving = self.system.flow.rhs(jnp.zeros_like(search.t), ahead.state, p)
        speed = self.system.across(moving)
        tangents, later = [], []
        for tangent in ahead.tangents:
            dt = -self.system.across(tangent.state) / speed
            moved = jax.tree.map(lambda dz, v, dt=dt: dz + v * dt, tangent.state, moving)
            tangents.append(Tangent(moved, tangent.p))
            later.append(dt)
        grown = ahead.log_volume + jnp.log(jnp.abs(search.leaving / self.system.rate(ahead.state, p)))
        return Pushforward(ahead.state, tuple(tangents), grown), tuple(later)

    def _arrived(self, start: Crossing, ended: _Search, state: State) -> Crossing:
        """The crossing, or a lane that has failed and says why."""
        crossed = ended.left <= 0
        why = jnp.where(ended.lost, 1.0 * NOT_FINITE, 1.0 * NO_RETURN)
        reason = jnp.where(crossed, start.reason, jnp.where(start.reason > 0.0, start.reason, why))
        # Steps of a lane's own leave in its state why it was lost.
        kept = crossed | ended.lost if isinstance(self.unit, AdaptiveStrobe) else crossed
        state = masked(state, kept)
        return Crossing(state, jnp.where(crossed, ended.t, jnp.nan), reason)


def side_of_section(section: Section, height: Array, rate: Array, step: ArrayLike) -> Array:
    """The side that a motion leaves for, of the section or from beside it.

    Args:
        height: where it leaves.
        rate: of the height.
        step: length of a step.
    """
    return jnp.sign(jnp.where(jnp.abs(height) < near_section(section, rate, step), rate, height))


def near_section(section: Section, rate: Array, step: ArrayLike) -> Array:
    """Height below which a state is on the section."""
    return _ON_SECTION * (abs(section.value) + jnp.abs(rate) * step)


def _state_of(carried: Carried) -> State:
    return carried.state if isinstance(carried, Pushforward) else carried


def crossing_between(
    ends: tuple[Array, Array, Array, Array], side: Array, *, either: bool
) -> tuple[Array, Array, Array, Array]:
    """The side after a step, the part of it that has a crossing, and whether there is one.

    Args:
        ends: heights and their rates, for a whole step, before it and after it.
        side: +1 above, −1 below, before it; 0 on it, at rest across it.
        either: whether a crossing down is one as well.
    """
    now = jnp.where(ends[2] >= 0.0, 1.0, -1.0)
    turn = ends[1] / (ends[1] - ends[3])
    turns = ends[1] * ends[3] < 0.0
    away = turns & (ends[1] * side > 0.0)  # first away from the section, then towards it
    crossed = side * now < 0.0
    touched = ~crossed & turns & ~away & (_cubic(ends, turn)[0] * side < 0.0)
    low, high = jnp.where(crossed & away, turn, 0.0), jnp.where(touched, turn, 1.0)
    if not either:
        second = touched & (side > 0.0)  # down and up again
        low, high = jnp.where(second, turn, low), jnp.where(second, 1.0, high)
        return now, low, high, (crossed & (side < 0.0)) | touched
    return now, low, high, crossed | touched


def straight_share(ends: tuple[Array, Array, Array, Array], low: Array, high: Array) -> Array:
    """A first guess of where a height passes zero, by the straight line, within the part that has it."""
    straight = ends[0] / (ends[0] - ends[2])
    return jnp.where((straight > low) & (straight < high), straight, 0.5 * (low + high))


def near_turn(ends: tuple[Array, Array, Array, Array], side: Array) -> tuple[Array, Array]:
    """The part of a step after which its height turns back, and whether that is near zero though not seen beyond it.

    Args:
        ends, side: as of `crossing_between`.
    """
    turn = ends[1] / (ends[1] - ends[3])
    turns = (ends[1] * side < 0.0) & (ends[3] * side > 0.0) & (turn > _WITHIN) & (turn < 1.0 - _WITHIN)
    gap = _cubic(ends, turn)[0] * side
    return turn, turns & (gap < _NEARLY * (jnp.abs(ends[1]) + jnp.abs(ends[3])))


def improve_share(
    share: Array, height: Array, rate: Array, rising: Array, low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Newton's better share of a step, for a height and its rate, in the part that has the crossing; that part.

    At an end of the part rounding may take it beyond: halving from there would settle as far away as steps do.
    """
    short = height * rising < 0.0
    low, high = jnp.where(short, share, low), jnp.where(short, high, share)
    better = share - height / rate
    inside = (better >= low - SETTLED) & (better <= high + SETTLED)
    return jnp.where(inside, jnp.clip(better, low, high), 0.5 * (low + high)), low, high


def _compose(step_map: ReturnMap, pushed: Pushforward, p: Parameters, volume: bool) -> Pushforward:
    """State and tangents one map later, logarithms of volumes added where they are asked for."""
    after = step_map.pushforward(pushed.state, p, pushed.tangents, volume)
    return after._replace(log_volume=pushed.log_volume + after.log_volume)


def _finite(state: State) -> Array:
    return jnp.isfinite(sum(x * x for component in error_components(state) for x in component))


def _cubic(ends: tuple[Array, Array, Array, Array], share: Array) -> tuple[Array, Array]:
    """Value and slope at a share of the cubic with these values and slopes at both ends."""
    y0, d0, y1, d1 = ends
    second, third = 3.0 * (y1 - y0) - 2.0 * d0 - d1, d0 + d1 - 2.0 * (y1 - y0)
    value = y0 + share * (d0 + share * (second + share * third))
    return value, d0 + share * (2.0 * second + 3.0 * share * third)
