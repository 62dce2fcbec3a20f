"""A diagram as a picture of cells: the share of a column's points in each, as whole numbers for a palette."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, UInt8
from matplotlib.colors import to_hex

from jaxnh.plotting.density import INK, column_shares

LEVELS = INK.N
PALETTE = ("#ffffff", *(to_hex(INK(k)) for k in range(LEVELS)))
"""Colours of the numbers of a raster; 0 is an empty cell."""

ROWS = 420
"""Cells of a column, and pixels that they have on the page."""

_LEAST = 1e-3  # share of a column's points that has the first colour


class Raster(NamedTuple):
    """A picture of a diagram.

    Attributes:
        cells: place of each cell in `PALETTE`, (rows, columns), from the lower left.
        across: left and right end.
        up: lower and upper end.
    """

    cells: UInt8[np.ndarray, "rows columns"]
    across: tuple[float, float]
    up: tuple[float, float]


def raster(
    axis: Float[np.ndarray, " columns"], values: Float[np.ndarray, "columns points"], window: tuple[float, float] | None
) -> Raster:
    """Values over an axis as cells.

    Args:
        window: range of the values; None: all of them.
    """
    across, up, share = column_shares(axis, values, window, ROWS)
    steps = 1.0 + (LEVELS - 1) * (1.0 - np.log(np.maximum(share, _LEAST)) / np.log(_LEAST))
    cells = np.where(share > 0.0, np.round(steps), 0.0).astype(np.uint8).T
    return Raster(np.ascontiguousarray(cells), (float(across[0]), float(across[-1])), (float(up[0]), float(up[-1])))


def values_of(data: xr.Dataset, axis: str, variable: str) -> tuple[np.ndarray, np.ndarray]:
    """Values of the axis of a diagram in rising order, and those of a variable over it, (columns, points)."""
    name = f"{variable}_state" if f"{variable}_state" in data else variable
    found = data[name].transpose(axis, ...)
    place = np.argsort(data[axis].to_numpy(), kind="stable")
    return data[axis].to_numpy()[place], found.to_numpy().reshape(len(place), -1)[place]
