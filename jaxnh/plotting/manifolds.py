"""Panels of the stable and unstable manifolds of one lane in a plane, over points of its attractor."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxnh.plotting.frame import new_axes
from jaxnh.plotting.groups import lane_of, require_variables
from jaxnh.plotting.labels import is_angle
from jaxnh.plotting.planes import draw_points, finish_plane, plane_coordinates
from jaxnh.plotting.style import BLACK, BLUE, LINE, VERMILION

_KINDS = (("unstable", VERMILION), ("stable", BLUE))


def manifolds(data: xr.Dataset, ax: Axes | None = None, *, lane: int = 0, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Branches of one lane in the plane of the two variables that the group names, and the saddles.

    Args:
        data: variables (axes, saddle, branch, point), and `branch_kind` (branch,).
        lane: its number in C order of the axes.
        over: groups of points of the same lanes, which are drawn below.

    Raises:
        ResultError: the group does not name two variables that it has, or has not the kinds of branches.
    """
    ax = new_axes(ax)
    for group in over:
        draw_points(lane_of(group, lane), ax, LINE)
    of_lane = lane_of(data, lane)
    plane = plane_coordinates(of_lane)
    x, y = (variable.transpose("branch", ..., "point").to_numpy() for variable in plane)
    (kinds,) = (variable.to_numpy() for variable in require_variables(of_lane, "branch_kind"))
    length = x.shape[-1]
    within = False
    for number, (word, colour) in enumerate(_KINDS):
        rows = [leaf[kinds == number].reshape(-1, length) for leaf in (x, y)]
        lines = [np.concatenate([leaf, np.full((len(leaf), 1), np.nan)], axis=1).ravel() for leaf in rows]
        seams = [np.abs(np.diff(line)) > np.pi for line, name in zip(lines, plane, strict=True) if is_angle(name)]
        if seams:  # a line ends on one side of the picture and goes on at the other
            lines = [np.insert(line, np.flatnonzero(np.any(seams, axis=0)) + 1, np.nan) for line in lines]
        if len(lines[0]):  # stable manifolds go far beyond the attractor
            ax.plot(*lines, color=colour, linewidth=0.5, label=word, zorder=3, scalex=not within, scaley=not within)
            within = word == "unstable" and bool(np.isfinite(lines[0]).any())
    ax.plot(x[..., 0].ravel(), y[..., 0].ravel(), "o", color=BLACK, markersize=3, zorder=4)
    ax.legend(loc="best")
    return finish_plane(data, lane, ax)
