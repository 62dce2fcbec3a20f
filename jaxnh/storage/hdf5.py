"""Result files: netCDF4-compatible HDF5, written whole or not at all, and sealed with checksums. No JAX.

Every variable carries the SHA-256 of its data, and the file that of all the rest, so that a single changed bit anywhere
is found. Blocks of large variables have HDF5's own checksum besides.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

if TYPE_CHECKING:
    from jaxnh.analyses.base import Group

SEAL = "content_sha256"
"""Root attribute: hash of all names, shapes, dimensions and attributes, those with the hashes of the data included."""

DATA = "sha256"
"""Attribute of a variable: hash of its numbers as they lie in memory."""

_LARGE = 1 << 14  # bytes; smaller variables are stored in one piece
_CHUNK = 1 << 20  # bytes a block of a large one
_LEVEL = 1  # of gzip: digits of chaos do not compress, and higher levels take longer to find that out
_VERSION = ("v110", "v110")  # of the file format: from this one on HDF5 keeps checksums of its own tables
_OF_SCALES = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates")


class StoreError(Exception):
    """A result file cannot be read or written; the message is one sentence."""


# ---- writing


class _Sink(io.RawIOBase):
    """A file for HDF5 to write in that never says no: HDF5 cannot close one that a full disk kept it from writing.

    The first error is kept in `error`, and from then on nothing is written.
    """

    def __init__(self, handle: int) -> None:
        self.error: OSError | None = None
        self._handle, self._at = handle, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: os.fstat(self._handle).st_size}[whence]
        self._at = base + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        data = os.pread(self._handle, len(view), self._at)
        view[: len(data)] = data
        view[len(data) :] = bytes(len(view) - len(data))
        self._at += len(view)
        return len(view)

    def write(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        done = 0
        while self.error is None and done < len(view):
            try:
                done += os.pwrite(self._handle, view[done:], self._at + done)
            except OSError as error:
                self.error = error
        self._at += len(view)
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        size = self._at if size is None else size
        try:
            os.ftruncate(self._handle, size)
        except OSError as error:
            self.error = self.error or error
        return size

    def check(self) -> None:
        """Raise the error that a write has met."""
        if self.error is not None:
            raise self.error


@contextlib.contextmanager
def writing(path: Path, *, checked: bool = False) -> Iterator[tuple[Any, _Sink]]:
    """A new HDF5 file under a temporary name in the same folder; at the end it is sealed, synced and renamed.

    Killed at any moment, this leaves either what was there before or the whole file under the final name.

    Args:
        checked: read all of it back before it gets its name.

    Raises:
        StoreError: the folder or the disk refuses.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    except OSError as error:
        raise StoreError(f"cannot write in {path.parent}: {error.strerror or error}") from error
    temporary, sink = Path(name), _Sink(handle)
    try:
        with h5py.File(sink, "w", track_order=True, libver=_VERSION) as file:
            yield file, sink
            if SEAL not in file.attrs:
                file.attrs[SEAL] = _digest(file)
        sink.check()
        os.fchmod(handle, 0o666 & ~_umask())
        os.fsync(handle)
        if checked:
            verify(temporary)
        temporary.replace(path)
        sync(path.parent)
    except (OSError, RuntimeError) as error:
        raise StoreError(f"cannot write {path}: {sink.error or error}") from error
    finally:
        os.close(handle)
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write(path: Path, attrs: Mapping[str, Any], groups: Mapping[str, Group]) -> str:
    """Write a result file, whole or not at all; returns its seal.

    Raises:
        StoreError: the folder or the disk refuses.
    """
    with writing(path) as (file, _):
        for key, value in attrs.items():
            file.attrs[key] = value
        for name, group in groups.items():
            _write_group(file.create_group(name, track_order=True), group)
        file.attrs[SEAL] = seal = _digest(file)
    return seal


def _write_group(target: Any, group: Group) -> None:
    attrs = {**group.attrs, "warnings": "\n".join(group.warnings)} if group.warnings else group.attrs
    for key, value in attrs.items():
        target.attrs[key] = value
    for name, variable in group.variables.items():
        data = variable.data
        dataset = create(target, name, data.shape, data.dtype)
        dataset[...] = data.astype(h5py.string_dtype()) if data.dtype.kind == "U" else data
        dataset.attrs["long_name"] = variable.long_name
        dataset.attrs["units"] = variable.units
        for key, value in variable.attrs.items():
            dataset.attrs[key] = value
        dataset.attrs[DATA] = checksum(data).hexdigest()
    attach(target, {name: variable.dims for name, variable in group.variables.items()})


def create(target: Any, name: str, shape: tuple[int, ...], dtype: Any, rows: int = 0) -> Any:
    """A variable still without data. A large one lies in blocks of so many whole rows, or about a megabyte of them."""
    dtype = h5py.string_dtype() if np.dtype(dtype).kind == "U" else np.dtype(dtype)
    size = math.prod(shape) * dtype.itemsize
    if size <= _LARGE or h5py.check_string_dtype(dtype):
        return target.create_dataset(name, shape, dtype)
    rows = rows or max(1, _CHUNK * shape[0] // size)
    rows = min(shape[0], 1 << (rows.bit_length() - 1))
    chunks = (rows, *shape[1:])
    return target.create_dataset(
        name, shape, dtype, chunks=chunks, shuffle=True, compression="gzip", compression_opts=_LEVEL, fletcher32=True
    )


def attach(target: Any, dims: Mapping[str, tuple[str, ...]]) -> None:
    """Make every axis a dimension scale, with an index where no variable has its name."""
    for name, axes in dims.items():
        for axis, dim in enumerate(axes):
            if dim not in target:
                index = np.arange(target[name].shape[axis])
                target.create_dataset(dim, data=index)
                target[dim].attrs.update({"long_name": f"index along {dim}", "units": "1"})
                target[dim].attrs[DATA] = checksum(index).hexdigest()
            if not target[dim].is_scale:
                target[dim].make_scale(dim)
            if name != dim:
                target[name].dims[axis].attach_scale(target[dim])


# ---- reading


def dimensions(dataset: Any) -> tuple[str, ...]:
    """Names of the dimensions of a variable."""
    own = dataset.name.rsplit("/", 1)[1]
    if dataset.is_scale:
        return (own,)
    return tuple(axis[0].name.rsplit("/", 1)[1] if len(axis) else "" for axis in dataset.dims)


def attributes(item: Any) -> dict[str, Any]:
    """Attributes of a file, group or variable, without those that HDF5's dimension scales need."""
    return {key: item.attrs[key] for key in item.attrs if key not in _OF_SCALES}


def read_attrs(path: Path, group: str = "/") -> dict[str, Any]:
    """Root attributes of a result file, or those of a group that is there.

    Raises:
        StoreError: the file is not HDF5, is damaged, or is none of ours.
    """
    try:
        with h5py.File(path, "r") as file:
            attrs, found = dict(file.attrs), dict(file[group].attrs)
    except OSError as error:
        raise StoreError(f"{path} is not a readable HDF5 file") from error
    if "jaxnh_version" not in attrs:
        raise StoreError(f"{path} is an HDF5 file, but not a result of jaxnh")
    return found


def read_variables(path: Path, group: str) -> dict[str, np.ndarray]:
    """All arrays of one group, by name; text as an array of strings.

    Raises:
        StoreError: the file cannot be read or has no such group.
    """
    try:
        with h5py.File(path, "r") as file:
            return {name: read(item) for name, item in file.require_group(group).items()}
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise StoreError(f"{path} has no readable group {group}") from error


def read(dataset: Any, rows: slice = slice(None)) -> np.ndarray:
    """Data of a variable, or some of its rows; text as an array of strings."""
    where = rows if dataset.ndim else ()
    return dataset.asstr()[where].astype(str) if h5py.check_string_dtype(dataset.dtype) else dataset[where]


# ---- checksums


def checksum(data: np.ndarray, begun: Any = None) -> Any:
    """SHA-256 of an array, or of those before it and then this one."""
    found = begun or hashlib.sha256()
    if data.dtype.kind == "U":
        found.update("".join(f"{word}\0" for word in data.ravel()).encode())
    else:
        found.update(np.ascontiguousarray(data).data)
    return found


def blocks(dataset: Any) -> Iterator[np.ndarray]:
    """The data of a variable, some megabytes of rows at a time."""
    rows = len(dataset) if dataset.ndim else 0
    many = max(rows, 1)
    if dataset.chunks:
        block = dataset.chunks[0] * dataset.nbytes // rows
        many = dataset.chunks[0] * max(1, 8 * _CHUNK // block)
    for first in range(0, max(rows, 1), many):
        yield read(dataset, slice(first, first + many))


def verify(path: Path) -> None:
    """Read all of a file, and compare with the checksums it carries.

    Raises:
        StoreError: something differs or cannot be read, or there are no checksums; the message names what.
    """
    name = ""
    try:
        with h5py.File(path, "r") as file:
            if SEAL not in file.attrs:
                raise StoreError(f"{path} has no checksums")
            content: Any = file
            for group in content.values():
                for item in group.values():
                    name, found = item.name, hashlib.sha256()
                    for block in blocks(item):
                        found = checksum(block, found)
                    if found.hexdigest() != item.attrs[DATA]:
                        raise StoreError(f"{path}: the data of {name} do not fit their checksum")
            if file.attrs[SEAL] != _digest(file):
                raise StoreError(f"{path}: names or attributes do not fit their checksum")
    except StoreError:
        raise
    except Exception as error:  # whatever HDF5 makes of damaged tables
        raise StoreError(f"{path}: {name or 'the file'} cannot be read: it is damaged") from error


def _digest(file: Any) -> str:
    """Hash of everything in a file but its data, for which their own hashes stand."""
    found = hashlib.sha256()

    def add(*content: Any) -> None:
        found.update(json.dumps(content, default=_plain, sort_keys=True).encode())

    add({key: value for key, value in attributes(file).items() if key != SEAL})
    for group_name, group in file.items():
        add(group_name, attributes(group))
        for name, item in group.items():
            add(name, item.shape, item.dtype.str, dimensions(item), attributes(item))
    return found.hexdigest()


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else repr(value)


# ---- folders


def check_writable(path: Path) -> None:
    """Make the folder of an output and see that a file can be made in it, without leaving one.

    Raises:
        StoreError: it cannot; the message names the folder and the reason.
    """
    if path.is_dir():
        raise StoreError(f"{path} is a folder, not a file to write")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise StoreError(f"cannot write in {path.parent}: {error.strerror or error}") from error


def sync(path: Path) -> None:
    """Have the content of a file or folder on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
