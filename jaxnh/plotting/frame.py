"""The axes that panels are drawn on: new ones, their labels and limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.plotting.groups import fixed_axes
from jaxnh.plotting.labels import axis_label, title_of
from jaxnh.plotting.style import NARROW, PAGE


def new_axes(ax: Axes | None) -> Axes:
    """The axes given, or those of a new figure."""
    return Figure(figsize=(PAGE.width, 3.2), layout="constrained").subplots() if ax is None else ax


def narrow(ax: Axes) -> bool:
    """Return whether axes are in a figure as wide as a column."""
    figure = ax.get_figure(root=True)
    return figure is not None and figure.get_figwidth() < NARROW


def legend_above(ax: Axes, handles: Sequence[Artist], most: int = 4, *, centred: bool = False) -> None:
    """A legend above the axes, where it hides nothing, of so many columns at most, in a narrow figure half of them."""
    columns = max(1, most // 2) if narrow(ax) else most
    place, x = ("lower center", 0.5) if centred else ("lower right", 1.0)
    ax.legend(handles=list(handles), loc=place, bbox_to_anchor=(x, 1.0), ncols=min(len(handles), columns))


def over_axis(data: xr.Dataset, coordinate: xr.DataArray, ax: Axes, ylabel: str) -> Axes:
    """Label and limits of axes over an axis of the sweep: all panels of a file end at the same values.

    Where the sweep has other axes, the title says at which point of them this is; where there is a section, on which.
    """
    edges = cell_edges(np.unique(coordinate.to_numpy()))
    ax.set(xlabel=axis_label(coordinate), ylabel=ylabel, xlim=(edges[0], edges[-1]))
    if narrow(ax):
        ax.locator_params(axis="x", nbins=6)  # numbers of the axis stand apart
    # y: else it would stand above the colour bar of a density.
    ax.set_title(title_of(data, fixed_axes(data, str(coordinate.name))), loc="left", y=1.0)
    return ax


def cell_edges(centres: np.ndarray) -> np.ndarray:
    """Edges (n + 1,) halfway between rising centres (n,), and as far beyond the first and the last."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    inner = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - inner[0]], inner, [2 * centres[-1] - inner[-1]]])
