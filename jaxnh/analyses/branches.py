"""Branches of periodic orbits over the first axis, stable and unstable, and their bifurcations.

Orbits to begin with are those that the sweep's lanes settle on and, where they are asked for, those that Newton finds
from random starts. What follows is for all lanes together (`family_tree`): branches are followed to their ends, doubled
orbits and those of branch points in turn, and none twice.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float
from pydantic import Field, model_validator

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    Entry,
    OptionError,
    Options,
    Setting,
    Sweep,
    Table,
    Whole,
    rule,
    variable,
)
from jaxnh.analyses.branch_seeds import random_wave, settled_waves
from jaxnh.analyses.families import orbits_of
from jaxnh.analyses.family_tree import Bifurcation, Tree, grow
from jaxnh.analyses.locating import PERIOD_TILE, refined
from jaxnh.analyses.price import Price, newton_price
from jaxnh.analyses.random_starts import Side, check_box
from jaxnh.analyses.scene import Axis, LaneRunner, Scene, counted_in
from jaxnh.analyses.settling import states_at
from jaxnh.analyses.survey import survey_from_start
from jaxnh.orbits.branches import ENDS, Branch, Steps
from jaxnh.orbits.kinds import KINDS
from jaxnh.orbits.normal_forms import CRITICALITIES

_OWN_NAMES = (
    "branch", "point", "iterate", "multiplier", "part", "bifurcation", "period", "stable", "multipliers", "residual",
    "begins", "ends", "points", "kind", "criticality", "coefficient",
)  # fmt: skip
_WORK = 3.0  # of a run, in those of settling: a guess


class BranchesOptions(Options):
    """Options of `branches`."""

    limit: int = Field(default=8, ge=1, le=64, description="Largest period of the orbits that are followed")
    transient: int = Field(default=512, ge=0, description="Periods before lanes are looked at")
    step: float = Field(
        default=0.02, gt=0, le=0.25, description="Largest step along a branch, in widths of the sweep and in sizes"
    )
    longest: int = Field(default=2000, ge=2, description="Points of a branch to either side of its first, at most")
    starts: int = Field(
        default=0, ge=0, description="Random starts of Newton at each of the values searched; needs a box"
    )
    values: int = Field(default=5, ge=1, description="Number of values searched, evenly over the lanes of the sweep")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: dict[str, Side] = Field(
        default_factory=dict, description="Coordinates of random starts, each with its lowest and highest value"
    )

    @model_validator(mode="after")
    def _check(self) -> BranchesOptions:
        if bool(self.starts) != bool(self.box):
            raise rule(*(("needs starts, their number", "box") if self.box else ("needs a box to draw from", "starts")))
        for name, (low, high) in self.box.items():
            if not low < high:
                raise rule(f"the first number must be the lower one, not {low:g} and {high:g}", f"box.{name}", "box")
        for name in ("seed", "values"):
            if name in self.model_fields_set and not self.starts:
                raise rule("goes with starts, and there are none", name)
        return self


def periods(options: BranchesOptions, lanes: int) -> float:
    """Lane-periods of a run: a guess, as nobody knows how many branches there are."""
    return _WORK * lanes * (options.transient + 2 * options.limit)


def numbers(options: BranchesOptions) -> int:
    """Numbers that a lane needs: the points it is judged by."""
    return 6 * options.limit


def check(options: BranchesOptions, setting: Setting) -> None:
    """See that there is one axis, a parameter that lanes may differ in, and a box for random starts."""
    first, *others = setting.axes
    if first.kind == "start":
        what = f"{first.name} is a coordinate of the start state"
        raise OptionError(f"branches are followed along the first axis of the sweep, and {what}" + setting.advice)
    if first.kind == "shared":
        what = f"the map has no derivative in {first.name}, which all lanes share"
        raise OptionError(f"branches are followed along the first axis of the sweep, and {what}" + setting.advice)
    if others:
        names = " and ".join(axis.name for axis in others)
        raise OptionError(f"branches are followed along one axis; leave out {names}")
    if len(np.unique(first.values)) < 2:
        raise OptionError(f"branches are followed over a range of {first.name}, and the sweep has one value of it")
    taken = {*setting.flow.coordinates, *(f"{name}_points" for name in setting.flow.coordinates)}
    for name in {first.name, *taken} & {*_OWN_NAMES, f"{first.name}_error"}:
        raise OptionError(f"{name} is what branches calls a number of its own; rename it")
    if options.starts:
        check_box(options.box, setting, "box")


def run(options: BranchesOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """The orbit that every lane has settled on: a point of it, its period, and the size of the motion."""
    found = survey_from_start(scene, lanes, options.limit, "branches", options.transient)
    size = np.where(found.failed[:, None], np.nan, found.size)
    return xr.Dataset(
        {
            "lane_period": variable(LANE, found.period, "period of a lane"),
            "lane_u": variable((LANE, "lane_component"), found.u, "point of the orbit of a lane"),
            "lane_size": variable((LANE, "lane_component"), size, "size of the motion of a lane"),
        }
    )


def whole(options: BranchesOptions, sweep: Sweep, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `branches` and `bifurcations`, from what all lanes have settled on."""
    [axis], [(order, row)] = sweep.axes, sweep.rows
    scene = replace(row, along=replace(axis, values=axis.values[order]))
    u, period, size = (data[f"lane_{name}"].to_numpy()[order] for name in ("u", "period", "size"))
    known = np.isfinite(size).all(axis=1)
    unit = np.median(size[known], axis=0) if known.any() else np.ones(u.shape[1])
    ends = float(axis.values.min()), float(axis.values.max())
    families = [orbits_of(scene, lanes, strobe, unit, ends) for strobe in refined(scene)]
    waves = settled_waves(scene, lanes, u, np.where(known, period, 0))
    if options.starts:
        some = np.unique(np.linspace(0, len(order) - 1, min(options.values, len(order))).round().astype(int))
        here = scene.take(np.argsort(scene.line.values, kind="stable")[some])
        with lanes.stage(f"branches: {options.starts} random starts at {len(some)} values of {axis.name}", 0):
            wave = random_wave(
                here, lanes, options.starts, options.seed, options.box, options.limit, unit, options.transient
            )
        by_value = {orbit.value: list[Any]() for orbit in wave}
        for orbit in wave:
            by_value[orbit.value].append(orbit)
        waves += by_value.values()

    def stage(label: str) -> Any:
        return lanes.stage(f"branches: {label}", 0)

    tree = grow(families, waves, options.limit, Steps(options.step, options.longest), stage)
    return datasets(scene, lanes, tree, options)


# ---- datasets


def datasets(scene: Scene, lanes: LaneRunner, tree: Tree, options: BranchesOptions) -> dict[str, xr.Dataset]:
    """Both groups: branches in the order of their periods, bifurcations in that of the parameter."""
    axis, system = scene.line, scene.system
    order = sorted(range(len(tree.branches)), key=lambda k: (tree.branches[k].period, k))
    rank = {k: place for place, k in enumerate(order)}
    found = sorted(tree.bifurcations, key=lambda point: (point.value, point.kind, len(point.points)))
    branches = _branches(scene, lanes, [tree.branches[k] for k in order])
    attrs = {
        "limit": options.limit,
        "along": axis.name,
        "lost": tree.lost,
        "panel": "branches",
        "panel_variables": f"{system.plane[0]}_points",
        **({"warnings": words} if (words := _warnings(axis, tree)) else {}),
    }
    points = _bifurcations(scene, lanes, found, rank)
    marks = {"along": axis.name, "panel": "marks", "panel_variables": f"{system.plane[0]}_points"}
    return {"branches": xr.Dataset(branches, attrs=attrs), "bifurcations": xr.Dataset(points, attrs=marks)}


def _warnings(axis: Axis, tree: Tree) -> str:
    """Lines for the user."""
    if not tree.branches:
        return f"branches: no periodic orbit was found to follow along {axis.name}"
    if tree.lost:
        return f"branches: {tree.lost} sign changes of test functions led to no bifurcation that could be located"
    return ""


def _branches(scene: Scene, lanes: LaneRunner, branches: Sequence[Branch]) -> dict[str, Entry]:
    """Variables over (branch, point), filled up with NaN."""
    axis, system = scene.line, scene.system
    sizes = [len(branch.value) for branch in branches]
    shape = (len(branches), max(sizes, default=0))

    def table(values: Sequence[np.ndarray], empty: float = np.nan, *more: int) -> np.ndarray:
        whole = np.full((*shape, *more), empty)
        for k, one in enumerate(values):
            whole[(k, slice(len(one)), *map(slice, one.shape[1:]))] = one
        return whole

    dims, flags = ("branch", "point"), _flags(ENDS)
    d = system.dimension
    values = table([_parts(branch.multipliers) for branch in branches], np.nan, d, 2)
    stable = [np.all(np.abs(branch.multipliers) < 1.0, axis=1) for branch in branches]
    most = max((branch.period for branch in branches), default=1)
    return {
        axis.name: variable(dims, table([branch.value for branch in branches]), axis.long_name, axis.units),
        "period": variable("branch", np.array([b.period for b in branches], np.int32), "period", counted_in(system)),
        **_coordinates(scene, lanes, [branch.points for branch in branches], functools.partial(table), dims, most),
        "multipliers": variable((*dims, "multiplier", "part"), values, "Floquet multipliers, real and imaginary part"),
        "stable": variable(dims, table(stable, -1).astype(np.int8), "1 where the orbit attracts, -1 beyond the end"),
        "residual": variable(
            dims,
            table([branch.residual for branch in branches]),
            "largest component of P(u) − u, in sizes of the motion",
        ),
        "begins": variable("branch", _column([b.ends[0] for b in branches]), "why the branch begins there", **flags),
        "ends": variable("branch", _column([b.ends[1] for b in branches]), "why the branch ends there", **flags),
    }


def _bifurcations(
    scene: Scene, lanes: LaneRunner, found: Sequence[Bifurcation], rank: Mapping[int, int]
) -> dict[str, Entry]:
    """Variables over (bifurcation,)."""
    axis, system = scene.line, scene.system
    dim, name = ("bifurcation",), axis.name
    most = max((len(point.points) for point in found), default=1)

    def column(values: Sequence[np.ndarray], empty: float = np.nan, *more: int) -> np.ndarray:
        whole = np.full((len(found), *more), empty)
        for k, one in enumerate(values):
            whole[(k, *map(slice, one.shape))] = one
        return whole

    multipliers = column([_parts(point.multipliers) for point in found], np.nan, system.dimension, 2)
    signs = {
        "flag_values": np.arange(-1, 2, dtype=np.int8),
        "flag_meanings": " ".join(CRITICALITIES),
    }
    error_words = f"largest error of {name}, from step refinement, interpolation and rounding"
    return {
        "kind": variable(dim, _column([point.kind for point in found]), "kind of bifurcation", **_flags(KINDS)),
        name: variable(
            dim,
            np.array([point.value for point in found], float),
            f"{axis.long_name} at the bifurcation",
            axis.units,
            ancillary_variables=f"{name}_error",
        ),
        f"{name}_error": variable(dim, np.array([point.error for point in found], float), error_words, axis.units),
        "period": variable(
            dim, np.array([len(point.points) for point in found], np.int32), "period of the orbit", counted_in(system)
        ),
        "branch": variable(dim, np.array([rank[point.branch] for point in found], np.int32), "number of the branch"),
        "criticality": variable(
            dim, _column([point.criticality for point in found]), "whether what is born is stable where it is", **signs
        ),
        "coefficient": variable(
            dim,
            np.array([point.coefficient for point in found], float),
            "cubic coefficient of the normal form in sizes of the motion; of a fold the curvature of the parameter",
        ),
        **_coordinates(scene, lanes, [point.points[None] for point in found], _row(column), dim, most),
        "multipliers": variable(
            (*dim, "multiplier", "part"), multipliers, "Floquet multipliers, real and imaginary part"
        ),
    }


def _row(column: Any) -> Any:
    """A table of rows of one."""
    return lambda values, empty=np.nan, *more: column([one[0] for one in values], empty, *more)


def _coordinates(
    scene: Scene, lanes: LaneRunner, points: Sequence[Float[np.ndarray, "k n d"]], table: Any, dims: Any, most: int
) -> dict[str, Entry]:
    """Coordinates of the first point of every orbit, and under NAME_points of all of them."""
    flat = [one.reshape(-1, one.shape[-1]) for one in points]
    whole = np.concatenate(flat) if flat else np.zeros((1, scene.system.dimension))
    states = states_at(scene, lanes, whole)
    named = scene.system.outputs(jax.tree.map(lambda leaf: leaf[:, None], states), np.zeros(1))
    cuts = np.cumsum([len(one) for one in flat])[:-1]
    found: dict[str, Entry] = {}
    for name, output in named.items():
        if name not in scene.system.coordinates:
            continue
        parts = np.split(np.asarray(output.data)[:, 0], cuts) if flat else []
        every = [part.reshape(one.shape[:2]) for part, one in zip(parts, points, strict=True)]
        first, words = [one[:, 0] for one in every], output.long_name
        found[name] = variable(dims, table(first), f"{words} of the orbit's first point", **output.attrs)
        found[f"{name}_points"] = variable(
            (*dims, "iterate"), table(every, np.nan, most), f"{words} of the orbit's points", **output.attrs
        )
    return found


def _parts(values: np.ndarray) -> np.ndarray:
    return np.stack([np.real(values), np.imag(values)], axis=-1)


def _column(values: Sequence[int]) -> np.ndarray:
    return np.array(values, np.int8)


def _flags(words: Sequence[str]) -> dict[str, Any]:
    return {"flag_values": np.arange(len(words), dtype=np.int8), "flag_meanings": " ".join(words)}


def count(data: xr.Dataset) -> dict[str, int]:
    """Number of branches."""
    return {"branches": data.sizes["branch"]}


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a period: how many branches there are, how many of them are stable somewhere, and their range."""
    name, period = str(data.attrs["along"]), data["period"].to_numpy()
    rows = []
    for n in np.unique(period):
        here = np.flatnonzero(period == n)
        stable = np.any(data["stable"].to_numpy()[here] == 1, axis=1)
        values = data[name].to_numpy()[here]
        ends = f"{np.nanmin(values):.9g} to {np.nanmax(values):.9g}"
        rows.append((str(n), str(len(here)), str(int(stable.sum())), ends))
    return Table("Branches of periodic orbits", ("period", "branches", "stable somewhere", name), tuple(rows))


def price(options: BranchesOptions, scene: Scene) -> Price:
    """Orbits and their multipliers need the derivatives of a period; before them comes the map alone."""
    return newton_price(scene, PERIOD_TILE)


ANALYSIS = Analysis(
    "branches",
    BranchesOptions,
    periods,
    run,
    whole=Whole(("bifurcations",), whole),
    newton=True,
    numbers=numbers,
    count=count,
    check=check,
    table=table,
    price=price,
    brief={"transient": 1, "limit": 1},
)
"""The entry of this analysis in the table."""
