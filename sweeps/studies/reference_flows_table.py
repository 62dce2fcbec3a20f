"""The dataset of `sweeps.studies.reference_flows`: a row for each flow and map, from the results of its runs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import jaxnh
from jaxnh.analyses.base import flag, variable
from jaxnh.analyses.exponents.estimates import SOURCES
from jaxnh.analyses.verdict import exceeds_shear, largest_across, nearly_zero
from jaxnh.storage import hdf5
from jaxnh.systems.status import STATUS
from sweeps.studies.dysts_flows import PublishedFlow, independent_spectra

RECORD, RESULT, LONGER = "record.json", "result.h5", "longer"
"""Names in the folder of a flow: the record of its runs, its result, and the folder of a longer run."""

TIMED_OUT = 124
"""Exit code of a run that had no answer within its limit of time."""

RUNS = (*STATUS, "refused", "crashed", "timed_out")
"""Meanings of the flags of `status`: those of lanes, and of runs without an answer."""

MOTIONS = ("undecided", "chaotic", "regular", "equilibrium")
"""Meanings of the flags of `motion`."""

_REFUSED, _CRASHED, _LATE = (RUNS.index(word) for word in RUNS[-3:])
_NONE = -1
_PAIRS = {
    "exponents": "Lyapunov exponents, natural logarithm",
    "longer_exponents": "those of a run ten times as long, after the end of the first one",
    "independent_exponents": "those of an independent integration of fixed steps, which does not resolve stiff flows",
}
_NUMBERS = {
    "kaplan_yorke": "Kaplan–Yorke dimension",
    "kaplan_yorke_error": "error of the Kaplan–Yorke dimension by those of the exponents, at 95 %",
    "sum_rule_residual": "sum of the exponents minus the mean divergence, integrated by itself",
    "error_estimate": "error of a unit of time, or of a return to the section, relative to the size of the motion",
    "time_unit": "unit of time that lengths and errors are of",
    "averaging_periods": "units of time, or iterates, of the average",
    "seconds": "seconds of the run, its process with it",
    "published_largest": "largest exponent that dysts has",
    "published_kaplan_yorke": "Kaplan–Yorke dimension that dysts has",
}


def reference_table(folder: Path, published: Mapping[str, PublishedFlow], names: Sequence[str]) -> xr.Dataset:
    """Return the table of all flows and maps that have been run, over the dimensions `flow` and `exponent`.

    Exponents are in 1/time of a flow and in 1/iterate of a map; beyond those that there are they are not numbers, as is
    whatever is not known of a flow.

    Args:
        folder: has a folder for each.
        published: flows of dysts by name; all others are maps.
        names: of all, in the order of the table.

    Raises:
        ResultError: a result is damaged.
    """
    independent = independent_spectra()
    rows = []
    for name in names:
        if not (folder / name / RECORD).exists():
            continue
        row = _row(folder / name) | {"flow": name, "is_map": name not in published}
        if name in published:
            row |= _published(published[name])
        if name in independent:
            row["independent_exponents"] = independent[name]["mean"]
            row["independent_exponents_error"] = independent[name]["error"]
        longer = folder / name / LONGER / RESULT
        if longer.exists():
            spectrum = _spectrum(longer)
            row["longer_exponents"], row["longer_exponents_error"] = spectrum["exponents"], spectrum["exponents_error"]
        rows.append(row)
    return _dataset(rows, len(names))


def save(path: Path, data: xr.Dataset) -> None:
    """Write the table as the group `flows` of a result file."""
    attrs = {"jaxnh_version": jaxnh.__version__, "title": "Reference spectra of flows and maps"}
    hdf5.write(path, attrs, {"flows": data})


# ---- rows


def _row(folder: Path) -> dict[str, Any]:
    """A row of numbers by name, from the record of a flow and its result."""
    record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    tried = record["tried"]
    last = tried[-1]
    row: dict[str, Any] = {"measured_at": record["measured_at"], "seconds": last["seconds"]}
    if last["code"]:
        why = {TIMED_OUT: _LATE, 2: _REFUSED}.get(last["code"], _CRASHED)
        return row | {"status": why, "message": last["message"]}
    return row | _spectrum(folder / RESULT)


def _spectrum(path: Path) -> dict[str, Any]:
    data, attrs = hdf5.read_group(path, "lyapunov").squeeze(), hdf5.read_attrs(path)
    exponents, error = (np.atleast_1d(data[name].to_numpy()) for name in ("exponents", "exponents_error"))
    method, averaged = int(data["exponents_method"]), float(data["averaging_periods"])
    unit = float(attrs.get("strobe_period", 1.0))
    return {
        "motion": motion(exponents, error, SOURCES[method], averaged, unit),
        "exponents": exponents,
        "exponents_error": error,
        "exponents_method": method,
        "status": int(data["status"]),
        "kaplan_yorke": float(data["kaplan_yorke"]),
        "kaplan_yorke_error": float(data["kaplan_yorke_error"]),
        "sum_rule_residual": float(data["sum_rule_residual"]),
        "averaging_periods": averaged,
        "error_estimate": float(attrs.get("error_estimate", math.nan)),
        "solver": str(attrs.get("solver", "")),
        "steps_per_period": int(attrs.get("steps_per_period", 0)),
        "time_unit": unit,
    }


def motion(exponents: np.ndarray, error: np.ndarray, method: str, averaged: float, unit: float) -> int:
    """Return the kind of a motion by its exponents alone, a number of `MOTIONS`, as `verdict` judges them.

    Chaotic: the largest exponent across the flow is above what shear on a torus leaves in it; regular: it is zero
    within a small error, or negative.

    Args:
        exponents, error: (k,), in 1/time.
        method: word of `exponents_method`.
        averaged, unit: length of the average in units of time, and that unit.
    """
    if method == "equilibrium":
        return MOTIONS.index("equilibrium")
    largest, bar = largest_across(exponents[None], error[None])
    if exceeds_shear(largest, bar, np.array([averaged]), unit)[0]:
        return MOTIONS.index("chaotic")
    regular = nearly_zero(largest, bar, unit) | (largest + bar < 0.0)
    return MOTIONS.index("regular" if regular[0] else "undecided")


def _published(flow: PublishedFlow) -> dict[str, Any]:
    entry = flow.entry
    largest, dimension = entry["maximum_lyapunov_estimated"], entry["kaplan_yorke_dimension"]
    return {"published_largest": _number(largest), "published_kaplan_yorke": _number(dimension)}


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


# ---- columns


def _dataset(rows: Sequence[Mapping[str, Any]], count: int) -> xr.Dataset:
    most = max((len(row[name]) for row in rows for name in _PAIRS if name in row), default=1)
    variables = {
        "flow": variable("flow", np.array([row["flow"] for row in rows], str), "name", units=""),
        "exponent": variable("exponent", np.arange(1, most + 1), "number of the exponent, largest first"),
        "is_map": flag("flow", _column(rows, "is_map", 0), "what it is", ("flow", "map")),
        "status": flag("flow", _column(rows, "status", _NONE), "whether there is an answer, or why not", RUNS),
    }
    for name, words in _PAIRS.items():
        for suffix, more in (("", ""), ("_error", ", their error at 95 %")):
            values = np.full((len(rows), most), np.nan)
            for i, row in enumerate(rows):
                own = row.get(name + suffix, ())
                values[i, : len(own)] = own
            variables[name + suffix] = variable(("flow", "exponent"), values, words + more, units="")
    for name, words in _NUMBERS.items():
        variables[name] = variable("flow", _column(rows, name, np.nan), words, units="s" if name == "seconds" else "")
    for name, words, meanings in (
        ("exponents_method", "what the exponents are", SOURCES),
        ("motion", "kind of motion by the exponents alone", MOTIONS),
    ):
        variables[name] = flag("flow", _column(rows, name, _NONE), words, ("none", *meanings), least=_NONE)
    variables["steps_per_period"] = variable("flow", _column(rows, "steps_per_period", 0), "steps a unit of time")
    for name, words in (
        ("solver", "method of integration"),
        ("message", "why there is no answer"),
        ("measured_at", "commit and hash of the code"),
    ):
        variables[name] = variable("flow", np.array([row.get(name, "") for row in rows], str), words, units="")
    return xr.Dataset(variables, attrs={"flows_and_maps": count})


def _column(rows: Sequence[Mapping[str, Any]], name: str, default: float) -> np.ndarray:
    return np.array([row.get(name, default) for row in rows])
