"""Branches of tori: their rotation numbers over the parameter, solid where they attract and dashed elsewhere."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxnh.plotting.branches import MARKS, stretch_places
from jaxnh.plotting.frame import new_axes
from jaxnh.plotting.groups import parameter_of, require_variables, variables_of
from jaxnh.plotting.labels import axis_label
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.style import CURVES

_NAMED = 8  # branches that the legend names


def torus_branches(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Rotation numbers of all branches over the parameter, a colour a branch; a mark where they are born.

    Args:
        data: the parameter, the rotation number and `kind` over (torus_branch, torus_point), and the parameter where
            each is born.
        ax: axes to draw into, or new ones.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    parameter, [drawn] = parameter_of(data), variables_of(data)
    kind, born, period = require_variables(data, "kind", "birth", "period")
    attracting = next(value for value, (words, _) in meanings(kind).items() if words == "attracting")
    x, y, named = data[parameter].to_numpy(), drawn.to_numpy(), set[int]()
    for k, (n, birth) in enumerate(zip(period.to_numpy().tolist(), born.to_numpy(), strict=True)):
        colour, attracts = CURVES[k % len(CURVES)], kind.to_numpy()[k] == attracting
        known, none = np.isfinite(x[k]), np.zeros(len(x[k]), bool)
        for which, style, width in ((attracts, "-", 1.1), (known & ~attracts, (0, (4, 2)), 0.8)):
            places = stretch_places(which, none) & known
            if not places.any():
                continue
            label = f"of an orbit of period {n}" if k < _NAMED and k not in named else None
            named.add(k)
            line = np.where(places, x[k], np.nan), np.where(places, y[k], np.nan)
            ax.plot(*line, color=colour, linewidth=width, linestyle=style, label=label)
        if np.isfinite(birth) and len(y[k]):
            mark = MARKS["neimark sacker"]
            ax.plot([birth], [y[k, 0]], mark, color="#303030", markersize=3.5, markeredgewidth=0.6, zorder=4)
    ax.set(xlabel=axis_label(data[parameter]), ylabel=axis_label(drawn, "rotation number"))
    ax.set_title("solid: attracting, dashed: not; triangles: Neimark–Sacker", fontsize=8, loc="left")
    if len(x) > 1:
        ax.legend(fontsize=7, frameon=False)
    return ax
