"""Jumps of a field at the surfaces that motions pass, of which tangents along steps across them know nothing.

Each surface is met exactly, on the chord of a step that passes it: there a corner changes nothing, and a jump does.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.engine.accuracy.first_look import march
from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples
from jaxnh.maps.batching import as_batched
from jaxnh.maps.section import flow_of
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.rows import spread_indices
from jaxnh.systems.state import State

_WATCHED = 32  # samples on whose motions jumps are looked for
_HALVINGS = 40  # of a step, to the surface that it passes
_NO_JUMP = 1e-6  # of the largest rate: a change across a surface that may be its distance from the place


def field_jumps(maps: SampleMaps, samples: Samples) -> tuple[bool, bool]:
    """Return whether the field jumps where motions from samples pass its surfaces, within a period or unit of time.

    Returns:
        Whether it does at any surface; and at one whose height depends on the state, past which tangents jump as well.
    """
    if not isinstance(maps.flow, PiecewiseSmooth):
        return False, False
    few = samples.take_lanes(spread_indices(len(samples.row), _WATCHED))
    if maps.sectioned:
        few = few._replace(states=few.states.state)

    def shared(row: int) -> tuple[Flow, float]:
        flow = flow_of(maps.flows[row])
        return flow, flow.period

    anywhere, moving = np.any(np.asarray(maps.by_flow(_largest_jumps, shared, few, 1)) > _NO_JUMP, axis=0)
    return bool(anywhere), bool(moving)


def _largest_jumps(flow: PiecewiseSmooth, length: ArrayLike, state: State, p: Parameters) -> Float[Array, " 2"]:
    """Largest jump of the field on one lane's way, at any surface and at one that moves with the state.

    Of the largest rate of each coordinate there and at the beginnings of steps.
    """

    def watch(begin: tuple[Array, State], end: tuple[Array, State]) -> tuple[Array, Array]:
        across, rates = _across_surfaces(flow, p, begin, end)
        return across, jnp.maximum(rates, jnp.abs(ravel_pytree(flow.rhs(*begin, p))[0]))

    across, rates = march(flow, length, state, p, watch).watched
    return jnp.max(jnp.where(across > 0.0, across / rates[None], 0.0), axis=1)


def _across_surfaces(
    flow: PiecewiseSmooth, p: Parameters, begin: tuple[Array, State], end: tuple[Array, State]
) -> tuple[Float[Array, "2 d"], Float[Array, " d"]]:
    """Largest change of each rate across any surface that a step passes, where its chord does; and across moving ones.

    At a corner nothing changes anywhere on the surface, whether or not the motion itself passes it there.

    Returns:
        The changes; and the largest modulus of each rate on both sides.
    """
    first = len(flow.jumps)

    def at(share: ArrayLike) -> tuple[Array, State]:
        return jax.tree.map(lambda a, b: a + share * (b - a), begin, end)

    def heights(share: ArrayLike) -> Float[Array, " surfaces"]:
        return jnp.stack(flow.heights(*at(share), p)[first:])

    before, after = heights(0.0), heights(1.0)
    flat, whole = ravel_pytree(begin[1])
    total, rates = jnp.zeros((2, len(flat))), jnp.zeros_like(flat)
    for k in range(flow.switches):

        def halve(_: int, ends: tuple[Array, Array], k: int = k) -> tuple[Array, Array]:
            low, high = ends
            middle = 0.5 * (low + high)
            same = heights(middle)[k] * before[k] > 0.0
            return jnp.where(same, middle, low), jnp.where(same, high, middle)

        zero = jnp.zeros_like(begin[0])
        place = at(lax.fori_loop(0, _HALVINGS, halve, as_batched((zero, zero + 1.0), zero))[0])
        sides = flow.sides(*place, p)
        above, below = (
            ravel_pytree(flow.branch(*place, p, (*sides[: first + k], zero + side, *sides[first + k + 1 :])))[0]
            for side in (1.0, -1.0)
        )
        there, y = place[0], ravel_pytree(place[1])[0]
        slope = jax.grad(lambda z, k=k, t=there: flow.heights(t, whole(z), p)[first + k])(y)
        passed = before[k] * after[k] < 0.0
        across = jnp.where(passed, jnp.abs(above - below), 0.0)
        rates = jnp.maximum(rates, jnp.where(passed, jnp.maximum(jnp.abs(above), jnp.abs(below)), 0.0))
        total = jnp.maximum(total, jnp.stack([across, jnp.where(jnp.any(slope != 0.0), across, 0.0)]))
    return total, rates
