"""Panels of one lane in a plane: trajectories, and points of maps."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxnh.exceptions import ResultError
from jaxnh.plotting.colouring import Colouring
from jaxnh.plotting.frame import new_axes
from jaxnh.plotting.groups import axes_of, kind_of, lane_count, lane_of, variables_of
from jaxnh.plotting.labels import axis_label, title_of
from jaxnh.plotting.style import LINE, POINT, Colour

_DISTINCT = 256  # up to so many different points get large markers
_RESTS, _MARGIN = 1e-9, 0.05  # of the size of what is shown: a range of rounding, and what is shown on either side then
_LETTERS = "abcdefghijklmnopqrstuvwxyz"


def trajectories(data: xr.Dataset, ax: Axes | None = None, *, lane: int = 0, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Trajectory of one lane in the plane of the two variables that the group names.

    Args:
        data: variables (axes, time).
        lane: its number in C order of the axes.
        over: groups of points of the same lanes, to be drawn over it.

    Raises:
        ResultError: the group does not name two variables that it has.
    """
    ax = new_axes(ax)
    x, y = plane_coordinates(lane_of(data, lane))
    ax.plot(x.to_numpy().ravel(), y.to_numpy().ravel(), color=LINE, linewidth=0.4, zorder=1)
    for group in over:
        draw_points(lane_of(group, lane), ax)
    return finish_plane(data, lane, ax)


def points(data: xr.Dataset, ax: Axes | None = None, *, lane: int = 0) -> Axes:
    """Points of one lane in the plane of the two variables that the group names, as of a Poincaré map.

    Args:
        data: variables (axes, points).
        lane: its number in C order of the axes.

    Raises:
        ResultError: the group does not name two variables that it has.
    """
    ax = new_axes(ax)
    draw_points(lane_of(data, lane), ax)
    return finish_plane(data, lane, ax)


def draw_lanes(
    data: xr.Dataset,
    ax: Axes | None = None,
    *,
    colours: Colouring,
    lanes: Iterable[int],
    over: Iterable[xr.Dataset] = (),
) -> Axes:
    """Trajectories or points of several lanes in one plane, each lane in its colour.

    Args:
        data: variables (axes, points).
        colours: of the lanes.
        lanes: their numbers in C order of the axes.
        over: groups of points of the same lanes, to be drawn over trajectories.

    Raises:
        ResultError: the group does not name two variables that it has.
    """
    ax = new_axes(ax)
    axes = axes_of(data)
    for lane in lanes:
        place = dict(zip(axes, np.unravel_index(lane, [data.sizes[name] for name in axes]), strict=True))
        own = colours.values.isel({name: int(i) for name, i in place.items() if name in colours.values.dims})
        colour = colours.colour(float(own.to_numpy().ravel()[0]))
        if kind_of(data) == "trajectories":
            x, y = plane_coordinates(lane_of(data, lane))
            ax.plot(x.to_numpy().ravel(), y.to_numpy().ravel(), color=colour, linewidth=0.4, zorder=1)
        else:
            draw_points(lane_of(data, lane), ax, colour)
        for group in over:
            draw_points(lane_of(group, lane), ax, colour)
    x, y = plane_coordinates(data)
    ax.set(xlabel=axis_label(x), ylabel=axis_label(y))
    colours.explain(ax)
    widen(ax)
    return ax


def plane_coordinates(data: xr.Dataset) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the two variables that a plane is of.

    Raises:
        ResultError: the group does not name two that it has.
    """
    variables = variables_of(data)
    if len(variables) != 2:
        raise ResultError(f"a plane has two coordinates, and panel_variables names {len(variables)}")
    return variables[0], variables[1]


def draw_points(data: xr.Dataset, ax: Axes, colour: Colour = POINT) -> None:
    """Draw the points of one lane, large where few differ."""
    plane = np.column_stack([variable.to_numpy().ravel() for variable in plane_coordinates(data)])
    few = len(np.unique(plane.round(4), axis=0)) <= _DISTINCT
    ax.plot(*plane.T, "o", color=colour, markersize=3.5 if few else 1.0, markeredgewidth=0, zorder=2)


def finish_plane(data: xr.Dataset, lane: int, ax: Axes) -> Axes:
    """Label the axes of a panel of one lane, and name its values above."""
    x, y = plane_coordinates(data)
    ax.set(xlabel=axis_label(x), ylabel=axis_label(y))
    widen(ax)
    return name_lane(data, lane, ax)


def widen(ax: Axes) -> None:
    """Show no rounding: a coordinate that rests, as that of a section, has a range by the size of what is shown."""
    corners = np.nan_to_num(ax.dataLim.get_points(), posinf=0.0, neginf=0.0)
    size = float(np.max(np.abs(corners)))
    for (low, high), set_limits in ((ax.dataLim.intervalx, ax.set_xlim), (ax.dataLim.intervaly, ax.set_ylim)):
        if high - low <= _RESTS * size and size > 0.0:
            middle = 0.5 * (low + high)
            set_limits(middle - _MARGIN * size, middle + _MARGIN * size)


def name_lane(data: xr.Dataset, lane: int, ax: Axes) -> Axes:
    """Name the values of the axes that a lane has above its panel."""
    letter = f"({_LETTERS[lane]}) " if lane_count(data) <= len(_LETTERS) else ""
    ax.set_title(letter + title_of(lane_of(data, lane), axes_of(data)))
    return ax
