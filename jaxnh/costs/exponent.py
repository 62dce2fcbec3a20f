"""Error of the largest Lyapunov exponent against the time averaged over, at the most chaotic b of a sweep.

The analysis itself is run at growing averaging times, on lanes so near in b that they differ in nothing but the path
they take. Their scatter about a ten times longer run is the true error, beside the error bar that the analysis gives.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from jaxnh.analyses import lyapunov
from jaxnh.analyses.base import Group, LaneRunner, Scene, Variable
from jaxnh.costs.stage import Inside

_SEARCHED = 256  # values of b of the sweep among which the most chaotic is looked for
_SEARCH_PERIODS = 256
_LANES = 256
_SPACING = 1e-9  # between them in b: enough for chaos to part them, nothing to the exponent
_TRANSIENT = 256
_AVERAGED = (16, 32, 64, 128, 256, 512)  # forcing periods; the reference has ten times the last
_QUANTILES = (0.1, 0.5, 0.9)


def price(scene: Scene, lanes: LaneRunner) -> Group | None:
    """Error and error bar at every averaging time; None where no b of the sweep is chaotic beyond its error bar."""
    with lanes.stage(f"cost: largest exponents of {_SEARCHED} values of b", _SEARCHED * (_TRANSIENT + _SEARCH_PERIODS)):
        b = _most_chaotic(scene, Inside(lanes))
    if b is None:
        return None
    averaged = np.array([*_AVERAGED, 10 * _AVERAGED[-1]])
    with lanes.stage(f"cost: largest exponent at b = {b:.6g}", _LANES * float(np.sum(_TRANSIENT + averaged))):
        return _measured(scene, Inside(lanes), b, averaged)


def _measured(scene: Scene, lanes: LaneRunner, b: float, averaged: np.ndarray) -> Group:
    """The analysis at every averaging time, the last of which gives the reference."""
    near = dataclasses.replace(scene, values=b + _SPACING * np.arange(_LANES))
    exponents, bars, seconds, cpu_seconds = [], [], [], []
    _exponents(near, lanes, int(averaged[0]))  # compiles
    for periods in averaged:
        wall, cpu = time.perf_counter(), time.process_time()
        exponent, bar = _exponents(near, lanes, int(periods))
        seconds.append((time.perf_counter() - wall) / _LANES)
        cpu_seconds.append((time.process_time() - cpu) / _LANES)
        exponents.append(exponent)
        bars.append(bar)
    reference = float(np.mean(exponents[-1]))
    errors = np.abs(np.array(exponents[:-1]) - reference)
    return _group(b, averaged[:-1], errors, np.array(bars[:-1]), seconds[:-1], cpu_seconds[:-1], reference)


def _most_chaotic(scene: Scene, lanes: LaneRunner) -> float | None:
    """The b of the sweep with the largest exponent."""
    picked = np.unique(np.linspace(0, len(scene.values) - 1, _SEARCHED).round().astype(int))
    exponent, bar = _exponents(dataclasses.replace(scene, values=scene.values[picked]), lanes, _SEARCH_PERIODS)
    best = int(np.nanargmax(exponent))
    return float(scene.values[picked[best]]) if exponent[best] > 2 * bar[best] else None


def _exponents(scene: Scene, lanes: LaneRunner, periods: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest exponent and its error bar of every lane."""
    options = lyapunov.LyapunovOptions(transient=_TRANSIENT, periods=periods, exponents=1)
    found = lyapunov.run(options, scene, lanes).variables
    return found["exponents"].data[:, 0], found["exponents_error"].data[:, 0]


def _group(
    b: float,
    averaged: np.ndarray,
    errors: np.ndarray,
    bars: np.ndarray,
    seconds: list[float],
    cpu_seconds: list[float],
    reference: float,
) -> Group:
    """Quantiles over the lanes, (averaged, quantile)."""
    unit = "1/time"
    spread = ("averaged", "quantile")
    variables = {
        "averaged": Variable(("averaged",), averaged, "averaging time", "forcing periods"),
        "quantile": Variable(("quantile",), np.array(_QUANTILES), "part of the lanes below"),
        "error": Variable(
            spread,
            np.quantile(errors, _QUANTILES, axis=1).T,
            "distance of the largest exponent from a longer run",
            unit,
        ),
        "error_bar": Variable(
            spread, np.quantile(bars, _QUANTILES, axis=1).T, "error bar that the analysis gives", unit
        ),
        "seconds": Variable(
            ("averaged",), np.array(seconds), f"time a value of b of {_LANES} together, transient and all", "s"
        ),
        "cpu_seconds": Variable(
            ("averaged",),
            np.array(cpu_seconds),
            f"time of all processors a value of b of {_LANES} together, transient and all",
            "s",
        ),
    }
    attrs = {
        "b": b,
        "reference": reference,
        "reference_periods": 10 * int(averaged[-1]),
        "lanes": _LANES,
        "transient": _TRANSIENT,
    }
    return Group(variables, attrs)
