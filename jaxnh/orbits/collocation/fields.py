"""Rates of a flow's coordinates and their derivatives, a point a lane."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.orbits.collocation.equations import FieldValues
from jaxnh.systems.flow import Flow, Parameters


def point_rates(flow: Flow, u: Float[Array, " d"], t: ArrayLike, p: Parameters, names: tuple[str, ...]) -> FieldValues:
    """The rates of the coordinates at a point, with derivatives in them and in parameters by name."""
    chart = flow.chart

    def rate(u: Array, values: Array) -> Array:
        y = chart.state(u)
        own = {**p, **{name: values[k] for k, name in enumerate(names)}}
        return jnp.stack(chart.lower(y, flow.rhs(t, y, own)))

    values = jnp.stack([jnp.asarray(p[name], u.dtype) for name in names]) if names else jnp.zeros(0, u.dtype)
    return FieldValues(rate(u, values), *jax.jacfwd(rate, (0, 1))(u, values))  # pyright: ignore[reportArgumentType]
