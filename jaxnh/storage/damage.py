"""Damage of a file that could not be read: concluded from its checksums or from HDF5, never by default."""

from __future__ import annotations

from pathlib import Path

from jaxnh.exceptions import DamagedError
from jaxnh.storage.hdf5 import SEAL, read_attrs, verify

READING = (OSError, KeyError, RuntimeError, ValueError, TypeError)
"""Exceptions of h5py and xarray where a file is damaged; any of these may as well be a fault of a program."""


def fault_of(path: Path, error: Exception) -> Exception:
    """Classify an error in the reading of a result: damage, if the file does not fit its checksums; else that error.

    A file without checksums is called damaged where HDF5 cannot read it, which is an `OSError`.
    """
    try:
        if SEAL in read_attrs(path):
            verify(path)
        elif isinstance(error, OSError):
            return DamagedError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}")
    except DamagedError as damage:
        return damage
    return error
