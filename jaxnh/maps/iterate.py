"""Iterates of a map, its points one by one, and its derivatives, of one lane."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.maps.batching import as_batched
from jaxnh.maps.protocol import ReturnMap, Tangent
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State


def iterate(strobe: ReturnMap, n: ArrayLike, state: State, p: Parameters) -> State:
    """Pⁿ(z; p) for one lane; n may be traced."""
    return strobe.iterate(n, state, p)


def record(strobe: ReturnMap, count: ArrayLike, state: State, p: Parameters, room: int) -> State:
    """The states after 1, 2, …, count periods along a new first axis, which has room for so many; count may be traced.

    What room is left holds zeros.
    """

    def period(i: Array, carry: tuple[State, State]) -> tuple[State, State]:
        z = strobe(carry[0], p)
        return z, jax.tree.map(lambda kept, x: lax.dynamic_update_index_in_dim(kept, x, i, 0), carry[1], z)

    none = jax.tree.map(lambda x: jnp.zeros((room, *jnp.shape(x)), jnp.result_type(x)), state)
    return lax.fori_loop(0, count, period, (state, none))[1]


def section_map(strobe: ReturnMap, n: ArrayLike, u: Float[Array, " d"], p: Parameters) -> Float[Array, " d"]:
    """Pⁿ in section coordinates."""
    return strobe.chart.point(iterate(strobe, n, strobe.chart.state(u), p))


class Derivatives(NamedTuple):
    """Pⁿ at a point, and its derivatives.

    Attributes:
        image: Pⁿ(u; p), (d,).
        monodromy: ∂Pⁿ/∂u, (d, d).
        by_parameter: ∂Pⁿ/∂p of one parameter, (d,), or of several, (d, k); None where none was asked for.
    """

    image: Float[Array, " d"]
    monodromy: Float[Array, "d d"]
    by_parameter: Float[Array, "d ..."] | None


def derivatives(
    strobe: ReturnMap, n: ArrayLike, u: Float[Array, " d"], p: Parameters, name: str | tuple[str, ...] | None = None
) -> Derivatives:
    """Pⁿ(u; p) with ∂Pⁿ/∂u, and if a parameter is named, or several, ∂Pⁿ/∂p in them, in one forward pass.

    The same as `jax.jacfwd` of `section_map`, to rounding.
    """
    chart, d = strobe.chart, strobe.chart.dimension
    tangents = [Tangent(jax.jvp(chart.state, (u,), (e,))[1]) for e in jnp.eye(d)]
    still = jax.tree.map(jnp.zeros_like, tangents[0].state)
    for parameter in (name,) if isinstance(name, str) else name or ():
        tangents.append(Tangent(still, {parameter: jnp.ones_like(u[0])}))

    def period(_: int, carry: tuple[State, tuple[Tangent, ...]]) -> tuple[State, tuple[Tangent, ...]]:
        pushed = strobe.pushforward(carry[0], p, carry[1], volume=False)
        return pushed.state, pushed.tangents

    state, moved = lax.fori_loop(0, n, period, as_batched((chart.state(u), tuple(tangents)), u[0]))
    columns = [jnp.stack(chart.lower(state, t.state)) for t in moved]
    by_parameter = jnp.stack(columns[d:], axis=-1) if isinstance(name, tuple) else columns[d] if name else None
    return Derivatives(chart.point(state), jnp.stack(columns[:d], axis=-1), by_parameter)


def derivative_and_volume(
    strobe: ReturnMap, u: Float[Array, " d"], p: Parameters
) -> tuple[Float[Array, "d d"], Float[Array, ""]]:
    """∂P/∂u, and the volume that the map makes of one: its determinant, known where rounding hides it in ∂P/∂u."""
    chart = strobe.chart
    tangents = tuple(Tangent(jax.jvp(chart.state, (u,), (e,))[1]) for e in jnp.eye(chart.dimension))
    pushed = strobe.pushforward(chart.state(u), p, tangents)
    columns = [jnp.stack(chart.lower(pushed.state, t.state)) for t in pushed.tangents]
    return jnp.stack(columns, axis=-1), jnp.exp(pushed.log_volume)


def return_time(strobe: ReturnMap, u: Float[Array, " d"], p: Parameters) -> Float[Array, ""]:
    """Time from a point of a section to the next crossing, of one lane."""
    return strobe(strobe.chart.state(u), p).t
