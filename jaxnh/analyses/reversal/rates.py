"""Exponents of an attractor and of its image, the repeller, and the sum of the former, the mean divergence.

Those of the attractor are as `lyapunov` computes them. Those of the repeller are averages along motions backwards in
time, by steps of negative length from a point of the image: nothing of the attractor goes into them but where they
begin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.exponents.errors import average_blocks, average_windows, widen_to_zero
from jaxnh.analyses.exponents.tangent_growth import average, begin
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import LyapunovOptions
from jaxnh.maps.build import backward_parts
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.state import State

_ALIGNING = 8  # of this many parts of the transient, one turns tangents into place
_TANGENT_ERRORS = 100.0  # times the error of a period's map: what steps may do to the growth of tangents in it


class Rates(NamedTuple):
    """Exponents in 1/time, largest first, and their sum.

    Attributes:
        exponents, error: (lanes, k).
        total, total_error: of all exponents, (lanes,).
    """

    exponents: Float[np.ndarray, "lanes k"]
    error: Float[np.ndarray, "lanes k"]
    total: Float[np.ndarray, " lanes"]
    total_error: Float[np.ndarray, " lanes"]


def of_attractor(options: LyapunovOptions, batch: LaneBatch, lanes: LaneRunner, parts: int) -> Rates:
    """Return all exponents of lanes of a flow, and their sum from the growth of volume, which scatters less."""
    averages = lyapunov.averages(options, batch, lanes, parts)
    spectrum = lyapunov.spectrum(options, batch, lanes, averages, parts)
    mean, error, k = spectrum.mean.copy(), spectrum.error.copy(), spectrum.mean.shape[1]
    known = np.isin(spectrum.source, [lyapunov.SOURCES.index(source) for source in ("orbit", "equilibrium")])
    smooth = spectrum.source == lyapunov.SOURCES.index("smooth_average")
    before, length = options.transient // _ALIGNING, options.periods // BLOCKS * BLOCKS
    plain = average_blocks(averages.rates[:, :, k : k + 1])
    windows = average_windows(averages.smooth[:, :, k : k + 1], before, length)
    total, total_error = (
        np.where(smooth, of_windows[:, 0], of_blocks[:, 0])
        for of_windows, of_blocks in zip(windows, plain, strict=True)
    )
    total = np.where(known, mean.sum(axis=1), total)
    total_error = np.where(known, error.sum(axis=1), total_error) + _step_error(batch)
    if batch.flow.autonomous:
        moving = spectrum.source != lyapunov.SOURCES.index("equilibrium")
        for values in (mean, error):
            values[:, 0] = np.where(moving & np.isfinite(values[:, 0]), 0.0, values[:, 0])
    return _in_time(batch, mean, error, total, total_error)


def of_repeller(
    options: LyapunovOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    parts: int,
    states: State,
    instant: float,
) -> Rates:
    """Return all exponents of the flow backwards in time from states at an instant of the clock, and their sum."""

    made = backward_parts(batch.flow, batch.solver, batch.steps, parts, instant, compensated=batch.compensated)
    strobes = in_precision(made, batch.precision)
    k, lead, p = lyapunov.tangents(options, batch), int(batch.flow.autonomous), dict(batch.p)
    aligning, block = max(options.transient // _ALIGNING, 1), options.periods // BLOCKS
    rates = np.full((batch.count, BLOCKS, lead + k + 2), np.nan)
    with lanes.stage(f"reversal: repellers of {batch.count} lanes", batch.count * (aligning + options.periods)):
        growth = lanes(begin, (batch.system,), (states,), static=(k,))
        growth, _ = average(lanes, strobes, growth, p, aligning)
        for i in range(BLOCKS):
            growth, rates[:, i] = average(lanes, strobes, growth, p, block, i / BLOCKS)
    mean, error = widen_to_zero(average_blocks(rates[:, :, : lead + k]), aligning, BLOCKS * block)
    if lead:
        mean[:, 0], error[:, 0] = np.where(np.isfinite(mean[:, 0]), 0.0, np.nan), 0.0
    total, total_error = (values[:, 0] for values in average_blocks(rates[:, :, lead + k : lead + k + 1]))
    error[:, lead:] += _step_error(batch)
    return _in_time(batch, mean, error, total, total_error + _step_error(batch))


def _step_error(batch: LaneBatch) -> float:
    """Return what steps may add to the growth a period."""
    return _TANGENT_ERRORS * batch.error_estimate


def _in_time(
    batch: LaneBatch,
    mean: Float[np.ndarray, "lanes k"],
    error: Float[np.ndarray, "lanes k"],
    total: Float[np.ndarray, " lanes"],
    total_error: Float[np.ndarray, " lanes"],
) -> Rates:
    order, period = np.argsort(-mean, axis=1), batch.flow.period
    mean, error = (np.take_along_axis(values, order, axis=1) / period for values in (mean, error))
    return Rates(mean, error, total / period, total_error / period)
