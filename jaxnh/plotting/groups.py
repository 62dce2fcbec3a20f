"""Panels of groups (`descriptions`): the kind of panel, what it shows, and along which axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from jaxnh.exceptions import ResultError


def kind_of(data: xr.Dataset) -> str:
    """The kind of panel, a key of `PANELS`; "" where the group says nothing."""
    return str(data.attrs.get("panel", ""))


def variables_of(data: xr.Dataset) -> list[xr.DataArray]:
    """The variables that the panel is of.

    Raises:
        ResultError: none is named, or one is not there.
    """
    names = str(data.attrs.get("panel_variables", "")).split()
    if not names:
        raise ResultError("panel_variables names nothing to draw")
    return require_variables(data, *names)


def with_variables(data: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """The group as a panel of other variables of its own."""
    return data.assign_attrs(panel_variables=" ".join(names), panel_label="")


def require_variables(data: xr.Dataset, *names: str) -> list[xr.DataArray]:
    """Variables by name.

    Raises:
        ResultError: one is not there.
    """
    if missing := [name for name in names if name not in data]:
        raise ResultError(f"there is no variable {missing[0]}")
    return [data[name] for name in names]


def label_of(data: xr.Dataset) -> str:
    """The quantity of the panel in words; "" where these are the variable's own."""
    return str(data.attrs.get("panel_label", ""))


def levels_of(data: xr.Dataset) -> list[float]:
    """Levels to compare its numbers with: those of `panel_levels`, separated by blanks, or zero; "none": none."""
    words = str(data.attrs.get("panel_levels", "0")).split()
    return [] if words == ["none"] else [float(word) for word in words]


def label_of_first(data: xr.Dataset) -> str:
    """The first of the variables in words, where one alone is shown; "" as of `label_of`."""
    return label_of(data) if len(variables_of(data)) == 1 else ""


def declared_axes(data: xr.Dataset) -> tuple[str, ...]:
    """The axes of the sweep in their order, as the attribute `axes` has them; without it nothing."""
    return tuple(str(data.attrs.get("axes", "")).split())


def parameter_of(data: xr.Dataset) -> str:
    """The parameter that a group lies along: what it says, or the first axis.

    Raises:
        ResultError: it is no variable of the group.
    """
    name = str(data.attrs.get("along", "")) or next(iter(declared_axes(data)), "")
    require_variables(data, name or "of a parameter")
    return name


def axes_of(data: xr.Dataset) -> tuple[str, ...]:
    """Dimensions that are axes of the sweep; where nothing is declared, the leading one of what is shown.

    A trajectory, or points, of one lane that has been taken out of a group are over none.
    """
    first = variables_of(data)[0]
    if "axes" not in data.attrs:
        alone = first.ndim == 1 and kind_of(data) in ("trajectories", "points")
        return () if alone else tuple(map(str, first.dims[:1]))
    return tuple(name for name in declared_axes(data) if name in first.dims)


def long_axes(data: xr.Dataset) -> tuple[str, ...]:
    """Axes of more than one point, or where there are none the first."""
    axes = axes_of(data)
    return tuple(name for name in axes if data.sizes[name] > 1) or axes[:1]


def other_axes(data: xr.Dataset) -> tuple[str, ...]:
    """Axes of more than one point beside the one that a panel of the whole group is over.

    Where the first axis has become a variable, as in a cascade that lies along it, these are all that are left.
    """
    long, declared = long_axes(data), declared_axes(data)
    if declared and declared[0] in data.data_vars:
        return tuple(name for name in long if data.sizes[name] > 1)
    return long[1:]


def along_axis(data: xr.Dataset, variable: xr.DataArray) -> tuple[xr.DataArray, xr.DataArray]:
    """The coordinate (n,) of the one axis that a panel is over, and a variable (n, ...) along it.

    Raises:
        ResultError: there is no axis, or more than one has more than one point.
    """
    long = long_axes(data)
    if len(long) != 1:
        raise ResultError(f"a panel is over one axis, not over {' and '.join(long) or 'none'}")
    single = {name: 0 for name in axes_of(data) if name != long[0]}
    return data[long[0]], variable.isel(single).transpose(long[0], ...)


def fixed_axes(data: xr.Dataset, axis: str) -> tuple[str, ...]:
    """Axes beside the one of a panel, at one point each."""
    return tuple(name for name in declared_axes(data) if name != axis and name in data and data[name].size == 1)


def lane_count(data: xr.Dataset) -> int:
    """Number of lanes: points of the product of the axes."""
    return math.prod(data.sizes[name] for name in axes_of(data))


def lane_of(data: xr.Dataset, lane: int) -> xr.Dataset:
    """One lane, by its number in C order of the axes."""
    axes = axes_of(data)
    place = np.unravel_index(lane, [data.sizes[name] for name in axes])
    return data.isel({name: int(i) for name, i in zip(axes, place, strict=True)})


def places_of(data: xr.Dataset, axes: Sequence[str]) -> list[dict[str, int]]:
    """Every point of the product of some axes, as a place along each."""
    return [dict(zip(axes, place, strict=True)) for place in np.ndindex(*(data.sizes[name] for name in axes))]


def at_place(data: xr.Dataset, place: Mapping[str, int]) -> xr.Dataset:
    """The dataset at a place along some axes, which stay as coordinates without a dimension."""
    return data.isel({name: i for name, i in place.items() if name in data.dims})


def same_plane(points: xr.Dataset, trajectories: xr.Dataset) -> bool:
    """Return whether points are to be drawn over trajectories: of the same lanes, and in the same plane."""
    names = [[variable.name for variable in variables_of(each)] for each in (points, trajectories)]
    return "section" not in points.attrs and same_lanes(points, trajectories) and names[0] == names[1]


def same_lanes(first: xr.Dataset, second: xr.Dataset) -> bool:
    """Return whether two groups are of the same lanes."""
    axes = axes_of(first)
    return axes == axes_of(second) and all(first[name].equals(second[name]) for name in axes)


def row_numbers(data: xr.Dataset) -> list[int]:
    """Numbers of the rows of a plane that branches or windows were followed along; none of those over one axis."""
    return np.unique(data["row"].to_numpy()).tolist() if "row" in data.data_vars else []


def in_row(data: xr.Dataset, number: int) -> xr.Dataset:
    """The group with what is of one row alone; as it is where it has no rows.

    Branches keep their numbers, which bifurcations name: those of other rows have NaN in place of numbers.
    """
    if not row_numbers(data):
        return data
    rows, second = data["row"] == number, str(data.attrs.get("rows", ""))
    values = data[second].to_numpy()[rows.to_numpy()] if second in data else np.zeros(0)
    if "window" in rows.dims:
        chosen = data.isel(window=np.flatnonzero(rows.to_numpy())).drop_vars("row")
    else:
        numbers = [item for item in data.data_vars.values() if item.dtype.kind == "f" and rows.dims[0] in item.dims]
        chosen = data.drop_vars("row").assign({str(item.name): item.where(rows) for item in numbers})
    return chosen.assign_attrs({"row": f"{second} = {values[0]:g}"} if values.size else {})
