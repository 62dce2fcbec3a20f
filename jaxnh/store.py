"""Result files: one netCDF4-compatible HDF5 file, written whole or not at all. No JAX."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

if TYPE_CHECKING:
    from jaxnh.analyses.record import Group, Variable


class StoreError(Exception):
    """A result file cannot be read or written; the message is one sentence."""


def write(path: Path, attrs: Mapping[str, Any], groups: Mapping[str, Group]) -> None:
    """Write a result file under a temporary name in the same folder, sync it, then rename it and sync the folder.

    Killed at any moment, this leaves either no file or the whole file under the final name.

    Raises:
        StoreError: the folder or the disk refuses.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
    except OSError as error:
        raise StoreError(f"cannot write in {path.parent}: {error.strerror or error}") from error
    try:
        # Made in memory: HDF5 cannot close a file that a full disk kept it from writing, and ends the process.
        with h5py.File(path.name, "w", driver="core", backing_store=False, track_order=True) as file:
            for key, value in attrs.items():
                file.attrs[key] = value
            for group_name, group in groups.items():
                _write_group(file.create_group(group_name, track_order=True), group)
            file.flush()
            temporary.write_bytes(file.id.get_file_image())
        temporary.chmod(0o666 & ~_umask())
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    except (OSError, RuntimeError) as error:
        raise StoreError(f"cannot write {path}: {error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _write_group(target: h5py.Group, group: Group) -> None:
    for key, value in group.attrs.items():
        target.attrs[key] = value
    if group.warnings:
        target.attrs["warnings"] = "\n".join(group.warnings)
    datasets = {name: _write_variable(target, name, variable) for name, variable in group.variables.items()}
    for name, variable in group.variables.items():
        for axis, dim in enumerate(variable.dims):
            if dim not in datasets:
                datasets[dim] = target.create_dataset(dim, data=np.arange(variable.data.shape[axis]))
                datasets[dim].attrs["long_name"] = f"index along {dim}"
                datasets[dim].attrs["units"] = "1"
            if not datasets[dim].is_scale:
                datasets[dim].make_scale(dim)
            if name != dim:
                datasets[name].dims[axis].attach_scale(datasets[dim])


def _write_variable(target: h5py.Group, name: str, variable: Variable) -> h5py.Dataset:
    text = variable.data.dtype.kind == "U"
    data = variable.data.astype(h5py.string_dtype()) if text else variable.data
    large = data.nbytes > 1 << 14 and not text
    options = {"shuffle": True, "compression": "gzip", "fletcher32": True} if large else {}
    dataset = target.create_dataset(name, data=data, **options)
    dataset.attrs["long_name"] = variable.long_name
    dataset.attrs["units"] = variable.units
    for key, value in variable.attrs.items():
        dataset.attrs[key] = value
    return dataset


def read_attrs(path: Path) -> dict[str, Any]:
    """Root attributes of a result file.

    Raises:
        StoreError: the file is not HDF5, is damaged, or is none of ours.
    """
    try:
        with h5py.File(path, "r") as file:
            attrs = dict(file.attrs)
    except OSError as error:
        raise StoreError(f"{path} is not a readable HDF5 file") from error
    if "jaxnh_version" not in attrs:
        raise StoreError(f"{path} is an HDF5 file, but not a result of jaxnh")
    return attrs


def read_variables(path: Path, group: str) -> dict[str, np.ndarray]:
    """All arrays of one group, by name; text as an array of strings.

    Raises:
        StoreError: the file cannot be read or has no such group.
    """
    try:
        with h5py.File(path, "r") as file:
            return {
                name: item.asstr()[()].astype(str) if h5py.check_string_dtype(item.dtype) else item[()]
                for name, item in file.require_group(group).items()
            }
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise StoreError(f"{path} has no readable group {group}") from error


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


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
