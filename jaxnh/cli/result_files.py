"""Result files that commands are given."""

from __future__ import annotations

from pathlib import Path

from jaxnh.exceptions import InputError


def check_result(file: Path) -> None:
    """Check that a result is there, as a file.

    Raises:
        InputError: it is not; the message says where a run of it has been begun.
    """
    if file.is_file():
        return
    unfinished = file.with_name(f"{file.name}.tiles").is_dir()  # as `storage.tiles.folder_of`, which h5py comes with
    advice = "; a run of it was begun and is not at its end: run the same sweep again to go on" if unfinished else ""
    raise InputError(f"command line: FILE: {file} is {'a folder' if file.is_dir() else 'not there'}{advice}")
