"""Branches of periodic orbits, solid where they attract and dashed elsewhere, and their bifurcations as marks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from jaxnh.plotting.density import DensityImage
from jaxnh.plotting.frame import narrow, new_axes
from jaxnh.plotting.groups import along_axis, parameter_of, require_variables, variables_of
from jaxnh.plotting.labels import axis_label, is_symbol, symbol_of, words_of
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.style import CURVES

_INK = LinearSegmentedColormap.from_list("ink", ("#d4d4d4", "#808080"))
MARKS = {"fold": "s", "period doubling": "o", "neimark sacker": "^", "branch point": "D", "hopf": "v", "grazing": "P"}
"""The mark of a kind of bifurcation."""
_STYLES = ((1, "-"), (0, (0, (4, 2))), (2, ":"))  # of what attracts, does not, and is not known
_PERIODS = 8  # that the legend names, the shortest first


def branches(
    data: xr.Dataset, ax: Axes | None = None, *, marks: Iterable[xr.Dataset] = (), under: Iterable[xr.Dataset] = ()
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
    parameter, [drawn] = parameter_of(data), variables_of(data)
    stable, period = (variable.to_numpy() for variable in require_variables(data, "stable", "period"))
    undecided = bool(np.any(stable == 2))
    edges = [_draw_density(group, str(drawn.name).removesuffix("_points"), parameter, ax) for group in under]
    x, y = data[parameter].to_numpy(), drawn.transpose("branch", "point", "iterate").to_numpy()
    marks = list(marks)
    turns = _bifurcation_points(marks, parameter, len(x))
    every = np.unique(period).tolist()
    for k, n in enumerate(every):
        colour = CURVES[k % len(CURVES)]
        rows = np.flatnonzero(period == n)
        for kind, style in _STYLES[: 2 + undecided]:
            attracts = kind == 1
            orbits = [(b, i) for b in rows for i in range(max(n, 1))]
            lines = [_stretches(*_insert_turns(x[b], y[b, :, i], stable[b], turns[b]), kind) for b, i in orbits]
            if lines:
                points = np.concatenate(lines)
                words = f"period {n}" if n else "equilibria"
                label = words if attracts and k < _PERIODS else None
                ax.plot(*points.T, color=colour, linewidth=1.1 if attracts else 0.7, linestyle=style, label=label)
    for group in marks:
        bifurcations(group, ax)
    ends = np.concatenate([x[np.isfinite(x)], *edges])
    low, high = (ends.min(), ends.max()) if ends.size else (0.0, 1.0)
    ax.set(xlabel=axis_label(data[parameter]), ylabel=_label(drawn), xlim=(low, high))
    _add_legend(ax, undecided)
    return ax


def bifurcations(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """A coordinate of all points of orbits at bifurcations over the parameter, a mark a kind; open where subcritical.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    parameter, [drawn] = parameter_of(data), variables_of(data)
    kind, criticality = require_variables(data, "kind", "criticality")
    x, y = data[parameter].to_numpy(), drawn.transpose("bifurcation", "iterate").to_numpy()
    for value, (words, _) in meanings(kind).items():
        rows = np.flatnonzero(kind.to_numpy() == value)
        for sign, face in ((False, "#303030"), (True, "white")):
            chosen = rows[(criticality.to_numpy()[rows] < 0) == sign]
            if not len(chosen):
                continue
            ax.plot(
                np.repeat(x[chosen], y.shape[1]),
                y[chosen].ravel(),
                MARKS.get(words, "x"),
                color="#303030",
                markerfacecolor=face,
                markersize=3.5,
                markeredgewidth=0.6,
                zorder=4,
                label=f"{words}, subcritical" if sign else words,
            )
    ax.set(xlabel=axis_label(data[parameter]), ylabel=_label(drawn))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=7, frameon=False)
    return ax


def _draw_density(group: xr.Dataset, name: str, parameter: str, ax: Axes) -> np.ndarray:
    """Strobe points as a grey density, where they are of the same coordinate over the same axis; its edges."""
    if name not in group:
        return np.zeros(0)
    coordinate, points = along_axis(group, group[name])
    if coordinate.name != parameter:
        return np.zeros(0)
    axis = coordinate.to_numpy()
    return DensityImage(axis, points.to_numpy().reshape(len(axis), -1), _INK, ax).ends


def _label(drawn: xr.DataArray) -> str:
    """Label of the points of an orbit, the coordinate's name within the words as a symbol where it is one."""
    name = str(drawn.name).removesuffix("_points")
    words = words_of(drawn)
    return axis_label(drawn, words.replace(f" {name} ", f" {symbol_of(name)} ", 1) if is_symbol(name) else words)


def _add_legend(ax: Axes, undecided: bool) -> None:
    """The legend, beside the axes or in a column above them, and what the lines are."""
    words, said = (
        "solid: stable, dashed: unstable" + ", dotted: undecided" * undecided,
        bool(ax.get_legend_handles_labels()[0]),
    )
    if said and narrow(ax):
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 2}
        ax.legend(fontsize=7, frameon=False, title=words, title_fontsize=8, **place)
        return
    ax.set_title(words, fontsize=8, loc="left")
    if said:
        ax.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _bifurcation_points(
    marks: Iterable[xr.Dataset], parameter: str, count: int
) -> list[list[tuple[float, np.ndarray]]]:
    """Bifurcations on each branch: the parameter there, and the coordinate of the orbit's points."""
    turns: list[list[tuple[float, np.ndarray]]] = [[] for _ in range(count)]
    for group in marks:
        if parameter in group and "branch" in group:
            points = variables_of(group)[0].transpose("bifurcation", "iterate").to_numpy()
            for b, value, row in zip(group["branch"].to_numpy(), group[parameter].to_numpy(), points, strict=True):
                if 0 <= b < count:
                    turns[int(b)].append((float(value), row[np.isfinite(row)]))
    return turns


def _insert_turns(
    x: np.ndarray, y: np.ndarray, stable: np.ndarray, turns: Iterable[tuple[float, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A curve with its bifurcations inserted; whether points attract, and which are new."""
    finite = np.isfinite(x) & np.isfinite(y)
    whole = [float(np.ptp(values[finite])) or 1.0 if finite.any() else 1.0 for values in (x, y)]
    places, more = list[int](), list[tuple[float, float]]()
    for k in np.flatnonzero((stable[1:] != stable[:-1]) & finite[1:] & finite[:-1]):
        ends = np.array([[x[k], y[k]], [x[k + 1], y[k + 1]]]) / whole
        near = [(value, up) for value, row in turns for up in row]
        far = [float(np.linalg.norm(np.array(point) / whole - ends.mean(axis=0))) for point in near]
        if far and min(far) <= np.linalg.norm(ends[1] - ends[0]):
            places.append(int(k) + 1)
            more.append(near[int(np.argmin(far))])
    new = np.insert(np.zeros(len(x), bool), places, True)
    across, up = (np.insert(old, places, [point[k] for point in more]) for k, old in enumerate((x, y)))
    return across, up, np.insert(stable, places, 0), new


def _stretches(x: np.ndarray, y: np.ndarray, stable: np.ndarray, new: np.ndarray, kind: int) -> np.ndarray:
    """Points (some, 2) of a curve where it is of one kind, with gaps between stretches.

    A stretch ends at the bifurcation that has been put in, or where there is none at the next point beyond.
    """
    places = stretch_places((stable == kind) & ~new, new)
    points = np.column_stack([np.where(places, x, np.nan), np.where(places, y, np.nan)])
    return np.concatenate([points, np.full((1, 2), np.nan)])


def stretch_places(which: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Places of the points of a kind with those that their stretches end at: the next point, or a new one before."""
    places = which.copy()
    places[1:] |= which[:-1]
    places[:-1] |= which[1:] & new[:-1]
    return places
