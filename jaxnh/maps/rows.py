"""Maps of lanes that are at several values of what lanes share, as d, stacked: a row of tables for each value.

The arithmetic of a lane, and so its bits, are those of the map at its own value.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State

ROW = "row of its map"
"""Key among the parameters of lanes under which the number of their row is handed over."""

ROWS = 32
"""Rows of a stack, whether it needs them or not: all stacks run through one program."""


class StackedMaps(eqx.Module):
    """Pytrees of one structure, one for each row.

    Attributes:
        rows: their floating-point numbers stacked, (ROWS, …); whole numbers are the same in all.
    """

    rows: Any

    def at(self, row: ArrayLike) -> Any:
        """The pytree of a row, which may be traced."""
        return jax.tree.map(lambda leaf: leaf[row] if _is_stacked(leaf) else leaf, self.rows)


class StrobeRows(ReturnMap):
    """P(z; p) of lanes that name their row in p: the row's own map takes its place before it comes to a lane.

    Attributes:
        system: the flow of the first row, as maps know it.
        maps: of all rows.
    """

    system: Any
    maps: StackedMaps

    @property
    def turns(self) -> tuple[float, ...]:
        """As of every row."""
        return self.maps.rows.turns

    def at(self, row: ArrayLike) -> ReturnMap:
        """The map of a row, which may be traced."""
        return self.maps.at(row)

    def __call__(self, state: State, p: Parameters) -> State:
        """Not in a lane: `engine.executor.row_blocks` puts the map of its row in its place."""
        raise NotImplementedError

    def push(self, state: State, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushforward:
        """Not in a lane: `engine.executor.row_blocks` puts the map of its row in its place."""
        raise NotImplementedError


def stack(trees: Sequence[Any]) -> StackedMaps:
    """Pytrees of one structure as rows, the last of them in all rows that are left.

    Raises:
        ValueError: they differ in a whole number.
    """

    def one(*leaves: Any) -> np.ndarray:
        arrays = [np.asarray(leaf) for leaf in leaves]
        if arrays[0].dtype.kind == "f":
            return np.stack(arrays + arrays[-1:] * (ROWS - len(arrays)))
        if any(not np.array_equal(arrays[0], other) for other in arrays[1:]):
            raise ValueError("rows of one program differ in a whole number")
        return arrays[0]

    return StackedMaps(jax.tree.map(one, *trees))


def strobe_rows(strobes: Sequence[ReturnMap]) -> StrobeRows:
    """Maps of one kind as rows, in tables no larger than they need."""
    return StrobeRows(strobes[0].system, stack([strobe.compact() for strobe in strobes]))


def row_by_row(strobe: ReturnMap, p: Parameters, count: int) -> Iterator[tuple[np.ndarray, ReturnMap, Parameters]]:
    """Of `count` lanes the numbers of those of each row, its map and their parameters; without rows, of all lanes.

    For programs whose bits depend on the shape of a tile.
    """
    if not isinstance(strobe, StrobeRows):
        yield np.arange(count), strobe, p
        return
    row, own = np.asarray(p[ROW]), {name: np.asarray(values) for name, values in p.items() if name != ROW}
    for k in np.unique(row).tolist():
        here = np.flatnonzero(row == k)
        yield here, strobe.at(k), {name: values[here] for name, values in own.items()}


def _is_stacked(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)
