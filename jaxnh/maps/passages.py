"""Passages of walls and surfaces within a trial of a step, and the record of a lane on its way from trial to trial.

Heights and their rates at both ends of a trial say whether one has been passed, as in `crossings`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from jaxnh.maps.crossings import SETTLED, crossing_between, near_turn, straight_share
from jaxnh.maps.event_heights import Heights, any_of, as_vector, pick
from jaxnh.maps.general_flow import Moving
from jaxnh.maps.saltation import AfterEvent, Arrival, Reading

_AT_ONE_TIME = 1.0 - 2.0**-20  # share of a trial up to an event from which on another is at the same time
_SOME_WAY = 1e3  # times what is on a wall: a trial that goes further has not begun on it with a jump
_BESIDE_END = 1.0 + 2.0**-20  # share up to which a passage at the end of a trial is looked for


class March(NamedTuple):
    """State of a march through the steps of a map.

    Attributes:
        moving: the state, with tangents and the logarithm of volume where they are asked for.
        t: time of it.
        step: number of the step that it is in.
        height, rate: of walls and surfaces, and their rates; of what holds the motion its release.
        side: +1 above, −1 below, 0 held there.
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
        lost: whether the state is not finite, or held twice.
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


class Trials(NamedTuple):
    """The trials of a lane up to the end of its period, or to its next crossing of a section.

    Attributes:
        first: where they begin.
        unfinished: whether one is left.
        advance: one of them, with the event that it may have ended at.
        march: the lane on its way, after one of them.
        duration: time of the period, after the last one.
        surfaces: number of walls and surfaces, the section not among them.
    """

    first: Any
    unfinished: Callable[[Any], Array]
    advance: Callable[[Any], tuple[Any, Arrival]]
    march: Callable[[Any], March]
    duration: Callable[[Any], Array]
    surfaces: int


class Passages(NamedTuple):
    """Passages within what a trial has gone over.

    Attributes:
        sides: +1 above, −1 below, at its end.
        passed: whether each wall or surface is passed.
        seen: whether one is that is looked for.
        first: number of the first of these.
        guess: of the share of the trial at which it is.
        low, high: part of the trial that has it.
        sure: whether both its sides have been seen.
        turn: where a height first turns near zero, as a share; infinite where none does.
    """

    sides: Heights
    passed: list[Array]
    seen: Array
    first: Array
    guess: Array
    low: Array
    high: Array
    sure: Array
    turn: Array

    def to_end(self, number: int, instead: Array) -> Passages:
        """Return these, or instead one at the end of the trial."""
        return self._replace(
            first=jnp.where(instead, number, self.first),
            guess=jnp.where(instead, 1.0, self.guess),
            low=jnp.where(instead, 0.0, self.low),
            high=jnp.where(instead, _BESIDE_END, self.high),
            sure=self.sure | instead,
        )


def passages_within(
    march: March,
    reading: Reading,
    h: Array,
    before: Heights,
    numbers: Sequence[Any],
    either: Sequence[bool],
    seeking: Array,
    finite: Array,
    on_wall: Sequence[Array],
    kept_side: float,
    earlier: Sequence[Array],
) -> Passages:
    """Locate passages within what a trial of length h has gone over, and turns of heights near zero.

    Args:
        march: before the trial.
        reading: at its end.
        before: side of each height at its beginning.
        numbers: number of each height.
        either: whether each is passed both ways.
        seeking: whether the trial is a whole step, in which passages are looked for.
        finite: whether the state at its end is.
        on_wall: height below which a motion that comes nearer arrives with the end of the trial.
        kept_side: 1.0 where that is no passage, and −1.0 where it is.
        earlier: of each height whether it is passed before the one that is sought, at the same time.
    """
    kept, arriving = _heights_at_end(march, reading, h, before, seeking, on_wall, kept_side)
    ends = [(a, b * h, c, d * h) for a, b, c, d in zip(march.height, march.rate, kept, reading.rate, strict=True)]
    between = [crossing_between(e, side, either=both) for e, side, both in zip(ends, before, either, strict=True)]
    between = [
        (now, low, jnp.where(there, _BESIDE_END, high), hit)
        for there, (now, low, high, hit) in zip(arriving, between, strict=True)
    ]
    passed = [part[3] & finite for part in between]
    guesses = [straight_share(e, part[1], part[2]) for e, part in zip(ends, between, strict=True)]
    looked_for = [
        seeking | (march.settled & ~march.again & (march.sought != k) & ((guess < _AT_ONE_TIME) | now))
        for k, guess, now in zip(numbers, guesses, earlier, strict=True)
    ]
    checked = [hit & looked for hit, looked in zip(passed, looked_for, strict=True)]
    turns = [near_turn(e, side) for e, side in zip(ends, before, strict=True)]
    turns = [(turn, near & seeking & finite) for turn, near in turns]
    candidates = as_vector([jnp.where(hit, guess, jnp.inf) for hit, guess in zip(checked, guesses, strict=True)])
    first = jnp.argmin(candidates).astype(jnp.int32)
    crossed = [part[0] != old for part, old in zip(between, before, strict=True)]
    return Passages(
        sides=tuple(part[0] for part in between),
        passed=passed,
        seen=any_of(checked),
        first=first,
        guess=pick(first, guesses),
        low=pick(first, [part[1] for part in between]),
        high=pick(first, [part[2] for part in between]),
        sure=pick(first, crossed),
        turn=jnp.min(as_vector([jnp.where(near, turn, jnp.inf) for turn, near in turns])),
    )


def at_one_time(rate: Array, length: Array) -> Array:
    """Height below which a motion is on a wall or surface when it meets another one, in a trial of such a length."""
    return SETTLED * jnp.abs(rate) * length


def is_on_section_first(number: int, march: March, reading: Reading, after: AfterEvent, *, once_more: bool) -> Array:
    """Return whether a motion that has met a wall is on the section before it jumps, and has not been yet.

    Args:
        number: of the section.
        march, reading, after: before the trial, at its end, and after the jump.
        once_more: whether it is not where the motion is there once more after the jump, and goes on over the section:
            that is its crossing.
    """

    def comes(height: Heights, rate: Heights) -> Array:
        near = at_one_time(rate[number], march.stretch)
        return (jnp.abs(height[number]) <= near) & (rate[number] * march.side[number] < 0.0)

    first = comes(reading.height, reading.rate)
    return first & ~comes(after.height, after.rate) if once_more else first


def _heights_at_end(
    march: March,
    reading: Reading,
    h: Array,
    before: Heights,
    seeking: Array,
    on_wall: Sequence[Array],
    kept_side: float,
) -> tuple[list[Array], list[Array]]:
    """Heights at the end of a trial, near zero on the side that they count for, and which arrive there.

    A motion that has gone some way to a wall at the end of the last step comes from the side that its rate says,
    whatever rounding does.
    """
    kept = [
        jnp.where(jnp.abs(x) <= r, 1e-300 * s, x)
        for x, r, s in zip(reading.height, march.rounding, before, strict=True)
    ]
    ending = [(s != 0.0) & (jnp.abs(x) <= near) for x, near, s in zip(kept, on_wall, march.side, strict=True)]
    arriving = [there & (rate * b < 0.0) for there, rate, b in zip(ending, reading.rate, before, strict=True)]
    come = [
        seeking & there & (jnp.abs(rate * h) > _SOME_WAY * near)
        for there, rate, near in zip(ending, reading.rate, on_wall, strict=True)
    ]
    kept = [
        jnp.where(arrives, kept_side * 1e-300 * b, jnp.where(comes, -1e-300 * jnp.sign(rate), x))
        for arrives, comes, b, rate, x in zip(arriving, come, before, reading.rate, kept, strict=True)
    ]
    return kept, arriving
