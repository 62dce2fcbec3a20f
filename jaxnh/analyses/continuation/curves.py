"""Curves of bifurcations over two parameters: of periodic orbits, and of equilibria where they are asked for.

Bifurcations to begin with are those of the branches over the first axis at some values of the second, from what lanes
settle on there (`branches`). All curves of one kind and period are then followed together
(`orbits.continuation.curves`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    OptionError,
    Setting,
    SweepLanes,
    SweepReduction,
    variable,
)
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner
from jaxnh.analyses.continuation.condition_curves import check_conditions, condition_curves, conditions_of
from jaxnh.analyses.continuation.curve_tables import (
    CurvePoint,
    CurveSet,
    curves_dataset,
    curves_table,
    special_dataset,
)
from jaxnh.analyses.continuation.cycle_curves import cycle_seeds
from jaxnh.analyses.continuation.equilibria import check_equilibria, section_plane
from jaxnh.analyses.continuation.equilibrium_curves import EquilibriumCurves, equilibrium_curves, rounding_errors
from jaxnh.analyses.continuation.families import check_plane, orbit_family, parameter_plane, step_control
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.analyses.continuation.seeds import attractor_waves
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.analyses.periodic.attractor_survey import survey_from_start
from jaxnh.analyses.periodic.location import price_of_orbits, refined_maps
from jaxnh.analyses.random_starts import check_box
from jaxnh.maps.section import Section
from jaxnh.orbits.bifurcations.codimension_two import special_points
from jaxnh.orbits.bifurcations.curve_errors import errors_of_points, errors_of_special, refine_curve
from jaxnh.orbits.continuation.curves import Curve, ParameterPlane, follow_both_ways, join_curves, join_unknowns
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, NEIMARK_SACKER
from jaxnh.orbits.continuation.paths import STEPS
from jaxnh.orbits.continuation.tracks import nearest

_OWN_NAMES = (
    "curve", "point", "codimension_two", "multiplier", "part", "kind", "period", "multipliers", "begins", "ends",
    "codimension_two_kind", "codimension_two_curve",
)  # fmt: skip
_NEAR = 1e-3  # lengths: a chord between two points is nearer to its curve than this
_NOTHING = "curves: there is no {} to follow over {} and {}"
_WORK = 3.0  # of a run, in those of settling: a guess


class _Seed(NamedTuple):
    """A bifurcation to begin with."""

    kind: int
    points: Float[np.ndarray, "n d"]
    values: Float[np.ndarray, " 2"]


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
    if options.conditional:
        check_conditions(options, setting)
        own |= {"condition", "duration"}
    for name in {*names, *setting.flow.coordinates} & own:
        raise OptionError(f"{name} is what curves calls a number of its own; rename it")


def run(options: CurvesOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Nothing: only lanes at a few values of the second axis are looked at, once all are there."""
    return xr.Dataset({"lane_number": variable(LANE, np.arange(batch.count, dtype=np.int32), "number of a lane")})


def whole(options: CurvesOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `curves` and `codimension_two`."""
    (first, second), [(_, row)] = sweep.axes, sweep.rows
    sampled = np.unique(
        np.linspace(0, len(second.values) - 1, min(options.n_values, len(second.values))).round().astype(int)
    )
    chosen = np.unique(second.values[sampled])
    batches = [_lanes_at(row, first, np.flatnonzero(row.p[second.name] == value)) for value in chosen]
    low, high = (np.array([float(end(axis.values)) for axis in sweep.axes]) for end in (np.min, np.max))
    names, followed, still = (first.name, second.name), CurveSet([], [], []), None
    if options.equilibria:
        still = equilibrium_curves(batches, lanes, options, names, low, high)
        followed = _of_equilibria(still)
    attractors = _attractors(options, batches, lanes)
    waves, sizes = [each.waves for each in attractors], [each.sizes for each in attractors if len(each.sizes)]
    size = np.median(np.concatenate(sizes), axis=0) if sizes else np.ones(row.chart.dimension)
    if options.max_period and options.bifurcations is None:
        orbits = _of_orbits(options, batches, lanes, waves, size, names, low, high, still)
        followed = _joined(followed, orbits)
    lines = [] if followed.curves or options.bifurcations is False else [_NOTHING.format("bifurcation", *names)]
    if options.conditional:
        curves = condition_curves(options, batches, lanes, waves, size, names, (low, high))
        followed = _joined(followed, CurveSet(list(curves), [curve.errors for curve in curves], []))
        missed = [each for each in conditions_of(options) if not any(each.asks_for(curve) for curve in curves)]
        lines += [_NOTHING.format(f"cycle with {each.words}", *names) for each in missed]
    parts = batches[0], sweep.axes, followed
    data = curves_dataset(*parts, options.max_period)
    data.attrs |= {"warnings": "\n".join(lines)} if lines else {}
    return {"curves": data, "codimension_two": special_dataset(*parts)}


class _Attractors(NamedTuple):
    """Orbits that the lanes of a batch have settled on, in waves, and the sizes of motions, (some, d)."""

    waves: list[list[SeedOrbit]]
    sizes: Float[np.ndarray, "some d"]


def _attractors(options: CurvesOptions, batches: Sequence[LaneBatch], lanes: LaneRunner) -> list[_Attractors]:
    """The attractors of all batches; none where no orbits are followed."""
    if not options.max_period:
        return []
    attractors = list[_Attractors]()
    for batch in batches:
        survey = survey_from_start(batch, lanes, options.max_period, "curves", options.transient)
        waves = attractor_waves(batch, lanes, survey.u, np.where(survey.failed, 0, survey.period))
        attractors.append(_Attractors(waves, survey.size[~survey.failed]))
    return attractors


def _of_equilibria(still: EquilibriumCurves) -> CurveSet:
    """Curves of folds and Hopf points."""
    plane, every = still
    special = [
        CurvePoint(k, located.point, located.error, form.coefficients)
        for k, one in enumerate(every)
        for located, form in zip(one.points, one.forms, strict=True)
    ]
    return CurveSet([one.curve for one in every], [rounding_errors(plane, one.curve) for one in every], special)


def _of_orbits(
    options: CurvesOptions,
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    waves: Sequence[Sequence[Sequence[SeedOrbit]]],
    size: Float[np.ndarray, " d"],
    names: tuple[str, str],
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
    still: EquilibriumCurves | None,
) -> CurveSet:
    """Curves of bifurcations of periodic orbits, those among them that leave points of equilibria."""
    plane, *others = (
        parameter_plane(batches[0], lanes, strobe, size, names, low, high) for strobe in refined_maps(batches[0])
    )
    curves, steps = list[Curve](), step_control(options)._replace(max_steps=STEPS.max_steps)
    for batch, seeds_of_batch in zip(batches, waves, strict=True):
        second, value = names[1], float(batch.p[names[1]][0])
        families = [orbit_family(batch, lanes, strobe, size, (low[0], high[0])) for strobe in refined_maps(batch)]
        with lanes.stage(f"curves: bifurcations at {second} = {value:g}", 0):
            tree = grow(families, seeds_of_batch, options.max_period, steps)
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
            CurvePoint(k, point, errors_of_special(others, again[k], point))
            for k, curve in enumerate(curves)
            for point in special_points(plane, curve)
        ]
    return CurveSet(curves, errors, special)


def _joined(one: CurveSet, other: CurveSet) -> CurveSet:
    """All curves, one after the other."""
    first = len(one.curves)
    special = [point._replace(curve=first + point.curve) for point in other.special]
    return CurveSet([*one.curves, *other.curves], [*one.errors, *other.errors], [*one.special, *special])


def _lanes_at(row: LaneBatch, first: Axis, lanes: np.ndarray) -> LaneBatch:
    """The lanes along the first axis at a value of the second."""
    batch = row.take(lanes)
    return replace(batch, axis=replace(first, values=batch.p[first.name]))


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


ANALYSIS = Analysis(
    "curves",
    CurvesOptions,
    periods,
    run,
    whole=SweepReduction(("codimension_two",), whole),
    numbers=numbers,
    check=check,
    table=curves_table,
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1, "n_values": 1},
)
"""The entry of this analysis in the table."""
