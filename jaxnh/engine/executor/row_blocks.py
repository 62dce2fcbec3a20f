"""Lanes of several rows (`maps.rows`) in one program: blocks of lanes of one row, so many of them in a tile.

Inside a block all lanes share a table, so that the loop over them is vector code; blocks of eight lanes are not (3 to 7
times as slow), those of 16 take 1.2 times as long a lane as a tile of one row, those of 32 1.1 times (AVX-512, the
particle). Rows that leave few lanes to a program fill its tiles together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from jaxnh.maps.rows import ROW, StackedMaps, StrobeRows

_LARGE, _SMALL = (32, 256), (16, 64)  # lanes of a block and of a tile: of programs for many lanes, and for few
_FEW = 64  # lanes of a tile that is asked for where there are few


class Blocks(NamedTuple):
    """Lanes in blocks of one row each.

    Attributes:
        rows: of the blocks, (blocks,).
        lanes: pytrees whose leaves are (blocks, lanes a block, …), each block's last lane repeated where it lacks some.
        back: place of every lane among those of all blocks, (lanes,).
        a_tile: blocks of a tile.
    """

    rows: Int[np.ndarray, " blocks"]
    lanes: tuple[Any, ...]
    back: Int[np.ndarray, " lanes"]
    a_tile: int


def has_rows(shared: tuple[Any, ...]) -> bool:
    """Whether anything that lanes share is in rows."""
    return any(isinstance(part, StackedMaps | StrobeRows) for part in shared)


def in_blocks(lanes: tuple[Any, ...], tile: int) -> Blocks:
    """Lanes by their rows, whose numbers are under `ROW` in the mapping among them, for tiles of about so many.

    Blocks come in the order of their first lanes: lanes that take equally long stay together.
    """
    where = next(i for i, part in enumerate(lanes) if isinstance(part, Mapping) and ROW in part)
    p = dict(lanes[where])
    row = p.pop(ROW)
    block, size = _SMALL if tile <= _FEW else _LARGE
    order = np.argsort(row, kind="stable")
    rows, counts = np.unique(row, return_counts=True)
    ends, blocks = np.cumsum(counts), -(-counts // block)
    # Lane k of block j of a row that begins at `first` is number first + j block + k, or the row's last.
    of = np.repeat(np.arange(len(rows)), blocks)
    begun = np.arange(len(of)) - np.repeat(np.cumsum(blocks) - blocks, blocks)
    number = (ends - counts)[of, None] + begun[:, None] * block + np.arange(block)
    chosen = order[np.minimum(number, ends[of, None] - 1)]
    first = np.argsort(chosen[:, 0], kind="stable")
    chosen, of = chosen[first], of[first]
    back = np.empty(len(row), int)
    back[chosen.ravel()[::-1]] = np.arange(chosen.size)[::-1]
    moved = jax.tree.map(lambda leaf: leaf[chosen], (*lanes[:where], p, *lanes[where + 1 :]))
    return Blocks(rows[of].astype(np.int32), moved, back, size // block)


def of_block(*arguments: Any) -> Any:
    """The function of a lane for all lanes of a block: of what is shared, its row, its lanes, (function, static)."""
    *shared, row, lanes, (function, static) = arguments
    own = tuple(part.at(row) if isinstance(part, StackedMaps | StrobeRows) else part for part in shared)
    return jax.vmap(lambda lane: function(*own, *lane, *static))(lanes)
