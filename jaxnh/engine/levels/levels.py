"""A sweep from coarse to fine: which lanes a level adds, and the values at the places that it leaves out.

A level has every second value, along each axis, of the one after it. With `refine: boundary` it computes what lies
near a change of the kind of motion in the level before: a lane of that level is near one where any of its neighbours,
also across a corner, is of another kind, and a lane of this level where it or any of its neighbours is such a lane.
Rules tried on the full chart of exponents and periods over b and d at 256 x 256 (`configs/chart_b_d.yaml`), with 4
levels: this one computes 32 % of the lanes, and 0.09 % of the places are of another kind than in full. With the lanes
    at a change alone, and then again those at a new change, until there is none, it is 23 % and 0.4 %; with
    one more ring about the changes 39 % and less than 0.01 %. After this rule another round in the same level finds
    0.03 % of the places, and is not made. At 1024 x 1024 (`sweeps/timing/adaptive_charts.py`) 3 levels compute 23 % of
    the lanes, and 0.19 % are of another kind, 4 levels 20 % and 0.22 %.

Solver, steps and what analyses choose are those of the whole sweep: a lane has the same bits at whatever level it is
computed. Nothing is computed here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Int

from jaxnh.analyses.base import LANE, variable
from jaxnh.analyses.batch import Axis
from jaxnh.analyses.registry import ANALYSES
from jaxnh.jobs.arrays import DATA
from jaxnh.jobs.cutting import Cutting, Piece

if TYPE_CHECKING:
    import xarray as xr  # imported where the first result is made: with pandas it takes a third of a second

COMPUTED = "computed"
"""Variable of a group: which places were computed, at whatever level."""


@dataclass(frozen=True)
class Level:
    """A level of a sweep, before it is computed.

    Attributes:
        wanted: lanes that it computes, over its axes.
        known: those that are then computed, here or in a level before.
        coarser: groups of lanes of the level before over its axes, by analysis; empty for the first level.
    """

    wanted: Bool[np.ndarray, ...]
    known: Bool[np.ndarray, ...]
    coarser: Mapping[str, xr.Dataset]

    def wanted_in(self, piece: Piece) -> Bool[np.ndarray, " lanes"]:
        """Return which lanes of a piece are computed."""
        return self.wanted[_box(piece)].ravel()

    def share(self) -> float:
        """Share of the places that are computed."""
        return float(np.mean(self.known))


def axes_of(axes: Sequence[Axis], cutting: Cutting) -> tuple[Axis, ...]:
    """The axes of a sweep with the values that a level has."""
    return tuple(replace(axis, values=axis.values[:: cutting.step]) for axis in axes)


def level_of(cutting: Cutting, results: Mapping[str, xr.Dataset], coarser: Mapping[str, xr.Dataset]) -> Level | None:
    """Lanes that a level computes; None for a sweep without levels.

    Args:
        results: groups of the result of the level before, none for the first level.
        coarser: groups of its lanes, by analysis.
    """
    if not cutting.level:
        return None
    if cutting.level == 1:
        every = np.ones(cutting.shape, bool)
        return Level(every, every, {})
    before = coarser[cutting.independent[0]][COMPUTED].to_numpy().astype(bool)
    known = np.zeros(cutting.shape, bool)
    known[_every_second(cutting.shape)] = before
    if cutting.refine == "all":
        wanted = ~known
    else:
        seen = ((ANALYSES[name].classes, data) for name, data in results.items() if name in ANALYSES)
        kinds = [classes(data) for classes, data in seen if classes is not None]
        wanted = lanes_near_changes(kinds, cutting.shape) & ~known
    if any(_has_partial_axes(data, cutting.names) for data in coarser.values()):
        for piece in cutting.pieces():  # what the values of shared axes decide comes with a lane of each
            if piece.names == cutting.independent and not wanted[_box(piece)].any():
                wanted[piece.begin] = True
    return Level(wanted, known | wanted, coarser)


def lanes_near_changes(kinds: Iterable[Int[np.ndarray, ...]], shape: tuple[int, ...]) -> Bool[np.ndarray, ...]:
    """Return which lanes of a level of this shape lie near a change of any of these kinds in the level before.

    Args:
        kinds: over the axes, each with as many values as the level before has, and then any other dimensions.
    """
    near = np.zeros(shape, bool)
    coarse = near[_every_second(shape)]
    for kind in kinds:
        for values in np.moveaxis(kind.reshape(*coarse.shape, -1), -1, 0):
            coarse |= _reduce_neighbours(values, np.maximum) != _reduce_neighbours(values, np.minimum)
    return _reduce_neighbours(near, np.maximum)


def _every_second(shape: tuple[int, ...]) -> tuple[slice, ...]:
    return (slice(None, None, 2),) * len(shape)


def _reduce_neighbours(values: np.ndarray, pick: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """The largest or least of every value and its neighbours along all axes, those across a corner among them."""
    for k in range(values.ndim):
        wide = np.pad(values, [(1, 1) if k == axis else (0, 0) for axis in range(values.ndim)], mode="edge")
        count = values.shape[k]
        values = reduce(pick, (wide.take(np.arange(at, at + count), axis=k) for at in range(3)))
    return values


def _has_partial_axes(data: xr.Dataset, names: Sequence[str]) -> bool:
    """Return whether a variable has some of the axes, but not all."""
    met = [set(map(str, item.dims)) & set(names) for name, item in data.variables.items() if name not in names]
    return any(0 < len(axes) < len(names) for axes in met)


# ---- a piece of a level


def fill_level(level: Level, name: str, piece: Piece, axes: Sequence[Axis], computed: xr.Dataset | None) -> xr.Dataset:
    """The dataset of all lanes of a piece: those that were computed, and the others from the level before.

    Args:
        computed: of an analysis, the dataset of the lanes wanted, in their order; None where there are none.
    """
    mask = level.wanted_in(piece)
    if level.coarser:
        around = _from_coarser(level.coarser[name], piece, [axis.dim for axis in axes], ANALYSES[name].smooth)
        computed = around if computed is None else _insert_lanes(computed, mask, around)
    assert computed is not None
    words = "whether this place was computed; else it is filled from a neighbour on a coarser level"
    known = level.known[_box(piece)].ravel().astype(np.int8)
    return computed.assign({COMPUTED: variable(LANE, known, words, dtype="bool")})


def mark_computed(group: xr.Dataset, lanes: xr.Dataset) -> xr.Dataset:
    """Add to a group that is made of all lanes which of them were computed."""
    if not any(item.dims[:1] == (LANE,) for item in group.variables.values()):
        return group
    known = lanes[COMPUTED]
    return group.assign({COMPUTED: (LANE, known.to_numpy().ravel().astype(np.int8), {**known.attrs, "dtype": "bool"})})


def _insert_lanes(computed: xr.Dataset, mask: Bool[np.ndarray, " lanes"], around: xr.Dataset) -> xr.Dataset:
    """Insert computed lanes at their places among others."""
    import xarray as xr

    content = {}
    for name, item in computed.variables.items():
        values = item.values
        if item.dims[:1] == (LANE,):
            values = around.variables[name].values.astype(np.promote_types(around[name].dtype, values.dtype))
            values[mask] = item.values
        content[name] = (item.dims, values, item.attrs)
    return xr.Dataset(content, attrs=computed.attrs).set_coords([name for name in computed.coords if name in content])


def _from_coarser(data: xr.Dataset, piece: Piece, names: Sequence[str], smooth: Sequence[str]) -> xr.Dataset:
    """Numbers of the level before for the lanes of a piece: where it has a lane its own, else its lower neighbours'.

    Variables over some axes alone are left out.
    """
    import xarray as xr

    first = [begin // 2 for begin in piece.begin]
    part = {name: slice(low, end // 2 + 1) for name, low, end in zip(names, first, piece.end, strict=True)}
    places = [np.arange(*ends) for ends in zip(piece.begin, piece.end, strict=True)]
    content = {}
    for name, item in data.variables.items():
        dims = tuple(map(str, item.dims))
        if name == COMPUTED or (set(dims) & set(names) and dims[: len(names)] != tuple(names)) or name in names:
            continue
        attrs = {key: value for key, value in item.attrs.items() if key != DATA}
        if dims[: len(names)] == tuple(names):
            block = item.isel(part).values
            lower = [place // 2 - low for place, low in zip(places, first, strict=True)]
            values = block[np.ix_(*lower)]
            if name in smooth:
                values = _neighbour_means(block, values, lower, places)
            values = values.reshape(piece.lanes, *values.shape[len(names) :])
            content[str(name)] = ((LANE, *dims[len(names) :]), values, attrs)
        else:
            content[str(name)] = (dims, item.values, attrs)
    attrs = {key: value for key, value in data.attrs.items() if key not in ("warnings", "axes")}
    return xr.Dataset(content, attrs=attrs)


def _neighbour_means(
    block: np.ndarray, copied: np.ndarray, lower: Sequence[np.ndarray], places: Sequence[np.ndarray]
) -> np.ndarray:
    """Means of the neighbours on the coarser level, where all of these are finite; else as they were copied."""
    values = block
    for k, (low, place) in enumerate(zip(lower, places, strict=True)):
        upper = np.minimum(low + place % 2, block.shape[k] - 1)
        values = 0.5 * (values.take(low, axis=k) + values.take(upper, axis=k))
    return np.where(np.isfinite(values), values, copied)


def _box(piece: Piece) -> tuple[slice, ...]:
    return tuple(slice(*ends) for ends in zip(piece.begin, piece.end, strict=True))
