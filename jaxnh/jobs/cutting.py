"""Cutting of a sweep: pieces of work over its axes, and where their variables lie in the whole. No files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

_WORK = 2e6  # lane-periods a tile: up to ten seconds on one core, of the fastest maps half a second
_LARGE, _MANY = 4 * _WORK, 256  # likewise, where there are still so many tiles: each is a file
_FEWEST_TILES = 16  # on a graphics card, which does them in a fraction of a second: two for each of eight cards
_BYTES = 1 << 26  # of results a tile
_MOST_TILES = 1 << 14
_FEWEST_LANES = 16

Box = tuple[tuple[int, ...], tuple[int, ...]]
"""Begin and end of a piece along each axis."""


class Piece(NamedTuple):
    """A piece of work: its number, the analyses in it, and where along each axis it begins and ends, end excluded."""

    number: int
    names: tuple[str, ...]
    begin: tuple[int, ...]
    end: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(end - begin for begin, end in zip(self.begin, self.end, strict=True))

    @property
    def lanes(self) -> int:
        """Number of lanes."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Cutting:
    """Cutting of a sweep, or of a level of one, into pieces.

    Attributes:
        axes: of the sweep, in the order of results: name, size, and whether all lanes of a program share its value.
        tile: lanes a tile.
        order: names of the analyses in the order of the result.
        independent: those whose lanes know nothing of each other; the others are run along the whole first axis.
        shared_values: values of the axes that lanes share which a tile may have, where it has all lanes of these.
        wholes: groups that are made of all tiles together once these are there: name of the analysis, whose tiles have
            a group of that name as well, and then those that it brings.
        levels: from coarse to fine, that the sweep is computed in; each has a cutting of its own (`stages`).
        refine: which lanes a level adds, "all" or "boundary"; "" without levels.
        level: from 1; 0 of the whole.
        first: number of its first piece.
    """

    axes: tuple[tuple[str, int, bool], ...]
    tile: int
    order: tuple[str, ...]
    independent: tuple[str, ...]
    shared_values: int = 1
    wholes: tuple[tuple[str, ...], ...] = ()
    levels: int = 1
    refine: str = ""
    level: int = 0
    first: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(name for name, _, _ in self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the axes."""
        return tuple(size for _, size, _ in self.axes)

    @property
    def lanes(self) -> int:
        """Lanes of the whole sweep."""
        return math.prod(self.shape)

    @property
    def step(self) -> int:
        """Step along an axis of the sweep from one value of this level to the next."""
        return 2 ** (self.levels - self.level) if self.level else 1

    def stages(self) -> list[Cutting]:
        """Cuttings of the levels, one after the other, on every step-th value of each axis; without levels this one."""
        if self.levels == 1:
            return [self]
        stages: list[Cutting] = []
        for level in range(1, self.levels + 1):
            stage = replace(self, level=level, first=stages[-1].end if stages else 0)
            axes = tuple((name, -(-size // stage.step), shared) for name, size, shared in self.axes)
            stages.append(replace(stage, axes=axes))
        return stages

    @property
    def end(self) -> int:
        """Number after that of its last piece."""
        return self.first + len(self.pieces())

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of the result, in order: each analysis is followed by the groups that it brings."""
        brought = {names[0]: names for names in self.wholes}
        return tuple(group for name in self.order for group in brought.get(name, (name,)))

    def is_whole(self, piece: Piece) -> bool:
        """Return whether a piece is made of all tiles together."""
        return piece.names in self.wholes

    def sources(self, group: str) -> list[Piece]:
        """The pieces that make up a group of the result."""
        last = any(group in names for names in self.wholes)
        return [piece for piece in self.pieces() if group in piece.names and self.is_whole(piece) == last]

    def tiles_of(self, name: str) -> list[Piece]:
        """The tiles that have a group of an analysis."""
        return [piece for piece in self.pieces() if name in piece.names and not self.is_whole(piece)]

    def pieces(self) -> list[Piece]:
        """All pieces of work: the tiles, then each analysis that is not independent at each point of the other axes.

        Those that are made of all tiles come last.

        For each value of the axes that lanes share the others are cut into rectangles of at most `tile` lanes, or where
        all of them fit into one, so are those at up to `shared_values` of these values.
        """
        boxes = [(self.independent, box) for box in (self._tiles() if self.independent else ())]
        boxes += [((name,), box) for name in self.order if name not in self.independent for box in self._lines()]
        boxes += [(names, ((0,) * len(self.shape), self.shape)) for names in self.wholes]
        return [Piece(number, names, *box) for number, (names, box) in enumerate(boxes, self.first)]

    def _tiles(self) -> Iterator[Box]:
        own, shared = ([k for k, axis in enumerate(self.axes) if axis[2] == kind] for kind in (False, True))
        cut = dict(zip(own, tile_shape([self.shape[k] for k in own], self.tile), strict=True))
        whole = all(size == self.shape[k] for k, size in cut.items())
        values = min(self.shared_values, self.tile // max(1, math.prod(cut.values()))) if whole else 1
        cut |= dict(zip(shared, tile_shape([self.shape[k] for k in shared], max(1, values)), strict=True))
        for at in _corners(self.shape, cut, first=set(own)):
            yield at, tuple(min(b + cut[k], self.shape[k]) for k, b in enumerate(at))

    def _lines(self) -> Iterator[Box]:
        whole = self.shape[:1]
        for at in itertools.product(*(range(size) for size in self.shape[1:])):
            yield (0,) * len(whole) + at, whole + tuple(place + 1 for place in at)


def _corners(shape: Sequence[int], steps: Mapping[int, int], first: set[int]) -> Iterator[tuple[int, ...]]:
    """Corners of rectangles in C order, those of the axes `first` within each place of all others."""
    order = sorted(range(len(shape)), key=lambda k: k in first)
    for place in itertools.product(*(range(0, shape[k], steps[k]) for k in order)):
        at = dict(zip(order, place, strict=True))
        yield tuple(at[k] for k in range(len(shape)))


def tile_shape(sizes: Sequence[int], most: int) -> tuple[int, ...]:
    """Size of a tile along each axis: the last axes whole while they fit, one cut, those before it one by one."""
    shape, room = [], most
    for size in reversed(sizes):
        shape.append(max(1, min(size, room)))
        room = room // size if room >= size else 0
    return tuple(reversed(shape))


def tile_lanes(work: float, numbers: float, lanes: int, *, on_card: bool = False) -> int:
    """Lanes a tile, from config and kind of device: a power of two for some seconds of work and not too many bytes.

    Args:
        work: lane-periods a lane.
        numbers: numbers that a lane leaves.
        lanes: lanes of the sweep.
    """
    many = work * lanes / _FEWEST_TILES if on_card else min(_LARGE, work * lanes / _MANY)
    tile = max(_WORK, many, work * lanes / _MOST_TILES)
    wanted = min(tile / max(work, 1e-9), _BYTES / (8 * max(numbers, 1)), 1 << 20)
    return max(_FEWEST_LANES, 1 << (max(int(wanted), 1).bit_length() - 1))


def slab(dims: Sequence[str], piece: Piece, axes: Sequence[str]) -> tuple[slice, ...]:
    """Return where a piece's variable with these dimensions lies in that of the whole; other dimensions are whole.

    Args:
        axes: names of the axes, in the order of the piece.
    """
    places = dict(zip(axes, zip(piece.begin, piece.end, strict=True), strict=True))
    return tuple(slice(*places[dim]) if dim in places else slice(None) for dim in dims)


def share(cutting: Cutting, part: tuple[int, int], work: Mapping[int, float]) -> list[Piece]:
    """The pieces of part (k, n), k from 1; for n parts every piece in exactly one, but for those made of all tiles.

    What runs along the whole first axis goes in turn to the part that has least to do. The tiles then make the parts
    equal, as far as they can, and those of a part are neighbours.

    Args:
        work: of every piece, by its number, in any unit.
    """
    k, n = part
    pieces = [piece for piece in cutting.pieces() if not cutting.is_whole(piece)]
    loads, mine = [0.0] * n, list[Piece]()
    if not any(work[piece.number] for piece in pieces):  # start states alone
        work = {piece.number: piece.lanes for piece in pieces}
    lines = [piece for piece in pieces if piece.names != cutting.independent]
    for piece in sorted(lines, key=lambda piece: -work[piece.number]):
        least = loads.index(min(loads))
        loads[least] += work[piece.number]
        mine += [piece] if least == k - 1 else []
    tiles = [piece for piece in pieces if piece.names == cutting.independent]
    room = _rooms(loads, sum(work[piece.number] for piece in tiles))
    ends, done = list(itertools.accumulate(room)), 0.0
    for piece in tiles:
        middle = done + work[piece.number] / 2
        done += work[piece.number]
        if next((i for i, end in enumerate(ends) if middle < end), n - 1) == k - 1:
            mine.append(piece)
    return sorted(mine)


def _rooms(loads: Sequence[float], more: float) -> list[float]:
    """Return what to add to each load to make all as equal as possible: the lower ones are filled up to a level."""
    level = next(
        level
        for number in range(len(loads), 0, -1)
        if (level := (more + sum(sorted(loads)[:number])) / number) >= sorted(loads)[number - 1]
    )
    return [max(0.0, level - load) for load in loads]
