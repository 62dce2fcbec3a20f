"""Equilibria of a flow without a clock: zeros of its field that lanes have come to, and whether they attract."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.window_averages import WindowAverages
from jaxnh.maps.section import rates
from jaxnh.systems.flow import Flow, Parameters

_STEPS = 20  # of Newton
_NEAR = 0.01  # of the range of a lane in its look: how far it may still be from its equilibrium
_ROUNDING = 1e-9  # of sizes, and of the linearisation's norm in its eigenvalues
_NOTHING = 1e-13  # of the largest size: coordinates that are zero


class Equilibria(NamedTuple):
    """Zeros of the field near lanes: whether one exists, whether it attracts, its point, and its largest exponent."""

    exists: Bool[np.ndarray, " lanes"]
    stable: Bool[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]
    exponent: Float[np.ndarray, " lanes"]


def find_equilibria(
    batch: LaneBatch,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    size: Float[np.ndarray, "lanes d"],
    window: WindowAverages,
) -> Equilibria:
    """Find zeros of the field that lanes have come to: near their points, against their range in a window."""
    equilibria = equilibria_from_starts(batch, lanes, u, size)
    apart = np.abs(batch.chart.wrap(equilibria.u - u))
    near = np.all(apart <= _NEAR * (window.high - window.low) + _rounding(batch, size), axis=1)
    exponent = np.where(near, equilibria.exponent, np.nan)
    return Equilibria(equilibria.exists & near, equilibria.stable & near, equilibria.u, exponent)


def equilibria_from_starts(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"]
) -> Equilibria:
    """Solve for a zero of the field by Newton, least squares where that is singular, from points of lanes."""
    at, step = u.copy(), np.zeros_like(u)
    p = dict(batch.p)
    rates, change = field_and_slopes(batch.flow, lanes, u, p)
    for _ in range(_STEPS):
        with np.errstate(invalid="ignore", over="ignore"):
            finite = np.all(np.isfinite(change), axis=(1, 2)) & np.all(np.isfinite(rates), axis=1)
        inverse = np.linalg.pinv(np.where(finite[:, None, None], change, 0.0))
        step = -np.einsum("lij,lj->li", inverse, np.where(finite[:, None], rates, 0.0))
        at = at + step
        rates, change = field_and_slopes(batch.flow, lanes, at, p)
    finite = np.all(np.isfinite(change), axis=(1, 2)) & np.all(np.isfinite(rates), axis=1)  # else no step was taken
    rounding = _rounding(batch, size)
    exists = finite & np.all(np.abs(step) <= rounding, axis=1)
    # Least squares take no step either where the field is across the range of a singular linearisation.
    with np.errstate(invalid="ignore"):
        rest = np.einsum("lij,lj->li", np.abs(change), rounding) + rounding / batch.flow.period
        exists &= np.all(np.abs(rates) <= rest, axis=1)
    real = np.sort(np.linalg.eigvals(np.where(exists[:, None, None], change, 0.0)).real, axis=1)[:, ::-1]
    hidden = batch.flow.chart.dimension - batch.flow.exponents  # zeros, of what constraints keep
    if hidden:
        order = np.argsort(np.abs(real), axis=1)[:, hidden:]
        real = np.sort(np.take_along_axis(real, order, axis=1), axis=1)[:, ::-1]
    with np.errstate(invalid="ignore"):
        least = _ROUNDING * np.linalg.norm(change, axis=(1, 2))
    return Equilibria(exists, exists & (real[:, 0] < -least), at, np.where(exists, real[:, 0], np.nan))


def _rounding(batch: LaneBatch, size: Float[np.ndarray, "lanes d"]) -> Float[np.ndarray, "lanes d"]:
    unit = np.where(np.array(batch.chart.angles), 1.0, size)
    return _ROUNDING * unit + _NOTHING * unit.max(axis=1, keepdims=True)


def field_and_slopes(
    flow: Flow, lanes: LaneRunner, u: Float[np.ndarray, "points d"], p: Mapping[str, Float[np.ndarray, " points"]]
) -> tuple[Float[np.ndarray, "points d"], Float[np.ndarray, "points d d"]]:
    """Return rates of a flow without a clock at points, and their derivatives in the coordinates."""
    rate, jacobian = lanes(_field, (flow,), (u, p))
    return np.asarray(rate), np.asarray(jacobian)


def _field(flow: Flow, u: Float[Array, " d"], p: Parameters) -> tuple[Array, Array]:
    """Return rates of section coordinates and ∂(rate)/∂(coordinate), for one lane."""

    def rate(u: Array) -> Array:
        y = flow.chart.state(u)
        return jnp.stack(rates(flow, y, p))

    return rate(u), jax.jacfwd(rate)(u)
