"""The axes that panels are drawn on: new ones, their labels and limits, and the colours that panels share."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.plotting.groups import fixed_axes
from jaxnh.plotting.labels import axis_label, title_of

WIDTH = 10.0  # inches, of the figure of a whole result
LINE, POINT, MARK = "#7f9cb8", "#b3261e", "#1c6e4a"
CURVES = ("#b3261e", "#3b6fb5", "#1c6e4a", "#e0a030", "#7a3b8f", "#6d4c41", "#e0447c", "#303030")


def new_axes(ax: Axes | None) -> Axes:
    """The axes given, or those of a new figure."""
    return Figure(figsize=(0.7 * WIDTH, 4.5), layout="constrained").subplots() if ax is None else ax


def over_axis(data: xr.Dataset, coordinate: xr.DataArray, ax: Axes, ylabel: str) -> Axes:
    """Label and limits of axes over an axis of the sweep: all panels of a file end at the same values.

    Where the sweep has other axes, the title says at which point of them this is; where there is a section, on which.
    """
    edges = cell_edges(np.unique(coordinate.to_numpy()))
    ax.set(xlabel=axis_label(coordinate), ylabel=ylabel, xlim=(edges[0], edges[-1]))
    # y: else it would stand above the colour bar of a density.
    ax.set_title(title_of(data, fixed_axes(data, str(coordinate.name))), fontsize=10, loc="left", y=1.0)
    return ax


def cell_edges(centres: np.ndarray) -> np.ndarray:
    """Edges (n + 1,) halfway between rising centres (n,), and as far beyond the first and the last."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    inner = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - inner[0]], inner, [2 * centres[-1] - inner[-1]]])
