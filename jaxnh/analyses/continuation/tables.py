"""The groups `branches` and `bifurcations`: variables over branches and their points, and over bifurcations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, Table, flag, number_variable, variable
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.continuation.equilibrium_sensitivities import equilibrium_sensitivities
from jaxnh.analyses.continuation.family_tree import Bifurcation, Tree
from jaxnh.analyses.continuation.grazing import grazing_sensitivities
from jaxnh.analyses.continuation.search_evidence import SearchEvidence
from jaxnh.analyses.coordinates import coordinates_at
from jaxnh.analyses.periodic.sensitivities import CriticalOrbit, Sensitivities, bifurcation_sensitivities
from jaxnh.analyses.periodic.sensitivity_tables import (
    absent_words,
    sensitivity_cells,
    sensitivity_heads,
    sensitivity_variables,
)
from jaxnh.analyses.table_arrays import longest, padded, real_and_imaginary
from jaxnh.orbits.bifurcations.normal_forms import CRITICALITIES
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.kinds import KINDS, STABILITIES, stability
from jaxnh.orbits.continuation.paths import ENDS
from jaxnh.systems.readout import Output

OWN_NAMES = (
    "branch", "point", "iterate", "multiplier", "part", "bifurcation", "period", "stable", "multipliers", "residual",
    "begins", "ends", "points", "kind", "not_located", "not_located_kind", "criticality",
    "coefficient", "parameter", "duration", "step_change", "starts",
)  # fmt: skip
"""Names of variables and dimensions that no parameter or coordinate may have."""

_STEP_CHANGE = "largest distance of the map from one of twice the steps on the branch, in sizes of the motion"
_LARGE = 1e-2  # such a distance, at which orbits are none of the flow
_MULTIPLIERS = "Floquet multipliers, real and imaginary part"
_EIGENVALUES = "; of an equilibrium eigenvalues"


class FollowedBranches(NamedTuple):
    """Branches of one family: of orbits of a map, or of equilibria of its flow.

    Attributes:
        tree: them and their bifurcations.
        family: the first of its maps.
        batch: whose section coordinates their points have.
        durations: of the cycles of each branch, where they are known.
        evidence: of the random starts, where there were any and branches are those of a return map.
    """

    tree: Tree
    family: Family
    batch: LaneBatch
    durations: Sequence[np.ndarray] | None = None
    evidence: SearchEvidence | None = None


def datasets(
    lanes: LaneRunner,
    grown: Sequence[FollowedBranches],
    max_period: int,
    *,
    derived: bool = False,
    searched: str = "",
) -> dict[str, xr.Dataset]:
    """Both groups: branches in the order of their periods, bifurcations in that of the parameter.

    Args:
        lanes: runs lanes.
        grown: first the orbits, then, where there are any, the equilibria, whose period is 0.
        max_period: the largest period of the orbits that are followed.
        derived: whether bifurcations have derivatives in the other parameters.
        searched: what was looked at, in words, for where nothing is there.
    """
    batch = grown[0].batch
    axis, trees = batch.first_axis, [part.tree for part in grown]
    all_ = [(family, k) for family, tree in enumerate(trees) for k in range(len(tree.branches))]
    order = sorted(all_, key=lambda pair: (_period(grown[pair[0]], trees[pair[0]].branches[pair[1]].period), pair))
    rank = {pair: place for place, pair in enumerate(order)}
    bifurcations = ordered_bifurcations(grown)
    branches = _branches(lanes, grown, [(family, trees[family].branches[k]) for family, k in order])
    attrs = {
        "max_period": max_period,
        "along": axis.name,
        "method": "shooting" if grown[0].durations is None else "collocation",
        **({"warnings": words} if (words := _warnings(axis, grown, searched)) else {}),
    }
    if evidence := grown[0].evidence:
        starts = [-1 if family else evidence.starts[k] for family, k in order]
        words = "number of random starts that led to an orbit of the branch"
        branches["starts"] = number_variable("branch", np.array(starts, np.int32), words, ("equilibrium",), -1)
    lost = sum(len(tree.lost) for tree in trees)
    if (timed := grown[0].durations) is not None:
        of_branch = {rank[0, k]: duration for k, duration in enumerate(timed)}  # of equilibria there is none
        whole = padded([of_branch.get(k, ()) for k in range(len(order))], branches[axis.name][1].shape[1:])
        words = "time that the cycle takes"
        branches["duration"] = variable(("branch", "point"), whole, words, batch.flow.readout.labels.units["t"])
    branches["not_located"] = variable((), np.int64(lost), "number of bifurcations that could not be located")
    signs = np.full(branches[axis.name][1].shape, -1)
    for family, tree in enumerate(trees):
        for change in tree.lost:
            signs[rank[family, change.branch], change.place] = change.kind
    words = "kind of bifurcation that could not be located between the point and the next one"
    branches["not_located_kind"] = flag(("branch", "point"), signs, words, ("none", *KINDS), -1)
    points = _bifurcations(lanes, grown, bifurcations, [rank[family, point.branch] for family, point in bifurcations])
    own = {"along": axis.name}
    if derived:
        rates = _sensitivities(lanes, grown, bifurcations)
        words = f"{axis.long_name} at the bifurcation"
        points |= sensitivity_variables(rates, batch, ("bifurcation",), axis.name, words, axis.units)
        own |= {"warnings": reasons} if (reasons := absent_words("bifurcations", rates)) else {}
    return {
        "branches": xr.Dataset(branches, attrs=attrs),
        "bifurcations": xr.Dataset(points, attrs=own),
    }


def _sensitivities(
    lanes: LaneRunner, grown: Sequence[FollowedBranches], bifurcations: Sequence[tuple[int, Bifurcation]]
) -> Sensitivities:
    """Derivatives of the parameter at bifurcations, of orbits, of equilibria and where orbits graze."""
    batch = grown[0].batch
    critical = [CriticalOrbit(-1 if family else p.kind, p.value, p.points, p.multipliers) for family, p in bifurcations]
    rates = bifurcation_sensitivities(batch, lanes, critical)
    if still := [k for k, (family, _) in enumerate(bifurcations) if family]:
        resting = [critical[k]._replace(kind=bifurcations[k][1].kind) for k in still]
        rates = rates.with_rows(still, equilibrium_sensitivities(grown[1].batch, lanes, resting))
    if touching := [k for k, (_, point) in enumerate(bifurcations) if point.arcs]:
        grazing = [bifurcations[k][1].arcs for k in touching]
        rates = rates.with_rows(touching, grazing_sensitivities(batch, lanes, grazing))
    return rates


def ordered_bifurcations(grown: Sequence[FollowedBranches]) -> list[tuple[int, Bifurcation]]:
    """All bifurcations in the order of the parameter, each after the number of its family."""
    every = [(number, point) for number, part in enumerate(grown) for point in part.tree.bifurcations]
    return sorted(every, key=lambda pair: (pair[1].value, pair[1].kind, len(pair[1].points)))


def _period(part: FollowedBranches, points: int) -> int:
    return 0 if part.family.field else points


def _warnings(axis: Axis, grown: Sequence[FollowedBranches], searched: str) -> str:
    """Lines for the user."""
    trees = [part.tree for part in grown]
    if not trees[0].branches:
        return f"branches: there is no periodic orbit to follow along {axis.name}{searched and '; '}{searched}"
    lines = list[str]()
    if lost := sum(len(tree.lost) for tree in trees):
        lines.append(f"branches: {lost} sign changes of test functions led to no bifurcation that could be located")
    wrong = np.array([branch.step_change for branch in trees[0].branches])
    if count := int(np.sum(wrong > _LARGE)):
        lines.append(
            f"branches: steps are too long on {count} of {len(wrong)}, where twice as many move orbits by up to "
            f"{np.nanmax(wrong):.2g} sizes of the motion: these are none of the flow (step_change); give a finer target"
        )
    if (evidence := grown[0].evidence) and evidence.alone:
        lines.append(
            f"branches: of the {evidence.met} that only random starts led to, {evidence.alone} by a single one of "
            f"{evidence.total}: one start more leads to about {evidence.alone / evidence.total:.2g} others; give more "
            "n_starts"
        )
    unknown = [int(np.sum(np.any(np.isnan(branch.multipliers), axis=1))) for branch in trees[0].branches]
    if count := sum(unknown):
        points = sum(len(branch.value) for branch in trees[0].branches)
        lines.append(
            f"branches: of {count} of {points} orbits not all multipliers are known; no bifurcation is told there"
        )
    return "\n".join(lines)


def _branches(
    lanes: LaneRunner, grown: Sequence[FollowedBranches], branches: Sequence[tuple[int, Branch]]
) -> dict[str, Entry]:
    """Variables over (branch, point), filled up with NaN."""
    axis, system, every = grown[0].batch.first_axis, grown[0].batch.system, [branch for _, branch in branches]
    length, dims = longest([branch.value for branch in every]), ("branch", "point")
    periods = [_period(grown[part], branch.period) for part, branch in branches]
    parts = [real_and_imaginary(branch.multipliers) for branch in every]
    values = padded(parts, (length, _dimension(grown), 2))
    attracts = [stability(grown[part].family, branch.multipliers, branch.errors) for part, branch in branches]
    residual = "largest component of P(u) − u, in sizes of the motion"
    return {
        axis.name: variable(dims, padded([branch.value for branch in every], (length,)), axis.long_name, axis.units),
        "period": period_variable(("branch",), periods, iterate_units(system)),
        **orbit_coordinates(lanes, grown, [(part, branch.points) for part, branch in branches], dims),
        "multipliers": variable((*dims, "multiplier", "part"), values, _multiplier_words(grown)),
        "stable": flag(
            dims, padded(attracts, (length,), -1), "whether the orbit attracts", ("beyond_the_end", *STABILITIES), -1
        ),
        "residual": variable(dims, padded([branch.residual for branch in every], (length,)), residual),
        "step_change": variable("branch", np.array([b.step_change for b in every], float), _STEP_CHANGE),
        "begins": flag("branch", [b.ends[0] for b in every], "why the branch begins there", ENDS),
        "ends": flag("branch", [b.ends[1] for b in every], "why the branch ends there", ENDS),
    }


def _bifurcations(
    lanes: LaneRunner,
    grown: Sequence[FollowedBranches],
    bifurcations: Sequence[tuple[int, Bifurcation]],
    branch: Sequence[int],
) -> dict[str, Entry]:
    """Variables over (bifurcation,)."""
    axis, system, every = grown[0].batch.first_axis, grown[0].batch.system, [point for _, point in bifurcations]
    dim, name = ("bifurcation",), axis.name

    periods = [_period(grown[part], len(point.points)) for part, point in bifurcations]
    parts = [real_and_imaginary(point.multipliers) for point in every]
    multipliers = padded(parts, (_dimension(grown), 2))
    error_words = f"largest error of {name}, from step refinement, interpolation and rounding"
    coefficient = (
        "cubic coefficient of the normal form in sizes of the motion; of a fold the curvature of the parameter"
    )
    return {
        "kind": flag(dim, [point.kind for point in every], "kind of bifurcation", KINDS),
        name: variable(
            dim,
            np.array([point.value for point in every], float),
            f"{axis.long_name} at the bifurcation",
            axis.units,
            ancillary_variables=f"{name}_error",
        ),
        f"{name}_error": variable(dim, np.array([point.error for point in every], float), error_words, axis.units),
        "period": period_variable(dim, periods, iterate_units(system)),
        "branch": variable(dim, np.array(branch, np.int32), "number of the branch"),
        "criticality": flag(
            dim,
            [point.criticality for point in every],
            "whether what is born is stable where it is",
            CRITICALITIES,
            -1,
        ),
        "coefficient": variable(dim, np.array([point.coefficient for point in every], float), coefficient),
        **orbit_coordinates(lanes, grown, [(part, point.points[None]) for part, point in bifurcations], dim),
        "multipliers": variable((*dim, "multiplier", "part"), multipliers, _multiplier_words(grown)),
    }


def bifurcations_table(data: xr.Dataset) -> Table:
    """A row a bifurcation, in the order of the parameter: what it is, of which orbit, where, and what is born there."""
    name = str(data.attrs["along"])
    kind, period, value, error, criticality = (
        data[key].to_numpy() for key in ("kind", "period", name, f"{name}_error", "criticality")
    )
    rows = []
    for k in range(data.sizes["bifurcation"]):
        period_words = str(period[k]) if period[k] else "equilibrium"
        born = CRITICALITIES[int(criticality[k]) + 1] if criticality[k] else "–"
        decimals = int(np.clip(-np.floor(np.log10(error[k])), 0, 15)) if error[k] > 0 else 15
        at = f"{value[k]:.{decimals}f} ± {error[k]:.1g}"
        rows.append((KINDS[int(kind[k])].replace("_", " "), period_words, at, born, *sensitivity_cells(data, name, k)))
    heads = ("bifurcation", "period", name, "criticality", *sensitivity_heads(data, name))
    return Table("Bifurcations", heads, tuple(rows), left=(0, 3))


def _dimension(grown: Sequence[FollowedBranches]) -> int:
    return max(part.batch.chart.dimension for part in grown)


def period_variable(dim: tuple[str, ...], periods: Sequence[int], counted: str) -> Entry:
    """The periods of orbits, 0 of equilibria."""
    words = "period of the orbit"
    return number_variable(dim, np.array(periods, np.int32), words, ("equilibrium",), counted_in=counted)


def _multiplier_words(grown: Sequence[FollowedBranches]) -> str:
    return _MULTIPLIERS + _EIGENVALUES if len(grown) > 1 else _MULTIPLIERS


def orbit_coordinates(
    lanes: LaneRunner,
    grown: Sequence[FollowedBranches],
    orbits: Sequence[tuple[int, Float[np.ndarray, "k n d"]]],
    dims: tuple[str, ...],
) -> dict[str, Entry]:
    """Coordinates of the first point of every orbit, and under NAME_points of all of them.

    Args:
        lanes: runs lanes.
        grown: families of orbits.
        orbits: rows of orbits, each with the number of its family; of one orbit each where there is one dimension.
        dims: dimensions of the rows and, where they have several orbits, of these.
    """
    most = max((points.shape[1] for _, points in orbits), default=1)
    shape, coordinates = (len(orbits), longest([points for _, points in orbits]), most), dict[str, Output]()
    for number, part in enumerate(grown):
        mine = [k for k, (family, _) in enumerate(orbits) if family == number]
        points = padded([orbits[k][1] for k in mine], (*shape[1:], part.batch.chart.dimension))
        for name, output in coordinates_at(part.batch, lanes, points).items():
            whole = coordinates.setdefault(name, output._replace(data=np.full(shape, np.nan)))
            whole.data[mine] = output.data
    variables = dict[str, Entry]()
    for name, (data, words, attrs) in coordinates.items():
        every = data if len(dims) > 1 else data.reshape(len(orbits), most)
        variables[name] = variable(dims, every[..., 0], f"{words} of the orbit's first point", **attrs)
        variables[f"{name}_points"] = variable((*dims, "iterate"), every, f"{words} of the orbit's points", **attrs)
    return variables


def special_kinds(
    before: str, kinds: Sequence[int], curves: Sequence[int], meanings: Sequence[str]
) -> dict[str, Entry]:
    """Kinds of points of codimension two, and the numbers of the curves that they are on, names after a prefix."""
    dim = "codimension_two"
    return {
        f"{before}kind": flag(dim, list(kinds), "point of codimension two", meanings),
        f"{before}curve": variable(dim, np.array(curves, np.int32), "number of the curve"),
    }


def special_values(
    name: str, axis: Axis, values: Sequence[float], errors: Sequence[float], words: str, unknown: str = ""
) -> dict[str, Entry]:
    """A parameter at points of codimension two, with its error; `unknown` says when that is NaN."""
    dim, error_name = "codimension_two", f"error of {name}{unknown}"
    return {
        name: variable(dim, np.array(values, float), words, axis.units, ancillary_variables=f"{name}_error"),
        f"{name}_error": variable(dim, np.array(errors, float), error_name, axis.units),
    }
