"""Values over one axis as a density: the share of a column's points in every cell, where they are too many to draw."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colorizer import ColorizingArtist
from matplotlib.colors import Colormap, ListedColormap, LogNorm
from matplotlib.image import PcolorImage

from jaxnh.exceptions import ResultError
from jaxnh.plotting.cascade import mark_doublings
from jaxnh.plotting.colouring import Colouring
from jaxnh.plotting.frame import cell_edges, narrow, new_axes, over_axis
from jaxnh.plotting.groups import along_axis, label_of, variables_of
from jaxnh.plotting.labels import axis_label
from jaxnh.plotting.spans import shade
from jaxnh.plotting.style import POINT, Colour

_MARKERS = 20_000  # up to so many points are drawn one by one
_FEW = 2000  # up to which they are large
_COLUMNS, _ROWS = 1200, 500  # at most; a little below the pixels that a panel gets

INK = ListedColormap(colormaps["magma_r"](np.linspace(0.22, 1.0, 24)))
"""Colours of shares, from few points to many; few steps print well, and files stay small."""


def density(
    data: xr.Dataset,
    ax: Axes | None = None,
    *,
    cascades: Iterable[xr.Dataset] = (),
    spans: Iterable[xr.Dataset] = (),
    colours: Colouring | None = None,
) -> Axes:
    """All values of a variable over one axis, as in a bifurcation diagram; a density unless the points are few.

    The colour is the share of a column's points that fall into a cell, on a logarithmic scale: an orbit of period n has
    n cells of 1/n each.

    Args:
        data: the variable (axis, ...); other axes have one point.
        cascades: groups of doublings; those along the same axis are marked.
        spans: groups of windows; those along the same axis are shaded.
        colours: of the points, which are then drawn one by one.

    Raises:
        ResultError: the variable is missing, or more than one axis has more than one point.
    """
    ax = new_axes(ax)
    drawn, *more = variables_of(data)
    if more:
        raise ResultError("a density is of one variable, and panel_variables names more")
    coordinate, drawn = along_axis(data, drawn)
    axis = coordinate.to_numpy()
    values = drawn.to_numpy().reshape(len(axis), -1)
    if colours is not None:
        _coloured(coordinate, drawn, colours, ax)
    elif values.size <= _MARKERS:
        scatter_points(np.repeat(axis, values.shape[1]), values.ravel(), POINT, ax)
    else:
        _key_to_colours(DensityImage(axis, values, INK, ax), ax)
    over_axis(data, coordinate, ax, axis_label(drawn, label_of(data)))
    for cascade in cascades:
        mark_doublings(cascade, ax, str(coordinate.name))
    for group in spans:
        shade(group, ax, str(coordinate.name))
    return ax


class DensityImage(PcolorImage):
    """Shares of the points of columns, with no more cells than pixels, so that none is left out where it is drawn.

    An orbit is one cell high. Where axes have fewer pixels than cells, it would vanish in every row that is skipped.
    """

    def __init__(self, axis: np.ndarray, values: np.ndarray, colours: Colormap, ax: Axes) -> None:
        """Add the image to its axes.

        Args:
            axis: (lanes,), in any order.
            values: (lanes, points).
        """
        self._points, self._cells = (axis, values), (_COLUMNS, _ROWS)
        across, up, share = column_shares(axis, values)
        norm = LogNorm(share[share > 0].min(initial=0.5), 1.0)
        super().__init__(ax, across, up, np.ma.masked_equal(share.T, 0.0), cmap=colours, norm=norm)
        self.ends = across[[0, -1]]
        ax.add_image(self)
        self.set_clip_path(ax.patch)
        self.set_extent((*across[[0, -1]], *up[[0, -1]]))

    def make_image(self, renderer: Any, magnification: float = 1.0, unsampled: bool = False) -> Any:
        """The image as matplotlib draws it, from as many cells as there are pixels at most."""
        box = self.axes.bbox
        cells = (
            max(1, min(_COLUMNS, int(magnification * box.width))),
            max(1, min(_ROWS, int(magnification * box.height))),
        )
        if cells != self._cells:
            self._cells = cells
            across, up, share = column_shares(*self._points, columns=cells[0], rows=cells[1])
            self.set_data(across, up, np.ma.masked_equal(share.T, 0.0))
        return super().make_image(renderer, magnification, unsampled)


def column_shares(
    axis: np.ndarray,
    values: np.ndarray,
    window: tuple[float, float] | None = None,
    rows: int = _ROWS,
    columns: int = _COLUMNS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Histogram over an axis and a variable, each column for the same number of neighbouring points of the axis.

    Args:
        axis: (lanes,), in any order.
        values: (lanes, points); what is not finite is left out.
        window: range of the values that is drawn, a share being one of all points; None: all of them.
        rows: cells of a column.
        columns: at most.

    Returns:
        Edges (columns + 1,) and (rows + 1,), and the share (columns, rows) of a column's points in each cell.
    """
    distinct, place = np.unique(axis, return_inverse=True)
    each = math.ceil(len(distinct) / columns)
    edges = cell_edges(distinct)
    across = np.append(edges[:-1:each], edges[-1])
    finite = np.isfinite(values)
    if window is None:
        low, high = (values[finite].min(), values[finite].max()) if finite.any() else (0.0, 1.0)
        margin = 0.02 * (high - low) or 0.5
        window = low - margin, high + margin
    up = np.linspace(*window, rows + 1)
    row = np.searchsorted(up, values[finite], side="right") - 1
    column = np.broadcast_to((place // each)[:, None], values.shape)[finite]
    count = len(across) - 1
    whole = np.bincount(column, minlength=count)
    inside = (row >= 0) & (row < rows)
    counts = np.bincount(column[inside] * rows + row[inside], minlength=count * rows).reshape(count, rows)
    return across, up, counts / np.maximum(whole[:, None], 1)


def _coloured(coordinate: xr.DataArray, drawn: xr.DataArray, colours: Colouring, ax: Axes) -> None:
    """Points one by one, each in its colour."""
    at, by = xr.broadcast(coordinate, colours.values, exclude=set(drawn.dims) - set(colours.values.dims))
    at, by = (item.broadcast_like(drawn).transpose(*drawn.dims).to_numpy().ravel() for item in (at, by))
    values = drawn.to_numpy().ravel()
    for value in np.unique(by[np.isfinite(by)]) if colours.named else ():
        scatter_points(at[by == value], values[by == value], colours.colour(value), ax, total=drawn.size)
    if not colours.named:
        ax.scatter(at, values, s=0.6, c=colours.scale.to_rgba(by), linewidths=0, rasterized=True)
    colours.explain(ax)


def scatter_points(x: np.ndarray, y: np.ndarray, colour: Colour, ax: Axes, *, total: int | None = None) -> None:
    """Points one by one, large where they are few and a pixel each where they are many; an image in vector files.

    Args:
        total: number of points of all colours, where these are some of them.
    """
    count = total or x.size
    size = 2.6 if count <= _FEW else 1.6
    ax.plot(x, y, "." if count <= _MARKERS else ",", color=colour, markersize=size, markeredgewidth=0, rasterized=True)


def _key_to_colours(image: ColorizingArtist, ax: Axes) -> None:
    """A small colour bar above the axes, which keeps their width."""
    bar = ax.figure.colorbar(image, cax=ax.inset_axes((0.7, 1.03, 0.3, 0.025)), orientation="horizontal")
    bar.ax.xaxis.set_ticks_position("top")
    bar.ax.tick_params(labelsize="small", pad=1, length=2)
    label = "share of points" if narrow(ax) else "share of the points of a column"
    ax.annotate(label, (0.69, 1.04), xycoords="axes fraction", ha="right", va="center", fontsize="small")
