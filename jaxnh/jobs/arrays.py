"""Arrays and attributes as results have them, in memory and in files: text, checksums, indices. No JAX."""

from __future__ import annotations

import hashlib
from threading import Thread
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    import xarray as xr  # with pandas it takes longer to import than all else here

DATA = "sha256"
"""Attribute of a variable: hash of its numbers as they lie in memory."""

Attributes = dict[str, Any]
"""Attributes by name: text, numbers, or arrays of one dimension."""


class Hash(Protocol):
    """A checksum in the making."""

    def update(self, data: Any, /) -> None:
        """Add data."""

    def hexdigest(self) -> str:
        """The checksum of all data so far."""
        ...


def import_beside() -> None:
    """Let xarray import the array libraries that it asks for at its first variable, in a thread beside other work.

    With Dask installed that takes a quarter of a second, in which programs are compiled.
    """

    def first() -> None:
        import xarray as xr

        xr.Variable((), 0.0)

    Thread(target=first, daemon=True).start()


def with_indices(dataset: xr.Dataset) -> xr.Dataset:
    """A dataset in which every dimension has a coordinate: 0, 1, ... where it had none."""
    missing = [dim for dim in dataset.dims if dim not in dataset.variables]
    return dataset.assign_coords({dim: (dim, np.arange(dataset.sizes[dim]), index_words(str(dim))) for dim in missing})


def index_words(dim: str) -> dict[str, str]:
    """Attributes of the index of a dimension without a coordinate."""
    return {"long_name": f"index along {dim}", "units": "1"}


def as_text(data: np.ndarray) -> np.ndarray:
    """Text of any kind as NumPy's own; all else as it is."""
    return data.astype(str) if data.dtype.kind in "OT" else data


def checksum(data: np.ndarray, running: Hash | None = None) -> Hash:
    """SHA-256 of an array, or of those before it and then this one."""
    digest = running or hashlib.sha256()
    if data.dtype.kind == "U":
        digest.update("".join(f"{word}\0" for word in data.ravel()).encode())
    else:
        digest.update(np.ascontiguousarray(data).data)
    return digest


def plain(value: Any) -> Any:
    """An attribute as JSON takes it."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else repr(value)
