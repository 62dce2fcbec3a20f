"""A view as a picture of cells: of a diagram the share of a column's points in each, of a plane a lane a cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, UInt32
from matplotlib.colors import to_rgba_array

from jaxnh.plotting.density import INK, column_shares
from jaxnh.plotting.frame import cell_edges
from jaxnh.plotting.pixels import Pixels

LEVELS = INK.N
ROWS = 420
"""Cells of a column of a diagram, and pixels that they have on the page."""

MOST_CELLS = 1200
"""Cells of a plane, either way: about the pixels that the page has."""

_LEAST = 1e-3  # share of a column's points that has the first colour


class Raster(NamedTuple):
    """A picture of a view.

    Attributes:
        cells: colour of each cell, four bytes red, green, blue and opacity, (rows, columns), from the lower left.
        across: left and right end.
        up: lower and upper end.
    """

    cells: UInt32[np.ndarray, "rows columns"]
    across: tuple[float, float]
    up: tuple[float, float]


PlaneEdges = tuple[Float[np.ndarray, " across"], Float[np.ndarray, " up"]]
"""Edges of the pixels of a plane, one more than there are pixels either way."""


def _pack_colours(rgba: np.ndarray) -> UInt32[np.ndarray, ...]:
    """Colours (..., 4) of bytes as one number each."""
    return np.ascontiguousarray(rgba, np.uint8).view(np.uint32)[..., 0]


PALETTE = _pack_colours(np.round(255 * to_rgba_array(["#ffffff", *(INK(k) for k in range(LEVELS))])))
"""Colours of shares from few points to many, the first that of an empty cell."""


def raster(
    axis: Float[np.ndarray, " columns"], values: Float[np.ndarray, "columns points"], window: tuple[float, float] | None
) -> Raster:
    """Values over an axis as cells.

    Args:
        window: range of the values; None: all of them.
    """
    across, up, share = column_shares(axis, values, window, ROWS)
    steps = 1.0 + (LEVELS - 1) * (1.0 - np.log(np.maximum(share, _LEAST)) / np.log(_LEAST))
    cells = PALETTE[np.where(share > 0.0, np.round(steps), 0.0).astype(np.uint8).T]
    return Raster(np.ascontiguousarray(cells), (float(across[0]), float(across[-1])), (float(up[0]), float(up[-1])))


def plane_raster(pixels: Pixels, edges: PlaneEdges | None = None, share: np.ndarray | None = None) -> Raster:
    """A plane as cells of one size; where values are uneven or too many, each cell has the lane at its place.

    Args:
        edges: rising edges of the pixels across and up; None: halfway between their values.
        share: of the lanes that a pixel (m, n) stands for, those that are as its colour says; it is the paler the more
            others there are. None: all are.
    """
    across, up = edges or tuple(cell_edges(np.asarray(axis)) for axis in (pixels.plane.x, pixels.plane.y))
    rgba = pixels.rgba()
    if share is not None:
        rgba = np.round(255 - share[..., None] * (255.0 - rgba)).astype(np.uint8)
        rgba[..., 3] = 255
    (x_ends, x), (y_ends, y) = _cells(across), _cells(up)
    return Raster(_pack_colours(rgba[np.ix_(y, x)]), x_ends, y_ends)


def _cells(edges: Float[np.ndarray, " edges"]) -> tuple[tuple[float, float], np.ndarray]:
    """Ends of cells of one size between rising edges of pixels, and the pixel that lies in each."""
    ends, sizes = (float(edges[0]), float(edges[-1])), np.diff(edges)
    if len(sizes) <= MOST_CELLS and sizes.max() - sizes.min() < 0.01 * sizes.mean():
        return ends, np.arange(len(sizes))
    count = int(min(MOST_CELLS, np.ceil((ends[1] - ends[0]) / sizes.min())))
    middles = ends[0] + (np.arange(count) + 0.5) * (ends[1] - ends[0]) / count
    return ends, np.clip(np.searchsorted(edges, middles, side="right") - 1, 0, len(sizes) - 1)


def values_of(data: xr.Dataset, axis: str, variable: str) -> tuple[np.ndarray, np.ndarray]:
    """Values of the axis of a diagram in rising order, and those of a variable over it, (columns, points)."""
    values = data[variable].transpose(axis, ...)
    place = np.argsort(data[axis].to_numpy(), kind="stable")
    return data[axis].to_numpy()[place], values.to_numpy().reshape(len(place), -1)[place]
