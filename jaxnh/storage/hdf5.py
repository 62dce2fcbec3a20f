"""Result files: datasets as netCDF4-compatible HDF5, written whole or not at all, and sealed with checksums.

Every variable carries the SHA-256 of its data, and the file that of all the rest, so that a single changed bit
shows. Blocks of large variables have HDF5's own checksum besides.

Results are read by xarray (`open_result`, `read_group`). They are written by h5py, since `Dataset.to_netcdf` and
h5netcdf cannot do what a long run needs: replace a file in one step and survive a full disk (`atomic`), seal its
content, and take a variable piece by piece, compressed blocks of a tile as they are (`merge`). What is larger than
memory is read by h5py as well, in blocks (`blocks`).
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import h5py
import numpy as np

from jaxnh.exceptions import DamagedError, ResultError, take_path
from jaxnh.jobs.arrays import DATA, Attributes, Hash, as_text, checksum, index_words, plain
from jaxnh.storage import parts
from jaxnh.storage.atomic import Sink, replace_atomically
from jaxnh.storage.chunks import row_chunks

if TYPE_CHECKING:
    import xarray as xr  # imported where a dataset is read: with pandas it takes longer than all else here

SEAL = "content_sha256"
"""Root attribute: hash of all names, shapes, dimensions and attributes, those with the hashes of the data included."""

UNREADABLE = (OSError, KeyError, ValueError, RuntimeError, TypeError, MemoryError)
"""Exceptions of HDF5, h5py and xarray where tables or data of a file are damaged."""

_LARGE = 1 << 14  # bytes; smaller variables are stored in one piece
_READ = 1 << 23  # bytes that are read at once
_LEVEL = 1  # of gzip: digits of chaos do not compress, and higher levels take longer to find that out
VERSION = ("v110", "v110")  # of the file format: from this one on HDF5 keeps checksums of its own tables
_OF_SCALES = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates")
_AS_STORED = {"engine": "h5netcdf", "decode_times": False, "mask_and_scale": False}  # units are words here

_Item = TypeVar("_Item")


class LayoutError(DamagedError, TypeError):
    """A file holds something that no result has, as a variable outside of groups; the message is a sentence."""


class _VariableHeader(NamedTuple):
    """A variable but for its data."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    dims: tuple[str, ...]
    attrs: Attributes


# ---- writing


@contextlib.contextmanager
def write_sealed(path: Path, *, checked: bool = False) -> Iterator[tuple[h5py.File, Sink]]:
    """Write a new HDF5 file, sealed and synced before it gets its name; after an exception the former file stays.

    Args:
        checked: read all of it back before it gets its name.

    Raises:
        ResultError: the folder or the disk refuses.
    """
    with replace_atomically(path) as sink:
        with h5py.File(sink, "w", track_order=True, libver=VERSION) as file:
            yield file, sink
            if SEAL not in file.attrs:
                file.attrs[SEAL] = digest(file)
        sink.settle()
        if checked:
            verify(sink.path)


def write(path: Path, attrs: Mapping[str, Any], groups: Mapping[str, xr.Dataset]) -> str:
    """Write a result file, whole or not at all; returns its seal.

    In a group the coordinates of the axes come first, then all variables in the order of their dataset, then an index
    for every dimension without a coordinate.

    Args:
        attrs: root attributes; `axes`, if it is there, has the names of the axes in order, separated by blanks.
        groups: by name; their attribute `warnings` is left out where it is empty.

    Raises:
        ResultError: the folder or the disk refuses.
    """
    with write_sealed(path) as (file, _):
        set_attributes(file, attrs)
        axes = str(attrs.get("axes", "")).split()
        written = [_write_group(file.create_group(name, track_order=True), data, axes) for name, data in groups.items()]
        seal = _seal_of(attrs, ((name, *content) for name, content in zip(groups, written, strict=True)))
        file.attrs[SEAL] = seal
    return seal


def _write_group(
    target: h5py.Group, dataset: xr.Dataset, axes: Sequence[str]
) -> tuple[Attributes, list[_VariableHeader]]:
    attrs = {str(key): value for key, value in dataset.attrs.items() if key != "warnings" or value}
    set_attributes(target, attrs)
    names = [str(name) for name in dataset.variables]
    first = [axis for axis in axes if axis in dataset.variables and dataset.variables[axis].dims == (axis,)]
    names = [*first, *(name for name in names if name not in first)]
    written = list[_VariableHeader]()
    for name in names:
        content = dataset.variables[name]
        data = as_text(np.asarray(content.values))
        item = create(target, name, data.shape, data.dtype)
        item[...] = as_stored(data)
        own = {**content.attrs, **_coordinates(dataset, name), DATA: checksum(data).hexdigest()}
        set_attributes(item, own)
        written.append(_VariableHeader(name, data.shape, item.dtype.str, tuple(map(str, content.dims)), own))
    return attrs, written + attach(target, {item.name: item.dims for item in written})


def _coordinates(dataset: xr.Dataset, name: str) -> dict[str, str]:
    """The attribute by which CF names the coordinates of a variable that are no dimensions."""
    own = dataset.variables[name]
    if "coordinates" in own.attrs or name in dataset.coords:
        return {}
    others = [
        str(key)
        for key, coordinate in dataset.coords.items()
        if key not in dataset.dims and set(coordinate.dims) <= set(own.dims)
    ]
    return {"coordinates": " ".join(others)} if others else {}


def set_attributes(target: h5py.File | h5py.Group | h5py.Dataset, attrs: Mapping[Any, Any]) -> None:
    """Give a file, group or variable attributes, in their order."""
    attributes = target.attrs
    for key, value in attrs.items():
        attributes[key] = value


def create(
    target: h5py.Group, name: str, shape: tuple[int, ...], dtype: Any, chunks: tuple[int, ...] | None = None
) -> h5py.Dataset:
    """Create a variable without data; a large one in blocks, by default of about a megabyte of whole rows."""
    dtype = h5py.string_dtype() if np.dtype(dtype).kind == "U" else np.dtype(dtype)
    if math.prod(shape) * dtype.itemsize <= _LARGE or h5py.check_string_dtype(dtype):
        return target.create_dataset(name, shape, dtype)
    return target.create_dataset(
        name,
        shape,
        dtype,
        chunks=chunks or row_chunks(shape, dtype.itemsize),
        shuffle=True,
        compression="gzip",
        compression_opts=_LEVEL,
        fletcher32=True,
    )


def attach(target: h5py.Group, dims: Mapping[str, tuple[str, ...]]) -> list[_VariableHeader]:
    """Make every axis a dimension scale, with an index where no variable has its name; return the added ones."""
    added, scales = list[_VariableHeader](), dict[str, h5py.Dataset]()
    for name, axes in dims.items():
        item = variable(target, name)
        for axis, dim in enumerate(axes):
            if dim not in scales:
                if dim not in target:
                    index = np.arange(item.shape[axis])
                    own = {**index_words(dim), DATA: checksum(index).hexdigest()}
                    set_attributes(target.create_dataset(dim, data=index), own)
                    added.append(_VariableHeader(dim, index.shape, index.dtype.str, (dim,), own))
                scales[dim] = variable(target, dim)
                if not scales[dim].is_scale:
                    scales[dim].make_scale(dim)
            if name != dim:
                item.dims[axis].attach_scale(scales[dim])
    return added


def as_stored(data: np.ndarray) -> np.ndarray:
    """Data as h5py takes them."""
    return data.astype(h5py.string_dtype()) if data.dtype.kind == "U" else data


# ---- reading


def open_result(path: str | Path) -> xr.DataTree:
    """Open a result file as a tree with a dataset for each group; data are read when they are used.

    Close it, or use it in a `with`; `load()` reads all of it.

    Raises:
        InputError: that is no path.
        ResultError: the file is not there, is not HDF5, is damaged, or is not a result of jaxnh.
    """
    import xarray as xr

    path = take_path(path, "open_result", "result file")
    read_attrs(path)
    try:
        return xr.open_datatree(path, **_AS_STORED)
    except UNREADABLE as error:
        raise DamagedError(f"{path} cannot be read: it is damaged") from error


def read_group(path: Path, group: str) -> xr.Dataset:
    """One group, in memory; text as NumPy's own.

    Raises:
        ResultError: the file cannot be read or has no such group.
    """
    import xarray as xr

    try:
        h5py.File(
            path, "r"
        ).close()  # h5netcdf leaves a half-made object behind where this fails, with words of its own
        return xr.load_dataset(path, group=group, **_AS_STORED)
    except UNREADABLE as error:
        raise ResultError(f"{path} has no readable group {group}") from error


def read_attrs(path: Path, group: str = "/") -> Attributes:
    """Root attributes of a result file, or those of a group.

    Raises:
        ResultError: the file is not there, is not HDF5, is damaged, is none of ours, or has no such group.
    """
    if not path.is_file():
        raise ResultError(f"{path} is {'a folder' if path.is_dir() else 'not there'}")
    try:
        with h5py.File(path, "r") as file:
            attrs = dict(file.attrs)
            attributes = dict(file[group].attrs) if group in file else None
    except UNREADABLE as error:
        raise ResultError(f"{path} is not a readable HDF5 file") from error
    if "jaxnh_version" not in attrs:
        raise ResultError(f"{path} is an HDF5 file, but not a result of jaxnh")
    parts.check(path, attrs)
    if attributes is None:
        raise ResultError(f"{path} has no group {group}")
    return attributes


def groups(file: h5py.File) -> dict[str, h5py.Group]:
    """Groups of a file, in their order.

    Raises:
        LayoutError: there is something else in it.
    """
    return {name: _expected(item, h5py.Group) for name, item in file.items()}


def variables(group: h5py.Group) -> dict[str, h5py.Dataset]:
    """Variables of a group, in their order.

    Raises:
        LayoutError: there is something else in it.
    """
    return {name: _expected(item, h5py.Dataset) for name, item in group.items()}


def variable(group: h5py.Group, name: str) -> h5py.Dataset:
    """One variable of a group.

    Raises:
        KeyError: there is none.
        LayoutError: it is something else.
    """
    return _expected(group[name], h5py.Dataset)


def _expected(item: h5py.HLObject | None, kind: type[_Item]) -> _Item:
    if item is None:
        raise TypeError("a name in the file leads nowhere")
    if not isinstance(item, kind):
        what, name = ("group", str(item.name)) if isinstance(item, h5py.Group) else ("variable", str(item.name))
        where = "within a group" if what == "group" else "outside of all groups"
        raise LayoutError(f"{item.file.filename} has the {what} {name} {where}, and no result of jaxnh has")
    return item


def dimensions(item: h5py.Dataset) -> tuple[str, ...]:
    """Names of the dimensions of a variable."""
    if item.is_scale:
        return (_last(item),)
    return tuple(_last(axis[0]) if len(axis) else "" for axis in item.dims)


def _last(item: h5py.Dataset) -> str:
    return str(item.name).rsplit("/", 1)[1]


def attributes(item: h5py.File | h5py.Group | h5py.Dataset) -> Attributes:
    """Attributes of a file, group or variable, without those that HDF5's dimension scales need."""
    return {key: item.attrs[key] for key in item.attrs if key not in _OF_SCALES}


def read(item: h5py.Dataset, where: Any = ()) -> np.ndarray:
    """Data of a variable, or those of some slices; text as an array of strings."""
    if h5py.check_string_dtype(item.dtype):
        return np.asarray(item.asstr()[where], object).astype(str)
    return np.asarray(item[where])


def blocks(item: h5py.Dataset) -> Iterator[np.ndarray]:
    """The data of a variable in C order, some megabytes at a time.

    A variable that lies in blocks is cut along the first dimension on which these have more than one place.
    """
    chunks = row_chunks(item.shape, item.dtype.itemsize) if item.is_virtual else item.chunks
    if not item.ndim or not chunks:
        yield read(item)
        return
    cut = next((k for k, size in enumerate(chunks) if size > 1), item.ndim - 1)
    while cut and math.prod(item.shape[cut:]) * item.dtype.itemsize <= _READ:
        cut -= 1
    size = chunks[cut] * math.prod(item.shape[cut + 1 :]) * item.dtype.itemsize
    many = chunks[cut] * max(1, _READ // max(size, 1))
    for place in itertools.product(*(range(n) for n in item.shape[:cut])):
        for first in range(0, item.shape[cut], many):
            yield read(item, (*place, slice(first, first + many)))


# ---- checksums


def checksum_of(item: h5py.Dataset) -> str:
    """SHA-256 of the data of a variable, read in blocks."""
    digest: Hash = hashlib.sha256()
    for block in blocks(item):
        digest = checksum(block, digest)
    return digest.hexdigest()


def verify(path: Path) -> None:
    """Read all of a file, and compare with the checksums it carries.

    Raises:
        DamagedError: something differs or cannot be read, or there are no checksums; the message names what.
    """
    name = ""
    try:
        with h5py.File(path, "r") as file:
            if SEAL not in file.attrs:
                raise DamagedError(f"{path} has no checksums")
            for group in groups(file).values():
                for item in variables(group).values():
                    name = item.name
                    if checksum_of(item) != item.attrs[DATA]:
                        raise DamagedError(f"{path}: the data of {name} do not fit their checksum")
            if file.attrs[SEAL] != digest(file):
                raise DamagedError(f"{path}: names or attributes do not fit their checksum")
    except UNREADABLE as error:
        raise DamagedError(f"{path}: {name or 'the file'} cannot be read: it is damaged") from error


def digest(file: h5py.File) -> str:
    """Hash of everything in a file but its data, for which their own hashes stand."""
    content = (
        (
            name,
            attributes(group),
            [
                _VariableHeader(name, item.shape, item.dtype.str, dimensions(item), attributes(item))
                for name, item in variables(group).items()
            ],
        )
        for name, group in groups(file).items()
    )
    return _seal_of(attributes(file), content)


def _seal_of(attrs: Mapping[str, Any], groups: Iterable[tuple[str, Attributes, Sequence[_VariableHeader]]]) -> str:
    """The hash of a file with these root attributes, groups, and their attributes and variables."""
    seal = hashlib.sha256()

    def add(*content: Any) -> None:
        seal.update(json.dumps(content, default=plain, sort_keys=True).encode())

    add({key: value for key, value in attrs.items() if key != SEAL})
    for name, of_group, described in groups:
        add(name, of_group)
        for item in described:
            add(*item)
    return seal.hexdigest()
