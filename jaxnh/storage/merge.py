"""Pieces of a sweep into one result file: block by block, so that no more than a tile is ever in memory. No JAX."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxnh.storage import hdf5 as store
from jaxnh.storage.tiles import Damaged, Job, Piece, piece_path

_COPIED = 1 << 16  # bytes; blocks at least so large go from tile to result as they are
_COLLECTED = 1 << 26  # bytes; a variable of smaller blocks is put together in memory up to this


class Unusable(Exception):
    """A piece proves damaged while it is merged: which, and why."""

    def __init__(self, piece: Piece, why: str) -> None:
        super().__init__(why)
        self.piece, self.why = piece, why


@dataclass(frozen=True)
class Extra:
    """What a group gets beside what its pieces say: attributes that count lanes of the whole sweep, and warnings."""

    attrs: Mapping[str, Any]
    warnings: tuple[str, ...]


def merge(
    path: Path,
    attrs: Mapping[str, Any],
    folder: Path,
    job: Job,
    extras: Mapping[str, Extra],
    heed: Callable[[], None] = lambda: None,
) -> None:
    """Write the result of a job whose pieces are all there; it is read back before it gets its name.

    Args:
        attrs: root attributes.
        extras: by analysis.
        heed: called between pieces; may raise to end it, and then nothing is written.

    Raises:
        Unusable: a piece is not what its checksums say.
        store.StoreError: the folder or the disk refuses.
    """
    pieces = job.pieces()
    with store.writing(path, checked=True) as (file, sink):
        for key, value in attrs.items():
            file.attrs[key] = value
        for name in job.order:
            sources = [(piece, piece_path(folder, piece)) for piece in pieces if name in piece.names]
            joined = _Joined(file.create_group(name, track_order=True), job.lanes, len(sources) > 1)
            for piece, source in sources:
                heed()
                sink.check()
                try:
                    joined.add(piece, source)
                except Damaged as error:
                    raise Unusable(piece, str(error)) from None
            joined.finish(extras[name])
            sink.check()


class _Joined:
    """A group of the result in the making."""

    def __init__(self, target: Any, lanes: int, many: bool) -> None:
        self._target, self._lanes, self._many = target, lanes, many
        self._name = str(target.name)[1:]
        self._dims: dict[str, tuple[str, ...]] = {}
        self._hashes: dict[str, Any] = {}
        self._collected: dict[str, list[np.ndarray]] = {}

    def add(self, piece: Piece, path: Path) -> None:
        """The next piece, in order."""
        with contextlib.ExitStack() as stack:
            try:
                file: Any = stack.enter_context(h5py.File(path, "r"))
                group = file[self._name]
                data = {name: store.read(item) for name, item in group.items()}
                stated = {name: item.attrs[store.DATA] for name, item in group.items()}
            except Exception as error:  # whatever HDF5 makes of damaged tables
                raise Damaged("it is cut off or damaged") from error
            for name, values in data.items():
                if store.checksum(values).hexdigest() != stated[name]:
                    raise Damaged(f"the data of /{self._name}/{name} do not fit their checksum")
            if not self._dims:
                self._begin(group)
            if set(data) != set(self._dims):
                raise Damaged("its variables are not those of the other tiles")
            for name, values in data.items():
                self._put(name, group[name], values, piece)

    def _begin(self, first: Any) -> None:
        """Empty variables with the attributes of the first piece's."""
        self._target.attrs.update(store.attributes(first))
        for name, item in first.items():
            self._dims[name] = store.dimensions(item)
            shape = (self._lanes, *item.shape[1:]) if self._grows(name) else item.shape
            dtype = np.dtype("U") if h5py.check_string_dtype(item.dtype) else item.dtype
            rows = item.chunks[0] if self._grows(name) and item.chunks else 0
            row = math.prod(item.shape[1:]) * item.dtype.itemsize
            if self._grows(name) and rows * row < _COPIED and self._lanes * row < _COLLECTED:
                self._collected[name], rows = [], 0
            elif self._grows(name):
                rows = rows or item.shape[0]
            dataset = store.create(self._target, name, shape, dtype, rows)
            dataset.attrs.update(store.attributes(item))

    def _grows(self, name: str) -> bool:
        return self._many and self._dims[name][:1] == ("b",)

    def _put(self, name: str, source: Any, values: np.ndarray, piece: Piece) -> None:
        target = self._target[name]
        if not self._grows(name):
            if name not in self._hashes:
                self._hashes[name] = store.checksum(values)
                target[...] = values.astype(h5py.string_dtype()) if values.dtype.kind == "U" else values
            elif target.attrs[store.DATA] != source.attrs[store.DATA]:
                raise Damaged(f"{name} is not that of the other tiles")
            return
        if len(values) != piece.end - piece.first:
            raise Damaged(f"{name} has {len(values)} lanes in place of {piece.end - piece.first}")
        self._hashes[name] = store.checksum(values, self._hashes.get(name))
        if name in self._collected:
            self._collected[name].append(values)
        elif source.chunks and source.chunks == target.chunks and piece.first % target.chunks[0] == 0:
            for k in range(source.id.get_num_chunks()):
                offset = source.id.get_chunk_info(k).chunk_offset
                mask, block = source.id.read_direct_chunk(offset)
                target.id.write_direct_chunk((piece.first + offset[0], *offset[1:]), block, mask)
        else:
            target[piece.first : piece.end] = values

    def finish(self, extra: Extra) -> None:
        """What is known at the end: collected variables, hashes, scales, and attributes of the whole."""
        for name, parts in self._collected.items():
            self._target[name][...] = np.concatenate(parts)
        for name, found in self._hashes.items():
            self._target[name].attrs[store.DATA] = found.hexdigest()
        store.attach(self._target, self._dims)
        self._target.attrs.update(extra.attrs)
        if extra.warnings:
            self._target.attrs["warnings"] = "\n".join(extra.warnings)
