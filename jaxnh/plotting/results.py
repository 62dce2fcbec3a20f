"""A result, in memory or in a file, as one figure: every group as its own attributes say. No solver, no JAX.

A group says by `panel` what kind of panel it is, by `panel_variables` of what, and by `panel_label` in which words; see
`jaxnh.plotting.panels`. The axes of the sweep are named by the attribute `axes` of the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.exceptions import ResultError
from jaxnh.plotting.groups import (
    at_place,
    axes_of,
    kind_of,
    lane_count,
    long_axes,
    other_axes,
    places_of,
    same_plane,
)
from jaxnh.plotting.layout import Panel, laid_out
from jaxnh.plotting.panels import PANELS, Kind
from jaxnh.plotting.reading import load_result

_MOST_LANES = 12  # that get a panel each
_MOST_POINTS = 6  # of the axes beside the first, that get a panel each
_CHART_HEIGHT = 6.0  # inches

_Groups = Mapping[str, xr.Dataset]


def figure(result: xr.DataTree | xr.Dataset | Path | str) -> Figure:
    """Every group of a result that says how it is drawn, in their order; what is left out is said below.

    Args:
        result: a result or one group of it, a dataset of one group, or the path of a result file.

    Raises:
        ResultError: a file is damaged or none of ours, a group lacks what it names, or there is nothing to draw.
    """
    source = str(result) if isinstance(result, Path | str) else "the result"
    tree = load_result(Path(result)) if isinstance(result, Path | str) else result
    groups = _groups(tree)
    panels: list[Panel] = []
    lines: list[str] = []
    try:
        for name, data in groups.items():
            with _of_group(name):
                found, said = _panels(name, data, groups)
            panels += found
            lines += [line for line in said if line not in lines]
        if silent := [name for name, data in groups.items() if not kind_of(data)]:
            lines.append(f"not drawn, since no attribute panel says how: {', '.join(silent)}")
        if panels:
            attrs = {str(key): value for key, value in tree.attrs.items()}
            return laid_out(
                panels, str(attrs.get("title", "")), [*_provenance(attrs), *_of_level(attrs, groups), *lines]
            )
    except ResultError as error:
        raise ResultError(f"{source}: {error}") from error
    raise ResultError("; ".join((f"{source} has nothing that can be drawn", *lines)))


def _groups(result: xr.DataTree | xr.Dataset) -> _Groups:
    """Datasets of the groups by name, each with the axes of the sweep among its attributes."""
    if isinstance(result, xr.Dataset):
        return {"the dataset": result}
    if not result.children:
        return {result.name or "the dataset": result.to_dataset()} if result.has_data else {}
    axes = {"axes": result.attrs["axes"]} if "axes" in result.attrs else {}
    groups = {name: node.to_dataset() for name, node in result.children.items()}
    return {name: data.assign_attrs(axes | data.attrs) for name, data in groups.items()}


def _panels(name: str, data: xr.Dataset, groups: _Groups) -> tuple[list[Panel], list[str]]:
    """Panels of a group, and lines that say what is not drawn."""
    kind = PANELS.get(kind_of(data))
    if kind is None:
        stated = kind_of(data)
        return [], [f"{name} is not drawn: its panel, {stated}, is of no kind known here"] if stated else []
    return _of_lanes(name, data, kind, groups) if kind.each == "lane" else _over_an_axis(name, data, kind, groups)


def _of_lanes(name: str, data: xr.Dataset, kind: Kind, groups: _Groups) -> tuple[list[Panel], list[str]]:
    """A panel a lane, or of some picked evenly; none of points that are drawn over trajectories."""
    if kind is PANELS["points"] and any(same_plane(data, other) for other in _of_kind("trajectories", groups)):
        return [], []
    over = {}
    if kind is PANELS["trajectories"]:
        over["over"] = [other for other in _of_kind("points", groups) if same_plane(other, data)]
    count, axes = lane_count(data), axes_of(data)
    lanes = np.unique(np.linspace(0, count - 1, min(count, _MOST_LANES)).round().astype(int)).tolist()
    panels = [Panel(partial(_drawn, name, kind, data, lane=lane, **over), kind.height, False) for lane in lanes]
    points = "values" if len(axes) == 1 else "points"
    left_out = f"{len(lanes)} of the {count:,} {points} of {' and '.join(axes)} are drawn"
    return panels, [left_out] if count > len(lanes) else []


def _over_an_axis(name: str, data: xr.Dataset, kind: Kind, groups: _Groups) -> tuple[list[Panel], list[str]]:
    """A panel of the group, or one for each of a few points of the other axes; over two long axes a chart."""
    if kind is PANELS["shares"] and not axes_of(data):
        return [], []  # the attractors are drawn over their basins
    if kind is PANELS["marks"] and _of_kind("branches", groups):
        return [], []  # they are drawn over the branches
    others = other_axes(data)
    count = math.prod(data.sizes[axis] for axis in others)
    if count > _most_points(kind):
        if _has_chart(data):
            assert kind.chart is not None
            draw = partial(_charted, name, kind.chart, data, _of_kind(kind.over, groups))
            return [Panel(draw, _CHART_HEIGHT, True)], []
        if kind is PANELS["cascade"] and len(others) == 1 and any(map(_has_chart, groups.values())):
            return [], []  # it is drawn over the charts
        points = f"{count:,} points of {' and '.join(others)}"
        most = f"at most {_MOST_POINTS} get a panel each" if kind.each == "point" else "its panel shows one"
        return [], [f"{name} is not drawn: it has {points}, of which {most}"]
    panels = []
    for place in places_of(data, others):
        marks = {}
        if kind is PANELS["density"]:
            marks["cascades"] = [at_place(other, place) for other in _of_kind("cascade", groups)]
        if kind is PANELS["branches"]:
            marks = {"marks": _of_kind("marks", groups), "under": _of_kind("density", groups)}
        panels.append(Panel(partial(_drawn, name, kind, at_place(data, place), **marks), kind.height, True))
    return panels, []


def _most_points(kind: Kind) -> int:
    """Of the axes beside the first, that get a panel each."""
    return _MOST_POINTS if kind.each == "point" else 1


def _has_chart(data: xr.Dataset) -> bool:
    """Whether a group is drawn over two axes at once."""
    kind = PANELS.get(kind_of(data))
    if kind is None or kind.chart is None:
        return False
    return len(long_axes(data)) == 2 and math.prod(data.sizes[axis] for axis in other_axes(data)) > _most_points(kind)


def _of_kind(kind: str, groups: _Groups) -> list[xr.Dataset]:
    return [data for data in groups.values() if kind_of(data) == kind]


def _drawn(name: str, kind: Kind, data: xr.Dataset, ax: Axes, **options: object) -> Axes:
    with _of_group(name):
        return kind.draw(data, ax, **options)


def _charted(name: str, chart: Callable[..., Axes], data: xr.Dataset, over: Sequence[xr.Dataset], ax: Axes) -> Axes:
    with _of_group(name):
        return chart(data, ax, over=over)


@contextmanager
def _of_group(name: str) -> Iterator[None]:
    """Errors inside are those of one group, in one sentence.

    Raises:
        ResultError: the group is not as it says.
    """
    try:
        yield
    except ResultError as error:
        raise ResultError(f"{name} cannot be drawn: {error}") from error


def _provenance(attrs: Mapping[str, object]) -> list[str]:
    """What the numbers are from, in one line; nothing for a dataset that does not say.

    Raises:
        ResultError: the attributes of a result are not all there.
    """
    if "jaxnh_version" not in attrs:
        return []
    try:
        version, solver, steps = attrs["jaxnh_version"], attrs["solver"], attrs["steps_per_period"]
        error = float(str(attrs["error_estimate"]))
        turn, time = "period", "a period"
        if "section" in attrs:
            turn, time = "return", f"in a time of {float(str(attrs['strobe_period'])):.4g}"
    except (KeyError, ValueError) as missing:
        raise ResultError(f"its attributes are not as jaxnh writes them: {missing}") from missing
    return [f"jaxnh {version}, {solver}, {steps} steps {time}, error of one {turn} {error:.1g}"]


def _of_level(attrs: Mapping[str, object], groups: _Groups) -> list[str]:
    """Which level of a sweep it is, and what share of it was computed; nothing where there are no levels."""
    shares = [float(data["computed"].mean()) for data in groups.values() if "computed" in data.variables]
    if "levels" not in attrs or not shares:
        return []
    level = f"level {attrs['level']} of {attrs['levels']}"
    if shares[0] == 1.0:
        return [level]
    return [f"{level}, {100 * shares[0]:.3g} % of the points computed, the others filled from neighbours of their kind"]
