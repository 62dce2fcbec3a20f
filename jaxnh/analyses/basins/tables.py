"""The groups `basins` and `attractors` as datasets, and the intervals of shares. Nothing is computed of a motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int

from jaxnh.analyses.base import LANE, Entry, as_variable, flag, number_variable, variable
from jaxnh.analyses.basins.classification import NONE, POINTS, Attractors
from jaxnh.analyses.basins.continuation import CHANGES, Change
from jaxnh.analyses.basins.settling import CONSERVATIVE, TRANSIENT, LaneRecords
from jaxnh.analyses.batch import Axis, LaneBatch, rate_attrs
from jaxnh.analyses.intervals import normal_quantile
from jaxnh.analyses.periodic.sensitivities import Sensitivities
from jaxnh.analyses.periodic.sensitivity_tables import absent_words, sensitivity_variables
from jaxnh.analyses.table_arrays import RowPlaces
from jaxnh.analyses.verdict import KINDS
from jaxnh.systems.flow import Flow
from jaxnh.systems.readout import UNSAID, Output, status

_MOST_NUMBERS = 1 << 24  # of all points of attractors over the parameters
_UNDECIDED = ("no", "time", "volume_preserved", "transient")
_COMPUTED = (
    "Where the trajectory computed with these steps leads. Near a fractal boundary the label of a single start changes "
    "with the steps and with rounding; shares do not, within their intervals."
)


class SweepAttractors(NamedTuple):
    """Attractors at all values of the parameters.

    Attributes:
        point: value that each is at, (attractors,).
        number: of each; of those that are the same at several values one number, (attractors,).
        judged: what they are; None where there are none.
        coordinates: of a point of each, and of its points, by name, each (attractors,) or (attractors, points).
        changes: births, deaths and crises, with the numbers of the attractors.
    """

    point: Int[np.ndarray, " attractors"]
    number: Int[np.ndarray, " attractors"]
    judged: Attractors | None
    coordinates: Mapping[str, Output]
    changes: Sequence[Change]


def shares(
    number: Int[np.ndarray, " lanes"], point: Int[np.ndarray, " lanes"], points: int, most: int
) -> tuple[Int[np.ndarray, "points attractors"], Int[np.ndarray, " points"]]:
    """Return the number of lanes on each attractor at each point, and of all of them."""
    on = number > 0
    table = np.bincount(point[on] * most + number[on] - 1, minlength=points * most).reshape(points, most)
    return table, np.bincount(point, minlength=points)


def wilson(hits: Int[np.ndarray, ...], count: Int[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds of a probability at 95 % (Wilson, J. Am. Stat. Assoc. 22 (1927) 209), of hits among `count`."""
    z = normal_quantile()
    z2 = z**2
    middle = (hits + z2 / 2) / (count + z2)
    half = z / (count + z2) * np.sqrt(hits * (count - hits) / count + z2 / 4)
    # Of no hit, or nothing else, an end is 0 or 1 but for rounding.
    low, high = np.where(hits > 0, middle - half, 0.0), np.where(hits < count, middle + half, 1.0)
    return np.maximum(low, 0.0), np.minimum(high, 1.0)


def basins_group(
    records: LaneRecords,
    number: Int[np.ndarray, " lanes"],
    unit: str,
    flow: Flow,
    drawn: Mapping[str, np.ndarray],
    shape: tuple[int, ...],
    judged: int,
) -> xr.Dataset:
    """Return the attractor of every start state, for lanes of this shape: (lanes,), or (lanes, starts)."""
    dims = (LANE, "start")[: len(shape)]
    reason = np.select([records.known == CONSERVATIVE, records.known == TRANSIENT], [2, 3], 1)
    undecided = np.where(number != 0, 0, reason).astype(np.int8)
    words = "attractor that the start state leads to, by its number in `attractors`"
    special = ("failed_or_escaped", "undecided")
    variables = {
        "attractor": number_variable(dims, number.reshape(shape), words, special, -1, comment=_COMPUTED),
        "time": variable(
            dims, records.time.astype(np.int32).reshape(shape), "time until it was known", counted_in=unit
        ),
        "status": as_variable(dims, status(records.status.reshape(shape))),
        "undecided": flag(dims, undecided.reshape(shape), "why it is undecided where the lane leads", _UNDECIDED),
        "judged": variable((), np.int64(judged), "number of motions that were judged to be an attractor or none"),
        **{
            name: variable(
                dims,
                values.reshape(shape),
                f"{flow.readout.labels.long_names[name]} of the start state",
                flow.readout.labels.units[name],
            )
            for name, values in drawn.items()
        },
    }
    return xr.Dataset(variables)


def attractors_group(
    known: SweepAttractors,
    axes: Sequence[Axis],
    hits: tuple[np.ndarray, np.ndarray],
    unit: str,
    batch: LaneBatch,
    derived: Mapping[str, Sensitivities],
) -> xr.Dataset:
    """Return all attractors over the axes that are parameters, with their changes.

    Args:
        known: the attractors.
        axes: that are parameters.
        hits: as `shares` gives them.
        unit: that periods are counted in.
        batch: of lanes with their flow.
        derived: derivatives of numbers of the attractors, (attractors, parameters), by name.
    """
    names, sizes = tuple(axis.name for axis in axes), tuple(len(axis.values) for axis in axes)
    most = hits[0].shape[1]
    dims = (*names, "attractor")

    def table(values: np.ndarray, empty: float) -> np.ndarray:
        """Return values of all attractors over the axes."""
        places = RowPlaces((math.prod(sizes), most), (known.point, known.number - 1))
        return places.put(values, empty, values.dtype).reshape(*sizes, most, *values.shape[1:])

    kind, period, exponent, multiplier = _numbers_of(known)
    of_number = "number of the attractor, by size of its basin" + (" over all values" if axes else "")
    of_exponent = "largest Lyapunov exponent, without a clock that along the flow left out"
    of_multiplier = "largest modulus of the Floquet multipliers of a periodic orbit"
    variables = {
        "attractor": variable("attractor", np.arange(1, most + 1), of_number),
        "kind": flag(dims, table(kind, NONE), "kind of motion", ("absent", *KINDS), -1),
        "period": number_variable(
            dims, table(period, 0), "least period of a periodic orbit", ("none",), counted_in=unit
        ),
        "exponent": variable(dims, table(exponent, np.nan), of_exponent, **rate_attrs(batch.flow)),
        "multiplier": variable(dims, table(multiplier, np.nan), of_multiplier),
        **_fractions(hits, dims, (*sizes, most)),
    }
    several = sum(name.endswith("_points") for name in known.coordinates)
    points = min(POINTS, max(1, _MOST_NUMBERS // max(1, several * math.prod(sizes) * most)))
    for name, output in known.coordinates.items():
        every = name.endswith("_points")
        said = f"{output.long_name} of {'points' if every else 'a point'} of the attractor"
        values = output.data[:, :points] if every else output.data
        variables[name] = variable((*dims, "point") if every else dims, table(values, np.nan), said, **output.attrs)
    for name, each in derived.items():
        whole = each._replace(rates=table(each.rates, np.nan), errors=table(each.errors, np.nan))
        attrs = variables[name][2]
        units = str(attrs.get("units", UNSAID))
        variables |= sensitivity_variables(whole, batch, dims, name, str(attrs["long_name"]), units)
    if math.prod(sizes) > 1:
        variables |= _changes(known.changes, axes, sizes)
    warnings = "\n".join(dict.fromkeys(filter(None, (absent_words("basins", each) for each in derived.values()))))
    return xr.Dataset(variables, attrs={"warnings": warnings} if warnings else {})


def _numbers_of(known: SweepAttractors) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return kinds, periods, exponents and multipliers of all attractors, (attractors,) each."""
    if known.judged is None:
        return np.zeros(0, np.int8), np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
    return known.judged.kind, known.judged.period, known.judged.exponent, known.judged.multiplier


def _fractions(hits: tuple[np.ndarray, np.ndarray], dims: tuple[str, ...], shape: tuple[int, ...]) -> dict[str, Entry]:
    """Return shares of the start states in basins, and their bounds."""
    on_each, count = hits
    low, high = wilson(on_each, count[:, None])
    parts = {
        "fraction": (on_each / count[:, None], "share of the start states in its basin"),
        "fraction_low": (low, "lower bound of the share at 95 %"),
        "fraction_high": (high, "upper bound of the share at 95 %"),
    }
    return {name: variable(dims, values.reshape(shape), words) for name, (values, words) in parts.items()}


def _changes(changes: Sequence[Change], axes: Sequence[Axis], sizes: tuple[int, ...]) -> dict[str, Entry]:
    """Return births, deaths and crises: halfway between two neighbouring values, with half their distance as error."""
    kind = np.array([change.kind for change in changes], np.int8)
    number = np.array([change.attractor for change in changes], np.int32)
    ends = np.array([(change.before, change.after) for change in changes], int).reshape(-1, 2)
    variables = {
        "change_kind": flag("change", kind, "what happens to an attractor between two values", CHANGES),
        "change_attractor": variable("change", number, "number of the attractor that it happens to"),
    }
    for axis, place in zip(axes, np.unravel_index(ends, sizes), strict=True):
        values = axis.values[place]
        words = f"{axis.long_name} where it happens"
        variables[f"change_{axis.name}"] = variable("change", values.mean(axis=1), words, axis.units)
        error = 0.5 * np.abs(values[:, 1] - values[:, 0])
        words_of_error = f"error of change_{axis.name}: half the distance of the values that it lies between"
        variables[f"change_{axis.name}_error"] = variable("change", error, words_of_error, axis.units)
    return variables
