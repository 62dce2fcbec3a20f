"""Axes of a sweep to lanes, and datasets of lanes back to axes. Nothing is computed here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, variable
from jaxnh.analyses.scene import Axis
from jaxnh.engine.experiment import Experiment
from jaxnh.maps.rows import ROW
from jaxnh.maps.section import System
from jaxnh.storage.pieces import Piece
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State

_MOST_ROWS = 8  # values of shared axes that samples of a sweep are taken at


class SweepPoints(NamedTuple):
    """Lanes at points of a sweep.

    Attributes:
        system: the flow, on its section where it has no clock; that of the first row where there are several.
        start: start states, components (lanes,).
        p: parameters that lanes have of their own, by name, each (lanes,); of rows the lane's row as well (`ROW`).
        where: the value of every axis, by name, each (lanes,).
        flows: of rows, those at all values of the shared axes that lanes are at; else none.
    """

    system: System
    start: State
    p: Mapping[str, Float[np.ndarray, " lanes"]]
    where: Mapping[str, Float[np.ndarray, " lanes"]]
    flows: tuple[Flow, ...] = ()


def points(experiment: Experiment, axes: Sequence[Axis], places: Sequence[Int[np.ndarray, " lanes"]]) -> SweepPoints:
    """The lanes at places along each axis, one value of each shared axis for all of them."""
    where = {axis.name: axis.values[place] for axis, place in zip(axes, places, strict=True)}
    shared = {axis.name: float(where[axis.name][0]) for axis in axes if axis.kind == "shared"}
    own, begun = ({a.name: where[a.name] for a in axes if a.kind == kind} for kind in ("lane", "start"))
    return SweepPoints(experiment.dynamics(shared), experiment.start(begun, len(places[0]), shared, own), own, where)


def points_in_rows(
    experiment: Experiment, axes: Sequence[Axis], places: Sequence[Int[np.ndarray, " lanes"]]
) -> SweepPoints:
    """The lanes at places along each axis, a row for each point of the shared axes that some of them are at."""
    shared = [place for axis, place in zip(axes, places, strict=True) if axis.kind == "shared"]
    row = np.unique(np.stack(shared), axis=1, return_inverse=True)[1].ravel()
    of_row = [np.flatnonzero(row == k) for k in range(int(row.max()) + 1)]
    found = [points(experiment, axes, [place[some] for place in places]) for some in of_row]
    back = np.argsort(np.concatenate(of_row), kind="stable")

    def joined(*leaves: np.ndarray) -> np.ndarray:
        return np.concatenate(leaves)[back]

    start, p, where = jax.tree.map(joined, *((one.start, dict(one.p), dict(one.where)) for one in found))
    return SweepPoints(
        found[0].system, start, {**p, ROW: row.astype(np.int32)}, where, tuple(one.system.flow for one in found)
    )


def places_of(piece: Piece) -> tuple[Int[np.ndarray, " lanes"], ...]:
    """Places along each axis of the lanes of a piece, in C order."""
    ranges = [np.arange(begin, end) for begin, end in zip(piece.begin, piece.end, strict=True)]
    return tuple(grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij"))


def sampled(axes: Sequence[Axis], most: int | None) -> Iterator[tuple[Int[np.ndarray, " lanes"], ...]]:
    """Places of lanes that stand for a sweep, a row for each of some values of the shared axes, both ends among them.

    Args:
        most: lanes of all rows together, evenly along every axis; None for all lanes of the rows.
    """
    shared = [axis.kind == "shared" for axis in axes]
    rows = math.prod(_few(axes, shared, _MOST_ROWS, size=True))
    lanes = None if most is None else max(1, most // rows)
    chosen_rows = _few(axes, shared, _MOST_ROWS)
    chosen_lanes = _few(axes, [not s for s in shared], lanes)
    picked = [row if s else lane for row, lane, s in zip(chosen_rows, chosen_lanes, shared, strict=True)]
    every_row = [places for places, s in zip(picked, shared, strict=True) if s]
    grids = np.meshgrid(*every_row, indexing="ij") if every_row else []
    for k in range(math.prod(len(places) for places in every_row)):
        at = iter(grid.ravel()[k : k + 1] for grid in grids)
        ranges = [next(at) if s else places for places, s in zip(picked, shared, strict=True)]
        yield tuple(grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij"))


def _few(axes: Sequence[Axis], wanted: Sequence[bool], most: int | None, *, size: bool = False) -> list:
    """Places evenly along the axes wanted, both ends among them, and one along each other; or how many these are."""
    many = iter(_even([len(axis.values) for axis, want in zip(axes, wanted, strict=True) if want], most))
    found: list[np.ndarray] = []
    for axis, want in zip(axes, wanted, strict=True):
        places = np.linspace(0, len(axis.values) - 1, next(many)) if want else np.zeros(1)
        found.append(np.unique(places.round().astype(int)))
    return [len(places) for places in found] if size else found


def _even(sizes: Sequence[int], most: int | None) -> list[int]:
    """How many places to take along axes of these sizes: both ends, and beyond these no more than `most` in all.

    What a short axis does not need is left to the others.
    """
    found, left = list(sizes), most
    for rank, k in enumerate(sorted(range(len(sizes)), key=sizes.__getitem__) if left is not None else ()):
        assert left is not None
        each = int(left ** (1 / (len(sizes) - rank)) + 1e-9)
        found[k] = min(sizes[k], max(2, each))
        left = max(1, left // found[k])
    return found


# ---- back to axes


def on_axes(data: xr.Dataset, piece: Piece, axes: Sequence[Axis], *, line: bool) -> xr.Dataset:
    """A dataset of the lanes of a piece over the axes of the sweep, with their coordinates.

    A variable of the name of an axis that the dataset has is called NAME_state: states keep the names of coordinates,
    which may be axes as well.

    Args:
        line: whether the analysis has run along the whole first axis: its other variables then get the other axes, and
            those without dimensions are attributes where there are none.
    """
    names = [axis.name for axis in axes]
    others = tuple(names[1:]) if line else ()
    lane_dims, shared = tuple(names), tuple(axis.name for axis in axes if axis.kind == "shared")
    attrs, content = dict(data.attrs), {}
    for name, item in data.variables.items():
        dims, values = tuple(map(str, item.dims)), item.values
        if dims[:1] == (LANE,):
            content[name] = (lane_dims + dims[1:], values.reshape(*piece.shape, *values.shape[1:]), item.attrs)
        elif line and name not in data.coords and others:
            content[name] = (others + dims, values.reshape((1,) * len(others) + values.shape), item.attrs)
        elif line and not dims and not others:
            attrs[str(name)] = values.item()
        elif not line and name not in dims and shared:  # as times, which the clock decides
            rows = [size for size, axis in zip(piece.shape, axes, strict=True) if axis.kind == "shared"]
            content[name] = (shared + dims, np.broadcast_to(values, (*rows, *values.shape)), item.attrs)
        else:
            content[name] = (dims, values, item.attrs)
    met = [axis for axis in axes if any(axis.name in dims for dims, _, _ in content.values())]
    renamed = {axis.name: f"{axis.name}_state" for axis in met if axis.name in content}
    coordinates = {axis.name: _coordinate(axis, piece, names.index(axis.name)) for axis in met}
    found = xr.Dataset(coordinates | {renamed.get(str(name), name): v for name, v in content.items()}, attrs=attrs)
    for key in ("panel_variables",) if renamed else ():
        if key in found.attrs:
            found.attrs[key] = " ".join(renamed.get(word, word) for word in str(found.attrs[key]).split())
    return found


def whole_on_axes(data: xr.Dataset, axes: Sequence[Axis]) -> xr.Dataset:
    """A dataset of all lanes of a sweep over its axes, and of what is there once for some of them."""
    names, shape = tuple(axis.name for axis in axes), tuple(len(axis.values) for axis in axes)
    content = {
        name: (names + item.dims[1:], item.values.reshape(*shape, *item.shape[1:]), item.attrs)
        if item.dims[:1] == (LANE,)
        else (item.dims, item.values, item.attrs)
        for name, item in data.variables.items()
    }
    met = [axis for axis in axes if any(axis.name in dims for dims, _, _ in content.values())]
    return xr.Dataset(
        {a.name: variable(a.name, a.values, a.long_name, a.units) for a in met} | content, attrs=data.attrs
    )


def _coordinate(axis: Axis, piece: Piece, number: int) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
    return variable(axis.name, axis.values[piece.begin[number] : piece.end[number]], axis.long_name, axis.units)
