"""The place where a result is to be written: whether it is free, and what is there."""

from __future__ import annotations

from pathlib import Path

from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import ArgumentError, DamagedError, ResultError
from jaxnh.storage import hdf5
from jaxnh.storage.atomic import check_writable, target_of


def is_there(experiment: Experiment, path: Path, *, fresh: bool) -> bool:
    """Return whether a file is the result of this experiment. Other files are replaced on request alone.

    The result of a coarser level does not count. All of the file is read and compared with its checksums.

    Raises:
        ArgumentError: the file is something else, or damaged, or what the experiment is read from.
    """
    own = experiment.user_file
    sources = {"the config": experiment.source, "the system": own and own.path}
    for what, source in sources.items():
        if source and path.exists() and Path(source).exists() and path.samefile(source):
            raise ArgumentError("output", f"{path} is the file of {what}; name another one")
    if fresh or not path.is_file():
        return False
    try:
        attrs = hdf5.read_attrs(path)
        same = attrs["config_sha256"] == experiment.sha256
    except (ResultError, KeyError):
        raise ArgumentError("output", f"{path} is there and is no result of jaxnh", "replaces it") from None
    if same and attrs.get("level", 0) < attrs.get("levels", 0):
        return False
    if not same:
        other = other_than(experiment, attrs.get("system_file"))
        raise ArgumentError("output", f"{path} holds the result of {other}", "replaces it")
    try:
        hdf5.verify(path)
    except DamagedError as error:
        raise ArgumentError("output", f"{error}: the result of this config, but damaged", "computes it again") from None
    return True


def check_output(path: Path) -> None:
    """Make the folder of an output.

    Raises:
        ArgumentError: nothing can be written there.
    """
    try:
        check_writable(path)
    except ResultError as error:
        raise ArgumentError("output", str(error)) from None


def file_of(output: Path) -> Path:
    """The file that is read and written where this is the output: of a link the one it points to, there or not.

    Raises:
        ArgumentError: it is a link that leads nowhere.
    """
    try:
        return target_of(output)
    except ResultError as error:
        raise ArgumentError("output", str(error)) from None


def other_than(experiment: Experiment, user_text: str | None) -> str:
    """Describe how a result differs from one of this config, made with a user's file of that text."""
    own = experiment.user_file
    return f"another text of {own.path}" if own and user_text not in (None, own.text) else "another config"
