"""Branches of tori over the first axis: from Neimark–Sacker points, and through tori that lanes move on.

Neimark–Sacker points are those of the branches of orbits that lanes settle on (`continuation.branches`) or that Newton
comes to within their motions (`orbit_seeds`), whatever attracts there: tori that repel are followed as well, around
folds, to where they break down (`torus_paths`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxnh.analyses.base import (
    Analysis,
    Entry,
    Setting,
    SweepLanes,
    SweepReduction,
    Table,
    check_names,
    flag,
    number_lanes,
    range_in_words,
    variable,
)
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.continuation import branches
from jaxnh.analyses.continuation.families import step_control
from jaxnh.analyses.continuation.family_tree import Bifurcation
from jaxnh.analyses.continuation.tables import period_variable
from jaxnh.analyses.options.chaos import TorusBranchesOptions
from jaxnh.analyses.options.orbits import BranchesOptions
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images
from jaxnh.analyses.price import newton_price
from jaxnh.analyses.tori import tori
from jaxnh.analyses.tori.curve_tables import KINDS, NONE, CurveTable
from jaxnh.analyses.tori.invariant_curves import InvariantCurve, qualities
from jaxnh.analyses.tori.orbit_seeds import orbits_within_motions
from jaxnh.analyses.tori.torus_paths import (
    Torus,
    TorusBranch,
    ends_at,
    is_on_branch,
    is_part,
    strong_resonance,
    tori_at,
    tori_through,
    torus_through,
)
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.orbits.bifurcations.hopf_cycles import hopf_points
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.kinds import NEIMARK_SACKER
from jaxnh.orbits.continuation.paths import ENDS

_OWN_NAMES = (
    "torus_branch", "torus_point", "normal", "theta", "kind", "rotation", "rotation_error", "growth", "growth_error",
    "decay", "harmonics", "residual", "period", "birth", "begins", "ends",
)  # fmt: skip
_NO_FORM = "the normal form is not known at the Neimark–Sacker points"
_NO_TORUS = "Newton confirms no torus beside the Neimark–Sacker points"
_RESONANCE = "no torus is begun in the strong resonance 1:{q} of the Neimark–Sacker points"
_ESCAPED = 1e15  # sizes of the motion: larger curves are of motions on their way to infinity
_WORK = 3.0  # of a run, in those of settling: a guess


def check(options: TorusBranchesOptions, setting: Setting) -> None:
    """Check that there is an angle and something normal to a curve, and one axis that branches may be over."""
    tori.check(options, setting)
    branches.check(_as_branches(options), setting)
    check_names("torus_branches", _OWN_NAMES, setting)


def _as_branches(options: TorusBranchesOptions) -> BranchesOptions:
    return BranchesOptions(transient=options.transient, max_period=options.max_period)


def whole(
    options: TorusBranchesOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset
) -> Mapping[str, xr.Dataset]:
    """The groups `torus_branches` and `torus_curves`."""
    (axis, *_), [(order, row)] = sweep.axes, sweep.rows
    batch = replace(row, axis=replace(axis, values=axis.values[order]))
    of_branches = _as_branches(options)
    settled = branches.settle(of_branches, batch, lanes)
    with lanes.stage(f"torus_branches: motions of {batch.count:,} lanes", tori.periods(options, batch.count)):
        motions = tori.turning_motions(options, batch, lanes)
        curves = tori.curves_of_motions(options, batch, motions)
    with lanes.stage("torus_branches: orbits within motions", 0):
        seeds = orbits_within_motions(batch, lanes, settled, motions, options.max_period)
    orbits, *_ = branches.grow_branches(of_branches, batch, lanes, settled, seeds)
    curves = {k: curve for k, curve in curves.items() if np.all(curve.size < _ESCAPED * orbits.family.size)}
    family = _in_units_options(orbits.family, list(curves.values()))
    with lanes.stage("torus_branches: from Neimark–Sacker points", 0):
        followed, missed = _from_points(options, family, orbits.tree.bifurcations)
    with lanes.stage(f"torus_branches: from motions of {len(curves)} lanes", 0):
        values = batch.first_axis.values
        moved_on = [Torus(curve, float(values[k])) for k, curve in curves.items()]
        followed = _with_tori(options, family, moved_on, followed)
    with lanes.stage(f"torus_branches: what is normal to {sum(len(each.tori) for each in followed)} tori", 0):
        return _groups(options, batch, lanes, followed, missed)


def _in_units_options(family: Family, curves: Sequence[InvariantCurve]) -> Family:
    """The family in sizes of curves that motions turn on, where these are larger: orbits alone may rest in a point."""
    if not curves:
        return family
    return family._replace(size=np.maximum(family.size, np.median([curve.size for curve in curves], axis=0)))


class SkippedPoint(NamedTuple):
    """A Neimark–Sacker point that no branch begins at: the parameter, and why, in words."""

    value: float
    reason: str


def _from_points(
    options: TorusBranchesOptions, family: Family, born: Sequence[Bifurcation]
) -> tuple[list[TorusBranch], list[SkippedPoint]]:
    """The branches that Neimark–Sacker points begin, each once, as one may end at another such point.

    And the points that begin none.
    """
    followed, missed = list[TorusBranch](), list[SkippedPoint]()
    for n in sorted({len(point.points) for point in born if point.kind == NEIMARK_SACKER}):
        mine = [point for point in born if point.kind == NEIMARK_SACKER and len(point.points) == n]
        points, value = np.stack([point.points for point in mine]), np.array([point.value for point in mine])
        known = hopf_points(family, points, value)
        missed += [SkippedPoint(v, _NO_FORM) for v in sorted({*value.tolist()} - {point.value for point in known})]
        for point in known:
            if any(ends_at(family, branch, point) for branch in followed if branch.iterates == n):
                continue
            if q := strong_resonance(point):
                missed.append(SkippedPoint(point.value, _RESONANCE.format(q=q)))
            elif branch := tori_at(family, n, point, step_control(options), options.harmonics):
                followed.append(branch)
            else:
                missed.append(SkippedPoint(point.value, _NO_TORUS))
    return followed, missed


def _with_tori(
    options: TorusBranchesOptions, family: Family, tori_of_lanes: Sequence[Torus], known: Sequence[TorusBranch]
) -> list[TorusBranch]:
    """The known branches and those through tori that lanes move on and that none of them has.

    One that has all of a known branch, and has gone on where that ended, stands in its place.
    """
    followed = list(known)

    def is_known(torus: Torus) -> bool:
        return any(is_on_branch(family, branch, torus) for branch in followed)

    for torus in tori_of_lanes:
        if is_known(torus) or (start := torus_through(family, torus)) is None:
            continue
        equations, solution = start
        if is_known(equations.torus(solution.z[0])):  # a motion may still be on its way to its torus
            continue
        branch = tori_through(equations, solution, step_control(options), options.harmonics)
        parts = [each for each in followed if is_part(family, each, branch)]
        followed = [each for each in followed if not any(each is part for part in parts)]
        followed.append(branch.born_at(next((part.born for part in parts if np.isfinite(part.born)), np.nan)))
    return followed


# ---- results


def _groups(
    options: TorusBranchesOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    followed: Sequence[TorusBranch],
    missed: Sequence[SkippedPoint],
) -> dict[str, xr.Dataset]:
    """Numbers and curves over (torus_branch, torus_point), filled up beyond the ends."""
    axis, branch, dims = batch.first_axis, "torus_branch", ("torus_branch", "torus_point")
    shape = (len(followed), max((len(each.tori) for each in followed), default=0))
    curves, value = CurveTable(shape, options.points, batch), np.full(shape, np.nan)
    for k, each in enumerate(followed):
        values = np.array([torus.value for torus in each.tori])
        value[k, : len(values)] = values
        p, n = batch.at_values(values).p, np.full(len(values), each.iterates, np.int32)
        own = {i: torus.curve for i, torus in enumerate(each.tori)}
        error = each.iterates * batch.error_estimate
        for i, solved in qualities(images(lanes, batch.strobe(), p, n), own, error, batch.chart.wrap).items():
            curves.put((k, i), *solved, each.iterates)
    born = f"{axis.long_name} at the Neimark–Sacker point that it begins at"
    variables: dict[str, Entry] = {
        axis.name: variable(dims, value, axis.long_name, axis.units),
        "birth": variable(branch, np.array([each.born for each in followed]), born, axis.units),
        "period": period_variable((branch,), [each.iterates for each in followed], iterate_units(batch.system)),
        "begins": flag(branch, [each.ends[0] for each in followed], "why the branch begins there", ENDS),
        "ends": flag(branch, [each.ends[1] for each in followed], "why the branch ends there", ENDS),
        **curves.numbers(dims, "period of the orbit"),
    }
    attrs = {"along": axis.name, "max_harmonics": options.harmonics, "max_period": options.max_period}
    lines = _warnings(options, axis, followed, missed)
    attrs |= section_attrs(batch) | ({"warnings": "\n".join(lines)} if lines else {})
    along = xr.Dataset(curves.coordinates(lanes, dims), attrs={"along": axis.name, **section_attrs(batch)})
    return {"torus_branches": xr.Dataset(variables, attrs=attrs), "torus_curves": along}


def _warnings(
    options: TorusBranchesOptions, axis: Axis, followed: Sequence[TorusBranch], missed: Sequence[SkippedPoint]
) -> list[str]:
    """Lines of a search that has come to nothing."""
    reasons: dict[str, list[str]] = {}
    for point in missed:
        reasons.setdefault(point.reason, []).append(f"{point.value:.9g}")
    lines = [f"torus_branches: {reason} at {axis.name} = {', '.join(at)}" for reason, at in reasons.items()]
    if not followed:
        lines.append(
            f"torus_branches: there is no torus to follow along {axis.name}; looked at branches of orbits of period "
            f"{options.max_period} at most and at motions of {len(axis.values)} lanes"
        )
    return lines


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a branch: its orbit's period, where it is, its rotation numbers, kinds and ends."""
    name, rows = str(data.attrs["along"]), list[tuple[str, ...]]()
    value, rotation, kind = (data[key].to_numpy() for key in (name, "rotation", "kind"))
    for k, period in enumerate(data["period"].to_numpy().tolist()):
        kinds = [KINDS[flag] for flag in np.unique(kind[k]).tolist() if flag != NONE]
        ends = [ENDS[int(data[key][k])].replace("_", " ") for key in ("begins", "ends")]
        rows.append((str(period), range_in_words(value[k]), range_in_words(rotation[k]), ", ".join(kinds), *ends))
    return Table(
        "Branches of tori", ("period", name, "rotation number", "kind", "begins", "ends"), tuple(rows), left=(3, 4, 5)
    )


ANALYSIS = Analysis(
    "torus_branches",
    TorusBranchesOptions,
    # a guess, as nobody knows how many tori there are
    lambda options, lanes: _WORK * lanes * (2 * options.transient + options.periods),
    number_lanes,  # all lanes are looked at together
    whole=SweepReduction(("torus_curves",), whole),
    numbers=lambda options: 4 * options.points,
    check=check,
    table=table,
    price=lambda _, batch: newton_price(batch, ORBIT_TILE),
    brief={"transient": 1, "periods": 128},
)
