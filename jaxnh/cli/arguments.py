"""Arguments that commands share: a config with its overrides, and how the command was called."""

from __future__ import annotations

import shlex
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from jaxnh.config.schema_check import check_by_schema
from jaxnh.config.user_names import names_in, users_file
from jaxnh.config.yaml_source import read
from jaxnh.exceptions import InputError

if TYPE_CHECKING:
    from jaxnh.config.experiment import Experiment

_SILENT_SECONDS = 5.0


def check_text(config: Path | None, overrides: Sequence[str] | None) -> None:
    """See that a config can be read, and a user's file is there and is Python: before JAX, which starts in seconds.

    Raises:
        InputError: none is named, it is not YAML, an override has no place in it, its schema refuses it, or the user's
            file is no Python.
    """
    if config is None:
        raise InputError("command line: CONFIG: name a YAML file")
    source = read(config, overrides or [])
    path = users_file(config, source.data)
    check_by_schema(source, names_in(path) if path else None)
    if path is None:
        return
    if not path.is_file():
        raise source.error(("system", "file"), f"there is no file {path}")
    try:
        compile(path.read_bytes(), str(path), "exec")
    except SyntaxError as error:
        raise InputError(f"{path}:{error.lineno or 1}: not valid Python: {error.msg}") from None
    except (OSError, ValueError):
        return  # said when it is read


def experiment_of(config: Path | None, overrides: Sequence[str] | None) -> Experiment:
    """The validated config.

    Raises:
        InputError: none is named, or it says something that it cannot say.
    """
    check_text(config, overrides)
    assert config is not None
    from jaxnh.config.experiment import load
    from jaxnh.engine.xla_options import configure

    configure()  # before a user's file is tried out
    with _told_where(config):
        return load(config, overrides or [])


@contextmanager
def _told_where(config: Path) -> Iterator[None]:
    """While something inside takes long, say every some seconds which line of a user's file is being run."""
    over, reader = threading.Event(), threading.get_ident()

    def tell() -> None:
        seconds = 0.0
        while not over.wait(_SILENT_SECONDS):
            seconds += _SILENT_SECONDS
            place = _users_line(sys._current_frames().get(reader)) or str(config)
            print(f"reading {config} for {seconds:.0f} s, now at {place}", file=sys.stderr, flush=True)

    threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        over.set()


def _users_line(frame: FrameType | None) -> str:
    """FILE:LINE of the innermost code that is of no module, as that of a user's file is; "" where there is none."""
    while frame is not None:
        module = sys.modules.get(frame.f_globals.get("__name__", ""))
        if vars(module) is not frame.f_globals if module else "__file__" in frame.f_globals:
            return f"{frame.f_globals.get('__file__', frame.f_code.co_filename)}:{frame.f_lineno}"
        frame = frame.f_back
    return ""


def called(module: str) -> str:
    """The command as it was called, for the history of a result."""
    return shlex.join(["python", "-m", module, *sys.argv[1:]])
