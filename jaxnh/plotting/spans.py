"""Ranges of periodic windows along the axis, and their shade below strobe points."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxnh.plotting.groups import parameter_of, require_variables

PALE = "#b9cfe4"
"""Colour of a window beyond the doubling of its orbits."""


def shade(data: xr.Dataset, ax: Axes, axis: str) -> None:
    """Shade the windows of a group that are along an axis.

    Raises:
        ResultError: a variable is missing.
    """
    if parameter_of(data) == axis:
        for low, high in reaches(data)[1]:
            ax.axvspan(low, high, color=PALE, alpha=0.5, linewidth=0, zorder=0)


def reaches(data: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the ranges in which orbits attract, and of whole windows, each (window, 2); lanes stand for unknown ends.

    Raises:
        ResultError: a variable is missing.
    """
    names = "first", "last", "begin", "end", "limit", "crisis"
    first, last, begin, end, limit, crisis = (variable.to_numpy() for variable in require_variables(data, *names))

    def or_lane(value: np.ndarray, other: np.ndarray) -> np.ndarray:
        furthest = np.where(np.abs(other - first) > np.abs(other - last), first, last)
        return np.where(np.isfinite(value), value, np.where(np.isfinite(other), furthest, first))

    from_, to = or_lane(begin, end), or_lane(end, begin)
    to = np.where(np.isfinite(begin) | np.isfinite(end), to, last)
    stable = np.stack([np.minimum(from_, to), np.maximum(from_, to)], axis=-1)
    every = np.stack([first, last, from_, to, limit, crisis], axis=-1)
    return stable, np.stack([np.nanmin(every, axis=-1), np.nanmax(every, axis=-1)], axis=-1)
