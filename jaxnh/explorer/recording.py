"""Views of a result file; nothing is computed. No JAX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import xarray as xr

from jaxnh.exceptions import InputError, JaxnhError, ResultError
from jaxnh.explorer.blank_picture import BlankPicture, has_curves
from jaxnh.explorer.charts import with_charts
from jaxnh.explorer.file_source import (
    Attrs,
    FileSource,
    Groups,
    at_lanes,
    nearest_lane,
    places_inside,
    rises_or_falls,
    words_with_units,
)
from jaxnh.explorer.fixed_parameters import fixed_parameters
from jaxnh.explorer.overlays import ALONG_ONE
from jaxnh.explorer.raster import MOST_CELLS, plane_raster, raster, values_of
from jaxnh.explorer.source import LaneReport, Picture, PictureSource
from jaxnh.explorer.tiled_plane import TiledPlane
from jaxnh.explorer.view import View
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import label_of, variables_of
from jaxnh.plotting.labels import words_of
from jaxnh.plotting.panels import has_pixels, pixels_of
from jaxnh.storage.hdf5 import open_result


def open_recording(path: Path) -> PictureSource:
    """Open a result file as the source of its drawing.

    Raises:
        InputError: there is no such file, or neither a plane nor a diagram in it.
    """
    if not path.is_file():
        raise InputError(f"command line: RESULT: {path} is {'a folder' if path.is_dir() else 'not there'}")
    try:
        return source_of(open_result(path), str(path), path)
    except JaxnhError as error:
        raise InputError(f"command line: RESULT: {error}") from error


def source_of(tree: xr.DataTree, name: str, path: Path | None = None) -> PictureSource:
    """The planes over the first two long axes of a result, or where there are none the diagram over the first.

    Where there are only curves or branches, a white picture below these.

    Args:
        name: what the result is called.
        path: its file, beside which overviews of large planes are kept; None: they go with the program.

    Raises:
        ResultError: there is no plane, no diagram, no curves and no branches in it.
    """
    names, groups = str(tree.attrs.get("axes", "")).split(), with_charts(described(tree))
    sizes = {str(axis): size for data in groups.values() for axis, size in data.sizes.items()}
    long = [axis for axis in names if sizes.get(axis, 1) > 1]
    attrs = {**tree.attrs, "title": str(tree.attrs.get("title") or name)}
    planes = [key for key, data in groups.items() if len(long) > 1 and has_pixels(data)]
    planes = [key for key in planes if set(long[:2]) <= set(map(str, variables_of(groups[key])[0].dims))]
    if planes:
        axes = long[0], long[1]
        large = any(sizes[axis] > MOST_CELLS for axis in axes) and all(
            rises_or_falls(groups[planes[0]][a]) for a in axes
        )
        return (
            TiledPlane(groups, planes, axes, attrs, name, path)
            if large
            else RecordedPlane(groups, planes, axes, attrs, name)
        )
    if "diagram" in groups and long:
        return RecordedDiagram(groups, long[0], attrs, name)
    if has_curves(groups):
        return BlankPicture(groups, attrs, name)
    there = ", ".join(groups) or "nothing"
    raise ResultError(f"{name} has {there}, and no diagram and no plane of two axes")


def described(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The groups of a result by name, each with attributes that say how it is drawn.

    Those that lie along one parameter have the values of the other parameters as coordinates, to be laid over planes.
    """
    axes = str(tree.attrs.get("axes", ""))
    groups = {str(k): describe(str(k), node.to_dataset().assign_attrs(axes=axes)) for k, node in tree.children.items()}
    along = groups.keys() & set(ALONG_ONE)
    fixed = fixed_parameters(tree.attrs) if along else {}
    for name in along:
        others = {key: value for key, value in fixed.items() if key not in groups[name].variables}
        groups[name] = groups[name].assign_coords(others)
    return groups


class RecordedDiagram(FileSource):
    """The diagram of a result file; as `PictureSource`."""

    def __init__(self, groups: Groups, axis: str, attrs: Attrs, name: str) -> None:
        """Read the diagram.

        Args:
            groups: of the result, `diagram` among them.
            attrs: of its root.
            name: what it is called.
        """
        super().__init__(groups, groups["diagram"], (axis,), attrs, name)
        self._data = at_lanes(groups["diagram"], {}, keep=(axis,)).sortby(axis).load()
        values = self._data[axis].to_numpy()
        self.variables = {
            str(key): words_with_units(v)
            for key, v in self._data.data_vars.items()
            if v.dims[:1] == (axis,) and len(v.dims) > 1 and v.dtype.kind == "f"
        }
        drawn = next(iter(self.variables))
        self.first = View(axis, float(values.min()), float(values.max()), drawn, columns=len(values))

    def passes(self, view: View) -> Iterator[Picture]:
        """The part of the diagram that lies in a view."""
        axis, values = values_of(self._data, view.axis, view.variable)
        inside = places_inside(axis, (view.low, view.high), 1)
        cells = raster(axis[inside], values[inside], view.window)
        data = self._data.isel({view.axis: inside})
        yield Picture(cells, data, f"{len(inside):,} values", (self._note,))

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to a value of the axis."""
        return super().lane(view, nearest_lane(self._data, where))


class RecordedPlane(FileSource):
    """The planes of a result file, a quantity each; as `PictureSource`."""

    def __init__(self, groups: Groups, planes: list[str], axes: tuple[str, str], attrs: Attrs, name: str) -> None:
        """Read the planes.

        Args:
            groups: of the result.
            planes: those that are shown.
            attrs: of its root.
            name: what it is called.
        """
        super().__init__(groups, groups[planes[0]], axes, attrs, name)
        self._planes = {key: at_lanes(groups[key], {}, keep=axes).sortby(list(axes)).load() for key in planes}
        self._others = {key: groups[key].load() for key in groups.keys() & {"attractors"}}
        self.variables = {key: label_of(data) or words_of(variables_of(data)[0]) for key, data in self._planes.items()}
        first = self._planes[planes[0]]
        across, up = ((float(first[axis].min()), float(first[axis].max())) for axis in axes)
        counts = first.sizes[axes[0]], first.sizes[axes[1]]
        self.first = View(axes[0], *across, planes[0], up, axes[1], columns=counts[0], rows=counts[1])

    def passes(self, view: View) -> Iterator[Picture]:
        """The part of a plane that lies in a view."""
        data = self._planes[view.variable]
        inside = {name: places_inside(data[name].to_numpy(), ends, 2) for name, ends in view.ranges.items()}
        groups = {**self._others, view.variable: data.isel(inside)}
        pixels = pixels_of(view.variable, groups)
        words = " × ".join(f"{len(places):,}" for places in inside.values()) + " lanes"
        data = xr.DataTree.from_dict({"/": xr.Dataset(attrs=self._attrs), **groups})  # pyright: ignore[reportUnknownMemberType]
        yield Picture(plane_raster(pixels), data, words, (self._note,), pixels)

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to values of the axes."""
        return super().lane(view, nearest_lane(self._planes[view.variable], where))
