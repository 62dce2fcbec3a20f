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
from jaxnh.analyses.exponents.errors import Average, average_blocks, change, smooth_parts, widen_by_drift, widen_to_zero
from jaxnh.analyses.exponents.estimates import SOURCES, exponent_sum, step_error
from jaxnh.analyses.exponents.tangent_growth import average, begin
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import LyapunovOptions
from jaxnh.analyses.smooth_window import DEGREE
from jaxnh.maps.family import Maps
from jaxnh.maps.inverse import backward_parts
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.state import State

_COMPARED = 16  # periods in which averages are held against those with twice the steps, from one state each
_ALIGNING = 8  # of this many parts of the transient, one turns tangents into place


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
    mean, error = spectrum.mean.copy(), spectrum.error.copy()
    total = exponent_sum(
        batch, averages, spectrum, options.transient, options.transient // _ALIGNING, options.periods // BLOCKS
    )
    if batch.flow.autonomous:
        moving = spectrum.source != SOURCES.index("equilibrium")
        for values in (mean, error):
            values[:, 0] = np.where(moving & np.isfinite(values[:, 0]), 0.0, values[:, 0])
    return _in_time(batch, mean, error, *total)


def of_repeller(
    options: LyapunovOptions, batch: LaneBatch, lanes: LaneRunner, parts: int, states: State, instant: float
) -> Rates:
    """Return all exponents of the flow backwards in time from states at an instant of the clock, and their sum.

    Steps are chosen for the map and its tangents forward in time. Backwards they may do less, where the motion is
    another: their part of the errors is at least twice what twice the steps change.
    """

    def backward(refinement: int) -> Maps:
        steps = refinement * batch.steps
        made = backward_parts(batch.flow, batch.solver, steps, parts, instant, compensated=batch.compensated)
        return in_precision(made, batch.precision)

    strobes = backward(1)
    k, lead, p = lyapunov.tangents(options, batch), int(batch.flow.autonomous), dict(batch.p)
    aligning, block = max(options.transient // _ALIGNING, 1), options.periods // BLOCKS
    rates = np.full((batch.count, BLOCKS, lead + k + 2), np.nan)
    smooth = np.zeros((batch.count, 3 + DEGREE, lead + k + 1))
    with lanes.stage(f"reversal: repellers of {batch.count} lanes", batch.count * (aligning + options.periods)):
        growth = lanes(begin, (batch.system,), (states,), static=(k,))
        growth, _ = average(lanes, strobes, growth, p, aligning)
        for i in range(BLOCKS):
            growth, rates[:, i] = average(lanes, strobes, growth, p, block, i / BLOCKS)
            smooth += smooth_parts(growth, block, i)
        coarse, fine = (average(lanes, backward(n), growth, p, _COMPARED)[1][:, :-1] for n in (1, 2))
    by_steps = np.maximum(step_error(batch), 2.0 * change(coarse, fine))
    steps = batch.error_estimate * block * BLOCKS
    every = widen_by_drift(average_blocks(rates[:, :, :-1]), smooth, rates[:, :, :-1], steps)
    mean, error = widen_to_zero(Average(*(values[:, : lead + k] for values in every)), aligning, BLOCKS * block)
    if lead:
        mean[:, 0], error[:, 0] = np.where(np.isfinite(mean[:, 0]), 0.0, np.nan), 0.0
    total, total_error = (values[:, lead + k] for values in every)
    error[:, lead:] += by_steps[:, lead : lead + k]
    return _in_time(batch, mean, error, total, total_error + by_steps[:, lead + k])


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
