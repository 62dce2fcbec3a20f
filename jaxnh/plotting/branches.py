"""Branches of periodic orbits, solid where they attract and dashed elsewhere, and their bifurcations as marks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm

from jaxnh.exceptions import ResultError
from jaxnh.plotting.density import column_shares
from jaxnh.plotting.frame import new_axes
from jaxnh.plotting.groups import along, declared_axes, needed, shown
from jaxnh.plotting.labels import axis_label
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.style import CURVES

_INK = LinearSegmentedColormap.from_list("ink", ("#d4d4d4", "#808080"))
MARKS = {"fold": "s", "period doubling": "o", "neimark sacker": "^", "branch point": "D", "hopf": "v"}
"""The mark of a kind of bifurcation."""
_PERIODS = 8  # that the legend names, the shortest first


def branches(
    data: xr.Dataset,
    ax: Axes | None = None,
    *,
    marks: Iterable[xr.Dataset] = (),
    under: Iterable[xr.Dataset] = (),
) -> Axes:
    """A coordinate of all points of orbits over the parameter, a colour a period.

    Args:
        data: the parameter (branch, point), `stable` and `period`, and the coordinate (branch, point, iterate).
        marks: groups of bifurcations, drawn on the branches.
        under: groups of strobe points over the same axis, drawn below them.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    parameter, [drawn] = _parameter(data), shown(data)
    stable, period = (variable.to_numpy() for variable in needed(data, "stable", "period"))
    edges = [_below(group, str(drawn.name).removesuffix("_points"), parameter, ax) for group in under]
    x, y = data[parameter].to_numpy(), drawn.transpose("branch", "point", "iterate").to_numpy()
    every = np.unique(period).tolist()
    for k, n in enumerate(every):
        colour = CURVES[k % len(CURVES)]
        here = np.flatnonzero(period == n)
        for attracts, style in ((True, "-"), (False, (0, (4, 2)))):
            lines = [_stretches(x[b], y[b, :, i], (stable[b] == 1) == attracts) for b in here for i in range(n)]
            if lines:
                points = np.concatenate(lines)
                words = f"period {n}" if n else "equilibria"
                label = words if attracts and k < _PERIODS else None
                ax.plot(*points.T, color=colour, linewidth=1.1 if attracts else 0.7, linestyle=style, label=label)
    for group in marks:
        bifurcations(group, ax)
    ends = np.concatenate([x[np.isfinite(x)], *edges])
    low, high = (ends.min(), ends.max()) if ends.size else (0.0, 1.0)
    ax.set(xlabel=axis_label(data[parameter]), ylabel=axis_label(drawn), xlim=(low, high))
    ax.set_title("solid: stable, dashed: unstable", fontsize=8, loc="left")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def bifurcations(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """A coordinate of all points of orbits at bifurcations over the parameter, a mark a kind; open where subcritical.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    parameter, [drawn] = _parameter(data), shown(data)
    kind, criticality = needed(data, "kind", "criticality")
    x, y = data[parameter].to_numpy(), drawn.transpose("bifurcation", "iterate").to_numpy()
    for value, (words, _) in meanings(kind).items():
        here = np.flatnonzero(kind.to_numpy() == value)
        for sign, face in ((False, "#303030"), (True, "white")):
            some = here[(criticality.to_numpy()[here] < 0) == sign]
            if not len(some):
                continue
            ax.plot(
                np.repeat(x[some], y.shape[1]),
                y[some].ravel(),
                MARKS.get(words, "x"),
                color="#303030",
                markerfacecolor=face,
                markersize=3.5,
                markeredgewidth=0.6,
                zorder=4,
                label=f"{words}, subcritical" if sign else words,
            )
    ax.set(xlabel=axis_label(data[parameter]), ylabel=axis_label(drawn))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=7, frameon=False)
    return ax


def _parameter(data: xr.Dataset) -> str:
    """The axis that branches are over: the first of the sweep, or what the group says."""
    name = str(data.attrs.get("along", "")) or next(iter(declared_axes(data)), "")
    if name not in data:
        raise ResultError(f"there is no variable {name or 'of a parameter'}")
    return name


def _below(group: xr.Dataset, name: str, parameter: str, ax: Axes) -> np.ndarray:
    """Strobe points as a grey density, where they are of the same coordinate over the same axis; its edges."""
    if name not in group:
        return np.zeros(0)
    coordinate, points = along(group, group[name])
    if coordinate.name != parameter:
        return np.zeros(0)
    axis = coordinate.to_numpy()
    across, up, share = column_shares(axis, points.to_numpy().reshape(len(axis), -1))
    norm = LogNorm(share[share > 0].min(initial=0.5), 1.0)
    ax.pcolorfast(across, up, np.ma.masked_equal(share.T, 0.0), cmap=_INK, norm=norm)
    return across[[0, -1]]


def _stretches(x: np.ndarray, y: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Points (some, 2) of a curve where it is of one kind, to the next point beyond, with gaps between stretches."""
    here = which.copy()
    here[1:] |= which[:-1]
    points = np.column_stack([np.where(here, x, np.nan), np.where(here, y, np.nan)])
    return np.concatenate([points, np.full((1, 2), np.nan)])
