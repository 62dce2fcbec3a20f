"""Datasets of the pieces of a sweep into one, in memory; the same checks hold where files are merged.

Variables grow along every dimension that is an axis of the sweep, coordinates of the axes as well; all others are equal
in all pieces.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxnh.exceptions import DamagedError, RunError
from jaxnh.jobs.arrays import Attributes, as_text, checksum, plain, with_indices
from jaxnh.jobs.cutting import Cutting, Piece, slab

if TYPE_CHECKING:
    import xarray as xr  # imported where the first result is made: with pandas it takes a third of a second

Slab = tuple[slice, ...]


def assemble(parts: Iterable[tuple[Piece, xr.Dataset]], cutting: Cutting, warnings: Sequence[str] = ()) -> xr.Dataset:
    """The dataset of one analysis over the whole sweep, in memory: what `storage.merge` writes and `open_result` reads.

    Args:
        parts: all pieces of the analysis with their datasets.
        warnings: of the whole, beside those of its pieces.

    Raises:
        RunError: the parts do not fit together, or there are none.
    """
    import xarray as xr

    parts = [(piece, with_indices(dataset)) for piece, dataset in parts]
    if not parts:
        raise RunError("there is nothing to put together")
    common = CommonAttributes()
    for _, dataset in parts:
        common.add(dataset.attrs)
    try:
        arrays = _fill(parts, dict(zip(cutting.names, cutting.shape, strict=True)))
    except DamagedError as error:
        raise RunError(f"results of parts of a sweep do not fit together: {error}") from None
    first = parts[0][1]
    content = {name: (first.variables[name].dims, data, first.variables[name].attrs) for name, data in arrays.items()}
    whole = xr.Dataset(content, attrs=common.attributes(warnings)).set_coords([str(name) for name in first.coords])
    return xr.decode_cf(whole, decode_times=False, mask_and_scale=False)


def _fill(parts: Sequence[tuple[Piece, xr.Dataset]], axes: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Data of all variables, put together."""
    arrays: dict[str, np.ndarray] = {}
    wholes: dict[str, WholeVariable] = {}
    for piece, dataset in parts:
        data = {str(name): as_text(np.asarray(v.values)) for name, v in dataset.variables.items()}
        if not arrays:
            wholes = {name: WholeVariable(name, dataset[name].dims, v.shape, v.dtype, axes) for name, v in data.items()}
            arrays = {name: np.empty(wholes[name].shape, values.dtype) for name, values in data.items()}
        check_names(data, wholes)
        for name, values in data.items():
            place = wholes[name].place(piece, values, lambda values=values: checksum(values).hexdigest())
            if place is not None:  # texts of pieces differ in their greatest length
                arrays[name] = arrays[name].astype(np.promote_types(arrays[name].dtype, values.dtype), copy=False)
                arrays[name][place] = values
    for whole in wholes.values():
        whole.check_covered()
    return arrays


def check_names(names: Iterable[Any], expected: Iterable[str]) -> None:
    """Raise `DamagedError` where a piece has other variables than those before it."""
    if set(names) != set(expected):
        raise DamagedError("its variables are not those of the other tiles")


class WholeVariable:
    """A variable of the whole sweep in the making: its shape, and which parts of it are there.

    Attributes:
        name, dims: its name and dimensions.
        shape: of the whole.
        grows: whether it grows at all.
    """

    def __init__(
        self, name: str, dims: Sequence[Any], shape: tuple[int, ...], dtype: np.dtype, axes: Mapping[str, int]
    ) -> None:
        self.name, self.dims, self._axes = name, tuple(map(str, dims)), axes
        self.shape = tuple(axes.get(dim, size) for dim, size in zip(self.dims, shape, strict=True))
        self._dtype = dtype
        self.grows = any(dim in axes for dim in self.dims)
        self._repeats = not set(axes) <= set(self.dims)
        self._there: dict[tuple[tuple[int, int], ...], str] = {}

    def place(self, piece: Piece, values: np.ndarray, digest: Callable[[], str]) -> Slab | None:
        """Return where values of a piece go; None if equal ones are there, as they vary along no axis that is cut.

        Raises:
            DamagedError: they are not of that shape and type, or others are there.
        """
        places = slab(self.dims, piece, tuple(self._axes)) if self._axes else (slice(None),) * len(self.dims)
        ends = tuple(where.indices(size)[:2] for where, size in zip(places, self.shape, strict=True))
        expected = tuple(end - begin for begin, end in ends)
        if values.shape != expected:
            raise DamagedError(f"{self.name} has the shape {values.shape} in place of {expected}")
        if values.dtype != self._dtype and values.dtype.kind != "U":
            raise DamagedError(f"{self.name} has numbers {values.dtype} in place of {self._dtype}")
        value_digest = digest() if self._repeats else ""
        if ends not in self._there:
            self._there[ends] = value_digest
            return places
        if self._there[ends] != value_digest:
            raise DamagedError(f"{self.name} is not that of the other tiles")
        return None

    def check_covered(self) -> None:
        """Raise `DamagedError` where a part is missing; parts of a grid that differ do not overlap."""
        if sum(math.prod(end - begin for begin, end in ends) for ends in self._there) != math.prod(self.shape):
            raise DamagedError(f"{self.name} is not there as a whole")


class CommonAttributes:
    """Attributes on which all pieces agree, and all their warnings."""

    def __init__(self) -> None:
        self._attrs: Attributes | None = None
        self._warnings: dict[str, None] = {}

    def add(self, attrs: Mapping[Any, Any]) -> None:
        """Add the attributes of a piece."""
        own = {str(key): value for key, value in attrs.items() if key != "warnings"}
        self._warnings |= dict.fromkeys(filter(None, str(attrs.get("warnings", "")).split("\n")))
        known = own if self._attrs is None else self._attrs
        self._attrs = {key: value for key, value in known.items() if key in own and as_json(own[key]) == as_json(value)}

    def attributes(self, more: Sequence[str]) -> Attributes:
        """Attributes of the whole, with more warnings."""
        warnings = dict.fromkeys((*self._warnings, *more))
        return {**(self._attrs or {}), **({"warnings": "\n".join(warnings)} if warnings else {})}


def as_json(value: Any) -> str:
    """An attribute as JSON, to be compared."""
    return json.dumps(value, default=plain, sort_keys=True)
