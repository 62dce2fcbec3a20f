"""Groups of several results in one panel, as of a sweep up and one down: a colour a result, named above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxnh.exceptions import ResultError
from jaxnh.plotting.curves import curves_of
from jaxnh.plotting.density import scatter_points
from jaxnh.plotting.frame import legend_above, over_axis
from jaxnh.plotting.groups import along_axis, label_of, variables_of
from jaxnh.plotting.labels import axis_label
from jaxnh.plotting.style import CURVES

KINDS = ("density", "curves")
"""Kinds of panels that have several results in them."""

_DASHES = ("-", (0, (4, 2)), (0, (1, 1.5)), (0, (4, 1, 1, 1)))


def draw_overlay(kind: str, results: Mapping[str, xr.Dataset], ax: Axes) -> Axes:
    """The same group of several results over the same axis.

    Args:
        kind: of the panel, one of `KINDS`.
        results: datasets by the name that the legend gives them.

    Raises:
        ResultError: a variable is missing, or axes or variables differ.
    """
    names = [str(variable.name) for variable in variables_of(next(iter(results.values())))]
    over: list[str] = []
    ends: list[tuple[float, float]] = []
    for k, data in enumerate(results.values()):
        coordinate, first = along_axis(data, variables_of(data)[0])
        if [str(variable.name) for variable in variables_of(data)] != names:
            raise ResultError("results that are drawn together must show the same variables")
        over.append(str(coordinate.name))
        (_points if kind == "density" else _lines)(data, k, ax)
        over_axis(data, coordinate, ax, axis_label(first, label_of(data)))
        ends.append(ax.get_xlim())
    if len(set(over)) > 1:
        raise ResultError(f"results that are drawn together must be over the same axis, not over {', '.join(over)}")
    ax.set_xlim(min(low for low, _ in ends), max(high for _, high in ends))
    _legend(list(results), kind, ax)
    return ax


def _points(data: xr.Dataset, k: int, ax: Axes) -> None:
    coordinate, variable = along_axis(data, variables_of(data)[0])
    values = variable.to_numpy().reshape(coordinate.size, -1)
    at = np.repeat(coordinate.to_numpy(), values.shape[1])
    scatter_points(at, values.ravel(), CURVES[k % len(CURVES)], ax)


def _lines(data: xr.Dataset, k: int, ax: Axes) -> None:
    """Curves in the colour of the result; several of one result differ in their dashes."""
    drawn = [curve for variable in variables_of(data) for curve in curves_of(data, variable)]
    for j, curve in enumerate(drawn):
        ax.plot(curve.x, curve.y, color=CURVES[k % len(CURVES)], linestyle=_DASHES[j % len(_DASHES)])


def _legend(names: Sequence[str], kind: str, ax: Axes) -> None:
    marker, line = ("o", "") if kind == "density" else ("", "-")
    handles = [
        Line2D([], [], color=CURVES[k % len(CURVES)], label=name, marker=marker, linestyle=line)
        for k, name in enumerate(names)
    ]
    legend_above(ax, handles)
