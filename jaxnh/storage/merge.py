"""Pieces of a sweep into one result: a file, block by block, or a dataset in memory. No JAX.

Variables grow along every dimension that is an axis of the sweep, coordinates of the axes as well; all others are
equal in all pieces. With one axis no more than a tile is ever in memory, and compressed blocks go from tile to result
as they are. xarray can append to no HDF5 file, and would have to unpack and pack all data again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np
import xarray as xr

from jaxnh.exceptions import DamagedError, RunError
from jaxnh.storage import hdf5 as store
from jaxnh.storage.chunks import row_chunks, slab_chunks
from jaxnh.storage.pieces import Job, Piece, slab
from jaxnh.storage.tiles import piece_path

_COPIED = 1 << 16  # bytes; blocks at least so large go from tile to result as they are
_COLLECTED = 1 << 26  # bytes; a variable of smaller blocks is put together in memory up to this

Slab = tuple[slice, ...]


class DamagedPieceError(DamagedError):
    """A piece proves damaged while it is merged.

    Attributes:
        piece, why: which, and why.
    """

    def __init__(self, piece: Piece, why: str) -> None:
        super().__init__(why)
        self.piece, self.why = piece, why


def merge(
    path: Path,
    attrs: Mapping[str, Any],
    folder: Path,
    job: Job,
    warnings: Mapping[str, Sequence[str]],
    heed: Callable[[], None] = lambda: None,
) -> None:
    """Write the result of a job whose pieces are all there; it is read back before it gets its name.

    Args:
        attrs: root attributes.
        warnings: of the whole, by analysis, beside those of its pieces.
        heed: called between pieces; may raise to end it, and then nothing is written.

    Raises:
        DamagedPieceError: a piece is not what its checksums say, or does not fit the others.
        ResultError: the folder or the disk refuses.
    """
    with store.write_sealed(path, checked=True) as (file, sink):
        store.set_attributes(file, attrs)
        for name in job.groups:
            sources = [(piece, piece_path(folder, piece)) for piece in job.sources(name)]
            merged = _MergedGroup(file.create_group(name, track_order=True), _growing_axes(job, len(sources)))
            for piece, source in sources:
                heed()
                sink.check()
                try:
                    merged.add(piece, source)
                except DamagedError as error:
                    raise DamagedPieceError(piece, str(error)) from None
            merged.finish(warnings.get(name, ()))
            sink.check()


def gather(folder: Path, job: Job, name: str) -> xr.Dataset:
    """Gather the tiles of an analysis as one dataset over the whole sweep.

    Raises:
        ResultError: a tile cannot be read.
    """
    tiles = job.tiles_of(name)
    return assemble(((piece, store.read_group(piece_path(folder, piece), name)) for piece in tiles), job)


def assemble(parts: Iterable[tuple[Piece, xr.Dataset]], job: Job, warnings: Sequence[str] = ()) -> xr.Dataset:
    """The dataset of one analysis over the whole sweep, in memory: what `merge` writes and `open_result` reads.

    Args:
        parts: all pieces of the analysis with their datasets, as `write_piece` takes them.
        warnings: of the whole, beside those of its pieces.

    Raises:
        RunError: the parts do not fit together, or there are none.
    """
    parts = [(piece, store.with_indices(dataset)) for piece, dataset in parts]
    if not parts:
        raise RunError("there is nothing to put together")
    common = _Common()
    for _, dataset in parts:
        common.add(dataset.attrs)
    try:
        arrays = _fill(parts, dict(zip(job.names, job.shape, strict=True)))
    except DamagedError as error:
        raise RunError(f"results of parts of a sweep do not fit together: {error}") from None
    first = parts[0][1]
    content = {name: (first.variables[name].dims, data, first.variables[name].attrs) for name, data in arrays.items()}
    whole = xr.Dataset(content, attrs=common.attributes(warnings)).set_coords([str(name) for name in first.coords])
    return xr.decode_cf(whole, decode_times=False, mask_and_scale=False)


def _fill(parts: Sequence[tuple[Piece, xr.Dataset]], axes: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Data of all variables, put together."""
    arrays: dict[str, np.ndarray] = {}
    wholes: dict[str, _Whole] = {}
    for piece, dataset in parts:
        data = {str(name): store.as_text(np.asarray(v.values)) for name, v in dataset.variables.items()}
        if not arrays:
            wholes = {name: _Whole(name, dataset[name].dims, values, axes) for name, values in data.items()}
            arrays = {name: np.empty(wholes[name].shape, values.dtype) for name, values in data.items()}
        _check_names(data, wholes)
        for name, values in data.items():
            place = wholes[name].place(piece, values, lambda values=values: store.checksum(values).hexdigest())
            if place is not None:  # texts of pieces differ in their greatest length
                arrays[name] = arrays[name].astype(np.promote_types(arrays[name].dtype, values.dtype), copy=False)
                arrays[name][place] = values
    for whole in wholes.values():
        whole.check_covered()
    return arrays


def _growing_axes(job: Job, sources: int) -> Mapping[str, int]:
    """Axes along which variables of several pieces grow, with their sizes; of a single piece none."""
    return dict(zip(job.names, job.shape, strict=True)) if sources > 1 else {}


def _check_names(names: Iterable[Any], expected: Iterable[str]) -> None:
    if set(names) != set(expected):
        raise DamagedError("its variables are not those of the other tiles")


class _Whole:
    """A variable of the whole sweep in the making: its shape, and which parts of it are there.

    Attributes:
        name, dims: its name and dimensions.
        shape: of the whole.
        grows: whether it grows at all.
    """

    def __init__(
        self, name: str, dims: Sequence[Any], first: np.ndarray | h5py.Dataset, axes: Mapping[str, int]
    ) -> None:
        self.name, self.dims, self._axes = name, tuple(map(str, dims)), axes
        self.shape = tuple(axes.get(dim, size) for dim, size in zip(self.dims, first.shape, strict=True))
        self._dtype = first.dtype
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


class _Common:
    """Attributes on which all pieces agree, and all their warnings."""

    def __init__(self) -> None:
        self._attrs: store.Attributes | None = None
        self._warnings: dict[str, None] = {}

    def add(self, attrs: Mapping[Any, Any]) -> None:
        """Add the attributes of a piece."""
        own = {str(key): value for key, value in attrs.items() if key != "warnings"}
        self._warnings |= dict.fromkeys(filter(None, str(attrs.get("warnings", "")).split("\n")))
        known = own if self._attrs is None else self._attrs
        self._attrs = {key: value for key, value in known.items() if key in own and _text(own[key]) == _text(value)}

    def attributes(self, more: Sequence[str]) -> store.Attributes:
        """Attributes of the whole, with more warnings."""
        warnings = dict.fromkeys((*self._warnings, *more))
        return {**(self._attrs or {}), **({"warnings": "\n".join(warnings)} if warnings else {})}


def _text(value: Any) -> str:
    return json.dumps(value, default=store.plain, sort_keys=True)


# ---- ways into a file


class _Target(Protocol):
    """A variable of the result file that is written in parts."""

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        """Write the next part; `source` is the variable that it is from."""

    def finish(self) -> str:
        """Write what is still in memory; the checksum of the whole."""
        ...


class _MemorySink:
    """Put together in memory, and written at the end."""

    def __init__(self, item: h5py.Dataset, dtype: np.dtype) -> None:
        self._item, self._data = item, np.empty(item.shape, object if dtype.kind == "U" else dtype)

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._data[place] = values

    def finish(self) -> str:
        data = store.as_text(self._data)
        self._item[...] = store.as_stored(data)
        return store.checksum(data).hexdigest()


class _InTurn:
    """Parts along the first dimension, in order: the checksum runs along, and blocks that fit go over as they are."""

    def __init__(self, item: h5py.Dataset) -> None:
        self._item, self._hash = item, store.checksum(np.empty(0))

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._hash = store.checksum(values, self._hash)
        first, item = place[0].start, self._item
        if source.chunks and source.chunks == item.chunks and first % source.chunks[0] == 0:
            for k in range(source.id.get_num_chunks()):
                offset = source.id.get_chunk_info(k).chunk_offset
                mask, block = source.id.read_direct_chunk(offset)
                item.id.write_direct_chunk((first + offset[0], *offset[1:]), block, mask)
        else:
            item[place] = store.as_stored(values)

    def finish(self) -> str:
        return self._hash.hexdigest()


class _Slabs:
    """Parts in any order, along several axes; read back for the checksum."""

    def __init__(self, item: h5py.Dataset) -> None:
        self._item = item

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._item[place] = store.as_stored(values)

    def finish(self) -> str:
        return store.checksum_of(self._item)


class _Once:
    """All of it in one part."""

    def __init__(self, item: h5py.Dataset) -> None:
        self._item, self._digest = item, ""

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._item[place] = store.as_stored(values)
        self._digest = str(source.attrs[store.DATA])

    def finish(self) -> str:
        return self._digest


class _MergedGroup:
    """A group of the result in the making."""

    def __init__(self, target: h5py.Group, axes: Mapping[str, int]) -> None:
        self._group, self._axes = target, axes
        self._name = str(target.name)[1:]
        self._whole: dict[str, _Whole] = {}
        self._targets: dict[str, _Target] = {}
        self._common = _Common()

    def add(self, piece: Piece, path: Path) -> None:
        """The next piece, in order."""
        try:
            file = h5py.File(path, "r")
        except store.UNREADABLE as error:
            raise DamagedError("it is cut off or damaged") from error
        with file:
            try:
                group = store.groups(file)[self._name]
                items, attrs = store.variables(group), store.attributes(group)
                data = {name: store.read(item) for name, item in items.items()}
                stated = {name: str(item.attrs[store.DATA]) for name, item in items.items()}
            except store.UNREADABLE as error:
                raise DamagedError("it is cut off or damaged") from error
            for name, values in data.items():
                if store.checksum(values).hexdigest() != stated[name]:
                    raise DamagedError(f"the data of /{self._name}/{name} do not fit their checksum")
            if not self._whole:
                self._begin(items, attrs)
            _check_names(data, self._whole)
            self._common.add(attrs)
            for name, values in data.items():
                place = self._whole[name].place(piece, values, lambda name=name: stated[name])
                if place is not None:
                    self._targets[name].put(place, values, items[name])

    def _begin(self, items: Mapping[str, h5py.Dataset], attrs: store.Attributes) -> None:
        """Empty variables with the attributes of the first piece's."""
        store.set_attributes(self._group, attrs)
        for name, item in items.items():
            self._whole[name] = whole = _Whole(name, store.dimensions(item), item, self._axes)
            self._targets[name] = self._target(name, item, whole)
            store.set_attributes(store.variable(self._group, name), store.attributes(item))

    def _target(self, name: str, item: h5py.Dataset, whole: _Whole) -> _Target:
        """The way into the file that suits a variable: by its size, and by the blocks that its first piece lies in."""
        dtype = np.dtype("U") if h5py.check_string_dtype(item.dtype) else item.dtype
        if not whole.grows:
            return _Once(store.create(self._group, name, whole.shape, dtype))
        size = item.dtype.itemsize
        small = math.prod(whole.shape) * size < _COLLECTED
        if len(self._axes) == 1 and whole.dims[0] in self._axes:
            rows = item.chunks[0] if item.chunks else 0
            if small and rows * math.prod(item.shape[1:]) * size < _COPIED:
                return _MemorySink(store.create(self._group, name, whole.shape, dtype), dtype)
            chunks = row_chunks(whole.shape, size, rows or item.shape[0])
            return _InTurn(store.create(self._group, name, whole.shape, dtype, chunks))
        if small:
            return _MemorySink(store.create(self._group, name, whole.shape, dtype), dtype)
        chunks = slab_chunks(item.shape, whole.shape, size, _COLLECTED)
        return _Slabs(store.create(self._group, name, whole.shape, dtype, chunks))

    def finish(self, warnings: Sequence[str]) -> None:
        """Write what is known at the end: collected variables, hashes, scales, and attributes of the whole."""
        for name, target in self._targets.items():
            store.variable(self._group, name).attrs[store.DATA] = target.finish()
        store.attach(self._group, {name: whole.dims for name, whole in self._whole.items()})
        attrs, first = self._common.attributes(warnings), store.attributes(self._group)
        for key in first.keys() - attrs.keys():
            del self._group.attrs[key]
        changed = {key: value for key, value in attrs.items() if key not in first or _text(value) != _text(first[key])}
        store.set_attributes(self._group, changed)
