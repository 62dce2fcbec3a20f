"""Panels over two axes of a sweep, a pixel a lane: numbers about a level, whole numbers, and flags."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colorizer import ColorizingArtist
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize, TwoSlopeNorm
from matplotlib.patches import Patch

from jaxnh.exceptions import ResultError
from jaxnh.plotting.bifurcation_curves import draw_curves
from jaxnh.plotting.frame import cell_edges, legend_above, new_axes
from jaxnh.plotting.groups import axes_of, declared_axes, kind_of, label_of, long_axes, needed, shown
from jaxnh.plotting.labels import axis_label, symbol_of, title_of, words_of
from jaxnh.plotting.meanings import FAILED, NONE, meanings
from jaxnh.plotting.style import MANY

_PERIODS = (1, 2, 3, 4, 5, 6, 7, 8, 12, 16)  # with a colour each; the last stands for all from it on
_SPREAD = (0.5, 99.5)  # percentiles that the colours end at: a few pixels may lie far beyond


class Plane(NamedTuple):
    """A variable over two rising axes.

    Attributes:
        x, y: the axes, (n,) and (m,).
        values: (m, n), as an image has them.
        variable: with its words.
    """

    x: xr.DataArray
    y: xr.DataArray
    values: np.ndarray
    variable: xr.DataArray


def numbers_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """A number over two axes, its colours parted at zero; of several at each point, as exponents, the first.

    Where the group has two `panel_levels`, colours go from one to the other. A pixel without a number is black.

    Args:
        data: the variable (axis, axis) or (axis, axis, k); other axes have one point.
        over: groups of doublings along the first axis, and of curves of bifurcations, drawn over it.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax = new_axes(ax)
    plane = plane_of(data)
    levels = [float(level) for level in str(data.attrs.get("panel_levels", "0")).split()]
    finite = plane.values[np.isfinite(plane.values)]
    low, high = np.percentile(finite, _SPREAD) if finite.size else (0.0, 1.0)
    if len(levels) == 2:
        colours, norm = colormaps["cividis"], Normalize(levels[0], levels[1])
    else:
        at = levels[0]
        width = max(abs(at), abs(high - low), 1e-9) * 1e-3
        norm = TwoSlopeNorm(at, min(float(low), at - width), max(float(high), at + width))
        colours = colormaps["RdBu_r"]
    image = image_of(plane, plane.values, colours, norm, ax)
    symbol = symbol_of(str(plane.variable.name), "1") if plane.variable.ndim > 2 else ""
    label = axis_label(plane.variable, label_of(data) or words_of(plane.variable), symbol)
    ax.figure.colorbar(image, ax=ax, label=label, pad=0.01, fraction=0.04, extend="both")
    return _with_curves(over, plane, framed(data, plane, ax))


def integers_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Whole numbers, as periods are, over two axes: a colour each for small ones, grey where there is none.

    Args:
        data: one variable (axis, axis), 0 where there is no number; other axes have one point.
        over: as of `numbers_chart`.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax = new_axes(ax)
    plane = plane_of(data)
    n = np.asarray(plane.values, float)
    place = np.where(n > 0, np.searchsorted(_PERIODS, n, side="right"), 0)
    colours = ListedColormap([NONE, *MANY])
    edges = np.arange(len(_PERIODS) + 2) - 0.5
    image = image_of(plane, place, colours, BoundaryNorm(edges, colours.N), ax)
    names = ["none", *_range_names()]
    bar = ax.figure.colorbar(image, ax=ax, label=label_of(data) or words_of(plane.variable), pad=0.01, fraction=0.04)
    bar.set_ticks(list(range(len(names))), labels=names)
    bar.ax.minorticks_off()
    return _with_curves(over, plane, framed(data, plane, ax))


def flags_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Flags over two axes, with the share of the points that has each.

    Args:
        data: one variable (axis, axis) with `flag_values` and `flag_meanings`; other axes have one point.
        over: as of `numbers_chart`.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax = new_axes(ax)
    plane = plane_of(data)
    meaning = meanings(plane.variable)
    values = sorted(meaning)
    place = np.ma.masked_where(~np.isin(plane.values, values), np.searchsorted(values, plane.values))
    colours = ListedColormap([colour for _, colour in map(meaning.__getitem__, values)])
    image_of(plane, place, colours, Normalize(-0.5, len(values) - 0.5), ax)
    handles = [
        Patch(color=colour, label=f"{words}: {100 * np.mean(plane.values == value):.3g} %")
        for value, (words, colour) in meaning.items()
        if np.any(plane.values == value)
    ]
    legend_above(ax, handles)
    return _with_curves(over, plane, framed(data, plane, ax))


def plane_of(data: xr.Dataset) -> Plane:
    """The variable that the panel is of, over the two axes that have more than one point.

    Raises:
        ResultError: it is missing, or there are not two such axes.
    """
    variable = shown(data)[0]
    long = long_axes(data)
    if len(long) != 2:
        raise ResultError(f"a chart is over two axes, not over {' and '.join(long) or 'none'}")
    single = {name: 0 for name in axes_of(data) if name not in long}
    across, up = (data[name] for name in long)
    order = {name: np.argsort(data[name].to_numpy(), kind="stable") for name in long}
    values = variable.isel(single).isel(order).transpose(up.name, across.name, ...).to_numpy()
    whole = values.reshape(*values.shape[:2], -1)[..., 0]
    return Plane(across.isel({long[0]: order[long[0]]}), up.isel({long[1]: order[long[1]]}), whole, variable)


def image_of(plane: Plane, values: np.ndarray, colours: Colormap, norm: Normalize, ax: Axes) -> ColorizingArtist:
    """Values (m, n) of a plane, a pixel each; those that are not finite, or masked, are black."""
    colours = colours.with_extremes(bad=FAILED)
    masked = np.ma.masked_invalid(values) if np.issubdtype(values.dtype, np.floating) else values
    edges = (cell_edges(np.asarray(axis)) for axis in (plane.x, plane.y))
    return ax.pcolorfast(*edges, masked, cmap=colours, norm=norm)


def framed(data: xr.Dataset, plane: Plane, ax: Axes) -> Axes:
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
            if [variable.name for variable in shown(group)] == [plane.x.name, plane.y.name]:
                draw_curves(group, ax, background=True)
        else:
            _doublings(group, plane, ax)
    return ax


def _doublings(cascade: xr.Dataset, plane: Plane, ax: Axes) -> None:
    """Where the period doubles, a curve a level, of a cascade that lies along the axis across."""
    name, up = str(plane.x.name), str(plane.y.name)
    if name not in cascade.data_vars or up not in cascade.dims:
        return
    points, levels = needed(cascade, name)[0].transpose(up, ...), cascade[up].to_numpy()
    for column in points.to_numpy().reshape(len(levels), -1).T:
        ax.plot(column, levels, color="black", linewidth=0.7)


def _range_names() -> list[str]:
    """What the colours of whole numbers stand for."""
    names = []
    for first, following in zip(_PERIODS, (*_PERIODS[1:], None), strict=True):
        last = None if following is None else following - 1
        names.append(f"{first}" if last == first else f"≥ {first}" if last is None else f"{first} to {last}")
    return names
