"""Averages of growth along lanes, the spectra made of them, and the sum of all exponents."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.exponents.errors import Average, average_blocks, average_windows, widen_by_drift, widen_unsettled
from jaxnh.analyses.exponents.from_orbits import OrbitExponents
from jaxnh.analyses.exponents.tangent_growth import LARGEST_SEEN, TangentState
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.level import constraint_gradients, log_area
from jaxnh.systems.state import LaneStates

SOURCES = ("average", "smooth_average", "orbit", "equilibrium")
"""Meanings of the flags 0 to 3 of `exponents_method`."""

_TANGENT_ERRORS = 100.0  # times the error of a period's map: what steps may do to the growth of tangents in it


class Averages(NamedTuple):
    """Averages of lanes.

    Attributes:
        start: states where the averages begin.
        growth: of every lane at its end.
        rates: growth a period in every block that was run: of the flow's direction without a clock, of each tangent,
            of volume, and of volume by quadrature, (lanes, blocks, sums).
        smooth: what `smooth_parts` gives of the whole, without the last sum, (lanes, parts, sums).
        loss: of the flow's direction without a clock and of each tangent, as in `TangentState`, (lanes, sums).
        blocks: number of blocks that were run, (lanes,).
        settled: exponents of the lanes that were on orbits by the end of the first block, which needed no others.
    """

    start: LaneStates
    growth: TangentState
    rates: Float[np.ndarray, "lanes blocks sums"]
    smooth: Float[np.ndarray, "lanes parts sums"]
    loss: Float[np.ndarray, "lanes sums"]
    blocks: Int[np.ndarray, " lanes"]
    settled: OrbitExponents


class Spectrum(NamedTuple):
    """Exponents a period, and their sources.

    Attributes:
        mean, error: of the flow's direction without a clock, and of each tangent, (lanes, sums).
        source: number in `SOURCES`, (lanes,).
        of_sum: what steps may do to the sum of all exponents of a regular motion, (lanes,).
    """

    mean: Float[np.ndarray, "lanes sums"]
    error: Float[np.ndarray, "lanes sums"]
    source: Int8[np.ndarray, " lanes"]
    of_sum: Float[np.ndarray, " lanes"]


def step_error(batch: LaneBatch) -> float:
    """Return what steps may add to the growth a period."""
    return _TANGENT_ERRORS * batch.error_estimate


def widen_plain_by_drift(
    average: Average, averages: Averages, chosen: np.ndarray, sums: slice, steps: float
) -> Average:
    """Enlarge the errors of plain averages of chosen lanes to what a drift beyond their scatter may still come to.

    Of lanes that stopped early no drift is known.

    Args:
        sums: those of the rates that the averages are of.
        steps: as of `widen_by_drift`.
    """
    return widen_by_drift(average, averages.smooth[chosen][:, :, sums], averages.rates[chosen][:, :, sums], steps)


def exponent_sum(
    batch: LaneBatch, averages: Averages, spectrum: Spectrum, transient: int, aligned: int, block: int
) -> Average:
    """Return the sum of all exponents a period, and its error at 95 %.

    Of averages it is the growth of volume, which scatters less than each exponent; else the sum of the exponents.

    Args:
        transient, aligned, block: periods before the averages, those that tangents were carried before them, and those
            of a block.
    """
    k = spectrum.mean.shape[1]
    total, error = spectrum.mean.sum(axis=1), spectrum.error.sum(axis=1)
    steps = batch.error_estimate * block * averages.rates.shape[1]
    average, smooth = (spectrum.source == SOURCES.index(name) for name in ("average", "smooth_average"))
    for blocks in np.unique(averages.blocks[average]):
        chosen = average & (averages.blocks == blocks)
        plain = average_blocks(averages.rates[chosen, :blocks, k : k + 1])
        plain = widen_plain_by_drift(plain, averages, chosen, np.s_[k : k + 1], steps)
        plain = widen_unsettled(plain, averages.rates[chosen, :blocks, k : k + 1], transient + blocks * block)
        total[chosen], error[chosen] = plain.mean[:, 0], plain.error[:, 0]
    if np.any(smooth):
        length = block * averages.rates.shape[1]
        parts = averages.smooth[smooth, :, k : k + 1]
        windows = widen_by_drift(average_windows(parts, aligned, length), parts, steps=steps)
        windows = widen_unsettled(windows, averages.rates[smooth, :, k : k + 1], transient + length)
        total[smooth], error[smooth] = windows.mean[:, 0], windows.error[:, 0]
    return Average(total, error + step_error(batch) + spectrum.of_sum)


def lost_tangents(averages: Averages, spectrum: Spectrum) -> Bool[np.ndarray, "lanes sums"]:
    """Return which exponents are averages of tangents that were lost in others between orthonormalisations.

    A tangent that contracts by more than rounding leaves of it grows like what rounding adds to it.
    """
    averaged = np.isin(spectrum.source, (SOURCES.index("average"), SOURCES.index("smooth_average")))
    return (averages.loss > LARGEST_SEEN) & averaged[:, None] & np.isfinite(spectrum.mean)


def know_lost(
    mean: Float[np.ndarray, "lanes sums"],
    error: Float[np.ndarray, "lanes sums"],
    lost: Bool[np.ndarray, "lanes sums"],
    by_sum: Bool[np.ndarray, " lanes"],
    total: Average | None,
) -> None:
    """Set the exponents of lost tangents, or the errors of those that are not known, in place.

    Volume knows a smallest one, which is the sum of all less the others.

    Args:
        mean, error: exponents, that along the flow known.
        by_sum: where only the smallest is lost, and the sum is known.
        total: sum of all exponents, where all are asked for.
    """
    error[lost] = np.inf
    if total:
        mean[by_sum, -1] = total.mean[by_sum] - mean[by_sum, :-1].sum(axis=1)
        error[by_sum, -1] = total.error[by_sum] + error[by_sum, :-1].sum(axis=1)


def area_growth(batch: LaneBatch, lanes: LaneRunner, averages: Averages) -> Float[np.ndarray, " lanes"]:
    """Return ln of the growth of area on what motions keep over that of volume, from the begin of averages to the end.

    It stays bounded, but over a finite time the sum of the exponents is less the mean divergence by it. At rest on a
    critical point of an integral, where there is no such area, it is zero.
    """
    flow, shared = batch.flow, (batch.family or batch.system,)
    if not isinstance(flow, Lagrangian) or not flow.constrained:
        return np.zeros(batch.count)
    with np.errstate(invalid="ignore", divide="ignore"):
        start, end = (
            log_area(flow, np.asarray(lanes(constraint_gradients, shared, (state, dict(batch.p)))))
            for state in (averages.start, averages.growth.state)
        )
        grown = end - start
    return np.where(np.isfinite(grown), grown, 0.0)
