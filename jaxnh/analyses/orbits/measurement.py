"""Periods in time, multipliers and indices of periodic orbits, with the errors of steps and of rounding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Complex, Float, Int8

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.orbits.search import map_of_lanes
from jaxnh.maps.family import Maps
from jaxnh.maps.protocol import ReturnMap
from jaxnh.orbits.multipliers import multipliers
from jaxnh.orbits.recognition import Cycles
from jaxnh.orbits.shooting import close_orbits
from jaxnh.systems.flow import Parameters

STABILITIES = ("none", "stable", "saddle", "repelling", "neutral")
"""Meanings of the flags −1 to 3 of `stability`."""

_PROBE = 1e-7  # sizes: how far points are moved to see how multipliers depend on them
_TINY = np.finfo(float).tiny
_ROUNDING = 32.0 * np.finfo(float).eps  # sizes: of a point of an orbit, where it is far from a bifurcation


class MeasuredCycles(NamedTuple):
    """Orbits of n returns with their numbers.

    Attributes:
        points: section coordinates, from the point with the least first one on, (cycles, n, d).
        residual: largest component of P(u_i) − u_{i+1} in sizes of the motion, (cycles,).
        multipliers, multipliers_error: largest modulus first, (cycles, d).
        time, time_error: period, (cycles,).
        fixed_point_index: sign of ∏ (1 − μ), the fixed-point index of Pⁿ, (cycles,).
        stability: numbers in `STABILITIES`, (cycles,).
    """

    points: Float[np.ndarray, "cycles n d"]
    residual: Float[np.ndarray, " cycles"]
    multipliers: Complex[np.ndarray, "cycles d"]
    multipliers_error: Float[np.ndarray, "cycles d"]
    time: Float[np.ndarray, " cycles"]
    time_error: Float[np.ndarray, " cycles"]
    fixed_point_index: Int8[np.ndarray, " cycles"]
    stability: Int8[np.ndarray, " cycles"]


def measure(
    batch: LaneBatch, lanes: LaneRunner, strobes: Sequence[Maps], cycles: Cycles, size: Float[np.ndarray, "lanes d"]
) -> MeasuredCycles:
    """Return the numbers of orbits from the second of two maps, of which the first has half as many steps.

    The difference of both is the error of the first, and covers that of the second. Points are known to rounding,
    which near a bifurcation 1/|1 − μ| enlarges; what that does to the multipliers is seen where points are moved.
    """
    lane, points, wrap, unit = cycles.lane, cycles.points, batch.chart.wrap, size[cycles.lane]
    values, times = list[np.ndarray](), list[np.ndarray]()
    periods = [map_of_lanes(batch, lanes, strobe) for strobe in strobes]
    coarse, fine = close_orbits(periods[0], points, lane, wrap), close_orbits(periods[1], points, lane, wrap)
    for strobe, orbits in zip(strobes, (coarse, fine), strict=True):
        points = np.where(orbits.converged[:, None, None], orbits.points, np.nan)
        values.append(multipliers(orbits.blocks))
        times.append(return_times(batch, lanes, strobe, points, lane))
    residual = np.where(fine.converged, fine.residual / unit.max(axis=1), np.nan)
    signs = np.where(np.random.default_rng(0).random(points.shape) < 0.5, -1.0, 1.0)
    moved = points + _PROBE * signs * unit[:, None]
    shape = points.shape
    blocks = np.asarray(periods[1](moved.reshape(-1, shape[2]), np.repeat(lane, shape[1])).monodromy)
    aside = multipliers(blocks.reshape(*shape, shape[2]))
    with np.errstate(divide="ignore", invalid="ignore"):
        rounding = _ROUNDING * np.maximum(1.0, 1.0 / np.min(np.abs(1.0 - values[1]), axis=1))
        error = np.abs(values[1] - values[0]) + (np.abs(aside - values[1]) / _PROBE) * rounding[:, None]
        modulus = np.abs(values[1])  # of a small one the rounding is that of the matrices, which are larger
        larger = (modulus[:, :1] / np.maximum(modulus, _TINY)) ** (1.0 / shape[1])
        error += shape[1] * _ROUNDING * np.maximum(modulus, _TINY) * larger
        time_error = np.abs(times[1] - times[0]) + rounding * times[1] * batch.flow.autonomous
    order = (np.argmin(points[:, :, 0], axis=1)[:, None] + np.arange(shape[1])) % shape[1]
    points = np.take_along_axis(points, order[:, :, None], axis=1)
    index = np.nan_to_num(np.sign(np.real(np.prod(1.0 - values[1], axis=1)))).astype(np.int8)
    return MeasuredCycles(points, residual, values[1], error, times[1], time_error, index, _stability(values[1], error))


def _stability(
    values: Complex[np.ndarray, "cycles d"], error: Float[np.ndarray, "cycles d"]
) -> Int8[np.ndarray, " cycles"]:
    modulus = np.abs(values)
    beyond = modulus > 1.0
    conditions = [
        ~np.isfinite(modulus).all(axis=1),
        np.any(np.abs(modulus - 1.0) <= error, axis=1),
        ~beyond.any(axis=1),
        beyond.all(axis=1),
    ]
    return np.select(conditions, [-1, 3, 0, 2], 1).astype(np.int8)


def return_times(
    batch: LaneBatch, lanes: LaneRunner, strobe: Maps, points: Float[np.ndarray, "cycles n d"], lane: np.ndarray
) -> Float[np.ndarray, " cycles"]:
    """Return the time that n returns from successive points take, by default of a period each, of orbits or motions."""
    count, n, d = points.shape
    if not batch.on_section:
        return np.full(count, n * float(batch.flow.period))
    p = batch.parameters_of(np.repeat(lane, n))
    return np.sum(lanes(_return_time, (strobe,), (points.reshape(-1, d), p)).reshape(count, n), axis=1)


def _return_time(strobe: ReturnMap, u: Float[Array, " d"], p: Parameters) -> Array:
    return strobe(strobe.chart.state(u), p).t
