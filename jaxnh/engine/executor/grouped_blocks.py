"""Lanes of several groups (`maps.family`) in one program: a tile is several blocks, each with lanes of one group.

Inside a block all lanes share a table, so that the loop over them is vector code; blocks of eight lanes are not (3 to 7
times as slow), those of 16 take 1.2 times as long a lane as a tile of one group, those of 32 1.1 times (AVX-512, the
particle). Groups of few lanes fill tiles together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from jaxnh.maps.family import TreeStack
from jaxnh.systems.rows import select

_LARGE, _SMALL = (32, 256), (16, 64)  # lanes of a block and of a tile: of programs for many lanes, and for few
_FEW = 64  # lanes of a tile that is asked for where there are few


class Blocks(NamedTuple):
    """Lanes in blocks of one group each.

    Attributes:
        groups: of the blocks, (blocks,).
        lanes: pytrees whose leaves are (blocks, lanes a block, …), each block's last lane repeated where it lacks some.
        back: place of every lane among those of all blocks, (lanes,).
        a_tile: blocks of a tile.
    """

    groups: Int[np.ndarray, " blocks"]
    lanes: tuple[Any, ...]
    back: Int[np.ndarray, " lanes"]
    a_tile: int


def group_into_blocks(group: Int[np.ndarray, " lanes"], lanes: tuple[Any, ...], tile: int) -> Blocks:
    """Lanes by their groups, for tiles of about so many.

    Blocks come in the order of their first lanes: lanes that take equally long stay together.
    """
    block, size = _SMALL if tile <= _FEW else _LARGE
    order = np.argsort(group, kind="stable")
    groups, counts = np.unique(group, return_counts=True)
    ends, blocks = np.cumsum(counts), -(-counts // block)
    # Lane k of block j of a group that begins at `first` is number first + j block + k, or the group's last.
    owner = np.repeat(np.arange(len(groups)), blocks)
    start = np.arange(len(owner)) - np.repeat(np.cumsum(blocks) - blocks, blocks)
    number = (ends - counts)[owner, None] + start[:, None] * block + np.arange(block)
    chosen = order[np.minimum(number, ends[owner, None] - 1)]
    first = np.argsort(chosen[:, 0], kind="stable")
    chosen, owner = chosen[first], owner[first]
    back = np.empty(len(group), int)
    back[chosen.ravel()[::-1]] = np.arange(chosen.size)[::-1]
    return Blocks(groups[owner].astype(np.int32), select(lanes, chosen), back, size // block)


def evaluate_in_group(*arguments: Any) -> Any:
    """Evaluate the function of a lane for one lane of a group."""
    own, lane, function, static = _parts(arguments)
    return function(*own, *lane, *static)


def evaluate_block(*arguments: Any) -> Any:
    """Evaluate the function of a lane for all lanes of a block."""
    own, lanes, function, static = _parts(arguments)
    return jax.vmap(lambda *lane: function(*own, *lane, *static))(*lanes)


def _parts(arguments: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...], Any, tuple[Any, ...]]:
    """Parts of (*shared, *lanes, group, (function, static, number of lanes' arguments)); shared as the group has it."""
    *before, group, (function, static, count) = arguments
    shared, lanes = before[:-count], before[-count:]
    own = tuple(part.at(group) if isinstance(part, TreeStack) else part for part in shared)
    return own, tuple(lanes), function, static
