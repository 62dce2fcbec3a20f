"""Jumps and corners of a field on a motion, located by halving the steps of it in which the field changes most.

Of a smooth field what its derivative changes by over a step halves with it, and in thirty halvings becomes a billionth;
what the field changes by but for its derivatives at both ends becomes less still. A jump of the field, or of its
derivative along the motion at a corner, stays in one of the halves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxnh.config.messages import join_words
from jaxnh.engine.accuracy.sample_maps import image_of
from jaxnh.systems.first_order import FirstOrder
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.rows import select
from jaxnh.systems.state import State
from jaxnh.systems.straight_pieces import names_without_surface
from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL

_STEPS = 16  # of a motion in which the field changes most, that are halved
_HALVINGS = 30
_NAMED = 6  # coordinates of a place, at most
_STAYS = 0.25  # of a change over a step, that is left of it
_NOTHING = 1e-6  # of the largest value: a change that may be rounding
_LAST_DIGITS = 1e-290  # a field that is never larger has few digits, as of a motion that has come to rest


class Kink(NamedTuple):
    """A jump or a corner of a field.

    Attributes:
        order: power of the steps with which errors fall, of any method whose steps do not end there: of a jump 1, of a
            corner 2.
        description: what it is, where, and what would be right.
    """

    order: int
    description: str


def find_kink(
    flow: Flow, times: Float[np.ndarray, " points"], passed: State, p: Parameters, *, located: bool = True
) -> Kink | None:
    """Find a jump or a corner of a field on a motion; None where none is seen, or the state itself jumps.

    Args:
        times, passed: of states of the motion, one after the other.
        located: whether switches are left out, as by steps that end there.
    """
    if isinstance(flow, PiecewiseSmooth) and flow.needs_events:
        return None
    finite = np.all(np.isfinite(image_of(passed)), axis=0)
    points = len(times) if np.all(finite) else int(np.argmin(finite))
    if points < 2:
        return None
    begin, end = select(passed, slice(points - 1)), select(passed, slice(1, points))
    ends = times[: points - 1], times[1:points], begin, end

    @partial(jax.jit, compiler_options=COMPILED_FOR_ONE_CALL)
    @jax.vmap
    def field(t0: Array, t1: Array, y0: State, y1: State, share: Array) -> Float[Array, "2 d"]:
        """The field at a share of a step, and its derivative along the step."""

        def at(s: Array) -> Float[Array, " d"]:
            y = jax.tree.map(lambda a, b: a + s * (b - a), y0, y1)
            if isinstance(flow, PiecewiseSmooth) and located:
                return ravel_pytree(flow.branch(t0 + s * (t1 - t0), y, p, flow.sides(t0, y0, p)))[0]
            return ravel_pytree(flow.rhs(t0 + s * (t1 - t0), y, p))[0]

        return jnp.stack(jax.jvp(at, (share,), (jnp.ones_like(share),)))

    zero = np.zeros(points - 1)
    low, high = (np.asarray(field(*ends, share)) for share in (zero, zero + 1.0))
    for order, words in enumerate(("jumps", "has a corner")):
        largest = np.nanmax(np.maximum(np.abs(low[:, order]), np.abs(high[:, order])), axis=0)
        measure = np.where(largest > _LAST_DIGITS, largest, np.inf)
        with np.errstate(invalid="ignore", over="ignore"):  # where the field overflows, nothing is said
            step, share = _lasting_change(field, ends, low, high, measure, order)
        if step is not None:
            at = jax.tree.map(lambda a, b, i=step, s=share: a[i] + s * (b[i] - a[i]), begin, end)
            named = list(flow.readout.coordinates(at, np.zeros(1)).items())
            place = ", ".join(f"{name} = {float(output.data):.4g}" for name, output in named[:_NAMED])
            place += ", …" if len(named) > _NAMED else ""
            time = ends[0][step] + share * (ends[1][step] - ends[0][step])
            where = f"at t = {time:.4g}, {place}"
            remedy = (
                "make it smooth there, name the place in switches"
                if isinstance(flow, FirstOrder)
                else "make it smooth there"
            )
            names = names_without_surface(flow.rhs, 0.0, select(begin, 0), dict(p))
            without = f"steps cannot end where {join_words(names)} changes; " if names else ""
            return Kink(order + 1, f"the right-hand side {words} {where}: {without}{remedy}, or ask for less")
    return None


def _lasting_change(
    field: Callable[..., Any],
    ends: tuple[Any, ...],
    low: Float[np.ndarray, "steps 2 d"],
    high: Float[np.ndarray, "steps 2 d"],
    measure: Float[np.ndarray, " d"],
    order: int,
) -> tuple[int | None, float]:
    """The step whose change lasts as it is halved, and the share of it where that is; none where it does of no step."""

    def change(low: np.ndarray, high: np.ndarray, width: float) -> Float[np.ndarray, " some"]:
        """Change of the field less that by its derivatives at both ends, or of its derivative, in units of measure."""
        smooth = 0.5 * width * (low[:, 1] + high[:, 1]) if order == 0 else 0.0
        return np.max(np.abs(high[:, order] - low[:, order] - smooth) / measure, axis=1)

    changes = np.nan_to_num(change(low, high, 1.0), posinf=0.0)
    picked = np.sort(np.argsort(-changes, kind="stable")[:_STEPS])
    few = select(ends, picked)
    low, high, begin, width = low[picked], high[picked], np.zeros(len(picked)), 1.0
    for _ in range(_HALVINGS):
        width *= 0.5
        middle = np.asarray(field(*few, begin + width))
        later = change(middle, high, width) > change(low, middle, width)
        low, high = (np.where(later[:, None, None], *pair) for pair in ((middle, low), (high, middle)))
        begin = np.where(later, begin + width, begin)
    share_left = change(low, high, width) / np.maximum(changes[picked], np.finfo(float).tiny)
    # Of a pole, on the chord of a step, more and more would be left.
    lasting = (changes[picked] > _NOTHING) & (share_left > _STAYS) & (share_left < 1.0 / _STAYS)
    return (int(picked[np.argmax(lasting)]), float(begin[np.argmax(lasting)])) if np.any(lasting) else (None, 0.0)
