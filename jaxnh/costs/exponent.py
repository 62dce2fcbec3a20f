"""Error of the largest Lyapunov exponent against the time averaged over, at the most chaotic value of a sweep.

The analysis itself is run at growing averaging times, on lanes so near in the parameter that they differ in nothing but
the path they take. Their scatter about a ten times longer run is the true error, beside the error bar that the analysis
gives.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units, rate_attrs
from jaxnh.analyses.exponents import lyapunov
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.systems.rows import spread_indices

_SEARCHED = 256  # lanes of the sweep among which the most chaotic is looked for
_SEARCH_PERIODS = 256
_LANES = 256
_SPACING = 1e-9  # between them in the parameter: enough for chaos to part them, nothing to the exponent
_TRANSIENT = 256
_AVERAGED = (16, 32, 64, 128, 256, 512)  # periods; the reference has ten times the last
_QUANTILES = (0.1, 0.5, 0.9)


class _Average(NamedTuple):
    """Exponents and error bars of all lanes over one averaging time, and seconds a lane."""

    exponent: Float[np.ndarray, " lanes"]
    bar: Float[np.ndarray, " lanes"]
    seconds: float
    cpu_seconds: float


def price(batch: LaneBatch, lanes: LaneExecutor) -> xr.Dataset | None:
    """Error and error bar at every averaging time; None where no lane of the sweep is chaotic beyond its error bar."""
    with lanes.stage(f"cost: largest exponents of {_SEARCHED} lanes", _SEARCHED * (_TRANSIENT + _SEARCH_PERIODS)):
        value = _most_chaotic(batch, lanes.without_stages())
    if value is None:
        return None
    averaged = np.array([*_AVERAGED, 10 * _AVERAGED[-1]])
    label = f"cost: largest exponent at {batch.first_axis.name} = {value:.6g}"
    with lanes.stage(label, _LANES * float(np.sum(_TRANSIENT + averaged))):
        return _measure(batch, lanes.without_stages(), value, averaged)


def _measure(batch: LaneBatch, lanes: LaneRunner, value: float, averaged: Int[np.ndarray, " times"]) -> xr.Dataset:
    """The analysis at every averaging time, the last of which gives the reference."""
    near = batch.at_values(value + _SPACING * np.arange(_LANES))
    averages = []
    _exponents(near, lanes, int(averaged[0]))  # compiles
    for periods in averaged:
        wall, cpu = time.perf_counter(), time.process_time()
        exponent, bar = _exponents(near, lanes, int(periods))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        averages.append(_Average(exponent, bar, wall / _LANES, cpu / _LANES))
    return _dataset(batch, value, averaged[:-1], averages[:-1], float(np.mean(averages[-1].exponent)))


def _most_chaotic(batch: LaneBatch, lanes: LaneRunner) -> float | None:
    """The value of the first axis with the largest exponent."""
    picked = spread_indices(batch.count, _SEARCHED)
    exponent, bar = _exponents(batch.take(picked), lanes, _SEARCH_PERIODS)
    best = int(np.nanargmax(exponent))
    return float(batch.first_axis.values[picked[best]]) if exponent[best] > 2 * bar[best] else None


def _exponents(
    batch: LaneBatch, lanes: LaneRunner, periods: int
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Largest exponent and its error bar of every lane."""
    options = lyapunov.LyapunovOptions(transient=_TRANSIENT, periods=periods, exponents=1)
    result = lyapunov.run(options, batch, lanes)
    return result["exponents"].to_numpy()[:, 0], result["exponents_error"].to_numpy()[:, 0]


def _dataset(
    batch: LaneBatch, value: float, averaged: Int[np.ndarray, " times"], averages: list[_Average], reference: float
) -> xr.Dataset:
    """Quantiles over the lanes, (averaged, quantile)."""
    axis, rate, spread = batch.first_axis, rate_attrs(batch.flow), ("averaging_periods", "quantile")
    errors = np.abs(np.array([average.exponent for average in averages]) - reference)
    errors, bars = (
        np.quantile(values, _QUANTILES, axis=1).T for values in (errors, [average.bar for average in averages])
    )
    together = f"a value of {axis.name} of {_LANES} together, transient and all"
    seconds, cpu_seconds = ([getattr(average, kind) for average in averages] for kind in ("seconds", "cpu_seconds"))
    variables = {
        "averaging_periods": variable(
            "averaging_periods", averaged, "averaging time", counted_in=iterate_units(batch.without_section().system)
        ),
        "quantile": variable("quantile", np.array(_QUANTILES), "part of the lanes below"),
        "error": variable(spread, errors, "distance of the largest exponent from a longer run", **rate),
        "error_bar": variable(spread, bars, "error bar that the analysis gives", **rate),
        "seconds": variable("averaging_periods", seconds, f"time {together}", "s"),
        "cpu_seconds": variable("averaging_periods", cpu_seconds, f"time of all processors {together}", "s"),
        "value": variable((), value, f"{axis.long_name} of the lanes, about", axis.units),
        "lanes": variable((), _LANES, "number of lanes"),
        "reference": variable((), reference, "mean of the largest exponents of the longer run", **rate),
    }
    attrs = {"along": axis.name, "reference_periods": 10 * int(averaged[-1]), "transient": _TRANSIENT}
    return xr.Dataset(variables, attrs=attrs)
