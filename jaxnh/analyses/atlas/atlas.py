"""An atlas of two parameters: branches and windows along some rows, all curves through their bifurcations, and links.

What is followed is followed by `branches`, `windows` and `curves`, whose groups these are; charts are other analyses of
the same sweep. At some values of the second axis branches and windows are those over the first axis; all bifurcations
of branches begin curves over both, and every bifurcation has the number of its curve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxnh.analyses.atlas.links import NONE, curve_through
from jaxnh.analyses.atlas.rows import stack_rows
from jaxnh.analyses.base import (
    Analysis,
    Entry,
    OptionError,
    Setting,
    SweepLanes,
    SweepReduction,
    Table,
    number_lanes,
    number_variable,
    variable,
)
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation import branches, curves
from jaxnh.analyses.continuation.curve_tables import CurveSet
from jaxnh.analyses.continuation.families import lanes_along, plane_axes, values_searched
from jaxnh.analyses.continuation.tables import (
    OWN_NAMES,
    FollowedBranches,
    datasets,
    orbit_coordinates,
    ordered_bifurcations,
)
from jaxnh.analyses.options.orbits import AtlasOptions, BranchesOptions, CurvesOptions, WindowsOptions
from jaxnh.analyses.periodic.location import price_of_orbits
from jaxnh.analyses.windows import windows
from jaxnh.orbits.continuation.curves import Curve
from jaxnh.orbits.continuation.paths import MOST_POINTS

_OWN_NAMES = ("row", "rows", "curve", "branches", "bifurcations", "windows", "curves", "cut", "not_located", "spacing")
_COUNTED = ("branches", "bifurcations", "windows")
_WORK = 6.0  # of a run, in those of settling: a guess


class _Row(NamedTuple):
    """The first axis at a value of the second: lanes, branches (orbits first), and windows."""

    value: float
    batch: LaneBatch
    grown: list[FollowedBranches]
    windows: xr.Dataset


def numbers(options: AtlasOptions) -> int:
    """Return how many numbers a lane leaves."""
    return 1


def check(options: AtlasOptions, setting: Setting) -> None:
    """Check what `curves` asks of both axes, and `branches` and `windows` of the first."""
    curves.check(_curves_options(options), setting)
    setting = setting._replace(axes=plane_axes(setting.axes))
    along_first = setting._replace(axes=setting.axes[:1])
    branches.check(_branches_options(options), along_first)
    windows.check(_windows_options(options), along_first)
    taken = {*_OWN_NAMES, *OWN_NAMES}
    for axis in setting.axes:
        if axis.name in taken:
            raise OptionError(f"{axis.name} is what an atlas calls a number of its own; rename it")


def _branches_options(options: AtlasOptions) -> BranchesOptions:
    return BranchesOptions(**_shared(options, "n_starts", "equilibria", "seed", "box"))


def _curves_options(options: AtlasOptions) -> CurvesOptions:
    names = ("equilibria", "seed", "box") if options.equilibria else ()
    return CurvesOptions(**_shared(options, *names), n_values=options.n_values)


def _windows_options(options: AtlasOptions) -> WindowsOptions:
    names = ("max_period", "transient", "levels", "crisis")
    return WindowsOptions(**{name: getattr(options, name) for name in names})


def _shared(options: AtlasOptions, *names: str) -> dict[str, Any]:
    """Options of another analysis: periods and the transient, and of steps and starts those that are given."""
    steps = ("ds", "ds_min", "ds_max", "max_steps")
    given = {name: getattr(options, name) for name in (*steps, *names) if name in options.model_fields_set}
    return given | {"max_period": options.max_period, "transient": options.transient}


def whole(options: AtlasOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `atlas`, `branches`, `bifurcations`, `windows`, `curves`, `codimension_two` and `curve_orbits`."""
    sweep = sweep._replace(axes=plane_axes(sweep.axes))
    rows, of_curves = _rows(options, sweep, lanes), _curves_options(options)
    seeds = [curves.seeds_of(row.grown[0].tree, row.value) for row in rows]
    size = np.median([row.grown[0].family.size for row in rows], axis=0)
    followed = curves.follow_all(of_curves, sweep, lanes, curves.KnownBifurcations(size, seeds))
    every = [curve for curve in followed.curves if isinstance(curve, Curve)]
    second, values = sweep.axes[1], [row.value for row in rows]
    along = [datasets(lanes, row.grown, options.max_period) for row in rows]
    number = 0
    for row, groups in zip(rows, along, strict=True):
        groups["bifurcations"]["branch"] += number
        number += groups["branches"].sizes["branch"]
        groups["bifurcations"] = groups["bifurcations"].assign(curve=_curve_numbers(row, sweep, every))
    groups = {
        "branches": stack_rows([part["branches"] for part in along], "branch", second, values),
        "bifurcations": stack_rows([part["bifurcations"] for part in along], "bifurcation", second, values),
        "windows": stack_rows([row.windows for row in rows], "window", second, values),
        **curves.curve_groups(of_curves, sweep, followed),
        "curve_orbits": _curve_orbits(rows[0], lanes, every),
    }
    return {"atlas": _dataset(options, sweep, rows, followed, groups), **groups}


def _rows(options: AtlasOptions, sweep: SweepLanes, lanes: LaneRunner) -> list[_Row]:
    """Branches and windows at some values of the second axis."""
    (first, second), [(_, row)], rows = sweep.axes, sweep.rows, list[_Row]()
    of_branches = _branches_options(options)
    for value in values_searched(second, options.n_values).tolist():
        batch = lanes_along(row, first, second, value)
        with lanes.stage(f"atlas: branches and windows at {second.name} = {value:g}", 0):
            grown = branches.grow_branches(of_branches, batch, lanes, branches.settle(of_branches, batch, lanes))
            rows.append(_Row(value, batch, grown, windows.run(_windows_options(options), batch, lanes)))
    return rows


def _curve_numbers(row: _Row, sweep: SweepLanes, every: Sequence[Curve]) -> Entry:
    """The curve through every bifurcation of a row, in the order of their table."""
    widths, numbers = np.array([float(np.ptp(axis.values)) for axis in sweep.axes]), list[int]()
    for part, point in ordered_bifurcations(row.grown):
        family, period = row.grown[part].family, 0 if row.grown[part].family.field else len(point.points)
        at = point.points, np.array([point.value, row.value])
        numbers.append(curve_through(every, point.kind, period, *at, widths, family.wrap, family.size))
    words = "number of the curve through the bifurcation"
    return number_variable("bifurcation", np.array(numbers, np.int32), words, ("none",), NONE)


def _curve_orbits(row: _Row, lanes: LaneRunner, every: Sequence[Curve]) -> xr.Dataset:
    """Coordinates of the orbits of all curves, over (curve, point) and their points."""
    points = [(int(curve.equilibria), curve.points) for curve in every]
    return xr.Dataset(orbit_coordinates(lanes, row.grown, points, ("curve", "point")))


# ---- limits


def _dataset(
    options: AtlasOptions,
    sweep: SweepLanes,
    rows: Sequence[_Row],
    followed: CurveSet,
    groups: Mapping[str, xr.Dataset],
) -> xr.Dataset:
    """Numbers of all there is along each row and over the plane, and the limits up to which that is all."""
    (first, second), dim = sweep.axes, "row"
    columns: dict[str, Entry] = {
        second.name: variable(dim, np.array([row.value for row in rows]), second.long_name, second.units)
    }
    for name in _COUNTED:
        counts = [int(np.sum(groups[name][second.name].to_numpy() == row.value)) for row in rows]
        columns[name] = variable(dim, np.array(counts, np.int32), f"number of {name}")
    cut = [curve for curve in followed.curves if MOST_POINTS in curve.ends]
    single = {
        "curves": (len(followed.curves), "number of curves of bifurcations"),
        "cut": (len(cut), "number of curves that go on beyond their last point"),
        "not_located": (int(groups["branches"]["not_located"]), "number of bifurcations that could not be located"),
    }
    columns |= {name: variable((), np.int64(count), words) for name, (count, words) in single.items()}
    spacing = float(groups["windows"]["spacing"])
    columns["spacing"] = variable((), spacing, f"largest distance of lanes in {first.name}", first.units)
    attrs = {"over": f"{first.name} {second.name}", "complete_to": _limits(options, first.name, second.name, rows)}
    return xr.Dataset(columns, attrs=attrs)


def _limits(options: AtlasOptions, first: str, second: str, rows: Sequence[_Row]) -> str:
    """The extent of the search, and its limits."""
    values = ", ".join(f"{row.value:g}" for row in rows)
    starts = f", or Newton finds from {options.n_starts} random starts at some values of {first}"
    equilibria = f"; equilibria that Newton finds from {options.equilibria} random starts"
    return (
        f"orbits of periods up to {options.max_period} that lanes settle on after {options.transient} periods"
        f"{starts if options.n_starts else ''}, at {second} = {values}{equilibria if options.equilibria else ''}; "
        f"a curve that crosses none of these rows, a window of {first} narrower than `spacing`, and what is beyond "
        f"{options.max_steps} points of a curve are not there"
    )


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a value of the second axis: how many branches, bifurcations and windows are there."""
    second, names = str(data.attrs["over"]).split()[1], _COUNTED
    rows = tuple(
        (f"{float(data[second][k]):g}", *(str(int(data[name][k])) for name in names)) for k in range(data.sizes["row"])
    )
    words = f"{int(data['curves'])} curves, of which {int(data['cut'])} go on; {data.attrs['complete_to']}"
    return Table("Atlas", (second, *names), rows, caption=words)


ANALYSIS = Analysis(
    "atlas",
    AtlasOptions,
    # a guess, as the number of curves is not known
    lambda options, lanes: _WORK * options.n_values * lanes**0.5 * (options.transient + 8 * options.max_period),
    number_lanes,  # only those at a few values of the second axis are looked at, once all are there
    whole=SweepReduction(("branches", "bifurcations", "windows", "curves", "codimension_two", "curve_orbits"), whole),
    numbers=numbers,
    check=check,
    table=table,
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1, "n_values": 1},
)
