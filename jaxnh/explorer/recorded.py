"""Views of a result file: what was computed is shown, nothing is computed. Needs no JAX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from jaxnh.exceptions import InputError, JaxnhError
from jaxnh.explorer.raster import raster, values_of
from jaxnh.explorer.source import LaneReport, Parameter, Picture
from jaxnh.explorer.view import View
from jaxnh.storage.hdf5 import open_result

_OF_A_LANE = ("portrait", "poincare", "period", "lyapunov", "chaos01", "verdict")


class Recorded:
    """The diagram of a result file; as `Source`."""

    computes = False
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, path: Path) -> None:
        """Read the file.

        Raises:
            InputError: there is no such file, or no diagram over one axis in it.
        """
        if not path.is_file():
            raise InputError(f"command line: RESULT: {path} is {'a folder' if path.is_dir() else 'not there'}")
        try:
            tree = open_result(path)
        except JaxnhError as error:
            raise InputError(f"command line: RESULT: {error}") from error
        if "diagram" not in tree.children:
            there = ", ".join(tree.children) or "nothing"
            raise InputError(f"command line: RESULT: {path} has {there}, and no diagram")
        self._groups = {name: node.to_dataset().load() for name, node in tree.children.items() if name in _OF_A_LANE}
        data = tree["diagram"].to_dataset().load()
        axes = [name for name in str(tree.attrs.get("axes", "")).split() if data.sizes.get(name, 1) > 1]
        if len(axes) != 1:
            raise InputError(f"command line: RESULT: the diagram of {path} has {len(axes)} axes; explore shows one")
        [axis] = axes
        others = [name for name in str(tree.attrs["axes"]).split() if name != axis]
        self._data = data.isel(dict.fromkeys([name for name in others if name in data.dims], 0)).sortby(axis)
        values = self._data[axis].to_numpy()
        self.title = str(tree.attrs.get("title") or path)
        self.axis_words = str(self._data[axis].attrs.get("long_name", axis))
        self.variables = {
            str(name).removesuffix("_state"): str(v.attrs.get("long_name", name))
            for name, v in self._data.data_vars.items()
            if v.dims[:1] == (axis,) and len(v.dims) > 1 and v.dtype.kind == "f"
        }
        named = str(self._data.attrs.get("panel_variables", "")).split()
        shown = next((name for name in named if name in self.variables), next(iter(self.variables)))
        self.first = View(
            axis, float(values.min()), float(values.max()), shown, columns=len(values), strobes=1, transient=1
        )
        self._note = f"from {path}: {len(values):,} values; nothing is computed here"

    def passes(self, view: View) -> Iterator[Picture]:
        """The part of the diagram that lies in a view."""
        axis, values = values_of(self._data, view.axis, view.variable)
        inside = np.flatnonzero((view.low <= axis) & (axis <= view.high))
        if not len(inside):
            inside = np.array([np.argmin(np.abs(axis - 0.5 * (view.low + view.high)))])
        some = raster(axis[inside], values[inside], view.window)
        data = self._data.isel({view.axis: inside})
        yield Picture(some, data, f"{len(inside):,} values", (self._note,))

    def lane(self, view: View, value: float) -> Iterator[LaneReport]:
        """What the file has of the lane that is nearest to a value."""
        nearest = float(self._data[view.axis].sel({view.axis: value}, method="nearest"))
        groups: Mapping[str, xr.Dataset] = {
            name: data.sel({view.axis: nearest}).squeeze()
            for name, data in self._groups.items()
            if view.axis in data.dims
        }
        yield LaneReport({view.axis: nearest}, groups, True)

    def batch_text(self, view: View) -> str:
        """There is none: the file has its own config."""
        return ""
