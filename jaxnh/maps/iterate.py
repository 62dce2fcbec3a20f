"""Iterates of a map, its points one by one, and its derivatives, of one lane."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.protocol import Strobe, Tangent
from jaxnh.systems.particle import State


def iterate(strobe: Strobe, n: ArrayLike, state: State, b: ArrayLike) -> State:
    """Pⁿ(z; b) for one lane; n may be traced."""
    return lax.fori_loop(0, n, lambda _, z: strobe(z, b), state)


def record(strobe: Strobe, state: State, b: ArrayLike, count: int) -> tuple[State, State]:
    """The state after `count` periods, and those after 1, 2, …, count stacked along a new first axis."""

    def step(z: State, _: Any) -> tuple[State, State]:
        z = strobe(z, b)
        return z, z

    return lax.scan(step, state, length=count)


def section_map(strobe: Strobe, n: ArrayLike, u: Array, b: ArrayLike) -> Array:
    """Pⁿ in section coordinates, (d,) to (d,)."""
    return strobe.system.chart(iterate(strobe, n, strobe.system.unchart(u), b))


def derivatives(strobe: Strobe, n: ArrayLike, u: Array, b: ArrayLike) -> tuple[Array, Array, Array]:
    """Pⁿ(u; b) of shape (d,), its monodromy matrix ∂Pⁿ/∂u (d, d) and ∂Pⁿ/∂b (d,), in one forward pass.

    The same as `jax.jacfwd` of `section_map`, to rounding.
    """
    system, d = strobe.system, strobe.system.dimension
    basis = jnp.eye(d + 1)

    def lift(v: Array) -> tuple[State, Array]:
        return system.unchart(v[:d]), v[d]

    point = jnp.append(u, b)
    state, _ = lift(point)
    tangents = tuple(Tangent(*jax.jvp(lift, (point,), (e,))[1]) for e in basis)
    state, tangents = lax.fori_loop(0, n, lambda _, carry: strobe.push(carry[0], b, carry[1])[:2], (state, tangents))
    columns = [jax.jvp(system.chart, (state,), (t.state,))[1] for t in tangents]
    return system.chart(state), jnp.stack(columns[:d], axis=-1), columns[d]
