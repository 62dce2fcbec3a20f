"""Datasets of Lyapunov spectra: exponents with errors, the sum rule, the sum and the dimension."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int8

from jaxnh.analyses.base import LANE, Entry, as_variable, flag, variable
from jaxnh.analyses.batch import LaneBatch, iterate_units, rate_attrs
from jaxnh.analyses.exponents.dimension import kaplan_yorke, kaplan_yorke_error
from jaxnh.analyses.exponents.errors import Average, widen_to_sum_rule
from jaxnh.analyses.exponents.estimates import SOURCES, Averages, Spectrum, know_lost, lost_tangents
from jaxnh.analyses.exponents.orthonormalisation import spares_last
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import LyapunovOptions
from jaxnh.maps.section import reports
from jaxnh.systems.readout import status
from jaxnh.systems.rows import select
from jaxnh.systems.status import NOT_FINITE

_AT_REST = -7.0  # of the logarithm of a flow's speed, over the whole average: the motion is coming to rest
_MOST_PARTS = 1024  # of a period, between which growth is summed
_SLOWS = -1.0  # of the same, where it falls in each block: the motion comes to rest slowly; where it rises so, grows
_COMMENT = (
    "of an average: the largest of Student's 95 % errors of its block means and batches of them, and how far the sum "
    "of growth strays from a line; of a smooth_average: how far those over its halves are from each other and from "
    "the whole; of a regular motion, where that may matter: twice what twice the steps change as well, and what 16 "
    "periods do not show of it; of both, up to zero where a finite window leaves that open, as "
    "much as a drift that slows down may still come to, infinite where one does not slow down, the change itself where "
    "the steps account for it, and at least the residual of the sum rule where that contradicts them; of a smallest "
    "exponent whose tangent was lost in others, which is the sum of all less these: their errors; of an orbit: "
    "twice what twice the steps change in its multipliers; of an equilibrium: twice what a last step of Newton changes "
    "in its eigenvalues, and what rounding may"
)


def dataset(
    options: LyapunovOptions,
    batch: LaneBatch,
    averages: Averages,
    spectrum: Spectrum,
    total: Average | None,
    area: Float[np.ndarray, " lanes"],
) -> xr.Dataset:
    """Return all variables; for an autonomous flow the first sum is that along the flow.

    Args:
        total: sum of all exponents a period, where all are asked for, so that there is a sum rule.
        area: ln of the growth of area over that of volume, as in `area_growth`, (lanes,).
    """
    period, k = batch.flow.period, spectrum.mean.shape[1]
    mean, error = spectrum.mean / period, spectrum.error / period
    averaged = averages.blocks * (options.periods // BLOCKS)
    volume, sums = _volume_and_sums(averages, k, period)
    residual, lost, by_sum = None, lost_tangents(averages, spectrum), np.zeros(len(mean), bool)
    if total:
        # At rest the flow has no direction once its rate has come down to rounding.
        sums = np.where(spectrum.source == SOURCES.index("equilibrium"), mean.sum(axis=1), sums)
        with np.errstate(invalid="ignore"):  # both are minus infinity where a map has a multiplier zero
            mean_divergence = volume[:, 1 if batch.flow.readout.contraction else 0]
            residual = sums - mean_divergence - area / averaged / period
        of_average = np.isin(spectrum.source, (SOURCES.index("average"), SOURCES.index("smooth_average")))
        by_sum = lost[:, -1]
        if spares_last(batch, k):  # where the rule is broken, it is by that tangent, as all others are followed
            by_sum = by_sum | (of_average & (np.abs(residual) > np.maximum(error.sum(axis=1), total.error / period)))
        by_sum = by_sum & ~np.any(lost[:, :-1], axis=1) & np.isfinite(total.mean)
        residual = np.where(by_sum, np.nan, residual)
        rounding = np.finfo(float).eps * np.sqrt(_MOST_PARTS * averaged) * np.abs(mean_divergence)
        error[of_average] = widen_to_sum_rule(error[of_average], residual[of_average], rounding[of_average])
    attrs: dict[str, Any] = {}
    if batch.flow.autonomous:
        _know_along_flow(mean, error, averages, spectrum, averaged)
        attrs["along_flow"] = "the exponent along the flow is known to be zero"
    know_lost(mean, error, lost, by_sum, total and Average(total.mean / period, total.error / period))
    order = np.argsort(-mean, axis=1)[:, : min(options.exponents, k)]
    exponents, errors = np.take_along_axis(mean, order, axis=1), np.take_along_axis(error, order, axis=1)
    variables = _exponents(batch, spectrum.source, exponents, errors, _reasons(batch, averages, spectrum, exponents))
    rate, divergence = rate_attrs(batch.flow), ""
    if symbols := batch.flow.readout.contraction:
        divergence = f" −{symbols}"
        words = f"exponent off the constraint, −2{symbols}, by the determinants of the steps"
        variables["transverse"] = variable(LANE, 2.0 * volume[:, 0], words, **rate)
    variables["averaging_periods"] = variable(
        LANE, averaged, "length of the average", counted_in=iterate_units(batch.system)
    )
    if total and residual is not None:
        variables["sum_rule_residual"] = variable(LANE, residual, _sum_rule_in_words(batch, divergence), **rate)
        if divergence:
            words = "sum of the plain averages minus that of the logarithms of the steps' determinants"
            variables["volume_residual"] = variable(LANE, sums - volume[:, 0], words, **rate)
        variables |= _sum_and_dimension(batch, total, exponents, errors)
    return xr.Dataset(variables, attrs=attrs)


def _know_along_flow(
    mean: Float[np.ndarray, "lanes sums"],
    error: Float[np.ndarray, "lanes sums"],
    averages: Averages,
    spectrum: Spectrum,
    averaged: np.ndarray,
) -> None:
    """Set the exponent along the flow to zero, without error, in place.

    Not where the motion comes to rest, nor where its speed grows without end: in each block of the average.
    """
    decline, along = spectrum.mean[:, 0] * averaged, averages.rates[:, :, 0]
    ran = np.arange(BLOCKS) < averages.blocks[:, None]
    falls, rises = ~np.any(along >= 0.0, axis=1), np.all((along > 0.0) | ~ran, axis=1)
    rests = (decline < _AT_REST) | (falls & (decline < _SLOWS)) | (spectrum.source == SOURCES.index("equilibrium"))
    known = ~(rests | (rises & (decline > -_SLOWS)))
    lost = ~(spectrum.mean[:, 0] < np.inf)
    for values in (mean, error):
        values[:, 0] = np.where(lost, np.nan, np.where(known, 0.0, values[:, 0]))


def _reasons(
    batch: LaneBatch, averages: Averages, spectrum: Spectrum, exponents: Float[np.ndarray, "lanes exponents"]
) -> Int8[np.ndarray, " lanes"]:
    """Return why lanes have failed, numbers in `STATUS`."""
    ended = reports(batch.flow, select(averages.growth.state, np.s_[:, None]))["status"]
    known = [SOURCES.index(source) for source in ("equilibrium", "orbit")]
    lost = ~np.all(exponents < np.inf, axis=1) & ~np.isin(spectrum.source, known)
    return np.where(lost & (np.asarray(ended.data) == 0), NOT_FINITE, ended.data)


def _exponents(
    batch: LaneBatch, source: np.ndarray, exponents: np.ndarray, errors: np.ndarray, reason: np.ndarray
) -> dict[str, Entry]:
    """Return exponents, largest first, their errors, and what they are."""
    each, rate, words = (LANE, "exponent"), rate_attrs(batch.flow), "Lyapunov exponents, natural logarithm"
    number = np.arange(1, exponents.shape[1] + 1)
    return {
        "exponent": variable("exponent", number, "number of the exponent, largest first"),
        "exponents": variable(each, exponents, words, **rate, ancillary_variables="exponents_error exponents_method"),
        "exponents_error": variable(each, errors, "error of the exponents at 95 %", **rate, comment=_COMMENT),
        "exponents_method": flag(LANE, source, "what the exponents of a lane are", SOURCES),
        "status": as_variable(LANE, status(reason)),
    }


def _volume_and_sums(
    averages: Averages, k: int, period: float
) -> tuple[Float[np.ndarray, "lanes 2"], Float[np.ndarray, " lanes"]]:
    """Return growth of volume, also by quadrature, and the sum of k growths, of plain averages a unit of time."""
    ran = (np.arange(BLOCKS) < averages.blocks[:, None])[:, :, None]
    volume = np.sum(np.where(ran, averages.rates[:, :, k:], 0.0), axis=1) / averages.blocks[:, None] / period
    return volume, np.sum(np.where(ran, averages.rates[:, :, :k], 0.0), axis=(1, 2)) / averages.blocks / period


def _sum_and_dimension(
    batch: LaneBatch,
    total: Average,
    exponents: Float[np.ndarray, "lanes exponents"],
    errors: Float[np.ndarray, "lanes exponents"],
) -> dict[str, Entry]:
    """Return what follows from all exponents: their sum a period, as one a unit of time, and the dimension."""
    rate, period = rate_attrs(batch.flow), batch.flow.period
    words = "sum of all exponents, of averages by the growth of volume"
    # Without a clock the exponent along the flow counts as well.
    of_strobes = "of the Poincaré section" if batch.flow.continuous else "of the map"
    source = "of the flow" if batch.flow.autonomous else of_strobes
    with np.errstate(invalid="ignore"):  # of orbits that are superstable both are −∞
        missed = np.abs(exponents.sum(axis=1) - total.mean / period) + total.error / period
    return {
        "exponent_sum": variable(LANE, total.mean / period, words, **rate),
        "exponent_sum_error": variable(LANE, total.error / period, "error of the sum at 95 %", **rate),
        "kaplan_yorke": variable(
            LANE,
            kaplan_yorke(exponents),
            f"Kaplan–Yorke dimension {source}",
            ancillary_variables="kaplan_yorke_error",
        ),
        "kaplan_yorke_error": variable(
            LANE,
            kaplan_yorke_error(exponents, errors, missed),
            "error of the dimension by those of the exponents and of their sum at 95 %",
        ),
    }


def _sum_rule_in_words(batch: LaneBatch, divergence: str) -> str:
    other = f"mean divergence{divergence}, integrated by itself"
    other = other if batch.flow.continuous else "mean of ln |det| of the derivative"
    return f"sum of the plain averages, at rest of the exponents, minus the {other}"
