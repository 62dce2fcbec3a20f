"""The groups of curves over two parameters, `curves` and `codimension_two`, and their table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, Table, flag, variable
from jaxnh.analyses.batch import Axis, LaneBatch, iterate_units
from jaxnh.analyses.continuation.condition_curves import CONDITIONS, ConditionCurve
from jaxnh.analyses.continuation.tables import period_variable, special_kinds, special_values
from jaxnh.analyses.table_arrays import longest, padded, real_and_imaginary
from jaxnh.orbits.bifurcations.codimension_two import POINTS, Special
from jaxnh.orbits.bifurcations.equilibrium_forms import COUNT, TERMS
from jaxnh.orbits.continuation.curves import Curve
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import ENDS

CURVE_KINDS = (*KINDS, *(condition for condition in CONDITIONS if condition not in KINDS))
"""Kinds of curves by number: bifurcations, then conditions that are none."""


class CurvePoint(NamedTuple):
    """A point of codimension two, the number of its curve, and errors of both parameters.

    Of equilibria the coefficients of its normal form as well.
    """

    curve: int
    point: Special
    error: Float[np.ndarray, " 2"]
    coefficients: Float[np.ndarray, " 4"] | None = None


class CurveSet(NamedTuple):
    """Curves, errors of both parameters at their points, and points of codimension two."""

    curves: Sequence[Curve | ConditionCurve]
    errors: Sequence[Float[np.ndarray, "k 2"]]
    special: Sequence[CurvePoint]


def curves_dataset(batch: LaneBatch, axes: Sequence[Axis], followed: CurveSet, max_period: int) -> xr.Dataset:
    """Variables over (curve, point), filled up with NaN, and over (codimension_two,)."""
    curves, errors, special = followed
    length = longest([curve.values for curve in curves])

    def table(values: Sequence[np.ndarray], *more: int) -> np.ndarray:
        return padded(values, (length, *more))

    dims, d = ("curve", "point"), _dimension(batch, curves)
    multipliers = [real_and_imaginary(curve.multipliers) for curve in curves]
    columns: dict[str, Entry] = {}
    for k, axis in enumerate(axes):
        columns[axis.name] = variable(dims, table([curve.values[:, k] for curve in curves]), axis.long_name, axis.units)
        words = f"error of {axis.name}: a point of the exact curve is as near in both parameters"
        columns[f"{axis.name}_error"] = variable(dims, table([error[:, k] for error in errors]), words, axis.units)
        words = f"{axis.long_name} at the point of codimension two"
        columns |= _at_special(f"codimension_two_{axis.name}", axis, k, special, words)
    conditional = any(isinstance(curve, ConditionCurve) for curve in curves)
    kinds, words_of_kind = KINDS, "kind of bifurcation"
    if conditional:
        kinds, words_of_kind = CURVE_KINDS, "kind of bifurcation, or the condition that cycles keep"
    filled = {
        **columns,
        "kind": flag("curve", list(map(_kind, curves)), words_of_kind, kinds),
        "period": period_variable(("curve",), [curve.period for curve in curves], iterate_units(batch.system)),
        "multipliers": variable((*dims, "multiplier", "part"), table(multipliers, d, 2), _multiplier_words(curves)),
        "begins": flag("curve", [curve.ends[0] for curve in curves], "why the curve begins there", ENDS),
        "ends": flag("curve", [curve.ends[1] for curve in curves], "why the curve ends there", ENDS),
        **_kind_and_curve("codimension_two_", special),
    }
    if conditional:
        said = [curve.condition.words if isinstance(curve, ConditionCurve) else "" for curve in curves]
        filled["condition"] = variable("curve", np.array(said), "condition that cycles keep; of bifurcations none")
    if conditional and batch.flow.autonomous:
        durations = table([curve.durations if isinstance(curve, ConditionCurve) else np.zeros(0) for curve in curves])
        units = batch.flow.readout.labels.units["t"]
        filled["duration"] = variable(dims, durations, "time that cycles take that keep a condition", units)
    names = " ".join(axis.name for axis in axes)
    return xr.Dataset(filled, attrs={"max_period": max_period, "over": names})


def _kind(curve: Curve | ConditionCurve) -> int:
    """The number of a curve's kind."""
    return CURVE_KINDS.index(CONDITIONS[curve.condition.kind]) if isinstance(curve, ConditionCurve) else curve.kind


def _of_equilibria(curve: Curve | ConditionCurve) -> bool:
    return isinstance(curve, Curve) and curve.equilibria


def _dimension(batch: LaneBatch, curves: Sequence[Curve | ConditionCurve]) -> int:
    """Most multipliers of an orbit, or eigenvalues of an equilibrium."""
    return max([batch.chart.dimension, *(curve.multipliers.shape[1] for curve in curves)])


def _multiplier_words(curves: Sequence[Curve | ConditionCurve]) -> str:
    words = "Floquet multipliers, real and imaginary part"
    return words + "; of an equilibrium eigenvalues" if any(map(_of_equilibria, curves)) else words


def special_dataset(batch: LaneBatch, axes: Sequence[Axis], followed: CurveSet) -> xr.Dataset:
    """Variables over (codimension_two,): the points of codimension two, each with its curve and its multipliers."""
    curves, _, special = followed
    parts = [real_and_imaginary(member.point.multipliers) for member in special]
    multipliers = padded(parts, (_dimension(batch, curves), 2))
    periods = [curves[point.curve].period for point in special]
    variables = {
        **_kind_and_curve("", special),
        "period": period_variable(("codimension_two",), periods, iterate_units(batch.system)),
        "multipliers": variable(("codimension_two", "multiplier", "part"), multipliers, _multiplier_words(curves)),
    }
    for k, axis in enumerate(axes):
        variables |= _at_special(axis.name, axis, k, special, axis.long_name)
    if any(map(_of_equilibria, curves)):
        variables |= _of_points(batch, special)
    names = " ".join(axis.name for axis in axes)
    return xr.Dataset(variables, attrs={"over": names})


def _of_points(batch: LaneBatch, special: Sequence[CurvePoint]) -> dict[str, Entry]:
    """Coordinates and normal forms of equilibria at points of codimension two; NaN of orbits."""
    dim, flow = "codimension_two", batch.flow
    none = np.full((len(special), COUNT), np.nan)
    coefficients = np.array([none[0] if point.coefficients is None else point.coefficients for point in special])
    forms = "; ".join(f"{POINTS[kind]}: {form}: {names}" for kind, (form, names) in TERMS.items())
    variables = {
        "coefficients": variable(
            (dim, "coefficient"),
            coefficients.reshape(none.shape),
            "coefficients of the normal form",
            normal_forms=forms,
        )
    }
    for k, name in enumerate(flow.coordinates):
        values = [np.nan if point.coefficients is None else float(point.point.points[0, k]) for point in special]
        variables[name] = variable(dim, np.array(values), f"{flow.readout.labels.long_names[name]} of the equilibrium")
    return variables


def _kind_and_curve(before: str, special: Sequence[CurvePoint]) -> dict[str, Entry]:
    return special_kinds(before, [point.point.kind for point in special], [point.curve for point in special], POINTS)


def _at_special(name: str, axis: Axis, k: int, special: Sequence[CurvePoint], words: str) -> dict[str, Entry]:
    values, errors = [point.point.values[k] for point in special], [point.error[k] for point in special]
    return special_values(name, axis, values, errors, words, "; NaN where finer maps do not have the point")


def curves_table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a point of codimension two."""
    first, second = str(data.attrs["over"]).split()
    rows = []
    for k in range(data.sizes["codimension_two"]):
        curve = int(data["codimension_two_curve"][k])
        kind, period = KINDS[int(data["kind"][curve])], int(data["period"][curve]) or "of equilibria"
        at = (
            f"{float(data[f'codimension_two_{name}'][k]):.9g} ± {float(data[f'codimension_two_{name}_error'][k]):.1g}"
            for name in (first, second)
        )
        rows.append((POINTS[int(data["codimension_two_kind"][k])], f"{kind} {period}", *at))
    return Table("Points of codimension two", ("point", "on the curve of", first, second), tuple(rows), left=(0, 1))
