"""Equilibria of a flow without a clock: zeros of its field that lanes have come to, and whether they attract.

A motion that rests on a wall, or sticks to a surface, has come there in finite time, and so has every one near it: the
map over a unit of time has a multiplier zero there, which the linearised field does not know. Such equilibria are fixed
points of that map.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.window_averages import WindowAverages
from jaxnh.maps.iterate import derivative_and_volume, section_map
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import rates
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.rows import select, write_rows

_STEPS = 20  # of Newton
_HELD_STEPS = 4  # of Newton, from a point that motions have come to
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
    if isinstance(batch.flow, PiecewiseSmooth) and batch.flow.holding:
        equilibria = _with_held(batch, lanes, u, size, equilibria)
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
    exists = finite & np.all(np.abs(step) <= _rounding(batch, size), axis=1)
    # Least squares take no step either where the field is across the range of a singular linearisation.
    exists &= _are_zero(batch, size, rates, change)
    real = np.sort(np.linalg.eigvals(np.where(exists[:, None, None], change, 0.0)).real, axis=1)[:, ::-1]
    hidden = batch.flow.chart.dimension - batch.flow.exponents  # zeros, of what constraints keep
    if hidden:
        order = np.argsort(np.abs(real), axis=1)[:, hidden:]
        real = np.sort(np.take_along_axis(real, order, axis=1), axis=1)[:, ::-1]
    with np.errstate(invalid="ignore"):
        least = _ROUNDING * np.linalg.norm(change, axis=(1, 2))
    return Equilibria(exists, exists & (real[:, 0] < -least), at, np.where(exists, real[:, 0], np.nan))


def _with_held(
    batch: LaneBatch,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    size: Float[np.ndarray, "lanes d"],
    equilibria: Equilibria,
) -> Equilibria:
    """Return equilibria with those of lanes that are held: fixed points of the map over a unit of time, by Newton."""
    shared, p, unit = (batch.strobe(),), dict(batch.p), np.eye(u.shape[1])

    def mapped(at: np.ndarray) -> list[np.ndarray]:
        image, monodromy, volume = map(np.asarray, lanes(_map_and_derivative, shared, (at, p)))
        change = batch.chart.wrap(image - at)
        finite = np.all(np.isfinite(monodromy), axis=(1, 2)) & np.all(np.isfinite(change), axis=1)
        still = finite[:, None], finite[:, None, None]
        return [image, np.where(still[0], change, 0.0), np.where(still[1], monodromy, 0.0), finite & (volume == 0.0)]

    for _ in range(_HELD_STEPS):
        _, change, monodromy, _ = mapped(u)
        u = u + np.einsum("lij,lj->li", np.linalg.pinv(unit - monodromy), change)
    image, change, monodromy, held = mapped(u)
    exists = held & np.all(np.abs(change) <= _rounding(batch, size), axis=1)
    exists &= _are_zero(batch, size, *field_and_slopes(batch.flow, lanes, image, p))  # and no cycle as long as a unit
    largest = np.abs(np.linalg.eigvals(monodromy)).max(axis=1)
    with np.errstate(divide="ignore"):
        exponent = np.where(exists, np.log(largest) / batch.flow.period, np.nan)
    of_map = Equilibria(exists, exists & (largest < 1.0 - _ROUNDING), image, exponent)
    rows = np.flatnonzero(held)
    write_rows(equilibria, rows, select(of_map, rows))
    return equilibria


def _are_zero(
    batch: LaneBatch,
    size: Float[np.ndarray, "lanes d"],
    rates: Float[np.ndarray, "lanes d"],
    slopes: Float[np.ndarray, "lanes d d"],
) -> Bool[np.ndarray, " lanes"]:
    """Return whether rates are no more than the rounding of their points, by their slopes, makes them."""
    rounding = _rounding(batch, size)
    with np.errstate(invalid="ignore"):
        rest = np.einsum("lij,lj->li", np.abs(slopes), rounding) + rounding / batch.flow.period
        return np.all(np.abs(rates) <= rest, axis=1)


def _map_and_derivative(strobe: ReturnMap, u: Float[Array, " d"], p: Parameters) -> tuple[Array, Array, Array]:
    """Return the image of a point, and what `derivative_and_volume` does."""
    return section_map(strobe, 1, u, p), *derivative_and_volume(strobe, u, p)


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
