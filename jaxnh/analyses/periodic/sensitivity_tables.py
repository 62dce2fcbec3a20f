"""Derivatives in parameters as variables of results, with a dimension `parameter`, and as columns of tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from jaxnh.analyses.base import Entry, variable
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.periodic.sensitivities import Sensitivities
from jaxnh.systems.readout import UNSAID


def sensitivity_variables(
    sensitivities: Sensitivities, batch: LaneBatch, dims: Sequence[str], name: str, words: str, units: str
) -> dict[str, Entry]:
    """Variables of derivatives of a number, over its own dimensions and `parameter`, with their errors.

    Args:
        sensitivities: the derivatives.
        batch: whose flow has the parameters.
        dims: of the numbers.
        name, words, units: of the number.
    """
    each = {parameter: batch.flow.readout.labels.units.get(parameter, UNSAID) for parameter in sensitivities.names}
    common = units if set(each.values()) <= {"1"} else UNSAID
    said = ", ".join(f"{parameter} in {unit}" for parameter, unit in each.items() if unit not in (UNSAID, "1"))
    more = {"comment": f"units of the number over those of the parameter: {said}"} if said else {}
    key, dims = f"{name}_sensitivity", (*dims, "parameter")
    what = f"derivative of {words} in a parameter, all others held"
    return {
        "parameter": variable("parameter", np.array(sensitivities.names), "parameter of the flow"),
        key: variable(dims, sensitivities.rates, what, common, ancillary_variables=f"{key}_error", **more),
        f"{key}_error": variable(dims, sensitivities.errors, f"error of the {what}", common),
    }


def absent_words(analysis: str, sensitivities: Sensitivities) -> str:
    """Return a line for the user for each parameter in which there is no derivative; "" where there is none."""
    lines = (f"{analysis}: no derivative in {name}: {reason}" for name, reason in sensitivities.absent.items())
    return "\n".join(lines)


def sensitivity_heads(data: xr.Dataset, name: str) -> tuple[str, ...]:
    """Return heads of columns of a table for the derivatives of a number, a column a parameter."""
    asked = f"{name}_sensitivity" in data
    return tuple(f"∂{name}/∂{parameter}" for parameter in data["parameter"].to_numpy()) if asked else ()


def sensitivity_cells(data: xr.Dataset, name: str, row: int) -> tuple[str, ...]:
    """Return the cells below, of one number: as many digits as the error leaves, at most eight."""
    if f"{name}_sensitivity" not in data:
        return ()
    rates, errors = (data[f"{name}_sensitivity{end}"].to_numpy()[row] for end in ("", "_error"))
    with np.errstate(divide="ignore", invalid="ignore"):
        digits = np.nan_to_num(-np.floor(np.log10(errors)), nan=0.0, posinf=8.0)
    return tuple(
        f"{rate:.{int(k)}f}" if np.isfinite(rate) else "–" for rate, k in zip(rates, np.clip(digits, 0, 8), strict=True)
    )


def sensitivity_words(data: xr.Dataset, name: str) -> str:
    """Return derivatives of the first and the last level in words; "" where there are none."""
    known = data.isel(level=np.flatnonzero(np.isfinite(data[name].to_numpy())))
    if not (heads := sensitivity_heads(data, name)) or not known.sizes["level"]:
        return ""
    first, last = (sensitivity_cells(known, name, row) for row in (0, -1))
    ranges = zip(heads, first, last, strict=True)
    return ", ".join(f"{head} = {low} to {high}" for head, low, high in ranges if low != "–")
