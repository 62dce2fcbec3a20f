"""Motions between events: which events a motion meets in a period, and each arc up to its event as a smooth map.

Without a clock a period goes from a crossing of a section to the next one.

An arc keeps to one branch of the field for a length of its own, beyond walls and surfaces too, so that its end is a
smooth function of its beginning and of its length: orbits that touch a wall are solutions of smooth equations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxnh.maps.batching import as_batched
from jaxnh.maps.general_flow import own_parameters
from jaxnh.maps.jumping import JumpingStrobe
from jaxnh.maps.jumping_section import JumpingSection
from jaxnh.maps.section import Section, flow_of
from jaxnh.solvers import WrittenOutRungeKutta
from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth

SAMPLES = 64
"""Places along an arc, evenly in time, its end among them."""


class EventSequence(NamedTuple):
    """The events that a motion meets in a period, in order, with room for more.

    Attributes:
        met: number of them; one more than there is room for where there are too many.
        number: of the wall or surface of each, (room,).
        time: of each since the period began, (room,).
        state: coordinates after each, in front of these those at the beginning of the period, (1 + room, d).
        side: of all walls and surfaces then, +1 above, −1 below, (1 + room, k).
        duration: of the period.
    """

    met: Int[Array, ""]
    number: Int[Array, " room"]
    time: Float[Array, " room"]
    state: Float[Array, "more d"]
    side: Float[Array, "more k"]
    duration: Float[Array, ""]


def event_sequence(
    strobe: JumpingStrobe | JumpingSection, u: Float[Array, " d"], p: Parameters, room: int
) -> EventSequence:
    """The events of a period from a point on, of one lane.

    Args:
        strobe: the map, of a flow that walls and surfaces do not hold.
        u: the point.
        p: parameters of the lane.
        room: for so many events.
    """
    state: Any = strobe.chart.state(u)
    trials = strobe.trials(state, p)
    first, zero = trials.march(trials.first), jnp.zeros_like(u[0])
    y, side = first.moving.state.y, first.side[: trials.surfaces]
    none = EventSequence(
        jnp.int32(0),
        jnp.zeros(room, jnp.int32),
        jnp.zeros(room) + zero,
        jnp.zeros((1 + room, len(y))).at[0].set(jnp.stack(y)),
        jnp.zeros((1 + room, len(side))).at[0].set(jnp.stack(side)),
        zero,
    )

    def unfinished(known: tuple[Any, EventSequence]) -> Array:
        return trials.unfinished(known[0]) & (known[1].met <= room)

    def advance(known: tuple[Any, EventSequence]) -> tuple[Any, EventSequence]:
        trial, events = known
        trial, arrival = trials.advance(trial)
        march, k = trials.march(trial), events.met
        passes = arrival.passes & (arrival.sought < trials.surfaces)

        def written(kept: Array, new: Any, place: Array) -> Array:
            # A choice and no scatter, which XLA cannot compile here for two walls ("number of dimensions of this map").
            written_now = passes & (jnp.arange(len(kept), dtype=jnp.int32) == place)
            return jnp.where(written_now.reshape(-1, *[1] * (kept.ndim - 1)), new, kept)

        return trial, EventSequence(
            jnp.where(passes, k + 1, k),
            written(events.number, arrival.sought, k),
            written(events.time, march.t, k),
            written(events.state, jnp.stack(march.moving.state.y), k + 1),
            written(events.side, jnp.stack(march.side[: trials.surfaces]), k + 1),
            events.duration,
        )

    last, events = lax.while_loop(unfinished, advance, as_batched((trials.first, none), zero))
    lost = trials.march(last).lost | trials.unfinished(last)
    return events._replace(met=jnp.where(lost, room + 1, events.met), duration=trials.duration(last))


class ArcEnd(NamedTuple):
    """The end of an arc at its event.

    Attributes:
        after: coordinates and time after the event, (d + 1,); the time is zero where a period begins.
        missing: what is zero at the event: the height of the wall or surface that is met, its rate where it is touched,
            or what is left of the period, without a clock the height above the section.
        height: of the wall or surface.
    """

    after: Float[Array, " more"]
    missing: Float[Array, ""]
    height: Float[Array, ""]


def arc_end(
    system: PiecewiseSmooth | Section,
    solver: WrittenOutRungeKutta,
    steps: ArrayLike,
    period: ArrayLike,
    start: Float[Array, " more"],
    length: ArrayLike,
    side: Float[Array, " k"],
    event: Int[Array, ""],
    values: Float[Array, " q"],
    p: Parameters,
    names: tuple[str, ...],
) -> tuple[ArcEnd, ArcEnd, ArcEnd, ArcEnd]:
    """The end of an arc, and its derivatives in its beginning, its length, and parameters.

    Args:
        system: a flow with a clock, that walls and surfaces do not hold, or the section of one without.
        solver, steps: with so many of its steps.
        period: of the clock.
        start: coordinates and time at the beginning, (d + 1,).
        length: of time.
        side: of walls and surfaces, by which the field is chosen.
        event: the number of the wall or surface that is met; k more where it is touched; 2k where the period ends.
        values: of the parameters with names.
        p: parameters of the lane.
        names: of parameters.
    """
    flow: Any = flow_of(system)
    count, sides = side.shape[0], tuple(side)

    def end(start: Array, length: Array, values: Array) -> ArcEnd:
        own = own_parameters(flow, {**p, **{name: values[k] for k, name in enumerate(names)}})
        y = _moved(flow, solver, steps, start, length, sides, own)
        t = start[-1] + length
        state = PiecewisePoint(y, jnp.zeros_like(t))
        height, rate = _heights_and_rates(flow, t, state, sides, own)
        after, over = jnp.stack(y), event == 2 * count
        for k in range(len(flow.jumps)):
            jumped = jnp.stack(flow.jumped(k, t, state, own, sides).y)
            after = jnp.where(event == k, jumped, after)
        left = system.smooth_height(state) if isinstance(system, Section) else t - period
        missing = jnp.where(over, left, jnp.concatenate([height, rate])[event % (2 * count)])
        after = jnp.append(after, jnp.where(over, 0.0, t))
        return ArcEnd(after, missing, height[event % count])

    length = jnp.asarray(length, start.dtype)
    slopes: Any = jax.jacfwd(end, (0, 1, 2))(start, length, values)
    by_start, by_length, by_values = (ArcEnd(*(leaf[k] for leaf in slopes)) for k in range(3))
    return end(start, length, values), by_start, by_length, by_values


class ArcSamples(NamedTuple):
    """Places along an arc, `SAMPLES` of them, evenly in time.

    Attributes:
        state: coordinates, (places, d).
        height, rate: of all walls and surfaces, (places, k).
    """

    state: Float[Array, "places d"]
    height: Float[Array, "places k"]
    rate: Float[Array, "places k"]


def arc_samples(
    flow: PiecewiseSmooth,
    solver: WrittenOutRungeKutta,
    steps: ArrayLike,
    start: Float[Array, " more"],
    length: ArrayLike,
    side: Float[Array, " k"],
    p: Parameters,
) -> ArcSamples:
    """Places along an arc, after steps of which there are `SAMPLES` times as many; arguments as of `arc_end`."""
    own, part, sides = own_parameters(flow, p), length / SAMPLES, tuple(side)

    def advance(at: Array, _: None) -> tuple[Array, ArcSamples]:
        y, t = _moved(flow, solver, steps, at, part, sides, own), at[-1] + part
        height, rate = _heights_and_rates(flow, t, PiecewisePoint(y, jnp.zeros_like(t)), sides, own)
        return jnp.append(jnp.stack(y), t), ArcSamples(jnp.stack(y), height, rate)

    return lax.scan(advance, start, None, SAMPLES)[1]


def _moved(
    flow: PiecewiseSmooth,
    solver: WrittenOutRungeKutta,
    steps: ArrayLike,
    start: Array,
    length: ArrayLike,
    sides: tuple[Array, ...],
    own: Parameters,
) -> tuple[Array, ...]:
    """Coordinates after equal steps on one branch of the field."""
    h, c = length / jnp.asarray(steps, start.dtype), jnp.asarray(solver.c)

    def step(i: Array, y: PiecewisePoint) -> PiecewisePoint:
        t = start[-1] + jnp.asarray(i, start.dtype) * h
        return solver.carried_stages(lambda s, z: flow.branch(t + c[s] * h, z, own, sides), h, y)

    first = PiecewisePoint(tuple(start[:-1]), jnp.zeros_like(start[0]))
    return lax.fori_loop(0, steps, step, first).y


def _heights_and_rates(
    flow: PiecewiseSmooth, t: ArrayLike, state: PiecewisePoint, sides: tuple[Array, ...], own: Parameters
) -> tuple[Array, Array]:
    """Heights of walls and surfaces and their rates along a branch of the field."""
    along = flow.branch(t, state, own, sides)
    height, rate = jax.jvp(
        lambda t, y: jnp.stack(flow.heights(t, y, own, sides)),
        (jnp.asarray(t, float), state),
        (jnp.ones_like(t), along),
    )
    return height, rate
