"""Curves of bifurcations over two parameters: of periodic orbits, and of equilibria where they are asked for.

Bifurcations to begin with are those of the branches over the first axis at some values of the second, from what lanes
settle on there (`branches`). All curves of one kind and period are then followed together
(`orbits.continuation.curves`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Analysis, Setting, SweepLanes, SweepReduction, check_names, number_lanes
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner
from jaxnh.analyses.continuation.condition_curves import (
    ConditionCurve,
    check_conditions,
    condition_curves,
    conditions_of,
)
from jaxnh.analyses.continuation.curve_tables import CurvePoint, CurveSet, curves_dataset, curves_table, special_dataset
from jaxnh.analyses.continuation.cycle_curves import cycle_seeds
from jaxnh.analyses.continuation.equilibria import check_equilibria, section_plane
from jaxnh.analyses.continuation.equilibrium_curves import EquilibriumCurves, equilibrium_curves, rounding_errors
from jaxnh.analyses.continuation.families import (
    check_plane,
    lanes_along,
    orbit_family,
    parameter_plane,
    plane_axes,
    step_control,
    values_searched,
)
from jaxnh.analyses.continuation.family_tree import SeedOrbit, Tree, grow
from jaxnh.analyses.continuation.grazing_curves import grazing_curves
from jaxnh.analyses.continuation.motion_units import motion_unit, sizes_in_motion
from jaxnh.analyses.continuation.seeds import attractor_waves
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.analyses.periodic.attractor_survey import periods_in_motion, survey_from_start
from jaxnh.analyses.periodic.location import price_of_orbits, refined_maps
from jaxnh.analyses.random_starts import check_box
from jaxnh.maps.section import Section
from jaxnh.orbits.bifurcations.codimension_two import special_points
from jaxnh.orbits.bifurcations.curve_errors import errors_of_points, errors_of_special, refine_curve
from jaxnh.orbits.continuation.curves import (
    BifurcationEquations,
    Curve,
    ParameterPlane,
    follow_both_ways,
    join_curves,
    join_unknowns,
)
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, NEIMARK_SACKER
from jaxnh.orbits.continuation.paths import STEPS
from jaxnh.orbits.continuation.tracks import nearest

_OWN_NAMES = (
    "curve", "point", "codimension_two", "multiplier", "part", "kind", "period", "multipliers", "begins", "ends",
    "codimension_two_kind", "codimension_two_curve",
)  # fmt: skip
_NEAR = 1e-3  # lengths: a chord between two points is nearer to its curve than this
_NOTHING = "curves: there is no {} to follow over {} and {}; {}"
_WORK = 3.0  # of a run, in those of settling: a guess


class CurveSeed(NamedTuple):
    """A bifurcation to begin with."""

    kind: int
    points: Float[np.ndarray, "n d"]
    values: Float[np.ndarray, " 2"]


class KnownBifurcations(NamedTuple):
    """Bifurcations of orbits to begin with, at values of the second parameter, and the sizes of the motion."""

    size: Float[np.ndarray, " d"]
    rows: Iterable[Sequence[CurveSeed]]


def check(options: CurvesOptions, setting: Setting) -> None:
    """Check that there are two axes, parameters that lanes may differ in, of more than one value each."""
    setting = check_plane("curves", setting)
    names = [axis.name for axis in setting.axes]
    own = {*_OWN_NAMES, *(f"{name}_error" for name in names)}
    own |= {f"codimension_two_{name}{rest}" for name in names for rest in ("", "_error")}
    if options.equilibria:
        check_equilibria(setting)
        check_box(options.box, setting)
        own.add("coefficients")
    if options.conditional:
        check_conditions(options, setting)
        own |= {"condition", "duration"}
    check_names("curves", own, setting)


def whole(options: CurvesOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `curves` and `codimension_two`."""
    sweep = sweep._replace(axes=plane_axes(sweep.axes))
    return curve_groups(options, sweep, follow_all(options, sweep, lanes))


def curve_groups(options: CurvesOptions, sweep: SweepLanes, followed: CurveSet) -> dict[str, xr.Dataset]:
    """The groups `curves` and `codimension_two` of curves that have been followed."""
    parts, names = (sweep.rows[0][1], sweep.axes, followed), [axis.name for axis in sweep.axes]
    conditional = [curve for curve in followed.curves if isinstance(curve, ConditionCurve)]
    missed = [each for each in conditions_of(options) if not any(each.asks_for(curve) for curve in conditional)]
    looked = _searched(options, sweep.axes)
    lines = [_NOTHING.format(f"cycle with {each.words}", *names, looked) for each in missed]
    if options.bifurcations is None and len(conditional) == len(followed.curves):
        lines = [_NOTHING.format("bifurcation", *names, looked), *lines]
    data = curves_dataset(*parts, options.max_period)
    data.attrs |= {"warnings": "\n".join(lines)} if lines else {}
    return {"curves": data, "codimension_two": special_dataset(*parts)}


def _searched(options: CurvesOptions, axes: Sequence[Axis]) -> str:
    """Say what was looked at."""
    (first, second), still = axes, f" and of equilibria from {options.equilibria} starts" if options.equilibria else ""
    count, lanes = len(values_searched(second, options.n_values)), len(first.values)
    return (
        f"looked at branches over {first.name} of orbits of period {options.max_period} at most that {lanes} lanes "
        f"settle on{still}, at {count} value{'s' * (count > 1)} of {second.name}"
    )


class _Attractors(NamedTuple):
    """Orbits that the lanes of every batch have settled on, in waves, and the size of the motion."""

    waves: list[list[list[SeedOrbit]]]
    size: Float[np.ndarray, " d"]


def follow_all(
    options: CurvesOptions, sweep: SweepLanes, lanes: LaneRunner, known: KnownBifurcations | None = None
) -> CurveSet:
    """All curves: through bifurcations that are known, or those of the branches of what lanes settle on."""
    (first, second), [(_, row)] = sweep.axes, sweep.rows
    batches = [lanes_along(row, first, second, value) for value in values_searched(second, options.n_values).tolist()]
    low, high = (np.array([float(end(axis.values)) for axis in sweep.axes]) for end in (np.min, np.max))
    names, followed, still = (first.name, second.name), CurveSet([], [], []), None
    if options.equilibria:
        still = equilibrium_curves(batches, lanes, options, names, low, high)
        followed = _of_equilibria(still)
    settled = None if known else _attractors(options, batches, lanes)
    if options.max_period and options.bifurcations is None:
        if settled is not None:
            known = _bifurcations_of_lanes(options, batches, lanes, settled, second.name, (low[0], high[0]))
        assert known is not None
        followed = _joined(followed, _of_orbits(options, batches[0], lanes, names, low, high, still, known))
    if options.conditional and settled is not None:
        given = (options, batches, lanes, settled.waves, settled.size, names, (low, high))
        curves = condition_curves(*given) + (grazing_curves(*given) if options.grazing else [])
        followed = _joined(followed, CurveSet(list(curves), [curve.errors for curve in curves], []))
    return followed


def _attractors(options: CurvesOptions, batches: Sequence[LaneBatch], lanes: LaneRunner) -> _Attractors:
    """The attractors of all batches; none where no orbits are followed."""
    waves, d = list[list[list[SeedOrbit]]](), batches[0].chart.dimension
    periods, sizes = [np.zeros(0, int)], [np.zeros((0, d))]
    for batch in batches if options.max_period else []:
        survey = survey_from_start(batch, lanes, options.max_period, "curves", options.transient)
        period = periods_in_motion(batch, lanes, survey)
        waves.append(attractor_waves(batch, lanes, survey.u, period))
        periods.append(period)
        sizes.append(sizes_in_motion(batch, lanes, survey))
    unit = motion_unit(batches, lanes, np.concatenate(periods), np.concatenate(sizes), options.box)
    return _Attractors(waves, unit)


def _of_equilibria(still: EquilibriumCurves) -> CurveSet:
    """Curves of folds and Hopf points."""
    plane, every = still
    special = [
        CurvePoint(k, located.point, located.error, form.coefficients)
        for k, member in enumerate(every)
        for located, form in zip(member.points, member.forms, strict=True)
    ]
    return CurveSet(
        [member.curve for member in every], [rounding_errors(plane, member.curve) for member in every], special
    )


def _bifurcations_of_lanes(
    options: CurvesOptions,
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    settled: _Attractors,
    second: str,
    ends: tuple[float, float],
) -> KnownBifurcations:
    """Bifurcations on the branches of what lanes settle on, row by row as they are asked for."""
    steps, size = step_control(options)._replace(max_steps=STEPS.max_steps), settled.size

    def rows() -> Iterator[list[CurveSeed]]:
        for batch, waves in zip(batches, settled.waves, strict=True):
            value = float(batch.p[second][0])
            families = [orbit_family(batch, lanes, strobe, size, ends) for strobe in refined_maps(batch)]
            with lanes.stage(f"curves: bifurcations at {second} = {value:g}", 0):
                tree = grow(families, waves, options.max_period, steps)
            yield seeds_of(tree, value)

    return KnownBifurcations(size, rows())


def seeds_of(tree: Tree, second: float) -> list[CurveSeed]:
    """The bifurcations of branches of orbits that curves go through, at a value of the second parameter."""
    return [
        CurveSeed(point.kind, point.points, np.array([point.value, second]))
        for point in tree.bifurcations
        if point.kind in (FOLD, DOUBLING, NEIMARK_SACKER)
    ]


def _of_orbits(
    options: CurvesOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    names: tuple[str, str],
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
    still: EquilibriumCurves | None,
    known: KnownBifurcations,
) -> CurveSet:
    """Curves of bifurcations of periodic orbits, those among them that leave points of equilibria."""
    plane, *others = (
        parameter_plane(batch, lanes, strobe, known.size, names, low, high) for strobe in refined_maps(batch)
    )
    curves = list[Curve]()
    for seeds in known.rows:
        at = f" at {names[1]} = {seeds[0].values[1]:g}" if seeds else ""
        with lanes.stage(f"curves: from {len(seeds)} bifurcations{at}", 0):
            curves = _follow_curves(plane, curves, seeds, options)
    if still is not None and isinstance(batch.system, Section):
        points = [pair for followed in still.curves for pair in zip(followed.points, followed.forms, strict=True)]
        with lanes.stage("curves: of cycles from points of codimension two of equilibria", 0):
            starts = cycle_seeds(still.plane, plane, section_plane(batch.system), points)
            seeds = [CurveSeed(start.kind, start.points, start.values) for start in starts]
            curves = _follow_curves(plane, curves, seeds, options)
    curves.sort(key=lambda curve: (curve.period, curve.kind))
    with lanes.stage(f"curves: errors of {len(curves)}", 0):
        again = [[refine_curve(other, curve) for other in others] for curve in curves]
        errors = [errors_of_points(plane, *both) for both in zip(curves, again, strict=True)]
    with lanes.stage(f"curves: points of codimension two on {len(curves)}", 0):
        special = [
            CurvePoint(k, point, missed)
            for k, curve in enumerate(curves)
            for point in special_points(plane, curve)
            if (missed := errors_of_special([plane, *others], [curve, *again[k]], point)) is not None
        ]
    return CurveSet(curves, errors, special)


def _joined(first: CurveSet, second: CurveSet) -> CurveSet:
    """All curves, one after the other."""
    count = len(first.curves)
    special = [point._replace(curve=count + point.curve) for point in second.special]
    return CurveSet([*first.curves, *second.curves], [*first.errors, *second.errors], [*first.special, *special])


def _follow_curves(
    plane: ParameterPlane, there: Sequence[Curve], seeds: Sequence[CurveSeed], options: CurvesOptions
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


def _passes(plane: ParameterPlane, curve: Curve, seed: CurveSeed) -> bool:
    """Return whether a curve goes through a bifurcation, whichever of the orbit's points comes first."""
    if curve.kind != seed.kind or curve.period != len(seed.points):
        return False
    track, equations = curve.track, BifurcationEquations(plane, curve.kind, curve.track.z.shape[1])
    [z] = join_unknowns(plane, seed.points[None], seed.values[None])
    turned = equations.equivalents(z[None])
    return any(nearest(track.z, track.way, at, difference=equations.difference).distance <= _NEAR for [at] in turned)


ANALYSIS = Analysis(
    "curves",
    CurvesOptions,
    # a guess, as nobody knows how many curves there are
    lambda options, lanes: _WORK * options.n_values * lanes**0.5 * (options.transient + 2 * options.max_period),
    number_lanes,  # only those at a few values of the second axis are looked at, once all are there
    whole=SweepReduction(("codimension_two",), whole),
    numbers=lambda _: 1,
    check=check,
    table=curves_table,
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1, "n_values": 1},
)
