"""Files of pieces of a sweep into one result file, block by block. No JAX.

Variables grow as in `jobs.assembly`. With one axis no more than a tile is ever in memory, and compressed blocks go from
tile to result as they are. xarray can append to no HDF5 file, and would have to unpack and pack all data again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import h5py
import numpy as np
import xarray as xr

from jaxnh.exceptions import DamagedError
from jaxnh.jobs.arrays import as_text, checksum
from jaxnh.jobs.assembly import CommonAttributes, Slab, WholeVariable, as_json, assemble, check_names
from jaxnh.jobs.cutting import Cutting, Piece, slab
from jaxnh.storage import hdf5 as store
from jaxnh.storage import parts
from jaxnh.storage.chunks import row_chunks, slab_chunks
from jaxnh.storage.tiles import piece_path

_COPIED = 1 << 16  # bytes; blocks at least so large go from tile to result as they are
_COLLECTED = 1 << 26  # bytes; a variable of smaller blocks is put together in memory up to this


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
    cutting: Cutting,
    warnings: Mapping[str, Sequence[str]],
    heed: Callable[[], None] = lambda: None,
    *,
    virtual: bool = False,
) -> None:
    """Write the result of a sweep whose pieces are all there; it is read back before it gets its name.

    Args:
        attrs: root attributes.
        warnings: of the whole, by analysis, beside those of its pieces.
        heed: called between pieces; may raise to end it, and then nothing is written.
        virtual: leave large variables in the files of the pieces, which are linked to and not copied (`parts`).

    Raises:
        DamagedPieceError: a piece is not what its checksums say, or does not fit the others.
        ResultError: the folder or the disk refuses.
    """
    linked = parts.link(path, [piece_path(folder, piece) for piece in cutting.pieces()]) if virtual else {}
    with store.write_sealed(path, checked=True) as (file, sink):
        store.set_attributes(file, {**attrs, **linked})
        for name in cutting.groups:
            sources = [(piece, piece_path(folder, piece)) for piece in cutting.sources(name)]
            source_files = _SourceFiles(path, tuple(piece for piece, _ in sources)) if virtual else None
            axes = dict(zip(cutting.names, cutting.shape, strict=True)) if len(sources) > 1 else {}
            merged = _MergedGroup(file.create_group(name, track_order=True), axes, source_files)
            for piece, source in sources:
                heed()
                sink.check()
                try:
                    merged.add(piece, source)
                except DamagedError as error:
                    raise DamagedPieceError(piece, str(error)) from None
            merged.finish(warnings.get(name, ()))
            sink.check()
    if not virtual:
        parts.remove(path)


def gather(folder: Path, cutting: Cutting, name: str) -> xr.Dataset:
    """Gather the tiles of an analysis as one dataset over the whole sweep.

    Raises:
        ResultError: a tile cannot be read.
    """
    tiles = cutting.tiles_of(name)
    return assemble(((piece, store.read_group(piece_path(folder, piece), name)) for piece in tiles), cutting)


# ---- ways into a file


class _Target(Protocol):
    """A variable of the result file that is written in parts."""

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        """Write the next part; `source` is the variable that it is from."""

    def finish(self) -> str:
        """Write what is still in memory; the checksum of the whole."""
        ...


class _MemorySink:
    """Parts collected in memory, written at the end."""

    def __init__(self, item: h5py.Dataset, dtype: np.dtype) -> None:
        self._item, self._data = item, np.empty(item.shape, object if dtype.kind == "U" else dtype)

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._data[place] = values

    def finish(self) -> str:
        data = as_text(self._data)
        self._item[...] = store.as_stored(data)
        return checksum(data).hexdigest()


class _InTurn:
    """Parts along the first dimension, in order: the checksum is updated by each, and blocks that fit are copied."""

    def __init__(self, item: h5py.Dataset) -> None:
        self._item, self._hash = item, checksum(np.empty(0))

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._hash = checksum(values, self._hash)
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
    """Parts in any order along several axes; the whole is read back for its checksum."""

    def __init__(self, item: h5py.Dataset) -> None:
        self._item = item

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._item[place] = store.as_stored(values)

    def finish(self) -> str:
        return store.checksum_of(self._item)


class _Once:
    """The whole array as one part."""

    def __init__(self, item: h5py.Dataset) -> None:
        self._item, self._digest = item, ""

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        self._item[place] = store.as_stored(values)
        self._digest = str(source.attrs[store.DATA])

    def finish(self) -> str:
        return self._digest


class _SourceFiles(NamedTuple):
    """The result that leads to files of pieces, and the pieces of a group."""

    path: Path
    pieces: tuple[Piece, ...]

    def layout(self, name: str, whole: WholeVariable, dtype: np.dtype, axes: Sequence[str]) -> h5py.VirtualLayout:
        """Return where in these files a variable lies, by their place beside the result."""
        layout = h5py.VirtualLayout(whole.shape, dtype)
        for piece in self.pieces:
            place = slab(whole.dims, piece, axes)
            shape = tuple(len(range(*where.indices(size))) for where, size in zip(place, whole.shape, strict=True))
            file = piece_path(Path(parts.folder_of(self.path).name), piece).as_posix()
            layout[place] = h5py.VirtualSource(file, name, shape=shape)
        return layout


class _Virtual:
    """Parts that stay where they are; the whole is read once, in its order, for its checksum.

    A virtual dataset finds its files beside its own, which is open here by a handle without a name: it is read from a
    file that has one, and is removed again.
    """

    def __init__(self, group: h5py.Group, name: str, layout: h5py.VirtualLayout, files: _SourceFiles) -> None:
        self._layout, self._files = layout, files
        self._fill = np.nan if np.issubdtype(layout.dtype, np.floating) else 0
        group.create_virtual_dataset(name, layout, self._fill)

    def put(self, place: Slab, values: np.ndarray, source: h5py.Dataset) -> None:
        """Do nothing: it is there."""

    def finish(self) -> str:
        scratch = self._files.path.with_name(f".{self._files.path.name}.virtual.part")
        try:
            with h5py.File(scratch, "w", libver=store.VERSION) as file:
                return store.checksum_of(file.create_virtual_dataset("x", self._layout, self._fill))
        finally:
            scratch.unlink(missing_ok=True)


class _MergedGroup:
    """A group of the result in the making."""

    def __init__(self, target: h5py.Group, axes: Mapping[str, int], files: _SourceFiles | None = None) -> None:
        self._group, self._axes, self._files = target, axes, files
        self._name = str(target.name)[1:]
        self._whole: dict[str, WholeVariable] = {}
        self._targets: dict[str, _Target] = {}
        self._common = CommonAttributes()

    def add(self, piece: Piece, path: Path) -> None:
        """Add the next piece, in order."""
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
                if checksum(values).hexdigest() != stated[name]:
                    raise DamagedError(f"the data of /{self._name}/{name} do not fit their checksum")
            if not self._whole:
                self._begin(items, attrs)
            check_names(data, self._whole)
            self._common.add(attrs)
            for name, values in data.items():
                place = self._whole[name].place(piece, values, lambda name=name: stated[name])
                if place is not None:
                    self._targets[name].put(place, values, items[name])

    def _begin(self, items: Mapping[str, h5py.Dataset], attrs: store.Attributes) -> None:
        """Empty variables with the attributes of the first piece's."""
        store.set_attributes(self._group, attrs)
        for name, item in items.items():
            whole = WholeVariable(name, store.dimensions(item), item.shape, item.dtype, self._axes)
            self._whole[name] = whole
            self._targets[name] = self._target(name, item, whole)
            store.set_attributes(store.variable(self._group, name), store.attributes(item))

    def _target(self, name: str, item: h5py.Dataset, whole: WholeVariable) -> _Target:
        """Choose how a variable is written, by its size and by the blocks of its first piece."""
        dtype = np.dtype("U") if h5py.check_string_dtype(item.dtype) else item.dtype
        if not whole.grows:
            return _Once(store.create(self._group, name, whole.shape, dtype))
        if self._files and item.chunks and set(self._axes) <= set(whole.dims) and name not in self._axes:
            layout = self._files.layout(str(item.name), whole, item.dtype, tuple(self._axes))
            return _Virtual(self._group, name, layout, self._files)
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
        """Write collected variables, hashes, scales, and attributes of the whole."""
        for name, target in self._targets.items():
            store.variable(self._group, name).attrs[store.DATA] = target.finish()
        store.attach(self._group, {name: whole.dims for name, whole in self._whole.items()})
        attrs, first = self._common.attributes(warnings), store.attributes(self._group)
        for key in first.keys() - attrs.keys():
            del self._group.attrs[key]
        same = {key for key in first.keys() & attrs.keys() if as_json(attrs[key]) == as_json(first[key])}
        store.set_attributes(self._group, {key: value for key, value in attrs.items() if key not in same})
