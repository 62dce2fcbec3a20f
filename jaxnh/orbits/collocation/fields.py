"""Rates of a flow's coordinates and their derivatives, a point a lane."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.orbits.collocation.equations import FieldValues
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.observables import observable, time_unit


def point_rates(flow: Flow, u: Float[Array, " d"], t: ArrayLike, p: Parameters, names: tuple[str, ...]) -> FieldValues:
    """The rates of the coordinates at a point, with derivatives in them and in parameters by name."""
    rate, values = _rate_and_values(flow, u, t, p, names)
    return FieldValues(rate(u, values), *jax.jacfwd(rate, (0, 1))(u, values))  # pyright: ignore[reportArgumentType]


def timed_rates(flow: Flow, u: Float[Array, " d"], t: ArrayLike, p: Parameters, names: tuple[str, ...]) -> FieldValues:
    """The rates at a point, with the derivative in time before those in parameters."""

    def at_time(t: ArrayLike) -> Array:
        rate, values = _rate_and_values(flow, u, t, p, names)
        return rate(u, values)

    at, t = point_rates(flow, u, t, p, names), jnp.asarray(t, u.dtype)
    by_time = jax.jvp(at_time, (t,), (jnp.ones_like(t),))[1]
    return at._replace(by_parameters=jnp.concatenate([by_time[:, None], at.by_parameters], axis=1))  # pyright: ignore[reportArgumentType]


def height_rates(
    flow: Flow, u: Float[Array, " d"], t: ArrayLike, p: Parameters, name: str, names: tuple[str, ...]
) -> tuple[Float[Array, " 2"], Float[Array, "2 d"], Float[Array, "2 1+q"]]:
    """An observable of a flow, and its rate along the motion; derivatives of both in the state; in time and parameters.

    Args:
        name: of the observable (`systems.observables`); "": the divergence of the field, in units of time.
    """
    at = jnp.stack([jnp.asarray(x, u.dtype) for x in (t, *(p[key] for key in names))])

    def both(u: Array, at: Array) -> Array:
        own = {**p, **{key: at[1 + k] for k, key in enumerate(names)}}

        def height(u: Array, t: Array) -> Array:
            return observable(flow, name, t, flow.chart.state(u), own) if name else _divergence(flow, u, t, own)

        rate, values = _rate_and_values(flow, u, at[0], own, names)
        return jnp.stack(jax.jvp(height, (u, at[0]), (rate(u, values), jnp.ones_like(at[0]))))

    return both(u, at), *jax.jacfwd(both, (0, 1))(u, at)


def _divergence(flow: Flow, u: Float[Array, " d"], t: ArrayLike, p: Parameters) -> Float[Array, ""]:
    """The trace of the rates' derivative: its mean along a cycle is the sum of Floquet exponents (Liouville)."""
    rate, values = _rate_and_values(flow, u, t, p, ())
    return jnp.trace(jax.jacfwd(rate)(u, values)) / time_unit(flow, p)


class EigenvectorRates(NamedTuple):
    """Rates (d,) at a point, and derivatives in coordinates and parameters: theirs (d, d + q), and those of A v."""

    rate: Float[Array, " d"]
    slopes: Float[Array, "d d+q"]
    of_images: Float[Array, "m d d+q"]


def eigenvector_rates(
    flow: Flow, u: Float[Array, " d"], vectors: Float[Array, "m d"], p: Parameters, names: tuple[str, ...]
) -> EigenvectorRates:
    """The rates at a point of a flow without a clock, and the derivatives of the images A v of m vectors."""
    rate, values = _rate_and_values(flow, u, 0.0, p, names)

    def slopes(function: _Rate) -> Array:
        return jnp.concatenate(jax.jacfwd(function, (0, 1))(u, values), axis=1)

    def of_image(vector: Array) -> Array:
        return slopes(_directional_derivative(rate, vector, jnp.zeros_like(values)))

    return EigenvectorRates(rate(u, values), slopes(rate), jax.vmap(of_image)(vectors))


def mixed_derivative(
    flow: Flow, u: Float[Array, " d"], ways: Float[Array, "k d+q"], p: Parameters, names: tuple[str, ...]
) -> Float[Array, " d"]:
    """The derivative of the rates along k directions of coordinates and parameters, one after the other."""
    rate, values = _rate_and_values(flow, u, 0.0, p, names)
    for k in range(ways.shape[0]):
        rate = _directional_derivative(rate, ways[k, : len(u)], ways[k, len(u) :])
    return rate(u, values)


_Rate = Callable[[Array, Array], Array]


def _directional_derivative(rate: _Rate, way: Array, of_values: Array) -> _Rate:
    """The derivative of a function of coordinates and parameters along a direction."""
    return lambda u, values: jax.jvp(rate, (u, values), (way, of_values))[1]


def _rate_and_values(
    flow: Flow, u: Float[Array, " d"], t: ArrayLike, p: Parameters, names: tuple[str, ...]
) -> tuple[_Rate, Float[Array, " q"]]:
    """The rates as a function of coordinates and parameters by name, and the values of these."""
    chart = flow.chart

    def rate(u: Array, values: Array) -> Array:
        y = chart.state(u)
        own = {**p, **{name: values[k] for k, name in enumerate(names)}}
        return jnp.stack(chart.lower(y, flow.rhs(t, y, own)))

    return rate, jnp.stack([jnp.asarray(p[name], u.dtype) for name in names]) if names else jnp.zeros(0, u.dtype)
