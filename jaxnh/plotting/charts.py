"""Panels over two axes of a sweep, a pixel a lane: numbers about a level, whole numbers, and flags."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colorizer import ColorizingArtist
from matplotlib.patches import Patch

from jaxnh.plotting.bifurcation_curves import draw_curves
from jaxnh.plotting.frame import cell_edges, legend_above, new_axes
from jaxnh.plotting.groups import declared_axes, kind_of, label_of_first, require_variables, variables_of
from jaxnh.plotting.labels import axis_label, symbol_of, title_of, words_of
from jaxnh.plotting.pixels import Pixels, Plane, flag_pixels, integer_pixels, number_pixels


def numbers_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """A number over two axes (`pixels.number_pixels`) with a colour bar.

    Args:
        data: the variable (axis, axis) or (axis, axis, k); other axes have one point.
        over: groups of doublings along the first axis, and of curves of bifurcations, drawn over it.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax = new_axes(ax)
    pixels = number_pixels(data)
    image, variable = image_of(pixels, ax), pixels.plane.variable
    symbol = symbol_of(str(variable.name), "1") if variable.ndim > 2 else ""
    label = axis_label(variable, label_of_first(data) or words_of(variable), symbol)
    ax.figure.colorbar(image, ax=ax, label=label, pad=0.01, fraction=0.04, extend="both")
    return _with_curves(over, pixels.plane, label_frame(data, pixels.plane, ax))


def integers_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Whole numbers, as periods are, over two axes (`pixels.integer_pixels`) with a key to their colours.

    Args:
        data: one variable (axis, axis), 0 where there is no number; other axes have one point.
        over: as of `numbers_chart`.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax = new_axes(ax)
    pixels = integer_pixels(data)
    label = label_of_first(data) or words_of(pixels.plane.variable)
    bar = ax.figure.colorbar(image_of(pixels, ax), ax=ax, label=label, pad=0.01, fraction=0.04)
    names = [entry.words for entry in pixels.entries]
    bar.set_ticks(list(range(len(names))), labels=names)
    bar.ax.minorticks_off()
    return _with_curves(over, pixels.plane, label_frame(data, pixels.plane, ax))


def flags_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Flags over two axes (`pixels.flag_pixels`), with the share of the points that has each.

    Args:
        data: one variable (axis, axis) with `flag_values` and `flag_meanings`; other axes have one point.
        over: as of `numbers_chart`.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax = new_axes(ax)
    pixels = flag_pixels(data)
    image_of(pixels, ax)
    legend_above(ax, [Patch(color=entry.colour, label=entry.words) for entry in pixels.entries])
    return _with_curves(over, pixels.plane, label_frame(data, pixels.plane, ax))


def image_of(pixels: Pixels, ax: Axes) -> ColorizingArtist:
    """Pixels as an image over their axes."""
    edges = (cell_edges(np.asarray(axis)) for axis in (pixels.plane.x, pixels.plane.y))
    return ax.pcolorfast(*edges, pixels.places, cmap=pixels.colours, norm=pixels.norm)


def label_frame(data: xr.Dataset, plane: Plane, ax: Axes) -> Axes:
    """Labels and limits, and in the title the point of other axes that it is at."""
    across, up = (cell_edges(np.asarray(axis)) for axis in (plane.x, plane.y))
    ax.set(xlabel=axis_label(plane.x), ylabel=axis_label(plane.y), xlim=across[[0, -1]], ylim=up[[0, -1]])
    long = {plane.x.name, plane.y.name}
    fixed = [name for name in declared_axes(data) if name not in long and name in data and data[name].size == 1]
    ax.set_title(title_of(data, fixed), loc="left", y=1.0)
    return ax


def _with_curves(over: Iterable[xr.Dataset], plane: Plane, ax: Axes) -> Axes:
    for group in over:
        if kind_of(group) == "bifurcation_curves":
            if [variable.name for variable in variables_of(group)] == [plane.x.name, plane.y.name]:
                draw_curves(group, ax, background=True)
        else:
            _doublings(group, plane, ax)
    return ax


def _doublings(cascade: xr.Dataset, plane: Plane, ax: Axes) -> None:
    """Draw where the period doubles, a curve a level, of a cascade that lies along the axis across."""
    name, up = str(plane.x.name), str(plane.y.name)
    if name not in cascade.data_vars or up not in cascade.dims:
        return
    points, levels = require_variables(cascade, name)[0].transpose(up, ...), cascade[up].to_numpy()
    for column in points.to_numpy().reshape(len(levels), -1).T:
        ax.plot(column, levels, color="black", linewidth=0.7)
