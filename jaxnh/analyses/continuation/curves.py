"""Curves of bifurcations over two parameters: of periodic orbits, and of equilibria where they are asked for.

Bifurcations to begin with are those of the branches over the first axis at some values of the second, from what lanes
settle on there (`branches`). All curves of one kind and period are then followed together
(`orbits.continuation.curves`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    Entry,
    OptionError,
    Setting,
    SweepLanes,
    SweepReduction,
    Table,
    flag,
    variable,
)
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.continuation.cycle_curves import cycle_seeds
from jaxnh.analyses.continuation.equilibria import check_equilibria, section_plane
from jaxnh.analyses.continuation.equilibrium_curves import EquilibriumCurves, equilibrium_curves, rounding_errors
from jaxnh.analyses.continuation.families import (
    check_plane,
    lanes_along,
    orbit_family,
    parameter_plane,
    step_control,
    values_searched,
)
from jaxnh.analyses.continuation.family_tree import grow
from jaxnh.analyses.continuation.seeds import attractor_waves
from jaxnh.analyses.continuation.tables import special_kinds, special_values
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.analyses.periodic.attractor_survey import survey_from_start
from jaxnh.analyses.periodic.location import price_of_orbits, refined_maps
from jaxnh.analyses.random_starts import check_box
from jaxnh.maps.section import Section
from jaxnh.orbits.bifurcations.codimension_two import POINTS, Special, special_points
from jaxnh.orbits.bifurcations.curve_errors import errors_of_points, errors_of_special, refine_curve
from jaxnh.orbits.bifurcations.equilibrium_forms import COUNT, TERMS
from jaxnh.orbits.continuation.curves import Curve, ParameterPlane, follow_both_ways, join_curves, join_unknowns
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, KINDS, NEIMARK_SACKER
from jaxnh.orbits.continuation.paths import ENDS, STEPS
from jaxnh.orbits.continuation.tracks import nearest

_OWN_NAMES = (
    "curve", "point", "codimension_two", "multiplier", "part", "kind", "period", "multipliers", "begins", "ends",
    "codimension_two_kind", "codimension_two_curve",
)  # fmt: skip
_NEAR = 1e-3  # lengths: a chord between two points is nearer to its curve than this
_WORK = 3.0  # of a run, in those of settling: a guess


class _Seed(NamedTuple):
    """A bifurcation to begin with."""

    kind: int
    points: Float[np.ndarray, "n d"]
    values: Float[np.ndarray, " 2"]


class _Point(NamedTuple):
    """A point of codimension two, the number of its curve, and errors of both parameters.

    Of equilibria the coefficients of its normal form as well.
    """

    curve: int
    point: Special
    error: Float[np.ndarray, " 2"]
    coefficients: Float[np.ndarray, " 4"] | None = None


class _CurveSet(NamedTuple):
    """Curves, errors of both parameters at their points, and points of codimension two."""

    curves: list[Curve]
    errors: list[Float[np.ndarray, "k 2"]]
    special: list[_Point]


def periods(options: CurvesOptions, lanes: int) -> float:
    """Lane-periods of a run: a guess, as nobody knows how many curves there are."""
    return _WORK * options.n_values * lanes**0.5 * (options.transient + 2 * options.max_period)


def numbers(options: CurvesOptions) -> int:
    """Numbers that a lane leaves."""
    return 1


def check(options: CurvesOptions, setting: Setting) -> None:
    """Check that there are two axes, parameters that lanes may differ in, of more than one value each."""
    check_plane("curves", setting)
    names = [axis.name for axis in setting.axes]
    own = {*_OWN_NAMES, *(f"{name}_error" for name in names)}
    own |= {f"codimension_two_{name}{rest}" for name in names for rest in ("", "_error")}
    if options.equilibria:
        check_equilibria(setting)
        check_box(options.box, setting, "box")
        own.add("coefficients")
    for name in {*names, *setting.flow.coordinates} & own:
        raise OptionError(f"{name} is what curves calls a number of its own; rename it")


def run(options: CurvesOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Nothing: only lanes at a few values of the second axis are looked at, once all are there."""
    return xr.Dataset({"lane_number": variable(LANE, np.arange(batch.count, dtype=np.int32), "number of a lane")})


def whole(options: CurvesOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `curves` and `codimension_two`."""
    (first, second), [(_, row)] = sweep.axes, sweep.rows
    batches = [lanes_along(row, first, second, value) for value in values_searched(second, options.n_values).tolist()]
    low, high = (np.array([float(end(axis.values)) for axis in sweep.axes]) for end in (np.min, np.max))
    names, followed, still = (first.name, second.name), _CurveSet([], [], []), None
    if options.equilibria:
        still = equilibrium_curves(batches, lanes, options, names, low, high)
        followed = _of_equilibria(still)
    if options.max_period:
        followed = _joined(followed, _of_orbits(options, batches, lanes, names, low, high, still))
    parts = batches[0], sweep.axes, followed
    return {"curves": _dataset(*parts, options.max_period), "codimension_two": _special(*parts)}


def _of_equilibria(still: EquilibriumCurves) -> _CurveSet:
    """Curves of folds and Hopf points."""
    plane, every = still
    special = [
        _Point(k, located.point, located.error, form.coefficients)
        for k, one in enumerate(every)
        for located, form in zip(one.points, one.forms, strict=True)
    ]
    return _CurveSet([one.curve for one in every], [rounding_errors(plane, one.curve) for one in every], special)


def _of_orbits(
    options: CurvesOptions,
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    names: tuple[str, str],
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
    still: EquilibriumCurves | None,
) -> _CurveSet:
    """Curves of bifurcations of periodic orbits, those among them that leave points of equilibria."""
    surveys = [survey_from_start(batch, lanes, options.max_period, "curves", options.transient) for batch in batches]
    sizes = np.concatenate([survey.size[~survey.failed] for survey in surveys])
    size = np.median(sizes, axis=0) if len(sizes) else np.ones(batches[0].system.chart.dimension)
    plane, *others = (
        parameter_plane(batches[0], lanes, strobe, size, names, low, high) for strobe in refined_maps(batches[0])
    )
    curves, steps = list[Curve](), step_control(options)._replace(max_steps=STEPS.max_steps)
    for batch, survey in zip(batches, surveys, strict=True):
        second, value = names[1], float(batch.p[names[1]][0])
        period = np.where(survey.failed, 0, survey.period)
        waves = attractor_waves(batch, lanes, survey.u, period)
        families = [orbit_family(batch, lanes, strobe, size, (low[0], high[0])) for strobe in refined_maps(batch)]
        with lanes.stage(f"curves: bifurcations at {second} = {value:g}", 0):
            tree = grow(families, waves, options.max_period, steps)
        seeds = [
            _Seed(point.kind, point.points, np.array([point.value, value]))
            for point in tree.bifurcations
            if point.kind in (FOLD, DOUBLING, NEIMARK_SACKER)
        ]
        with lanes.stage(f"curves: from {len(seeds)} bifurcations at {second} = {value:g}", 0):
            curves = _follow_curves(plane, curves, seeds, options)
    if still is not None and isinstance(batches[0].system, Section):
        points = [pair for one in still.curves for pair in zip(one.points, one.forms, strict=True)]
        with lanes.stage("curves: of cycles from points of codimension two of equilibria", 0):
            starts = cycle_seeds(still.plane, plane, section_plane(batches[0].system), points)
            seeds = [_Seed(start.kind, start.points, start.values) for start in starts]
            curves = _follow_curves(plane, curves, seeds, options)
    curves.sort(key=lambda curve: (curve.period, curve.kind))
    with lanes.stage(f"curves: errors of {len(curves)}", 0):
        again = [[refine_curve(other, curve) for other in others] for curve in curves]
        errors = [errors_of_points(*both) for both in zip(curves, again, strict=True)]
    with lanes.stage(f"curves: points of codimension two on {len(curves)}", 0):
        special = [
            _Point(k, point, errors_of_special(others, again[k], point))
            for k, curve in enumerate(curves)
            for point in special_points(plane, curve)
        ]
    return _CurveSet(curves, errors, special)


def _joined(one: _CurveSet, other: _CurveSet) -> _CurveSet:
    """All curves, one after the other."""
    first = len(one.curves)
    special = [point._replace(curve=first + point.curve) for point in other.special]
    return _CurveSet([*one.curves, *other.curves], [*one.errors, *other.errors], [*one.special, *special])


def _follow_curves(
    plane: ParameterPlane, there: Sequence[Curve], seeds: Sequence[_Seed], options: CurvesOptions
) -> list[Curve]:
    """All curves, those through bifurcations that are on none yet among them, each once."""
    curves = list(there)
    for kind, n in sorted({(seed.kind, len(seed.points)) for seed in seeds}):
        mine = [seed for seed in seeds if (seed.kind, len(seed.points)) == (kind, n)]
        mine = [seed for seed in mine if not any(_passes(plane, curve, seed) for curve in there)]
        if mine:
            points, values = np.stack([seed.points for seed in mine]), np.stack([seed.values for seed in mine])
            for seed, curve in zip(
                mine, follow_both_ways(plane, kind, points, values, step_control(options)), strict=True
            ):
                if curve is not None and not any(_passes(plane, other, seed) for other in curves):
                    curves = _with_curve(plane, curves, curve)
    return curves


def _with_curve(plane: ParameterPlane, curves: Sequence[Curve], curve: Curve) -> list[Curve]:
    """The curves and another one, which those that were cut on it are joined to."""
    apart = list[Curve]()
    for other in curves:
        whole = join_curves(plane, other, curve, _NEAR)
        curve, more = (curve, [other]) if whole is None else (whole, [])
        apart += more
    return [*apart, curve]


def _passes(plane: ParameterPlane, curve: Curve, seed: _Seed) -> bool:
    """Return whether a curve goes through a bifurcation, whichever of the orbit's points comes first."""
    if curve.kind != seed.kind or curve.period != len(seed.points):
        return False
    turned = (np.roll(seed.points, m, 0)[None] for m in range(curve.period))
    return any(
        nearest(curve.track.z, curve.track.way, join_unknowns(plane, points, seed.values[None])[0]).distance <= _NEAR
        for points in turned
    )


# ---- the dataset


def _dataset(batch: LaneBatch, axes: Sequence[Axis], followed: _CurveSet, limit: int) -> xr.Dataset:
    """Variables over (curve, point), filled up with NaN, and over (codimension_two,)."""
    curves, errors, special = followed
    shape = (len(curves), max((len(curve.values) for curve in curves), default=0))

    def table(values: Sequence[np.ndarray], *more: int) -> np.ndarray:
        filled = np.full((*shape, *more), np.nan)
        for k, one in enumerate(values):
            filled[(k, *map(slice, one.shape))] = one
        return filled

    dims, d = ("curve", "point"), _dimension(batch, curves)
    multipliers = [np.stack([np.real(curve.multipliers), np.imag(curve.multipliers)], axis=-1) for curve in curves]
    columns: dict[str, Entry] = {}
    for k, axis in enumerate(axes):
        columns[axis.name] = variable(dims, table([curve.values[:, k] for curve in curves]), axis.long_name, axis.units)
        words = f"error of {axis.name}: a point of the exact curve is as near in both parameters"
        columns[f"{axis.name}_error"] = variable(dims, table([error[:, k] for error in errors]), words, axis.units)
        words = f"{axis.long_name} at the point of codimension two"
        columns |= _at_special(f"codimension_two_{axis.name}", axis, k, special, words)
    filled = {
        **columns,
        "kind": flag("curve", [curve.kind for curve in curves], "kind of bifurcation", KINDS),
        "period": variable(
            "curve",
            np.array([curve.period for curve in curves], np.int32),
            "period of the orbit",
            counted_in=iterate_units(batch.system),
        ),
        "multipliers": variable((*dims, "multiplier", "part"), table(multipliers, d, 2), _multiplier_words(curves)),
        "begins": flag("curve", [curve.ends[0] for curve in curves], "why the curve begins there", ENDS),
        "ends": flag("curve", [curve.ends[1] for curve in curves], "why the curve ends there", ENDS),
        **_kind_and_curve("codimension_two_", special),
    }
    names = " ".join(axis.name for axis in axes)
    attrs = {"limit": limit, "over": names}
    if not curves:
        attrs["warnings"] = f"curves: there is no bifurcation to follow over {names.replace(' ', ' and ')}"
    return xr.Dataset(filled, attrs=attrs)


def _dimension(batch: LaneBatch, curves: Sequence[Curve]) -> int:
    """Most multipliers of an orbit, or eigenvalues of an equilibrium."""
    return max([batch.chart.dimension, *(curve.multipliers.shape[1] for curve in curves)])


def _multiplier_words(curves: Sequence[Curve]) -> str:
    words = "Floquet multipliers, real and imaginary part"
    return words + "; of an equilibrium eigenvalues" if any(curve.equilibria for curve in curves) else words


def _special(batch: LaneBatch, axes: Sequence[Axis], followed: _CurveSet) -> xr.Dataset:
    """Variables over (codimension_two,): the points of codimension two, each with its curve and its multipliers."""
    curves, _, special = followed
    multipliers = np.full((len(special), _dimension(batch, curves), 2), np.nan)
    for k, (_, point, *_) in enumerate(special):
        values = point.multipliers
        multipliers[k, : len(values)] = np.stack([np.real(values), np.imag(values)], axis=-1)
    period = np.array([curves[point.curve].period for point in special], np.int32)
    variables = {
        **_kind_and_curve("", special),
        "period": variable("codimension_two", period, "period of the orbit", counted_in=iterate_units(batch.system)),
        "multipliers": variable(("codimension_two", "multiplier", "part"), multipliers, _multiplier_words(curves)),
    }
    for k, axis in enumerate(axes):
        variables |= _at_special(axis.name, axis, k, special, axis.long_name)
    if any(curve.equilibria for curve in curves):
        variables |= _of_points(batch, special)
    names = " ".join(axis.name for axis in axes)
    return xr.Dataset(variables, attrs={"over": names})


def _of_points(batch: LaneBatch, special: Sequence[_Point]) -> dict[str, Entry]:
    """Coordinates and normal forms of equilibria at points of codimension two; NaN of orbits."""
    dim, flow = "codimension_two", batch.flow
    none = np.full((len(special), COUNT), np.nan)
    coefficients = np.array([none[0] if one.coefficients is None else one.coefficients for one in special])
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
        values = [np.nan if one.coefficients is None else float(one.point.points[0, k]) for one in special]
        variables[name] = variable(dim, np.array(values), f"{flow.labels.long_names[name]} of the equilibrium")
    return variables


def _kind_and_curve(before: str, special: Sequence[_Point]) -> dict[str, Entry]:
    return special_kinds(before, [one.point.kind for one in special], [one.curve for one in special], POINTS)


def _at_special(name: str, axis: Axis, k: int, special: Sequence[_Point], words: str) -> dict[str, Entry]:
    values, errors = [one.point.values[k] for one in special], [one.error[k] for one in special]
    return special_values(name, axis, values, errors, words, "; NaN where finer maps do not have the point")


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
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


ANALYSIS = Analysis(
    "curves",
    CurvesOptions,
    periods,
    run,
    whole=SweepReduction(("codimension_two",), whole),
    numbers=numbers,
    check=check,
    table=table,
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1, "n_values": 1},
)
"""The entry of this analysis in the table."""
