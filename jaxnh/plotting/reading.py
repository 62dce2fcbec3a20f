"""Result files as trees in memory."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from jaxnh.storage.damage import READING, fault_of
from jaxnh.storage.hdf5 import open_result


def load_result(path: Path) -> xr.DataTree:
    """All of a result file, in memory.

    Raises:
        ResultError: the file is not there, is damaged, or is none of ours.
    """
    with open_result(path) as tree:
        try:
            return tree.load()
        except READING as error:
            raise fault_of(path, error) from error
