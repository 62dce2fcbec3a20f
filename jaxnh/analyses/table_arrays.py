"""Arrays of tables: rows of different lengths filled up, rows at their places, complex numbers as two parts."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike


def longest(rows: Sequence[Sized]) -> int:
    """Return the length of the longest row; 0 where there is none."""
    return max(map(len, rows), default=0)


def padded(rows: Sequence[ArrayLike], shape: tuple[int, ...], empty: float = np.nan) -> np.ndarray:
    """Return arrays of at most a shape as one, (rows, *shape), filled up."""
    whole = np.full((len(rows), *shape), empty)
    for k, row in enumerate(rows):
        whole[(k, *map(slice, np.shape(row)))] = row
    return whole


def real_and_imaginary(values: np.ndarray) -> np.ndarray:
    """Return both parts of complex numbers, (...,), as (..., 2)."""
    return np.stack([np.real(values), np.imag(values)], axis=-1)


class RowPlaces(NamedTuple):
    """RowPlaces of rows in an array over lanes and what these have."""

    shape: tuple[int, ...]
    at: tuple[Int[np.ndarray, " rows"], ...]

    def put(self, values: np.ndarray, empty: float = np.nan, dtype: Any = float) -> np.ndarray:
        """Return an array with rows, (rows, ...), at their places, and a number for nothing elsewhere."""
        whole = np.full((*self.shape, *values.shape[1:]), empty, dtype)
        whole[self.at] = values
        return whole


def ordered_places(lane: Int[np.ndarray, " rows"], shape: tuple[int, int]) -> RowPlaces:
    """Return the places of rows that are in order of their lanes."""
    return RowPlaces(shape, (lane, np.arange(len(lane)) - np.searchsorted(lane, lane)))
