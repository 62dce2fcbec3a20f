"""Result files as trees in memory."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from jaxnh.exceptions import DamagedError
from jaxnh.storage.hdf5 import UNREADABLE, open_result


def load_result(path: Path) -> xr.DataTree:
    """All of a result file, in memory.

    Raises:
        ResultError: the file is not there, is damaged, or is none of ours.
    """
    with open_result(path) as tree:
        try:
            return tree.load()
        except UNREADABLE as error:
            raise DamagedError(f"{path} cannot be read: it is damaged") from error
