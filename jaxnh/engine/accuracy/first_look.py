"""A first look at a motion with steps that follow it, before anything is known of how many a period needs.

By the pair of orders 3 and 2 of Bogacki and Shampine, Appl. Math. Lett. 2 (1989) 321, each lane with steps of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples
from jaxnh.maps.batching import as_batched
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State

_LANES = 8  # of the sweep that are looked at, evenly among all
_TOLERANCE = 1e-4  # error of a step, of the largest modulus of each coordinate so far
_FIRST_STEP = 1e-6  # of the period
_SHORTEST = 1e-13  # of the period: what needs shorter steps goes to infinity
_VANISHES = 1e-13  # of the largest coordinate: below it one may be nothing but the rounding of others
_LIMITING = 0.05  # of the tolerance: an error by which the length of a step was chosen, as that of the first is not
_MOST_TRIALS = 1 << 18
_MOST_STEPS = 1 << 16  # of the reference, that samples are taken with
_FAR = 1e6  # times the largest modulus at the start: a motion that has left for infinity
_ORDER = 3


class FirstLook(NamedTuple):
    """Result of a first look.

    Attributes:
        steps: equal steps of a period, as short as the shortest that a motion that stays finite needs; 0 where none
            does.
        explanation: where no motion comes to the end of its period, why; else "".
    """

    steps: int
    explanation: str


class _Motion(NamedTuple):
    """One lane on its way.

    Attributes:
        y: coordinates.
        t: time.
        h: length of the next step.
        shortest: shortest step so far that the motion has needed.
        size: largest modulus of each coordinate so far.
        trials: steps tried.
    """

    y: Float[Array, " d"]
    t: Array
    h: Array
    shortest: Array
    size: Float[Array, " d"]
    trials: Array


def first_look(maps: SampleMaps, samples: Samples) -> FirstLook:
    """Follow a handful of lanes over a period, or a unit of time, with steps that their motions need."""
    picked = np.unique(np.linspace(0, len(samples.row) - 1, _LANES).round().astype(int))
    few = samples.take_lanes(picked)
    if maps.sectioned:
        few = few._replace(states=few.states.state)

    def shared(row: int) -> tuple[Flow, float]:
        flow = maps.flows[row].flow
        return flow, flow.period

    t, shortest, grown = maps.by_flow(_follow, shared, few, 1)
    periods = np.array([maps.flows[row].flow.period for row in few.row])
    arrived = t >= periods
    if np.any(arrived):
        needed = float(np.max((periods / shortest)[arrived]))
        return FirstLook(min(_MOST_STEPS, 1 << max(0, math.ceil(math.log2(needed)))), "")
    first = int(np.argmax(t))
    if grown[first]:
        return FirstLook(0, f"the motion goes to infinity at t = {t[first]:.4g}")
    if np.any(t > 0.0):
        return FirstLook(0, f"steps as short as {shortest[first]:.1g} do not come further than t = {t[first]:.4g}")
    return FirstLook(0, "")


def _follow(flow: Flow, period: ArrayLike, state: State, p: Parameters) -> tuple[Array, Array, Bool[Array, ""]]:
    """The time that one lane comes to, its shortest step, and whether it has left for infinity."""
    flat, whole = ravel_pytree(state)
    begun = jnp.abs(flat)

    def rate(t: Array, y: Float[Array, " d"]) -> Float[Array, " d"]:
        return ravel_pytree(flow.rhs(t, whole(y), p))[0]

    def unfinished(motion: _Motion) -> Array:
        return (motion.t < period) & (motion.h > _SHORTEST * period) & (motion.trials < _MOST_TRIALS)

    def step(motion: _Motion) -> _Motion:
        y, t = motion.y, motion.t
        h = jnp.minimum(motion.h, period - t)
        k1 = rate(t, y)
        k2 = rate(t + 0.5 * h, y + 0.5 * h * k1)
        k3 = rate(t + 0.75 * h, y + 0.75 * h * k2)
        new = y + h * (2.0 * k1 + 3.0 * k2 + 4.0 * k3) / 9.0
        k4 = rate(t + h, new)
        gap = jnp.abs(h * (-5.0 * k1 / 72.0 + k2 / 12.0 + k3 / 9.0 - k4 / 8.0))
        size = jnp.maximum(motion.size, jnp.abs(new))
        measure = jnp.maximum(size, _VANISHES * jnp.max(size))
        error = jnp.max(jnp.where(gap > 0.0, gap / (_TOLERANCE * measure), 0.0))
        error = jnp.where(jnp.all(jnp.isfinite(new)) & jnp.isfinite(error), error, jnp.inf)
        good = error <= 1.0
        last = h >= period - t
        change = jnp.clip(0.9 * jnp.maximum(error, 1e-9) ** (-1.0 / _ORDER), 0.1, 5.0)
        return _Motion(
            jnp.where(good, new, y),
            jnp.where(good, jnp.where(last, period, t + h), t),
            h * change,
            jnp.where(good & ~last & (error > _LIMITING), jnp.minimum(motion.shortest, h), motion.shortest),
            jnp.where(good, size, motion.size),
            motion.trials + 1,
        )

    zero = jnp.zeros_like(flat[0])
    begin = _Motion(flat, zero, zero + _FIRST_STEP * period, zero + period, begun, jnp.int32(0))
    end = lax.while_loop(unfinished, step, as_batched(begin, zero))
    largest = jnp.max(jnp.abs(begun))
    return end.t, end.shortest, jnp.max(jnp.abs(end.y)) > _FAR * jnp.where(largest > 0.0, largest, 1.0)
