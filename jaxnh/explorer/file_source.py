"""Members common to all views of a result file: its title, its axes, and the facts of a lane. No JAX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from jaxnh.explorer.overlays import GROUPS
from jaxnh.explorer.source import LaneReport, Parameter, axis_title
from jaxnh.explorer.view import View

_OF_A_LANE = ("portrait", "poincare", "period", "lyapunov", "chaos01", "verdict", "rotation", "basins", "attractors")

Groups = Mapping[str, xr.Dataset]
"""Groups of a result by name, described (`plotting.descriptions`)."""

Attrs = Mapping[str, Any]
"""Attributes of the root of a result."""


class FileSource:
    """Members common to all sources of a file."""

    computes = False
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, groups: Groups, first: xr.Dataset, axes: tuple[str, ...], attrs: Attrs, name: str) -> None:
        self._groups = {key: groups[key] for key in _OF_A_LANE if key in groups}
        self.overlays = {key: groups[key] for key in GROUPS if key in groups}
        self._attrs, self.title = attrs, attrs["title"]
        self.system_text = str(attrs.get("system_file", ""))
        self.axis_words = {axis: words_with_units(first[axis]) for axis in axes}
        others = [
            axis for axis in str(first.attrs["axes"]).split() if axis not in axes and first.sizes.get(axis, 1) > 1
        ]
        at = "".join(f", at {axis} = {float(first[axis][0]):g}, the first of {first.sizes[axis]:,}" for axis in others)
        self._note = f"from {name}{at}; nothing is computed here"

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to values of the axes."""
        groups = {
            name: at_lanes(data, where).load()
            for name, data in self._groups.items()
            if set(where) <= set(data.dims) or name == "attractors"
        }
        yield LaneReport(where, groups, True)

    def batch_text(self, view: View) -> str:
        """The config that the file was made from; "" where it has none."""
        return str(self._attrs.get("config", ""))


def words_with_units(variable: xr.DataArray) -> str:
    """The name of a variable in words, with its units."""
    attrs = variable.attrs
    return axis_title(str(attrs.get("long_name", variable.name)), str(attrs.get("units", "")))


def at_lanes(data: xr.Dataset, where: Mapping[str, float], keep: tuple[str, ...] = ()) -> xr.Dataset:
    """A group at values of some axes, and at the first of those others that are not to be kept."""
    axes = [name for name in str(data.attrs["axes"]).split() if name in data.dims and name not in keep]
    return data.isel({name: _place(data, name, where[name]) if name in where else 0 for name in axes})


def _place(data: xr.Dataset, axis: str, value: float) -> int:
    return int(np.argmin(np.abs(data[axis].to_numpy() - value)))


def nearest_lane(data: xr.Dataset, where: Mapping[str, float]) -> dict[str, float]:
    """Values of axes that the file has."""
    return {name: float(data[name][_place(data, name, value)]) for name, value in where.items()}


def places_inside(values: np.ndarray, ends: tuple[float, float], least: int) -> np.ndarray:
    """Places of the rising or falling values in a range, at least so many about its middle."""
    inside = np.flatnonzero((ends[0] <= values) & (values <= ends[1]))
    if len(inside) >= least:
        return inside
    return np.sort(np.argsort(np.abs(values - 0.5 * (ends[0] + ends[1])), kind="stable")[:least])


def rises_or_falls(axis: xr.DataArray) -> bool:
    """Return whether the values of an axis are in order, one way or the other."""
    steps = np.diff(axis.to_numpy())
    return bool(np.all(steps > 0) or np.all(steps < 0))
