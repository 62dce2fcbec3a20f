"""Windows of periodic orbits over the first axis that are wider than one lane, with where each begins and ends.

What lanes settle on says where windows are; orbits followed from there say where they begin and end (`window_search`),
and the doublings of each where these accumulate (`cascade`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from pydantic import Field

from jaxnh.analyses.base import Analysis, Entry, OptionError, Options, Setting, Table, variable
from jaxnh.analyses.branch_seeds import settled_waves
from jaxnh.analyses.cascade import along_line
from jaxnh.analyses.cascade_limits import doublings_limit
from jaxnh.analyses.families import orbits_of
from jaxnh.analyses.family_tree import Orbit
from jaxnh.analyses.locating import PERIOD_TILE, Located, refined
from jaxnh.analyses.price import Price, newton_price
from jaxnh.analyses.runs import Line
from jaxnh.analyses.scene import Axis, LaneRunner, Scene, counted_in
from jaxnh.analyses.survey import survey_from_start
from jaxnh.analyses.window_search import DOUBLED, ENDS, End, Window, all_lanes, search
from jaxnh.orbits.arclength import Family

_WORDS = ("fold", "branch point", "range", "not located", "torus", "doubling")
_DOUBLED = 4  # times the limit: lanes of orbits up to this period are seen, as those of doublings are
_WORK = 3.0  # of a run, in those of settling: a guess


class WindowsOptions(Options):
    """Options of `windows`."""

    limit: int = Field(default=12, ge=1, le=64, description="Largest period of the orbits that windows begin with")
    transient: int = Field(default=512, ge=0, description="Periods before lanes are looked at")
    levels: int = Field(
        default=4, ge=0, le=8, description="Doublings of a window to locate; four or more say where they accumulate"
    )


def periods(options: WindowsOptions, lanes: int) -> float:
    """Lane-periods of a run: a guess, as nobody knows how many windows there are."""
    return _WORK * lanes * (options.transient + 2 * _DOUBLED * options.limit)


def check(options: WindowsOptions, setting: Setting) -> None:
    """See that there is one axis, a parameter that lanes may differ in, with values to be neighbours."""
    first, *others = setting.axes
    if first.kind != "lane":
        what = "a coordinate of the start state" if first.kind == "start" else "what all lanes of a program share"
        raise OptionError(f"windows are looked for along a parameter, and {first.name} is {what}" + setting.advice)
    if others:
        names = " and ".join(axis.name for axis in others)
        raise OptionError(f"windows are looked for along one axis; leave out {names}")
    if len(np.unique(first.values)) < 2:
        raise OptionError(f"windows are looked for over a range of {first.name}, and the sweep has one value of it")


def independent(options: WindowsOptions) -> bool:
    """Never: a window is found by comparing neighbouring lanes."""
    return False


def run(options: WindowsOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """The windows that lanes along the first axis have settled in, in the order of the axis."""
    scene = scene.take(np.unique(scene.line.values, return_index=True)[1])
    found = survey_from_start(scene, lanes, _DOUBLED * options.limit, "windows", options.transient)
    size = np.median(found.size[~found.failed], axis=0) if not found.failed.all() else found.size[0]
    line = Line(scene.line.values, np.where(found.failed, 0, found.period), found.u)

    def stage(label: str) -> AbstractContextManager[object]:
        return lanes.stage(f"windows: {label}", 0)

    def orbits(some: Int[np.ndarray, " some"]) -> list[list[Orbit]]:
        return settled_waves(scene.take(some), lanes, line.u[some], line.period[some])

    def families(low: float, high: float) -> list[Family]:
        return [orbits_of(scene, lanes, strobe, size, (low, high)) for strobe in strobes]

    strobes = refined(scene)
    windows = search(line, options.limit, orbits, families, stage)
    windows.sort(key=lambda group: float(line.value[all_lanes(group)[0]]))
    doublings = [_doublings(options.levels, scene, lanes, line, group[0], size) for group in windows]
    return _dataset(options, scene, line, windows, doublings)


def _doublings(
    levels: int, scene: Scene, lanes: LaneRunner, line: Line, window: Window, size: Float[np.ndarray, " d"]
) -> tuple[Located, ...]:
    """Doublings of a window beyond its end, no further than one lane beyond those that have settled in it."""
    if not levels or window.end.kind != DOUBLED:
        return ()
    value = float(window.inside.value[0])
    up = window.beyond > value
    order = np.flatnonzero(line.value > value) if up else np.flatnonzero(line.value < value)[::-1]
    own = np.flatnonzero(np.isin(order, window.lanes))
    others = line.take(order[: own.max(initial=-1) + 2])
    no_orbit = Line(np.array([window.beyond]), np.zeros(1, int), window.inside.u)
    begun = Line(*(np.concatenate(leaves) for leaves in zip(window.inside, no_orbit, strict=True)))
    with lanes.stage(f"windows: doublings of period {window.period}", 0):
        return along_line(scene, lanes, begun.joined(others), levels, size)


# ---- the dataset


def _dataset(
    options: WindowsOptions,
    scene: Scene,
    line: Line,
    found: Sequence[Sequence[Window]],
    doublings: Sequence[Sequence[Located]],
) -> xr.Dataset:
    """Variables over (window,), and the doublings over (window, level)."""
    axis, unit = scene.line, counted_in(scene.system)
    value, error = np.full((2, len(found), options.levels), np.nan)
    limits = np.full((len(found), 2), np.nan)
    for k, located in enumerate(doublings):
        value[k, : len(located)] = [one.point.value for one in located]
        error[k, : len(located)] = [one.error for one in located]
        if len(located):
            limit = doublings_limit(value[k, : len(located)], np.array([one.point.error for one in located]))
            limits[k] = limit.value, limit.error + located[-1].error
    lanes = [all_lanes(group) for group in found]
    count = [len(some) for some in lanes]
    first, last = (np.array([line.value[some[end]] for some in lanes], float) for end in (0, -1))
    period = np.array([group[0].period for group in found], np.int32)
    variables = {
        "period": variable("window", period, "period of the orbits that the window begins with", unit),
        "orbits": variable("window", np.array([len(group) for group in found], np.int32), "number of such orbits"),
        "lanes": variable("window", np.array(count, np.int32), "number of lanes that have settled in the window"),
        "first": variable("window", first, f"{axis.long_name} of the first of these lanes", axis.units),
        "last": variable("window", last, f"{axis.long_name} of the last of these lanes", axis.units),
        **_end_variables("begin", "begin to attract", axis, [group[0].begin for group in found], scene),
        **_end_variables("end", "cease to attract", axis, [group[0].end for group in found], scene),
        "doubling": variable(
            ("window", "level"),
            value,
            f"{axis.long_name} at the doublings of the orbits",
            axis.units,
            ancillary_variables="doubling_error",
        ),
        "doubling_error": variable(("window", "level"), error, "error of the doublings", axis.units),
        "limit": variable(
            "window",
            limits[:, 0],
            f"{axis.long_name} where the doublings accumulate",
            axis.units,
            ancillary_variables="limit_error",
        ),
        "limit_error": variable(
            "window", limits[:, 1], "error of the place where the doublings accumulate", axis.units
        ),
    }
    attrs = {
        "along": axis.name,
        "largest_period": options.limit,
        "lowest": float(line.value[0]),
        "highest": float(line.value[-1]),
        "spacing": float(np.diff(line.value).max()),
        "panel": "windows",
        "panel_variables": "period",
        "panel_label": axis.long_name,
        **(
            {} if found else {"warnings": f"windows: {_searched(options.limit, axis.name, line.value)}: none was found"}
        ),
    }
    return xr.Dataset(variables, attrs=attrs)


def _end_variables(name: str, words: str, axis: Axis, ends: Sequence[End], scene: Scene) -> dict[str, Entry]:
    """The place, its error, its kind and the multipliers there of one end of all windows."""
    flags: dict[str, Any] = {"flag_values": np.arange(len(ENDS), dtype=np.int8), "flag_meanings": " ".join(ENDS)}
    multipliers = np.full((len(ends), scene.system.dimension, 2), np.nan)
    for k, end in enumerate(ends):
        multipliers[k] = np.stack([np.real(end.multipliers), np.imag(end.multipliers)], axis=-1)
    return {
        name: variable(
            "window",
            np.array([end.value for end in ends], float),
            f"{axis.long_name} where orbits of the period {words}",
            axis.units,
            ancillary_variables=f"{name}_error",
        ),
        f"{name}_error": variable(
            "window",
            np.array([end.error for end in ends], float),
            f"error of {name}, from step refinement, interpolation and rounding",
            axis.units,
        ),
        f"{name}_kind": variable(
            "window", np.array([end.kind for end in ends], np.int8), f"what is where they {words}", **flags
        ),
        f"{name}_multipliers": variable(
            ("window", "multiplier", "part"),
            multipliers,
            f"Floquet multipliers where they {words}, real and imaginary part",
        ),
    }


def _searched(limit: int, name: str, values: Float[np.ndarray, " lanes"]) -> str:
    """In words, what was searched."""
    lane, where = f"one lane of {np.diff(values).max():.3g}", f"{name} = {values[0]:.6g} to {values[-1]:.6g}"
    return f"windows of periods up to {limit} wider than {lane} in {where}"


def count(data: xr.Dataset) -> dict[str, int]:
    """Number of windows."""
    return {"windows": data.sizes["window"]}


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a window: its period, where it begins, where its orbits double, and where the doublings accumulate."""
    rows = []
    for k in range(data.sizes["window"]):
        one = data.isel(window=k)
        ends = (cell for name in ("begin", "end") for cell in (_known(one, name), _WORDS[int(one[f"{name}_kind"])]))
        rows.append((str(int(one["period"])), str(int(one["orbits"])), *ends, _known(one, "limit")))
    heads = ("period", "orbits", "from", "", "to", "", "doublings end")
    lane = f"one lane of {data.attrs['spacing']:.3g}"
    words = f"windows of periods up to {data.attrs['largest_period']} wider than {lane}; (2): ± 2 in the last digit"
    return Table(f"Windows over {data.attrs['along']}", heads, tuple(rows), words, left=(3, 5))


def _known(one: xr.Dataset, name: str) -> str:
    """A number with its error in units of the last digit, in brackets."""
    value, error = float(one[name]), float(one[f"{name}_error"])
    if not np.isfinite(value + error) or error <= 0.0:
        return "–"
    digits = max(math.ceil(-math.log10(error)), 0)
    return f"{value:.{digits}f}({math.ceil(error * 10**digits)})"


def price(options: WindowsOptions, scene: Scene) -> Price:
    """Orbits and their multipliers need the derivatives of a period; before them comes the map alone."""
    return newton_price(scene, PERIOD_TILE)


ANALYSIS = Analysis(
    "windows",
    WindowsOptions,
    periods,
    run,
    independent=independent,
    newton=True,
    count=count,
    check=check,
    table=table,
    price=price,
    brief={"transient": 1, "limit": 1},
)
"""The entry of this analysis in the table."""
