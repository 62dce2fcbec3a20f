"""Windows of periodic orbits as bars at the height of their period, from where they begin to where they end."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from jaxnh.plotting.branches import MARKS
from jaxnh.plotting.frame import legend_above, new_axes
from jaxnh.plotting.groups import parameter_of, require_variables
from jaxnh.plotting.labels import axis_label, with_units
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.spans import PALE, reaches
from jaxnh.plotting.style import BLUE

_INK = "#303030"
_HALF = 0.12  # of a factor of two in the period: bars reach as far to either side
_MARGIN = 0.5


def windows(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """A bar a window over the parameter: dark where orbits of its period attract, pale as far as it is known to go.

    Args:
        data: over windows `period`, `begin` and `end` with their kinds, `limit`, `crisis`, the `first` and `last` lane;
            and the ends of the range of the parameter, under its name.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    period, begin, end = require_variables(data, "period", "begin", "end")
    stable, whole = reaches(data)
    height = period.to_numpy().astype(float)
    for n, inner, outer in zip(height, stable, whole, strict=True):
        for (low, high), colour in ((outer, PALE), (inner, BLUE)):
            ax.fill_between([low, high], n * 2.0**-_HALF, n * 2.0**_HALF, color=colour, linewidth=0)
    handles: list[Artist] = [
        Patch(color=BLUE, label="orbits attract"),
        Patch(color=PALE, label="doubled orbits, bands"),
    ]
    for place in (begin, end):
        kinds = require_variables(data, f"{place.name}_kind")[0]
        for value, (words, _) in meanings(kinds).items():
            marked = (kinds.to_numpy() == value) & np.isfinite(place.to_numpy())
            if words in MARKS and np.any(marked):
                mark = {"marker": MARKS[words], "markersize": 3.5, "color": _INK, "linestyle": "none", "label": words}
                handles += ax.plot(place.to_numpy()[marked], height[marked], **mark)
    [crisis] = require_variables(data, "crisis")
    if np.any(known := np.isfinite(crisis.to_numpy())):
        mark = {"marker": "x", "markersize": 4.0, "color": _INK, "linestyle": "none", "label": "crisis"}
        handles += ax.plot(crisis.to_numpy()[known], height[known], **mark)
    ax.set_yscale("log", base=2)
    ticks = np.unique(height).astype(int).tolist() or [1]
    ax.set_yticks(ticks, list(map(str, ticks)))
    ax.set_yticks([], minor=True)
    ax.set_ylim(ticks[0] * 2.0**-_MARGIN, ticks[-1] * 2.0**_MARGIN)
    once = {str(handle.get_label()): handle for handle in handles}
    legend_above(ax, list(once.values()))
    [searched] = require_variables(data, parameter_of(data))
    ax.set(xlabel=axis_label(searched), ylabel=with_units("period of windows", period), xlim=searched.to_numpy())
    return ax
