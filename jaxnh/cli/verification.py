"""Lanes of a result computed anew, and compared with what the file has."""

from __future__ import annotations

from pathlib import Path

from jaxnh.engine import verification
from jaxnh.exceptions import ArgumentError, ConfigError, InputError, ResultError
from jaxnh.storage import hdf5 as store


def run_again(path: Path, *, trust: bool = False) -> None:
    """Compute a sample of the lanes of a result anew, compare bit for bit, and print the outcome of each analysis.

    Args:
        trust: whether to run the Python text of a user's system, where no file of the user's own has the same.

    Raises:
        ArgumentError: the result has such a text in it, and is not trusted.
        InputError: something differs, or the file says too little of how it was made.
    """
    attrs = store.read_attrs(path)
    if "system_file" in attrs:
        own = Path(attrs["system_file_path"])
        state = _state_of(own, attrs["system_file"])
        if state and not trust:
            raise ArgumentError(
                "verify",
                f"{own} {state}, and {path} has in it the Python text of a system; --trust runs that text: read it "
                f'before (it is jaxnh.open_result("{path}").attrs["system_file"])',
            )
        print(f"{own} {state}; lanes are run again by its text in the result" if state else f"{own} is as it was")
    try:
        outcomes = verification.sample(path)
    except (ResultError, ConfigError) as error:
        words = " ".join(str(error).split())[:200]
        raise InputError(f"command line: FILE: {path} cannot be run again: {words}") from None
    for name, (lanes, differing) in outcomes.items():
        if differing:
            raise InputError(
                f"command line: FILE: {path}: {name}: run again, {differing} of {lanes} lanes differ; "
                f"the file was made on {attrs['device']}"
            )
        print(
            f"{name}: {lanes} lanes run again are equal bit for bit"
            if lanes
            else f"{name}: runs as a whole, not lane by lane"
        )


def _state_of(path: Path, text: str) -> str:
    """A user's file beside what a result says it was: what has become of it, "" where it is the same."""
    try:
        return "" if path.read_text(encoding="utf-8") == text else "has changed since"
    except (OSError, UnicodeDecodeError):
        return "is not there"
