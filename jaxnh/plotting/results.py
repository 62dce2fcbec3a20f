"""A result, in memory or in a file, as one figure, with the panels of `descriptions`. No JAX.

The axes of the sweep are named by the attribute `axes` of the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.exceptions import ArgumentError, InputError, ResultError
from jaxnh.jobs.attributes import error_in_words, steps_in_words
from jaxnh.plotting.colouring import colouring
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import (
    at_place,
    axes_of,
    in_row,
    kind_of,
    lane_count,
    long_axes,
    other_axes,
    places_of,
    row_numbers,
    same_lanes,
    same_plane,
    variables_of,
    with_variables,
)
from jaxnh.plotting.layout import Panel, lay_out
from jaxnh.plotting.overlay import KINDS, draw_overlay
from jaxnh.plotting.panels import PANELS, Kind
from jaxnh.plotting.planes import draw_lanes
from jaxnh.plotting.reading import load_result
from jaxnh.plotting.style import PAGE, Size, package_style

_COORDINATES = {"density": 1, "curves": 1, "trajectories": 2, "points": 2}  # that a panel is of, by its kind
_MOST_LANES = 12  # that get a panel each
_MOST_TOGETHER = 240  # that one panel shows in colours
_MOST_POINTS = 6  # of the axes beside the first, that get a panel each
_CHART_HEIGHT = 4.2  # inches, on a whole page

_Groups = Mapping[str, xr.Dataset]


class Choice(NamedTuple):
    """Choices of a user for the drawing of results.

    Attributes:
        coordinates: names that panels are of in place of their own: of one those over an axis, of two planes.
        colour: "start", an axis, or a variable of lanes such as "attractor" or "kind"; "": as each panel has it.
        size: of the figure.
        names: what the legend calls several results.
    """

    coordinates: Sequence[Sequence[str]] = ()
    colour: str = ""
    size: Size = PAGE
    names: Sequence[str] = ()


def figure(
    *results: xr.DataTree | xr.Dataset | Path | str,
    coordinates: Sequence[Sequence[str]] = (),
    colour: str = "",
    size: Size = PAGE,
    names: Sequence[str] = (),
    ax: Axes | None = None,
) -> Figure:
    """Draw every group of a result in order; a line below lists what is left out.

    Args:
        results: a result or one group of it, a dataset of one group, or the path of a result file; of several, those
            panels that can have many in them show all of them.
        coordinates: what panels are of in place of their own: ("x_dot",) those over an axis, ("x", "y") planes.
        colour: "start", an axis, or a variable of lanes as "attractor" or "kind": what decides colours in diagrams,
            portraits and maps, which then show all lanes in one.
        size: width and height in inches.
        names: what the legend calls several results; by default the names of their files.
        ax: axes of a figure of your own to draw on, where there is one panel; `size` is then the figure's.

    Returns:
        A new figure, or the one that has `ax`.

    Raises:
        ResultError: a file is damaged or none of ours, a group lacks what it names, or there is nothing to draw; with
            `ax` also where there are several panels.
        ArgumentError: no group has the coordinates, or what is to decide the colour.
    """
    if not results:
        raise ResultError("there is no result to draw")
    for result in results:
        if not isinstance(result, xr.DataTree | xr.Dataset | Path | str):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError(
                f"a figure is of a result, one group of it, or a result file, not of {type(result).__name__}"
            )
    choice = Choice(tuple(map(tuple, coordinates)), colour, size, names)
    source = str(results[0]) if isinstance(results[0], Path | str) else "the result"
    tree, *others = (load_result(Path(result)) if isinstance(result, Path | str) else result for result in results)
    with package_style():
        try:
            groups = {name: _choose_coordinates(data, choice) for name, data in _groups(tree).items()}
            _check_chosen(groups, choice)
            more = _named(results, choice, [_groups(other) for other in others])
            panels, lines = _of_groups(groups, choice, more)
            if panels and ax is not None:
                return _draw_on(ax, panels)
            if panels:
                attrs = {str(key): value for key, value in tree.attrs.items()}
                return lay_out(
                    panels,
                    str(attrs.get("title", "")),
                    [*_provenance(attrs), *_of_level(attrs, groups), *lines],
                    choice.size,
                )
        except ResultError as error:
            raise ResultError(f"{source}: {error}") from error
    raise ResultError("; ".join((f"{source} has nothing that can be drawn", *lines)))


def _draw_on(ax: Axes, panels: Sequence[Panel]) -> Figure:
    """The one panel on axes that are there; returns their figure.

    Raises:
        ResultError: there are several.
    """
    if len(panels) > 1:
        raise ResultError(f"there are {len(panels)} panels, and axes have place for one; draw one group, or one lane")
    panels[0].draw(ax)
    drawing = ax.get_figure(root=True)
    assert drawing is not None
    return drawing


def _named(
    results: Sequence[xr.DataTree | xr.Dataset | Path | str], choice: Choice, others: Sequence[_Groups]
) -> dict[str, _Groups]:
    """Groups of the other results by the name that the legend has, that of the first result with none.

    Raises:
        ResultError: not every result has a name, or two have the same.
    """
    if not others:
        return {}
    names = list(choice.names) or [
        Path(result).stem if isinstance(result, Path | str) else f"result {k}"
        for k, result in enumerate(results, start=1)
    ]
    if len(set(names)) < len(results) or len(names) > len(results):
        raise ResultError(f"{len(results)} results need as many names that differ, and these are {', '.join(names)}")
    return dict(zip(names, ({}, *others), strict=True))


def _choose_coordinates(data: xr.Dataset, choice: Choice) -> xr.Dataset:
    """A group as a panel of the chosen coordinates, where it has them."""
    wanted = _COORDINATES.get(kind_of(data), 0)
    for names in choice.coordinates:
        if len(names) == wanted and set(names) <= set(data.data_vars):
            return with_variables(data, names)
    return data


def _check_chosen(groups: _Groups, choice: Choice) -> None:
    """Check that every choice is of some group.

    Raises:
        ArgumentError: no group has such coordinates.
    """
    drawn = [[str(v.name) for v in variables_of(data)] for data in groups.values() if kind_of(data)]
    for names in choice.coordinates:
        if list(names) not in drawn:
            of_states = [data for data in groups.values() if kind_of(data) in _COORDINATES]
            there = dict.fromkeys(
                str(v.name) for data in of_states for v in data.data_vars.values() if v.dtype.kind == "f"
            )
            what = "no portrait or map" if len(names) == 2 else "no diagram"
            known = f"there are {', '.join(there)}" if there else f"there is none in {', '.join(groups)}"
            raise ArgumentError("coordinates", f"{what} of {', '.join(names)} can be drawn; {known}")


def _of_groups(groups: _Groups, choice: Choice, more: Mapping[str, _Groups]) -> tuple[list[Panel], list[str]]:
    """Panels of all groups, and lines that say what is not drawn."""
    panels: list[Panel] = []
    lines: list[str] = []
    for name, data in groups.items():
        with _of_group(name):
            together = {label: data if k == 0 else other.get(name) for k, (label, other) in enumerate(more.items())}
            if more and kind_of(data) in KINDS and not other_axes(data):
                there = {
                    label: _choose_coordinates(group, choice) for label, group in together.items() if group is not None
                }
                draw = _of_group(name)(partial(draw_overlay, kind_of(data), there))
                panels.append(Panel(draw, PANELS[kind_of(data)].height, True))
                continue
            new_panels, said = _panels(name, data, groups, choice)
        panels += new_panels
        lines += [line for line in said if line not in lines]
        if more and new_panels:
            lines.append(f"{name} is of {next(iter(more))} alone")
    if silent := [name for name, data in groups.items() if not kind_of(data)]:
        hint = "; a group is given by its name, as DataTree.from_dict({'poincare': data})" if len(groups) == 1 else ""
        lines.append(f"there is no picture of {', '.join(silent)}{hint}")
    return panels, lines


def _groups(result: xr.DataTree | xr.Dataset) -> _Groups:
    """Datasets of the groups by name, each with attributes that say how it is drawn."""
    if isinstance(result, xr.Dataset):
        return {"the dataset": describe("", result)}
    axes = str(result.root.attrs.get("axes", ""))
    if not result.children:
        name = result.name or ""
        return {name or "the dataset": describe(name, result.to_dataset(), axes)} if result.has_data else {}
    return {name: describe(name, node.to_dataset(), axes) for name, node in result.children.items()}


def _panels(name: str, data: xr.Dataset, groups: _Groups, choice: Choice) -> tuple[list[Panel], list[str]]:
    """Panels of a group, and lines that say what is not drawn."""
    kind = PANELS.get(kind_of(data))
    if kind is None:
        stated = kind_of(data)
        return [], [f"{name} is not drawn: its panel, {stated}, is of no kind known here"] if stated else []
    if kind in (PANELS["branches"], PANELS["windows"]) and row_numbers(data):
        panels = list[Panel]()
        for number in row_numbers(data):
            row_groups = {key: in_row(group, number) for key, group in groups.items()}
            panels += _over_an_axis(name, row_groups[name], kind, row_groups, choice)[0]
        return panels, []
    panels_of = _of_lanes if kind.each == "lane" else _over_an_axis
    return panels_of(name, data, kind, groups, choice)


def _of_lanes(
    name: str, data: xr.Dataset, kind: Kind, groups: _Groups, choice: Choice
) -> tuple[list[Panel], list[str]]:
    """A panel a lane, or of some picked evenly; with colours one of all. None of points drawn over trajectories."""
    if kind is PANELS["points"] and any(same_plane(data, other) for other in _of_kind("trajectories", groups)):
        return [], []
    over = {}
    if kind is PANELS["trajectories"]:
        over["over"] = [other for other in _of_kind("points", groups) if same_plane(other, data)]
    if kind is PANELS["manifolds"]:
        over["over"] = [other for other in _of_kind("points", groups) if same_lanes(other, data)]
    count, axes = lane_count(data), axes_of(data)
    most = _MOST_TOGETHER if choice.colour else _MOST_LANES
    lanes = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    if choice.colour:
        colours = colouring(choice.colour, data, groups.values())
        panels = [
            Panel(_of_group(name)(partial(draw_lanes, data, colours=colours, lanes=lanes, **over)), _CHART_HEIGHT, True)
        ]
    else:
        panels = [Panel(partial(_draw, name, kind, data, lane=lane, **over), kind.height, False) for lane in lanes]
    points = "values" if len(axes) == 1 else "points"
    left_out = f"{len(lanes)} of the {count:,} {points} of {' and '.join(axes)} are drawn"
    return panels, [left_out] if count > len(lanes) else []


def _over_an_axis(
    name: str, data: xr.Dataset, kind: Kind, groups: _Groups, choice: Choice
) -> tuple[list[Panel], list[str]]:
    """A panel of the group, or one for each of a few points of the other axes; over two long axes a chart."""
    if kind is PANELS["shares"] and not axes_of(data):
        return [], []  # the attractors are drawn over their basins
    if kind is PANELS["marks"] and _of_kind("branches", groups):
        return [], []  # they are drawn over the branches
    if kind is PANELS["special_points"] and _of_kind("bifurcation_curves", groups):
        return [], []  # they are drawn on the curves
    if kind in (PANELS["bifurcation_curves"], PANELS["special_points"]):
        drawn = any(PANELS[kind_of(group)].over == "cascade" for group in groups.values() if _has_chart(group))
        return ([], []) if drawn else ([Panel(partial(_draw, name, kind, data), kind.height, True)], [])
    others = other_axes(data)
    count = math.prod(data.sizes[axis] for axis in others)
    if count > _most_points(kind):
        if _has_chart(data):
            assert kind.chart is not None
            over = _of_kind(kind.over, groups)
            over += _of_kind("bifurcation_curves", groups) if kind.over == "cascade" else []
            draw = _of_group(name)(partial(kind.chart, data, over=over))
            return [Panel(draw, _CHART_HEIGHT, True)], []
        if kind is PANELS["cascade"] and len(others) == 1 and any(map(_has_chart, groups.values())):
            return [], []  # it is drawn over the charts
        points = f"{count:,} points of {' and '.join(others)}"
        most = f"at most {_MOST_POINTS} get a panel each" if kind.each == "point" else "its panel shows one"
        return [], [f"{name} is not drawn: it has {points}, of which {most}"]
    panels = []
    for place in places_of(data, others):
        marks, selection = {}, at_place(data, place)
        if kind is PANELS["density"]:
            marks["cascades"] = [at_place(other, place) for other in _of_kind("cascade", groups)]
            marks["spans"] = _of_kind("windows", groups)
            if choice.colour:
                marks["colours"] = colouring(choice.colour, selection, [at_place(g, place) for g in groups.values()])
        if kind is PANELS["branches"]:
            marks = {"marks": _of_kind("marks", groups), "under": _of_kind("density", groups)}
        panels.append(Panel(partial(_draw, name, kind, selection, **marks), kind.height, True))
    return panels, []


def _most_points(kind: Kind) -> int:
    """Number of values of the axes beside the first that get a panel each."""
    return _MOST_POINTS if kind.each == "point" else 1


def _has_chart(data: xr.Dataset) -> bool:
    """Return whether a group is drawn over two axes at once."""
    kind = PANELS.get(kind_of(data))
    if kind is None or kind.chart is None:
        return False
    return len(long_axes(data)) == 2 and math.prod(data.sizes[axis] for axis in other_axes(data)) > _most_points(kind)


def _of_kind(kind: str, groups: _Groups) -> list[xr.Dataset]:
    return [data for data in groups.values() if kind_of(data) == kind]


def _draw(name: str, kind: Kind, data: xr.Dataset, ax: Axes, **options: object) -> Axes:
    with _of_group(name):
        ax = kind.draw(data, ax, **options)
        if row := data.attrs.get("row"):
            ax.text(0.99, 0.97, str(row), fontsize=8, transform=ax.transAxes, ha="right", va="top")
        return ax


@contextmanager
def _of_group(name: str) -> Iterator[None]:
    """Report an error inside as one of a group, in one sentence.

    Raises:
        ResultError: the group is not as it says.
    """
    try:
        yield
    except ResultError as error:
        raise ResultError(f"{name} cannot be drawn: {error}") from error


def _provenance(attrs: Mapping[str, object]) -> list[str]:
    """The origin of the numbers in one line; nothing for a dataset that does not say.

    Raises:
        ResultError: the attributes of a result are not all there.
    """
    if "jaxnh_version" not in attrs:
        return []
    try:
        version, solver, steps = attrs["jaxnh_version"], attrs["solver"], steps_in_words(attrs)
        error = error_in_words(attrs)
    except (KeyError, ValueError) as missing:
        raise ResultError(f"its attributes are not as jaxnh writes them: {missing}") from missing
    return [f"jaxnh {version}, {solver}, {steps}, {error}"]


def _of_level(attrs: Mapping[str, object], groups: _Groups) -> list[str]:
    """Return which level of a sweep it is, and what share of it was computed; nothing where there are no levels."""
    shares = [float(data["computed"].mean()) for data in groups.values() if "computed" in data.variables]
    if "levels" not in attrs or not shares:
        return []
    level = f"level {attrs['level']} of {attrs['levels']}"
    if shares[0] == 1.0:
        return [level]
    return [f"{level}, {100 * shares[0]:.3g} % of the points computed, the others filled from neighbours of their kind"]
