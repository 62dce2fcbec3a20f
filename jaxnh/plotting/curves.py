"""Panels of numbers over one axis: curves with their errors, whole numbers, and flags as a strip of colours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.patches import Patch

from jaxnh.exceptions import ResultError
from jaxnh.plotting.frame import cell_edges, legend_above, new_axes, over_axis
from jaxnh.plotting.groups import along_axis, label_of, levels_of, variables_of
from jaxnh.plotting.labels import axis_label, is_symbol, symbol_of, words_of
from jaxnh.plotting.meanings import NONE, meanings
from jaxnh.plotting.style import BLUE, CURVES

_FEW = 48  # curves over fewer points show them
_LONG = 30  # letters: a longer label of a low panel has its units in a second line


class CurveData(NamedTuple):
    """One curve (n,) over rising x (n,), its error (n,) or None with its meaning, and its name in the legend."""

    x: np.ndarray
    y: np.ndarray
    error: np.ndarray | None
    meaning: str
    label: str


def curves(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Curves over one axis, with a band where the variable NAME has its error as NAME_error.

    A line is drawn at each of the group's levels (`groups.levels_of`).

    Args:
        data: the variables (axis,) or (axis, k), of which each k is a curve; other axes have one point.

    Raises:
        ResultError: a variable is missing, or more than one axis has more than one point.
    """
    ax = new_axes(ax)
    variables = variables_of(data)
    for level in levels_of(data):
        ax.axhline(level, color="black", linewidth=0.6)
    drawn = [curve for variable in variables for curve in curves_of(data, variable)]
    drawn = [curve for curve in drawn if np.isfinite(curve.y).any()] or drawn[:1]
    bands: dict[str, Artist] = {}
    lines: list[Artist] = []
    for k, curve in enumerate(drawn):
        colour = CURVES[k % len(CURVES)]
        if curve.error is not None:
            low, high = curve.y - curve.error, curve.y + curve.error
            ax.fill_between(curve.x, low, high, color=colour, alpha=0.4, linewidth=0)
            key = colour if len(drawn) == 1 else "gray"
            bands[curve.meaning] = Patch(color=key, alpha=0.4, linewidth=0, label=curve.meaning)
        marker = "o" if len(curve.x) < _FEW else ""
        lines += ax.plot(curve.x, curve.y, color=colour, linewidth=0.5, marker=marker, markersize=2, label=curve.label)
    handles = [*(lines if len(lines) > 1 else []), *bands.values()]
    if handles:
        legend_above(ax, handles)
    coordinate, first = along_axis(data, variables[0])
    return over_axis(data, coordinate, ax, axis_label(first, label_of(data), _common_symbol(first)))


def integers(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Positive whole numbers, as periods are, over one axis on a logarithmic scale; points without one stand below.

    Args:
        data: one variable (axis,), 0 where there is no number; other axes have one point.

    Raises:
        ResultError: the variable is missing, or more than one axis has more than one point.
    """
    ax = new_axes(ax)
    coordinate, variable = _only(data)
    x, n = coordinate.to_numpy(), variable.to_numpy()
    none = 0.5
    ax.plot(x[n > 0], n[n > 0], ".", color=BLUE, markersize=2)
    without = x[n <= 0]
    ax.plot(without, np.full(without.shape, none), "|", color=NONE, markersize=3.5)
    ax.set_yscale("log", base=2)
    highest = max(int(n.max(initial=1)), 1)
    ticks = [2**k for k in range(highest.bit_length())]
    ax.set_yticks([none, *ticks], ["none", *map(str, ticks)])
    ax.set_ylim(none / 1.5, 1.5 * highest)
    label = axis_label(variable, label_of(data))
    return over_axis(data, coordinate, ax, label.replace(" (", "\n(") if len(label) > _LONG else label)


def flags(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Flags as a strip of colours along one axis, with the number of points of each.

    Args:
        data: one variable (axis,) with `flag_values` and `flag_meanings`; other axes have one point.

    Raises:
        ResultError: the variable is missing, or more than one axis has more than one point.
    """
    ax = new_axes(ax)
    coordinate, variable = _only(data)
    meaning = meanings(variable)
    kind = variable.to_numpy()
    values = sorted(meaning)
    colours = ListedColormap([colour for _, colour in map(meaning.__getitem__, values)])
    distinct, first = np.unique(coordinate.to_numpy(), return_index=True)
    place = np.ma.masked_where(~np.isin(kind, values), np.searchsorted(values, kind))
    norm = Normalize(-0.5, len(values) - 0.5)
    ax.pcolorfast(cell_edges(distinct), [0.0, 1.0], place[None, first], cmap=colours, norm=norm)
    handles: list[Artist] = [
        Patch(color=colour, label=f"{words}: {np.sum(kind == value):,}")
        for value, (words, colour) in meaning.items()
        if np.any(kind == value)
    ]
    legend_above(ax, handles, centred=True)
    ax.set_yticks([])
    return over_axis(data, coordinate, ax, label_of(data) or words_of(variable))


def _only(data: xr.Dataset) -> tuple[xr.DataArray, xr.DataArray]:
    """The axis (n,) and the one variable (n,) along it."""
    variable, *more = variables_of(data)
    coordinate, variable = along_axis(data, variable)
    if more or variable.ndim != 1:
        raise ResultError(f"panel_variables has to name one variable over {coordinate.name} alone")
    return coordinate, variable


def curves_of(data: xr.Dataset, variable: xr.DataArray) -> Iterator[CurveData]:
    """Curves of a variable over rising values of the axis."""
    coordinate, values = along_axis(data, variable)
    error = data.get(f"{variable.name}_error")
    order = np.argsort(coordinate.to_numpy(), kind="stable")
    columns = values.to_numpy()[order].reshape(len(order), -1)
    errors = None if error is None else along_axis(data, error)[1].to_numpy()[order].reshape(len(order), -1)
    meaning = "" if error is None else str(error.attrs.get("long_name", "error"))
    for k, label in enumerate(_curve_labels(values)):
        band = None if errors is None else errors[:, k]
        yield CurveData(coordinate.to_numpy()[order], columns[:, k], band, meaning, label)


def _curve_labels(values: xr.DataArray) -> list[str]:
    """Names in the legend of the curves of a variable (n,) or (n, k)."""
    name = str(values.name)
    if values.ndim > 1:
        return [symbol_of(name, index) for index in _indices(values)]
    return [symbol_of(name) if is_symbol(name) else words_of(values) or symbol_of(name)]


def _common_symbol(values: xr.DataArray) -> str:
    """Symbol of all curves of a variable with an index; "" for one without."""
    if values.ndim == 1:
        return ""
    indices = _indices(values)
    return symbol_of(str(values.name), indices[0] if len(indices) == 1 else "k")


def _indices(values: xr.DataArray) -> list[str]:
    """Numbers of the curves of a variable (n, k): the coordinate along k, or without one from 1."""
    dim = values.dims[1]
    return [str(i) for i in (values[dim].to_numpy() if dim in values.coords else range(1, values.shape[1] + 1))]
