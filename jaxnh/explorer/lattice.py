"""Lanes of a plane as they become known, from coarse to fine: each stands for its neighbours until these are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
import xarray as xr
from jaxtyping import Int

from jaxnh.explorer.view import View

Places = Int[np.ndarray, " places"]
"""Places along an axis."""


class Lattice:
    """All lanes of a view of a plane."""

    def __init__(self, view: View, dims: Mapping[str, str]) -> None:
        """Nothing is known yet.

        Args:
            dims: of the axes in results, by name.
        """
        self._grid = {dims[name]: values for name, values in view.grid().items()}
        self._shape = (view.columns, view.rows)
        self._known: dict[str, np.ndarray] = {}
        self._part = xr.Dataset()

    def put(self, part: xr.Dataset, places: tuple[Places, Places], step: int) -> None:
        """Lanes at a product of places along both axes, for all lanes less than half a step away."""
        axes = tuple(self._grid)
        around = [_nearest_places(place, size, step) for place, size in zip(places, self._shape, strict=True)]
        for key, item in part.data_vars.items():
            if not set(axes) <= set(item.dims):
                continue
            values = item.transpose(*axes, ...).to_numpy()
            if key not in self._known:
                self._known[str(key)] = np.zeros((*self._shape, *values.shape[2:]), values.dtype)
            into, source = (np.ix_(*both) for both in zip(*around, strict=True))
            self._known[str(key)][into] = values[source]
        self._part = part

    def dataset(self) -> xr.Dataset:
        """All lanes; those that are not known yet have the values of a neighbour."""
        part, axes = self._part, tuple(self._grid)
        content = {}
        for name, values in self._known.items():
            others = [dim for dim in part[name].dims if dim not in axes]
            content[name] = ((*axes, *others), values.copy(), part[name].attrs)
        coordinates = {name: (name, values, part[name].attrs) for name, values in self._grid.items()}
        coordinates |= {str(name): item for name, item in part.coords.items() if not set(axes) & set(item.dims)}
        return xr.Dataset(content, coordinates, {**part.attrs, "axes": " ".join(axes)})


def _nearest_places(places: Places, size: int, step: int) -> tuple[Places, Places]:
    """Places along an axis whose nearest multiple of a step is one of these, and for each of them which."""
    every = np.arange(size)
    nearest = np.minimum((every + step // 2) // step, (size - 1) // step) * step
    mine = np.flatnonzero(np.isin(nearest, places))
    return mine, np.searchsorted(places, nearest[mine])


def blocks(
    shape: tuple[int, int], step: int, most: Callable[[], int], *, first: bool
) -> Iterator[tuple[Places, Places]]:
    """Places at multiples of a step that are not multiples of twice the step, some at a time.

    Args:
        most: says before each block how many lanes it may have; it has a row at least.
        first: whether none are known, so that all are wanted.
    """
    across, up = (np.arange(0, size, step) for size in shape)
    products = [(across, up)] if first else [(across[1::2], up[::2]), (across, up[1::2])]
    for columns, rows in products:
        while len(columns) and len(rows):
            count = -(-len(rows) // max(1, most() // len(columns)))  # of blocks, were all alike
            here, rows = np.split(rows, [-(-len(rows) // count)])
            yield columns, here
