"""Files of pieces that stay part of a result: links to them in a folder beside it, to which virtual datasets lead.

HDF5 keeps the file of every piece that it has read open, and gives fill values, without an error, for one that it
cannot open: so there are few of them, and a result whose files are not all there is refused.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxnh.exceptions import DamagedError, ResultError

FOLDER, COUNT = "parts_folder", "parts_files"
"""Root attributes of a result that leads to other files: their folder beside it, and how many there are."""

MOST = 200
"""Files of pieces of one result, at most: some systems let a process have 256 files open."""

_OURS = "[0-9]*.h5"


def folder_of(path: Path) -> Path:
    """Folder of the files that a result leads to."""
    return path.with_name(f"{path.name}.parts")


def link(path: Path, files: Iterable[Path]) -> dict[str, Any]:
    """Link files into the folder of a result, in place of those that are there, and return its root attributes.

    Raises:
        ResultError: there are too many of them, or the file system has no links.
    """
    files, folder = list(files), folder_of(path)
    if len(files) > MOST:
        raise ResultError(
            f"{len(files)} tiles are more files than HDF5 can read as one, {MOST}: "
            "merge without --virtual, or begin anew with a --tile of more lanes"
        )
    try:
        folder.mkdir(exist_ok=True)
        for file in files:
            new = folder / f".{file.name}.part"
            new.unlink(missing_ok=True)
            os.link(file, new)
            os.replace(new, folder / file.name)
        for left in {entry.name for entry in folder.glob(_OURS)} - {file.name for file in files}:
            (folder / left).unlink()
    except OSError as error:
        raise ResultError(f"cannot link tiles into {folder}: {error.strerror or error}") from error
    return {FOLDER: folder.name, COUNT: len(files)}


def check(path: Path, attrs: Mapping[str, Any]) -> None:
    """Check that the files that a result leads to are there.

    Args:
        attrs: its root attributes.

    Raises:
        DamagedError: some are not.
    """
    if FOLDER not in attrs:
        return
    folder, count = path.with_name(str(attrs[FOLDER])), int(attrs[COUNT])
    there = len(list(folder.glob(_OURS)))
    if there < count:
        raise DamagedError(f"{path} has its data in {folder}, where {there} of {count} files are")


def remove(path: Path) -> None:
    """Remove the files that a former result led to, once it leads to none."""
    with contextlib.suppress(OSError):
        for entry in folder_of(path).glob(_OURS):
            entry.unlink()
        folder_of(path).rmdir()
