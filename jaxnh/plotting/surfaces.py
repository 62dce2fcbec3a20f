"""Panels of manifolds of dimension two of one lane: triangles seen from outside, in parallel projection."""

from __future__ import annotations

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from jaxnh.exceptions import ResultError
from jaxnh.plotting.frame import new_axes
from jaxnh.plotting.groups import lane_of, require_variables, variables_of
from jaxnh.plotting.labels import is_angle, symbol_of, with_units
from jaxnh.plotting.planes import name_lane
from jaxnh.plotting.style import BLUE, LINE, VERMILION

_COLOURS = (VERMILION, BLUE)  # of unstable and stable ones
_AZIMUTH, _ELEVATION = np.deg2rad(-60.0), np.deg2rad(20.0)
_LIGHT = np.array([-0.4, 0.5, 0.77])  # to the right and up in the picture, and towards the eye
_SHADE, _STRIPE, _BANDS = 0.65, 0.12, 24


def surfaces(data: xr.Dataset, ax: Axes | None = None, *, lane: int = 0) -> Axes:
    """Surfaces of one lane over the three variables that the group names, in bands of equal arc length.

    Args:
        data: variables (axes, saddle, surface, point), with `arc_length`, `triangles` (axes, saddle, surface,
            triangle, corner) and `surface_kind` (axes, surface).
        lane: its number in C order of the axes.

    Raises:
        ResultError: the group does not name three variables that it has, or has no triangles.
    """
    ax = new_axes(ax)
    of_lane = lane_of(data, lane)
    shown = variables_of(of_lane)
    if len(shown) != 3:
        raise ResultError(f"a surface is drawn over three variables, not {len(shown)}")
    dims = "saddle", "surface"
    corners, arc, kinds = require_variables(of_lane, "triangles", "arc_length", "surface_kind")
    corners, arc = corners.transpose(*dims, ...).to_numpy(), arc.transpose(*dims, "point").to_numpy()
    points = np.stack([variable.transpose(*dims, "point").to_numpy() for variable in shown], axis=-1)
    for i in (i for i, variable in enumerate(shown) if is_angle(variable)):
        for s, k in np.ndindex(*corners.shape[:2]):
            points[s, k, :, i] = _unwrap(points[s, k, :, i], corners[s, k][corners[s, k][:, 0] >= 0])
    known = np.isfinite(points).all(axis=-1)
    low, high = (
        np.array([f(points[..., i][known]) if known.any() else float(k) for i in range(3)])
        for k, f in enumerate((np.min, np.max))
    )
    middle, half = 0.5 * (low + high), np.where(high > low, 0.5 * (high - low), 1.0)
    _draw_box(ax, shown, low, high)
    faces, colours, depths = [], [], []
    for s, k in np.ndindex(*corners.shape[:2]):
        own = corners[s, k][corners[s, k][:, 0] >= 0]
        if len(own):
            at = points[s, k][own]
            for i in (i for i, variable in enumerate(shown) if is_angle(variable)):
                at[..., i] = at[:, :1, i] + _turn(at[..., i] - at[:, :1, i])  # a surface may go around and close
            seen = _project((at - middle) / half)
            stripe = np.floor(_BANDS * arc[s, k][own].mean(axis=1) / np.nanmax(arc[s, k])) % 2
            faces.append(seen[:, :, :2])
            colours.append(_shaded(seen, _COLOURS[int(kinds.to_numpy().ravel()[k])], stripe))
            depths.append(seen[:, :, 2].mean(axis=1))
    if faces:
        order = np.argsort(np.concatenate(depths), kind="stable")  # what is nearer covers what is further
        face = np.concatenate(colours)[order]
        ax.add_collection(
            PolyCollection(
                list(np.concatenate(faces)[order]), facecolors=face, edgecolors=face, linewidths=0.2, rasterized=True
            )
        )
    ax.set_aspect("equal")
    ax.set_axis_off()
    return name_lane(data, lane, ax)


def _turn(angle: Float[np.ndarray, ...]) -> Float[np.ndarray, ...]:
    """Return angles from -pi to pi."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def _unwrap(
    angle: Float[np.ndarray, " points"], corners: Int[np.ndarray, "triangles 3"]
) -> Float[np.ndarray, " points"]:
    """Return angles of the points of a surface, each within half a turn of a neighbour's, from the first point on."""
    if not len(corners):
        return angle
    from scipy.sparse import coo_array  # takes a tenth of a second to import
    from scipy.sparse.csgraph import breadth_first_order

    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges = coo_array((np.ones(len(ends)), ends.T), (len(angle), len(angle)))
    order, before = breadth_first_order(edges, corners[0, 0], directed=False)
    angle = angle.copy()
    for point in order[1:]:
        angle[point] = angle[before[point]] + _turn(angle[point] - angle[before[point]])
    return angle


def _project(points: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """Return points to the right, up and towards the eye."""
    sin, cos, up, level = np.sin(_AZIMUTH), np.cos(_AZIMUTH), np.sin(_ELEVATION), np.cos(_ELEVATION)
    turn = np.array([[-sin, cos, 0.0], [-up * cos, -up * sin, level], [level * cos, level * sin, up]])
    return points @ turn.T


def _shaded(
    seen: Float[np.ndarray, "triangles 3 3"], colour: str, stripe: np.ndarray
) -> Float[np.ndarray, "triangles 3"]:
    """Return colours of triangles, darker where light comes from the side, and every other band a little paler."""
    normal = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    length = np.linalg.norm(normal, axis=1)
    light = np.abs(normal @ (_LIGHT / np.linalg.norm(_LIGHT))) / np.where(length > 0.0, length, 1.0)
    base = np.array(to_rgb(colour)) + (1.0 - np.array(to_rgb(colour))) * (0.25 + _STRIPE * 2 * stripe[:, None])
    return np.clip(base * (1.0 - _SHADE + _SHADE * light[:, None]), 0.0, 1.0)


def _draw_box(ax: Axes, shown: list[xr.DataArray], low: np.ndarray, high: np.ndarray) -> None:
    """Draw the edges of the box of the points, three of them with the coordinate and its range."""
    ends = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
    for a, end in enumerate(ends):
        for other in ends[a + 1 :]:
            if np.sum(end != other) == 1:
                line = _project(np.stack([end, other]))
                ax.plot(line[:, 0], line[:, 1], color=LINE, linewidth=0.5, zorder=0)
    edges = ([[-1, -1, -1], [1, -1, -1]], [[1, -1, -1], [1, 1, -1]], [[-1, -1, -1], [-1, -1, 1]])
    for i, (variable, edge) in enumerate(zip(shown, edges, strict=True)):
        name = with_units(symbol_of(str(variable.name).removesuffix("_points")), variable)
        middle = _project(np.array(edge, float)).mean(axis=0)[:2]
        shift, where = ((-3.0, 0.0), ("right", "center")) if i == 2 else ((0.0, -3.0), ("center", "top"))
        ax.annotate(
            f"{name}: {low[i]:.3g} to {high[i]:.3g}",
            middle,
            shift,
            textcoords="offset points",
            rotation=90.0 if i == 2 else np.rad2deg(_slope(edge)),
            rotation_mode="anchor" if i < 2 else "default",
            ha=where[0],
            va=where[1],
            fontsize=8,
        )


def _slope(edge: list[list[int]]) -> float:
    """Return the angle of an edge of the box in the picture, from left to right."""
    way = np.diff(_project(np.array(edge, float)), axis=0)[0]
    return float(np.arctan2(way[1], way[0]))
