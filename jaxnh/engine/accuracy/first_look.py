"""A first look at a motion with steps that follow it, before anything is known of how many a period needs.

By the pair of orders 3 and 2 of Bogacki and Shampine, Appl. Math. Lett. 2 (1989) 321, each lane with steps of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples
from jaxnh.maps.batching import as_batched
from jaxnh.maps.section import flow_of
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.rows import spread_indices
from jaxnh.systems.state import State, error_components

LANES_FOLLOWED = 8
"""Lanes of a sweep that are looked at, evenly among all."""

_TOLERANCE = 1e-4  # error of a step, of the largest modulus of each coordinate so far
_FIRST_STEP = 1e-6  # of the length of time
_SHORTEST = 1e-13  # of it: what needs shorter steps goes to infinity, or its rates do
_OVERFLOWING = 1e-9 * float(np.finfo(float).max)  # what has come so far in steps that are not too short grows like exp
_VANISHES = 1e-13  # of the largest coordinate: below it one may be nothing but the rounding of others
_LIMITING = 0.05  # of the tolerance: an error by which the length of a step was chosen, as that of the first is not
_MOST_TRIALS = 1 << 18
_MOST_STEPS = 1 << 16  # of the reference, that samples are taken with
_ORDER = 3
# The pair: the last stage is taken at the end of a step, and its row is the method of order 3.
_C = np.array([0.0, 1 / 2, 3 / 4, 1.0])
_A = np.array([[0.0] * 4, [1 / 2, 0.0, 0.0, 0.0], [0.0, 3 / 4, 0.0, 0.0], [2 / 9, 1 / 3, 4 / 9, 0.0]])
_ERROR = np.array([-5 / 72, 1 / 12, 1 / 9, -1 / 8])


Watch = Callable[[tuple[Array, State], tuple[Array, State]], Any]
"""Numbers, none less than zero, of a step: from times and states at both its ends."""


class FirstLook(NamedTuple):
    """Result of a first look.

    Attributes:
        steps: equal steps of a period, as short as the shortest that a motion that stays finite needs; 0 where none
            does.
        explanation: where no motion comes to the end of its period, why; else "".
    """

    steps: int
    explanation: str


class FollowedMotion(NamedTuple):
    """One lane on its way.

    Attributes:
        y: coordinates.
        t: time.
        h: length of the next step.
        shortest: shortest step so far that the motion has needed.
        size: largest modulus of each coordinate so far.
        way: largest distance of each from where it began.
        watched: largest of each number so far that its steps are watched for, if they are.
        trials: steps tried.
    """

    y: Float[Array, " d"]
    t: Array
    h: Array
    shortest: Array
    size: Float[Array, " d"]
    way: Float[Array, " d"]
    watched: Any
    trials: Array


class Passage(NamedTuple):
    """Passages of a handful of lanes, each with steps of its own.

    Attributes:
        arrived: share of the length of time that a lane has come through.
        needed: steps of the length of the shortest that its motion needs, in that time.
        moduli: largest modulus of each component.
        ways: largest distance of each component from where it began.
    """

    arrived: Float[np.ndarray, " lanes"]
    needed: Float[np.ndarray, " lanes"]
    moduli: Float[np.ndarray, "lanes components"]
    ways: Float[np.ndarray, "lanes components"]


def follow(maps: SampleMaps, samples: Samples, length: float | None = None) -> Passage:
    """Follow a handful of lanes with steps that their motions need.

    Args:
        length: of time, by default a period or a unit of time.
    """
    picked = spread_indices(len(samples.row), LANES_FOLLOWED)
    few = samples.take_lanes(picked)
    if maps.sectioned:
        few = few._replace(states=few.states.state)

    def shared(row: int) -> tuple[Flow, float]:
        flow = flow_of(maps.flows[row])
        return flow, flow.period if length is None else length

    return Passage(*maps.by_flow(_follow, shared, few, 1))


def first_look(maps: SampleMaps, samples: Samples, periods: float = 1.0) -> FirstLook:
    """Look whether motions come through so many periods, or units of time, and how many steps one takes."""
    length = periods * maps.flow.period
    passage = follow(maps, samples, None if periods == 1.0 else length)
    arrived = passage.arrived >= 1.0
    if np.any(arrived):
        needed = float(np.max(passage.needed[arrived])) / periods
        return FirstLook(min(_MOST_STEPS, 1 << max(0, math.ceil(math.log2(needed)))), "")
    share = float(np.max(passage.arrived))
    if share > 0.0:
        when, farthest = f"at t = {share * length:.3g}", passage.moduli[np.argmax(passage.arrived)]
        if np.max(farthest) < _OVERFLOWING:
            return FirstLook(0, f"the motion goes to infinity {when}")
        cut = maps.flow.autonomous and not maps.sectioned
        remedy = "; slow down its growth, or give a smaller time_unit" if cut else "; slow down its growth"
        return FirstLook(0, f"the motion grows beyond the largest number {when}{remedy}")
    return FirstLook(0, "")


def _follow(flow: Flow, length: ArrayLike, state: State, p: Parameters) -> tuple[Array, Array, Array, Array]:
    """One lane's part of a `Passage`."""
    end = march(flow, length, state, p)
    count = len(jax.tree.leaves(error_components(state)))
    return end.t / length, jnp.asarray(length) / end.shortest, end.size[:count], end.way[:count]


def march(flow: Flow, length: ArrayLike, state: State, p: Parameters, watch: Watch | None = None) -> FollowedMotion:
    """One lane at the end of a length of time, or where it goes no further.

    Args:
        watch: what its steps are watched for.
    """
    flat, whole = ravel_pytree(state)
    start = jnp.abs(flat)

    def rate(t: Array, y: Float[Array, " d"]) -> Float[Array, " d"]:
        return ravel_pytree(flow.rhs(t, whole(y), p))[0]

    def unfinished(motion: FollowedMotion) -> Array:
        return (motion.t < length) & (motion.h > _SHORTEST * length) & (motion.trials < _MOST_TRIALS)

    def step(motion: FollowedMotion) -> FollowedMotion:
        y, t = motion.y, motion.t
        h = jnp.minimum(motion.h, length - t)

        def stage(i: Array, k: Float[Array, "4 d"]) -> Float[Array, "4 d"]:
            return k.at[i].set(rate(t + jnp.array(_C)[i] * h, y + h * (jnp.array(_A)[i] @ k)))

        k = lax.fori_loop(0, len(_C), stage, as_batched(jnp.zeros((len(_C), len(y))), h))
        new = y + h * (jnp.array(_A)[-1] @ k)
        gap = jnp.abs(h * (jnp.array(_ERROR) @ k))
        size = jnp.maximum(motion.size, jnp.abs(new))
        measure = jnp.maximum(size, _VANISHES * jnp.max(size))
        error = jnp.max(jnp.where(gap > 0.0, gap / (_TOLERANCE * measure), 0.0))
        error = jnp.where(jnp.all(jnp.isfinite(new)) & jnp.isfinite(error), error, jnp.inf)
        good = error <= 1.0
        last = h >= length - t
        largest = motion.watched
        if watch:
            largest = jax.tree.map(jnp.maximum, largest, watch((t, whole(y)), (t + h, whole(new))))
        change = jnp.clip(0.9 * jnp.maximum(error, 1e-9) ** (-1.0 / _ORDER), 0.1, 5.0)
        return FollowedMotion(
            jnp.where(good, new, y),
            jnp.where(good, jnp.where(last, length, t + h), t),
            h * change,
            jnp.where(good & ~last & (error > _LIMITING), jnp.minimum(motion.shortest, h), motion.shortest),
            jnp.where(good, size, motion.size),
            jnp.where(good, jnp.maximum(motion.way, jnp.abs(new - flat)), motion.way),
            jax.tree.map(lambda new, old: jnp.where(good, new, old), largest, motion.watched),
            motion.trials + 1,
        )

    zero = jnp.zeros_like(flat[0])
    seen = jax.tree.map(jnp.zeros_like, watch((zero, state), (zero, state))) if watch else ()
    first = zero + _FIRST_STEP * length
    begin = FollowedMotion(flat, zero, first, zero + length, start, jnp.zeros_like(flat), seen, jnp.int32(0))
    return lax.while_loop(unfinished, step, as_batched(begin, zero))
