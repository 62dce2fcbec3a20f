"""Colours of lanes by start, attractor, kind of motion, or the value of an axis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D

from jaxnh.exceptions import ArgumentError
from jaxnh.plotting.frame import legend_above
from jaxnh.plotting.groups import axes_of, variables_of
from jaxnh.plotting.labels import axis_label, symbol_of
from jaxnh.plotting.meanings import NONE, meanings
from jaxnh.plotting.style import CURVES, MANY, Colour

START = "start"
"""Name of the colouring by the start state."""

_FEW, _MANY = 7, 10  # values with a colour each of the one palette, and of the other


class Colouring(NamedTuple):
    """The quantity that decides the colour of each point.

    Attributes:
        values: over some of the dimensions of what is drawn.
        words: for the legend or the colour bar.
        named: colour and words of each value; empty: values are numbers on a scale.
    """

    values: xr.DataArray
    words: str
    named: Mapping[float, tuple[str, str]]

    @property
    def scale(self) -> ScalarMappable:
        """Colours of numbers."""
        values = self.values.to_numpy().astype(float)  # of whole numbers, as starts are, there is no infinite one
        finite = values[np.isfinite(values)]
        return ScalarMappable(Normalize(finite.min(initial=np.inf), finite.max(initial=-np.inf)), colormaps["cividis"])

    def colour(self, value: float) -> Colour:
        """Colour of one value."""
        if self.named:
            return self.named.get(value, (NONE, ""))[0]
        red, green, blue, alpha = self.scale.to_rgba(np.array(value))
        return (red, green, blue, alpha) if np.isfinite(value) else NONE

    def explain(self, ax: Axes) -> None:
        """Add a legend above the axes or a colour bar beside them."""
        if not self.named:
            ax.figure.colorbar(self.scale, ax=ax, label=self.words, pad=0.01, fraction=0.04)
            return
        present = set(np.unique(self.values.to_numpy()).tolist())
        handles = [
            Line2D([], [], color=colour, marker="o", markersize=3, linestyle="", label=words)
            for value, (colour, words) in self.named.items()
            if value in present
        ]
        legend_above(ax, handles)


def colouring(name: str, data: xr.Dataset, groups: Iterable[xr.Dataset]) -> Colouring:
    """Resolve a colour by a name for a group: a dimension or an axis of it, or a variable of a lane in any group.

    Raises:
        ArgumentError: there is nothing of the name; the message lists the names.
    """
    variable = variables_of(data)[0]
    axes = set(axes_of(data))
    if name in data.coords and set(data[name].dims) <= set(variable.dims):
        return _colour_by(data[name], axis_label(data[name]))
    if name in variable.dims:
        return _colour_by(_numbers(variable, (name,), name), name)
    if name == START and axes:
        return _of_lanes(data)
    candidates = {str(key): item for group in groups for key, item in group.data_vars.items() if _of_a_lane(item, axes)}
    if name in candidates:
        return _colour_by(candidates[name], axis_label(candidates[name]))
    there = [START, *(str(dim) for dim in variable.dims if dim in axes), *candidates]
    raise ArgumentError("colour", f"nothing is called {name} to colour by; there are {', '.join(dict.fromkeys(there))}")


def _of_a_lane(variable: xr.DataArray, axes: set[str]) -> bool:
    """Return whether a variable is one number of each lane, or of each of some."""
    return bool(variable.dims) and set(map(str, variable.dims)) <= axes and variable.dtype.kind in "iuf"


def _of_lanes(data: xr.Dataset) -> Colouring:
    """Colouring of a group without a dimension of starts: every lane is a start, with its place as its name."""
    names = axes_of(data)
    numbers = _numbers(variables_of(data)[0], names, START)
    if numbers.size > _MANY:
        return Colouring(numbers, "number of the start", {})
    palette, named = _palette(numbers.size), {}
    for number in range(numbers.size):
        place = np.unravel_index(number, numbers.shape)
        at = (f"{symbol_of(axis)} = {float(data[axis][i]):.4g}" for axis, i in zip(names, place, strict=True))
        named[number] = palette[number], ", ".join(at)
    return Colouring(numbers, START, named)


def _numbers(variable: xr.DataArray, dims: tuple[str, ...], name: str) -> xr.DataArray:
    shape = [variable.sizes[dim] for dim in dims]
    return xr.DataArray(np.arange(np.prod(shape)).reshape(shape), dims=dims, name=name)


def _colour_by(values: xr.DataArray, words: str) -> Colouring:
    """Return the colouring by a variable: flags and few values by a colour each, others on a scale."""
    if "flag_meanings" in values.attrs and "valid_min" not in values.attrs:
        return Colouring(values, words, {value: (colour, said) for value, (said, colour) in meanings(values).items()})
    distinct = np.unique(values.to_numpy()[np.isfinite(values.to_numpy())]).tolist()
    counts = values.dtype.kind != "f"
    short, joined = (str(values.name), " ") if counts else (symbol_of(str(values.name)), " = ")
    words = short if counts else words
    if len(distinct) > _MANY:
        return Colouring(values, words, {})
    palette = _palette(len(distinct))
    named = {value: (palette[k], f"{short}{joined}{value:.6g}") for k, value in enumerate(distinct)}
    return Colouring(values, words, named)


def _palette(count: int) -> tuple[str, ...]:
    return CURVES if count <= _FEW else MANY
