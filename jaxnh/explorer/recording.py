"""Views of a result file; nothing is computed. No JAX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxnh.exceptions import InputError, JaxnhError, ResultError
from jaxnh.explorer.overlays import GROUPS
from jaxnh.explorer.raster import plane_raster, raster, values_of
from jaxnh.explorer.source import LaneReport, Parameter, Picture, PictureSource, axis_title
from jaxnh.explorer.view import View
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import label_of, variables_of
from jaxnh.plotting.labels import words_of
from jaxnh.plotting.panels import has_pixels, pixels_of
from jaxnh.storage.hdf5 import open_result

_OF_A_LANE = ("portrait", "poincare", "period", "lyapunov", "chaos01", "verdict", "basins", "attractors")

_Groups = Mapping[str, xr.Dataset]
_Attrs = Mapping[str, Any]


def open_recording(path: Path) -> PictureSource:
    """Open a result file as the source of its drawing.

    Raises:
        InputError: there is no such file, or neither a plane nor a diagram in it.
    """
    if not path.is_file():
        raise InputError(f"command line: RESULT: {path} is {'a folder' if path.is_dir() else 'not there'}")
    try:
        return source_of(open_result(path), str(path))
    except JaxnhError as error:
        raise InputError(f"command line: RESULT: {error}") from error


def source_of(tree: xr.DataTree, name: str) -> PictureSource:
    """The planes over the first two long axes of a result, or where there are none the diagram over the first.

    Args:
        name: what the result is called.

    Raises:
        ResultError: there is neither a plane nor a diagram in it.
    """
    names, groups = str(tree.attrs.get("axes", "")).split(), described(tree)
    sizes = {str(axis): size for data in groups.values() for axis, size in data.sizes.items()}
    long = [axis for axis in names if sizes.get(axis, 1) > 1]
    attrs = {**tree.attrs, "title": str(tree.attrs.get("title") or name)}
    planes = [key for key, data in groups.items() if len(long) > 1 and has_pixels(data)]
    planes = [key for key in planes if set(long[:2]) <= set(map(str, variables_of(groups[key])[0].dims))]
    if planes:
        return RecordedPlane(groups, planes, (long[0], long[1]), attrs, name)
    if "diagram" in groups and long:
        return RecordedDiagram(groups, long[0], attrs, name)
    there = ", ".join(groups) or "nothing"
    raise ResultError(f"{name} has {there}, and no diagram and no plane of two axes")


def described(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The groups of a result by name, each with attributes that say how it is drawn."""
    axes = str(tree.attrs.get("axes", ""))
    return {str(k): describe(str(k), node.to_dataset().assign_attrs(axes=axes)) for k, node in tree.children.items()}


class _Recording:
    """Members common to all sources of a file."""

    computes = False
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, groups: _Groups, first: xr.Dataset, axes: tuple[str, ...], attrs: _Attrs, name: str) -> None:
        self._groups = {key: groups[key] for key in _OF_A_LANE if key in groups}
        self.overlays = {key: groups[key] for key in GROUPS if key in groups}
        self._attrs, self.title = attrs, attrs["title"]
        self.axis_words = {axis: _words(first[axis]) for axis in axes}
        others = [
            axis for axis in str(first.attrs["axes"]).split() if axis not in axes and first.sizes.get(axis, 1) > 1
        ]
        at = "".join(f", at {axis} = {float(first[axis][0]):g}, the first of {first.sizes[axis]:,}" for axis in others)
        self._note = f"from {name}{at}; nothing is computed here"

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to values of the axes."""
        groups = {
            name: _at(data, where).load()
            for name, data in self._groups.items()
            if set(where) <= set(data.dims) or name == "attractors"
        }
        yield LaneReport(where, groups, True)

    def batch_text(self, view: View) -> str:
        """The config that the file was made from; "" where it has none."""
        return str(self._attrs.get("config", ""))


class RecordedDiagram(_Recording):
    """The diagram of a result file; as `PictureSource`."""

    def __init__(self, groups: _Groups, axis: str, attrs: _Attrs, name: str) -> None:
        """Read the diagram.

        Args:
            groups: of the result, `diagram` among them.
            attrs: of its root.
            name: what it is called.
        """
        super().__init__(groups, groups["diagram"], (axis,), attrs, name)
        self._data = _at(groups["diagram"], {}, keep=(axis,)).sortby(axis).load()
        values = self._data[axis].to_numpy()
        self.variables = {
            str(key): _words(v)
            for key, v in self._data.data_vars.items()
            if v.dims[:1] == (axis,) and len(v.dims) > 1 and v.dtype.kind == "f"
        }
        drawn = next(iter(self.variables))
        self.first = View(axis, float(values.min()), float(values.max()), drawn, columns=len(values))

    def passes(self, view: View) -> Iterator[Picture]:
        """The part of the diagram that lies in a view."""
        axis, values = values_of(self._data, view.axis, view.variable)
        inside = _inside(axis, (view.low, view.high), 1)
        cells = raster(axis[inside], values[inside], view.window)
        data = self._data.isel({view.axis: inside})
        yield Picture(cells, data, f"{len(inside):,} values", (self._note,))

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to a value of the axis."""
        return super().lane(view, _nearest(self._data, where))


class RecordedPlane(_Recording):
    """The planes of a result file, a quantity each; as `PictureSource`."""

    def __init__(self, groups: _Groups, planes: list[str], axes: tuple[str, str], attrs: _Attrs, name: str) -> None:
        """Read the planes.

        Args:
            groups: of the result.
            planes: those that are shown.
            attrs: of its root.
            name: what it is called.
        """
        super().__init__(groups, groups[planes[0]], axes, attrs, name)
        self._planes = {key: _at(groups[key], {}, keep=axes).sortby(list(axes)).load() for key in planes}
        self._others = {key: groups[key].load() for key in groups.keys() & {"attractors"}}
        self.variables = {key: label_of(data) or words_of(variables_of(data)[0]) for key, data in self._planes.items()}
        first = self._planes[planes[0]]
        across, up = ((float(first[axis].min()), float(first[axis].max())) for axis in axes)
        counts = first.sizes[axes[0]], first.sizes[axes[1]]
        self.first = View(axes[0], *across, planes[0], up, axes[1], columns=counts[0], rows=counts[1])

    def passes(self, view: View) -> Iterator[Picture]:
        """The part of a plane that lies in a view."""
        data = self._planes[view.variable]
        inside = {name: _inside(data[name].to_numpy(), ends, 2) for name, ends in view.ranges.items()}
        groups = {**self._others, view.variable: data.isel(inside)}
        pixels = pixels_of(view.variable, groups)
        words = " × ".join(f"{len(places):,}" for places in inside.values()) + " lanes"
        data = xr.DataTree.from_dict({"/": xr.Dataset(attrs=self._attrs), **groups})  # pyright: ignore[reportUnknownMemberType]
        yield Picture(plane_raster(pixels), data, words, (self._note,), pixels)

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to values of the axes."""
        return super().lane(view, _nearest(self._planes[view.variable], where))


def _words(variable: xr.DataArray) -> str:
    attrs = variable.attrs
    return axis_title(str(attrs.get("long_name", variable.name)), str(attrs.get("units", "")))


def _at(data: xr.Dataset, where: Mapping[str, float], keep: tuple[str, ...] = ()) -> xr.Dataset:
    """A group at values of some axes, and at the first of those others that are not to be kept."""
    axes = [name for name in str(data.attrs["axes"]).split() if name in data.dims and name not in keep]
    return data.isel({name: _place(data, name, where[name]) if name in where else 0 for name in axes})


def _place(data: xr.Dataset, axis: str, value: float) -> int:
    return int(np.argmin(np.abs(data[axis].to_numpy() - value)))


def _nearest(data: xr.Dataset, where: Mapping[str, float]) -> dict[str, float]:
    """Values of axes that the file has."""
    return {name: float(data[name][_place(data, name, value)]) for name, value in where.items()}


def _inside(values: np.ndarray, ends: tuple[float, float], least: int) -> np.ndarray:
    """Places of the rising values in a range, at least so many about its middle."""
    inside = np.flatnonzero((ends[0] <= values) & (values <= ends[1]))
    if len(inside) >= least:
        return inside
    return np.sort(np.argsort(np.abs(values - 0.5 * (ends[0] + ends[1])), kind="stable")[:least])
