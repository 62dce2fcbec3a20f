"""Result files as trees."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from jaxnh.exceptions import ResultError


def open_result(path: Path) -> xr.DataTree:
    """All of a result file.

    Raises:
        ResultError: the file is not there, is damaged, or is none of ours.
    """
    try:
        tree = xr.open_datatree(path, engine="h5netcdf").load()
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise ResultError(f"{path} is not a readable result file: {error}") from error
    if "jaxnh_version" not in tree.attrs:
        raise ResultError(f"{path} is an HDF5 file, but not a result of jaxnh")
    return tree
