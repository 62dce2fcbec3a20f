"""Planes of more lanes than the page has pixels: each pixel stands for a block of lanes, and no plane is read whole.

A view of few lanes is read as it lies in the file. One of more is taken from overviews (`overviews`), which are made
when they are first needed, a strip at a time; until then some of its lanes stand for all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxnh.explorer.file_source import Attrs, FileSource, Groups, at_lanes, nearest_lane, places_inside
from jaxnh.explorer.lane_blocks import LaneBlocks, Rule, lane_blocks, merge_blocks
from jaxnh.explorer.overviews import Overviews
from jaxnh.explorer.raster import MOST_CELLS, plane_raster
from jaxnh.explorer.source import LaneReport, Picture
from jaxnh.explorer.view import View
from jaxnh.plotting.frame import cell_edges
from jaxnh.plotting.groups import kind_of, label_of, variables_of, with_variables
from jaxnh.plotting.labels import words_of
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.panels import pixels_of
from jaxnh.plotting.pixels import plane_of

_AT_ONCE = 1 << 22  # lanes that a view is read of without overviews
_TOUCHED = 1 << 24  # lanes of the blocks of the file that these lie in
_SAMPLED = 128  # rows of a file that are read for a first look
CHAOS = "chaos"
"""The quantity that no group has: which share of the lanes is chaotic."""

_KINDS = ("chaotic", "hyperchaotic"), ("undecided", "failed")  # verdicts of chaos, and those that are none
_IN_WORDS = {
    "mean": "the mean of those that have a number",
    "majority": "the colour of the most, the paler the more others there are; shares in the key are of pixels",
}


class Quantity(NamedTuple):
    """A quantity of the lanes of a plane.

    Attributes:
        group: that it is read from.
        rule: of blocks of lanes.
        data: the group at the first place of all other axes, described; of the drawn variable the attributes count.
        values: of a part of that group, (across, up).
        chunks: lanes of a block of the file, across and up.
    """

    group: str
    rule: Rule
    data: xr.Dataset
    values: Callable[[xr.Dataset], xr.DataArray]
    chunks: tuple[int, int]


class TiledPlane(FileSource):
    """The planes of a large result file, a quantity each; as `PictureSource`."""

    def __init__(
        self, groups: Groups, planes: list[str], axes: tuple[str, str], attrs: Attrs, name: str, path: Path | None
    ) -> None:
        """Read the axes alone.

        Args:
            groups: of the result.
            planes: those that are shown.
            axes: across and up, each in order.
            attrs: of its root.
            name: what it is called.
            path: its file; None: it has none.
        """
        super().__init__(groups, groups[planes[0]], axes, attrs, name)
        data = {key: at_lanes(groups[key], {}, keep=axes) for key in planes}
        self._quantities = {key: _quantity(key, each, axes) for key, each in data.items()}
        self._quantities |= _chaos(self._quantities)
        self._others = {key: groups[key].load() for key in groups.keys() & {"attractors"}}
        self.variables = {
            key: label_of(each.data) or words_of(variables_of(each.data)[0]) for key, each in self._quantities.items()
        }
        self._values = {axis: data[planes[0]][axis].to_numpy() for axis in axes}
        self._axes = axes
        across, up = ((float(self._values[axis].min()), float(self._values[axis].max())) for axis in axes)
        self._shape = len(self._values[axes[0]]), len(self._values[axes[1]])
        self.first = View(axes[0], *across, planes[0], up, axes[1], columns=self._shape[0], rows=self._shape[1])
        levels = _level(max(self._shape))
        self._overviews = {
            key: Overviews(path, key, self._shape, each.rule, levels, lambda rows, key=key: self._read(key, rows, _ALL))
            for key, each in self._quantities.items()
        }

    def passes(self, view: View) -> Iterator[Picture]:
        """The part of a plane that lies in a view; where overviews are needed and not made, first some of its lanes."""
        places = [places_inside(self._values[axis], view.ranges[axis], 2) for axis in self._axes]
        across, up = (slice(int(each[0]), int(each[-1]) + 1) for each in places)
        overviews, as_it_is = self._overviews[view.variable], self._is_read_as_it_is(view.variable, across, up)
        if not as_it_is and not overviews.are_made:
            sample = self._sample(view.variable, across, up)
            while not overviews.are_made:
                yield sample._replace(words=f"{sample.words}; overviews are made once, {overviews.share:.0%}")
                overviews.make()
        yield self._picture(view.variable, across, up, as_it_is=as_it_is)

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The facts that the file has of the lane that is nearest to values of the axes."""
        return super().lane(view, nearest_lane(self._quantities[view.variable].data, where))

    # ---- how

    def _read(self, name: str, across: slice, up: slice) -> np.ndarray:
        """Lanes of a quantity, (across, up)."""
        quantity = self._quantities[name]
        part = quantity.data.isel({self._axes[0]: across, self._axes[1]: up})
        return quantity.values(part).transpose(*self._axes).to_numpy()

    def _is_read_as_it_is(self, name: str, across: slice, up: slice) -> bool:
        """Return whether a range is read lane by lane: every lane has a pixel, or it is little that is read."""
        sizes = across.stop - across.start, up.stop - up.start
        if not any(map(_level, sizes)):
            return True
        chunks = self._quantities[name].chunks
        touched = [
            (-(-part.stop // size) - part.start // size) * size for part, size in zip((across, up), chunks, strict=True)
        ]
        return sizes[0] * sizes[1] <= _AT_ONCE and touched[0] * touched[1] <= _TOUCHED

    def _picture(self, name: str, across: slice, up: slice, *, as_it_is: bool) -> Picture:
        """The picture of a range of lanes, by pixels of as many of them as it takes."""
        rule, sizes = self._quantities[name].rule, (across.stop - across.start, up.stop - up.start)
        levels = _level(sizes[0]), _level(sizes[1])
        if as_it_is:
            values = self._read(name, across, up)
            step, begins = (1 << levels[0], 1 << levels[1]), (across.start, up.start)
            blocks = lane_blocks(values, rule, [step])[0] if any(levels) else LaneBlocks(values, np.ones(values.shape))
        else:
            blocks, step, begins = self._blocks(name, across, up, levels)
        edges = [
            cell_edges(self._values[axis])[_starts(len(self._values[axis]), begin, size, count)]
            for axis, begin, size, count in zip(self._axes, begins, step, blocks.values.shape, strict=True)
        ]
        return self._drawn(name, blocks, edges, _words(sizes, step, blocks, rule), step)

    def _blocks(
        self, name: str, across: slice, up: slice, levels: tuple[int, int]
    ) -> tuple[LaneBlocks, tuple[int, int], tuple[int, int]]:
        """Blocks of overviews about a range, how many lanes they have either way, and where the first one begins."""
        level = max(min(levels), 1)
        while (across.stop - across.start) * (up.stop - up.start) >> 2 * level > _AT_ONCE:
            level += 1
        size, rule = 1 << level, self._quantities[name].rule
        begins = across.start // size * size, up.start // size * size
        counts = [-(-(part.stop - begin) // size) for part, begin in zip((across, up), begins, strict=True)]
        parts = [slice(begin // size, begin // size + count) for begin, count in zip(begins, counts, strict=True)]
        blocks = self._overviews[name].read(level, parts[0], parts[1])
        more = 1 << max(levels[0] - level, 0), 1 << max(levels[1] - level, 0)
        if max(more) > 1:
            lanes = [
                np.diff(_starts(every, begin, size, count))
                for every, begin, count in zip(self._shape, begins, counts, strict=True)
            ]
            blocks = merge_blocks(blocks, np.outer(*lanes), rule, more)
        return blocks, (more[0] * size, more[1] * size), begins

    def _drawn(
        self, name: str, blocks: LaneBlocks, edges: list[np.ndarray], words: str, step: tuple[int, int]
    ) -> Picture:
        quantity, many = self._quantities[name], max(step) > 1
        drawn = variables_of(quantity.data)[0]
        coordinates = {
            axis: (axis, 0.5 * (ends[1:] + ends[:-1]), quantity.data[axis].attrs)
            for axis, ends in zip(self._axes, edges, strict=True)
        }
        values = {str(drawn.name): (self._axes, blocks.values, drawn.attrs), "share": (self._axes, blocks.share)}
        data = xr.Dataset(values, coordinates, {**quantity.data.attrs, "axes": " ".join(self._axes)})
        groups = {**self._others, name: data}
        pixels = pixels_of(name, groups)
        share = plane_of(with_variables(data, ["share"])).values if many and quantity.rule == "majority" else None
        rising = tuple(ends if ends[0] < ends[-1] else ends[::-1] for ends in edges)
        notes = [f"a pixel stands for {step[0]} × {step[1]} lanes: {_IN_WORDS[quantity.rule]}"] if many else []
        shown = xr.DataTree.from_dict({"/": xr.Dataset(attrs=self._attrs), **groups})  # pyright: ignore[reportUnknownMemberType]
        return Picture(plane_raster(pixels, (rising[0], rising[1]), share), shown, words, (*notes, self._note), pixels)

    def _sample(self, name: str, across: slice, up: slice) -> Picture:
        """The picture of some lanes of a range, each for those about it."""
        sizes = across.stop - across.start, up.stop - up.start
        rows = across.start + (np.arange(min(_SAMPLED, sizes[0])) + 0.5) * sizes[0] / min(_SAMPLED, sizes[0])
        every = 1 << _level(sizes[1])
        middle = slice(up.start + every // 2, up.stop, every)
        values = np.concatenate([self._read(name, slice(int(row), int(row) + 1), up) for row in rows])
        values = values[:, every // 2 :: every]
        edges = [
            cell_edges(self._values[self._axes[0]][rows.astype(int)]),
            cell_edges(self._values[self._axes[1]][middle]),
        ]
        words = f"{values.shape[0]:,} × {values.shape[1]:,} of {sizes[0]:,} × {sizes[1]:,} lanes"
        picture = self._drawn(name, LaneBlocks(values, np.ones(values.shape)), edges, words, (1, 1))
        return picture._replace(data=None)


_ALL = slice(None)


def _level(lanes: int) -> int:
    """Return the level whose blocks are few enough for the pixels of the page."""
    level = 0
    while -(-lanes >> level) > MOST_CELLS:
        level += 1
    return level


def _starts(lanes: int, begin: int, size: int, count: int) -> np.ndarray:
    """Places of the first lanes of blocks, and of the end of the last one."""
    return np.minimum(begin + size * np.arange(count + 1), lanes)


def _words(sizes: tuple[int, int], step: tuple[int, int], blocks: LaneBlocks, rule: Rule) -> str:
    words = f"{sizes[0]:,} × {sizes[1]:,} lanes"
    if max(step) == 1:
        return words
    mixed = f"; {np.mean(blocks.share < 1):.0%} of the pixels are mixed" if rule == "majority" else ""
    return f"{words}, {step[0]} × {step[1]} a pixel{mixed}"


def _quantity(name: str, data: xr.Dataset, axes: tuple[str, str]) -> Quantity:
    """The quantity that the panel of a group is of."""
    variable = variables_of(data)[0]
    drawn, chunks = str(variable.name), tuple(variable.encoding.get("chunksizes") or ())
    own = dict(zip(variable.dims, chunks, strict=True)) if len(chunks) == variable.ndim else {}

    def values(part: xr.Dataset) -> xr.DataArray:
        item = part[drawn]
        return item.isel({dim: 0 for dim in item.dims if dim not in str(data.attrs["axes"]).split()})

    rule: Rule = "mean" if kind_of(data) == "curves" else "majority"
    return Quantity(name, rule, data, values, (own.get(axes[0], 1), own.get(axes[1], 1)))


def _chaos(known: Mapping[str, Quantity]) -> dict[str, Quantity]:
    """The share of chaotic lanes, of those with a verdict, or else by the largest exponent and its error."""
    if "verdict" in known:
        name, words_of_flags = "verdict", meanings(known["verdict"].data["kind"])
        flags = {word: flag for flag, (word, _) in words_of_flags.items()}

        def values(part: xr.Dataset) -> xr.DataArray:
            chaotic, without = (part["kind"].isin([flags[word] for word in words if word in flags]) for words in _KINDS)
            return chaotic.astype(float).where(~without)

    elif "lyapunov" in known and "exponents_error" in known["lyapunov"].data:
        name = "lyapunov"

        def values(part: xr.Dataset) -> xr.DataArray:
            largest, error = (part[key].isel(exponent=0) for key in ("exponents", "exponents_error"))
            return (largest > error).astype(float).where(np.isfinite(largest) & np.isfinite(error))

    else:
        return {}
    about = {
        "panel": "curves",
        "panel_variables": CHAOS,
        "panel_levels": "0 1",
        "panel_label": "share of chaotic lanes",
    }
    group = known[name].data.assign({CHAOS: xr.Variable((), np.nan, {"units": "1"})}).assign_attrs(about)
    return {CHAOS: Quantity(name, "mean", group, values, known[name].chunks)}
