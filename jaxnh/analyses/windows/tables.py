"""The group `windows`: variables over windows, and their table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, Table, flag, variable
from jaxnh.analyses.batch import Axis, LaneBatch, iterate_units
from jaxnh.analyses.cascade.plateaus import PeriodScan
from jaxnh.analyses.periodic.location import LocatedDoubling
from jaxnh.analyses.periodic.sensitivity_tables import sensitivity_cells, sensitivity_heads
from jaxnh.analyses.table_arrays import padded, real_and_imaginary
from jaxnh.analyses.windows.search import DOUBLED, ENDS, End, Window, all_lanes

OWN_NAMES = (
    "window", "level", "searched", "spacing", "period", "orbits", "lanes", "first", "last", "begin", "end", "limit",
    "crisis", "doubling", "multiplier", "part", "parameter",
)  # fmt: skip
"""Names of variables and dimensions that the parameter may not have."""

_NO_LIMIT = "NaN of fewer than four doublings"
_NO_CRISIS = (
    "NaN of orbits of period 1, where no limit of doublings is known within the sweep, and where no path was seen to "
    "leave the bands, or one at once, from the limit to three times as far beyond as the first doubling is before it"
)
_DIGITS = 9  # behind the point, in the table
_DERIVED = ("begin", "end", "limit")  # whose derivatives stand in the table
_WORDS = ("fold", "branch point", "range", "not located", "torus", "doubling")


class LocatedValue(NamedTuple):
    """A value of the parameter and its error; NaN where there is none, or it was not searched for."""

    value: float
    error: float


NOWHERE = LocatedValue(np.nan, np.nan)
"""No place."""


def dataset(
    max_period: int,
    levels: int,
    batch: LaneBatch,
    line: PeriodScan,
    groups: Sequence[Sequence[Window]],
    doublings: Sequence[Sequence[LocatedDoubling]],
    limits: Sequence[LocatedValue],
    crises: Sequence[LocatedValue],
) -> xr.Dataset:
    """Return the variables over (window,), and the doublings over (window, level)."""
    axis, unit = batch.first_axis, iterate_units(batch.system)
    value = padded([[doubling.point.value for doubling in located] for located in doublings], (levels,))
    error = padded([[doubling.error for doubling in located] for located in doublings], (levels,))
    lanes = [all_lanes(group) for group in groups]
    count = [len(numbers) for numbers in lanes]
    first, last = (np.array([line.value[numbers[end]] for numbers in lanes], float) for end in (0, -1))
    period = np.array([group[0].period for group in groups], np.int32)
    variables = {
        axis.name: variable("searched", line.value[[0, -1]], axis.long_name, axis.units),
        "spacing": variable(
            (), float(np.diff(line.value).max()), f"largest distance of lanes in {axis.name}", axis.units
        ),
        "period": variable("window", period, "period of the orbits that the window begins with", counted_in=unit),
        "orbits": variable("window", np.array([len(group) for group in groups], np.int32), "number of such orbits"),
        "lanes": variable("window", np.array(count, np.int32), "number of lanes that have settled in the window"),
        "first": variable("window", first, f"{axis.long_name} of the first of these lanes", axis.units),
        "last": variable("window", last, f"{axis.long_name} of the last of these lanes", axis.units),
        **_end_variables("begin", "begin to attract", axis, [group[0].begin for group in groups], batch),
        **_end_variables("end", "cease to attract", axis, [group[0].end for group in groups], batch),
        "level": variable("level", np.arange(1, levels + 1), "number of the period doubling"),
        "doubling": variable(
            ("window", "level"),
            value,
            f"{axis.long_name} at the doublings of the orbits",
            axis.units,
            ancillary_variables="doubling_error",
        ),
        "doubling_error": variable(("window", "level"), error, "error of the doublings", axis.units),
        **_place_variables("limit", "where the doublings accumulate", axis, limits, _NO_LIMIT),
        **_place_variables("crisis", "where the bands beyond the doublings grow", axis, crises, _NO_CRISIS),
    }
    warnings = _missing_doublings(axis.name, levels, groups, doublings)
    if not groups:
        warnings = [f"windows: {_describe_search(max_period, axis.name, line.value)}: none was found"]
    attrs = {"along": axis.name, "max_period": max_period, **({"warnings": "\n".join(warnings)} if warnings else {})}
    return xr.Dataset(variables, attrs=attrs)


def _end_variables(name: str, words: str, axis: Axis, ends: Sequence[End], batch: LaneBatch) -> dict[str, Entry]:
    """Return the place of one end of all windows, its error, its kind and the multipliers there."""
    multipliers = padded([real_and_imaginary(end.multipliers) for end in ends], (batch.chart.dimension, 2))
    return {
        **_place_variables(name, f"where orbits of the period {words}", axis, ends),
        f"{name}_kind": flag("window", [end.kind for end in ends], f"what is where they {words}", ENDS),
        f"{name}_multipliers": variable(
            ("window", "multiplier", "part"),
            multipliers,
            f"Floquet multipliers where they {words}, real and imaginary part",
        ),
    }


def _place_variables(
    name: str, words: str, axis: Axis, places: Sequence[LocatedValue | End], comment: str = ""
) -> dict[str, Entry]:
    """Return values of the parameter and their errors."""
    value, error = (np.array([getattr(place, key) for place in places], float) for key in ("value", "error"))
    attrs = {"ancillary_variables": f"{name}_error", **({"comment": comment} if comment else {})}
    return {
        name: variable("window", value, f"{axis.long_name} {words}", axis.units, **attrs),
        f"{name}_error": variable("window", error, f"largest error of {name}", axis.units),
    }


def _missing_doublings(
    name: str, levels: int, groups: Sequence[Sequence[Window]], doublings: Sequence[Sequence[LocatedDoubling]]
) -> list[str]:
    """Return warnings on windows that end in a doubling and of whose doublings some are not located."""
    return [
        f"windows: {len(located)} of {levels} doublings of the orbits of period {group[0].period} that double at "
        f"{name} = {group[0].end.value:.9g} were located within the sweep"
        for group, located in zip(groups, doublings, strict=True)
        if group[0].end.kind == DOUBLED and len(located) < levels
    ]


def _describe_search(max_period: int, name: str, values: Float[np.ndarray, " lanes"]) -> str:
    """Describe the search in words."""
    lane, where = f"one lane of {np.diff(values).max():.3g}", f"{name} = {values[0]:.6g} to {values[-1]:.6g}"
    return f"windows of periods up to {max_period} wider than {lane} in {where}"


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """Return a row for each window: period, ends, limit of the doublings, and crisis."""
    rows = []
    for k in range(data.sizes["window"]):
        row = data.isel(window=k)
        ends = (cell for name in ("begin", "end") for cell in (_format(row, name), _WORDS[int(row[f"{name}_kind"])]))
        orbits, last = int(row["orbits"]), (_format(row, name) for name in ("limit", "crisis"))
        rates = (cell for name in _DERIVED for cell in sensitivity_cells(data, name, k))
        rows.append((f"{int(row['period'])}{f' ×{orbits}' if orbits > 1 else ''}", *ends, *last, *rates))
    derived = (head for name in _DERIVED for head in sensitivity_heads(data, name))
    heads = ("period", "from", "", "to", "", "limit", "crisis", *derived)
    lane = f"one lane of {float(data['spacing']):.3g}"
    words = f"windows of periods up to {data.attrs['max_period']} wider than {lane}"
    words += "; (2): ± 2 in the last digit; ×2: twins"
    return Table(f"Windows over {data.attrs['along']}", heads, tuple(rows), words, left=(2, 4), ruled=False)


def _format(window: xr.Dataset, name: str) -> str:
    """Return a number with its error in units of the last digit, in brackets."""
    value, error = float(window[name]), float(window[f"{name}_error"])
    if not np.isfinite(value + error) or error <= 0.0:
        return "–"
    digits = min(max(math.ceil(-math.log10(error)), 0), _DIGITS)
    return f"{value:.{digits}f}({math.ceil(error * 10**digits)})"
