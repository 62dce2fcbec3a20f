"""Axes of a sweep to lanes, and datasets of lanes back to axes. Nothing is computed here."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Entry, variable
from jaxnh.analyses.batch import Axis
from jaxnh.engine.experiment import Experiment
from jaxnh.jobs.assembly import CommonAttributes
from jaxnh.jobs.cutting import Piece
from jaxnh.maps.family import ParameterFamily
from jaxnh.maps.section import System
from jaxnh.systems.state import State

if TYPE_CHECKING:
    import xarray as xr  # imported where the first result is made: with pandas it takes a third of a second

_MOST_ROWS = 8  # values of shared axes that samples of a sweep are taken at


class SweepPoints(NamedTuple):
    """Lanes at points of a sweep.

    Attributes:
        system: the flow, on its section where it has no clock; that of the first lane where they differ.
        start: start states, components (lanes,).
        p: parameters of lanes, by name, each (lanes,): those of their own, and those of the family.
        where: the value of every axis, by name, each (lanes,).
        family: where lanes may be at several values of the shared axes, the system at each of these; else None.
    """

    system: System
    start: State
    p: Mapping[str, Float[np.ndarray, " lanes"]]
    where: Mapping[str, Float[np.ndarray, " lanes"]]
    family: ParameterFamily[System] | None = None


def points(experiment: Experiment, axes: Sequence[Axis], places: Sequence[Int[np.ndarray, " lanes"]]) -> SweepPoints:
    """The lanes at places along each axis, one value of each shared axis for all of them."""
    where = {axis.name: axis.values[place] for axis, place in zip(axes, places, strict=True)}
    shared = {axis.name: float(where[axis.name][0]) for axis in axes if axis.kind == "shared"}
    own, starts = ({a.name: where[a.name] for a in axes if a.kind == kind} for kind in ("lane", "start"))
    return SweepPoints(experiment.dynamics(shared), experiment.start(starts, len(places[0]), shared, own), own, where)


def points_together(
    experiment: Experiment, axes: Sequence[Axis], places: Sequence[Int[np.ndarray, " lanes"]]
) -> SweepPoints:
    """The lanes at places along each axis, at as many values of the shared axes as these have, as a family."""
    shared = [place for axis, place in zip(axes, places, strict=True) if axis.kind == "shared"]
    # A sort of numbers takes a twentieth of the time of one of columns.
    columns = shared[0] if len(shared) == 1 else np.stack(shared)
    group = np.unique(columns, axis=-1, return_inverse=True)[1].ravel()
    order = np.argsort(group, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(group))[:-1])
    parts = [points(experiment, axes, [place[lanes] for place in places]) for lanes in members]
    back = np.argsort(order, kind="stable")

    def joined(*leaves: np.ndarray) -> np.ndarray:
        return np.concatenate(leaves)[back]

    start, p, where = jax.tree.map(joined, *((part.start, dict(part.p), dict(part.where)) for part in parts))
    names = tuple(axis.name for axis in axes if axis.kind == "shared")
    systems = {tuple(float(part.where[name][0]) for name in names): part.system for part in parts}
    family = ParameterFamily(names, systems.__getitem__, tuple(systems))
    return SweepPoints(parts[0].system, start, {**p, **{name: where[name] for name in names}}, where, family)


def points_along(
    experiment: Experiment, axes: Sequence[Axis], places: Sequence[Int[np.ndarray, " lanes"]]
) -> SweepPoints:
    """The lanes at places along the first axis, which all lanes of a program share: a family of its values."""
    at, name = points(experiment, axes, places), axes[0].name
    others = {axis.name: float(at.where[axis.name][0]) for axis in axes[1:] if axis.kind == "shared"}
    family = ParameterFamily((name,), lambda values: experiment.dynamics({**others, name: values[0]}))
    return at._replace(p={**at.p, name: at.where[name]}, family=family)


def places_of(piece: Piece) -> tuple[Int[np.ndarray, " lanes"], ...]:
    """Places of the lanes of a piece along each axis, in C order."""
    ranges = [np.arange(begin, end) for begin, end in zip(piece.begin, piece.end, strict=True)]
    return tuple(grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij"))


def sample_places(axes: Sequence[Axis], most: int | None) -> Iterator[tuple[Int[np.ndarray, " lanes"], ...]]:
    """Places of lanes that stand for a sweep, a row for each of some values of the shared axes, both ends among them.

    Args:
        most: lanes of all rows together, evenly along every axis; None for all lanes of the rows.
    """
    shared = [axis.kind == "shared" for axis in axes]
    rows = math.prod(_even_places(axes, shared, _MOST_ROWS, size=True))
    lanes = None if most is None else max(1, most // rows)
    chosen_rows = _even_places(axes, shared, _MOST_ROWS)
    chosen_lanes = _even_places(axes, [not s for s in shared], lanes)
    picked = [row if s else lane for row, lane, s in zip(chosen_rows, chosen_lanes, shared, strict=True)]
    every_row = [places for places, s in zip(picked, shared, strict=True) if s]
    grids = np.meshgrid(*every_row, indexing="ij") if every_row else []
    for k in range(math.prod(len(places) for places in every_row)):
        at = iter(grid.ravel()[k : k + 1] for grid in grids)
        ranges = [next(at) if s else places for places, s in zip(picked, shared, strict=True)]
        yield tuple(grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij"))


def _even_places(axes: Sequence[Axis], wanted: Sequence[bool], most: int | None, *, size: bool = False) -> list:
    """Places evenly along the axes wanted, both ends among them, and one along each other; or how many these are."""
    many = iter(_even_counts([len(axis.values) for axis, want in zip(axes, wanted, strict=True) if want], most))
    columns: list[np.ndarray] = []
    for axis, want in zip(axes, wanted, strict=True):
        places = np.linspace(0, len(axis.values) - 1, next(many)) if want else np.zeros(1)
        columns.append(np.unique(places.round().astype(int)))
    return [len(places) for places in columns] if size else columns


def _even_counts(sizes: Sequence[int], most: int | None) -> list[int]:
    """Return how many places to take along axes of these sizes: both ends, and beyond these no more than `most` in all.

    What a short axis does not need is left to the others.
    """
    counts, left = list(sizes), most
    for rank, k in enumerate(sorted(range(len(sizes)), key=sizes.__getitem__) if left is not None else ()):
        assert left is not None
        each = int(left ** (1 / (len(sizes) - rank)) + 1e-9)
        counts[k] = min(sizes[k], max(2, each))
        left = max(1, left // counts[k])
    return counts


# ---- back to axes


def join_lanes(parts: Sequence[xr.Dataset], back: Int[np.ndarray, " lanes"]) -> xr.Dataset:
    """A dataset of lanes that were computed in parts.

    Args:
        parts: which agree in what has no lanes.
        back: place of every lane among those of all parts.
    """
    import xarray as xr

    common = CommonAttributes()
    for part in parts:
        common.add(part.attrs)
    content = {}
    for name, item in parts[0].variables.items():
        values = item.values
        if item.dims[:1] == (LANE,):
            values = np.concatenate([part.variables[name].values for part in parts])[back]
        content[name] = (item.dims, values, item.attrs)
    return xr.Dataset(content, attrs=common.attributes(())).set_coords([str(name) for name in parts[0].coords])


def to_axes(data: xr.Dataset, piece: Piece, axes: Sequence[Axis], *, line: bool) -> xr.Dataset:
    """A dataset of the lanes of a piece over the axes of the sweep, with their coordinates.

    Args:
        line: whether the analysis has run along the whole first axis: its other variables then get the other axes.
    """
    import xarray as xr

    lane_dims = tuple(axis.dim for axis in axes)
    others, shared = lane_dims[1:] if line else (), tuple(axis.dim for axis in axes if axis.kind == "shared")
    content = {}
    for name, item in data.variables.items():
        dims, values = tuple(map(str, item.dims)), item.values
        if dims[:1] == (LANE,):
            content[name] = (lane_dims + dims[1:], values.reshape(*piece.shape, *values.shape[1:]), item.attrs)
        elif line and name not in data.coords and others:
            content[name] = (others + dims, values.reshape((1,) * len(others) + values.shape), item.attrs)
        elif not line and name not in dims and shared:  # as times, which the clock decides
            rows = [size for size, axis in zip(piece.shape, axes, strict=True) if axis.kind == "shared"]
            content[name] = (shared + dims, np.broadcast_to(values, (*rows, *values.shape)), item.attrs)
        else:
            content[name] = (dims, values, item.attrs)
    cuts = (slice(begin, end) for begin, end in zip(piece.begin, piece.end, strict=True))
    return xr.Dataset(_coordinates(axes, cuts, content) | content, attrs=data.attrs)


def whole_to_axes(data: xr.Dataset, axes: Sequence[Axis]) -> xr.Dataset:
    """A dataset of all lanes of a sweep over its axes, and of what is there once for some of them."""
    import xarray as xr

    names, shape = tuple(axis.dim for axis in axes), tuple(len(axis.values) for axis in axes)
    content = {
        name: (names + item.dims[1:], item.values.reshape(*shape, *item.shape[1:]), item.attrs)
        if item.dims[:1] == (LANE,)
        else (item.dims, item.values, item.attrs)
        for name, item in data.variables.items()
    }
    return xr.Dataset(_coordinates(axes, itertools.repeat(slice(None)), content) | content, attrs=data.attrs)


def _coordinates(
    axes: Sequence[Axis], cuts: Iterable[slice], content: Mapping[Any, tuple[Any, ...]]
) -> dict[Any, Entry]:
    """The values, each cut, of the axes that any variable has."""
    return {
        axis.dim: variable(
            axis.dim,
            axis.values[cut],
            f"start value of {axis.long_name}" if axis.kind == "start" else axis.long_name,
            axis.units,
        )
        for axis, cut in zip(axes, cuts, strict=False)
        if any(axis.dim in dims for dims, _, _ in content.values())
    }
