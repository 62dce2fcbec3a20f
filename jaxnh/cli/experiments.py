"""Experiments of configs, tried out while the terminal is told what takes long."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from jaxnh.config.config import Config
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.xla_options import configure

_SILENT_SECONDS = 5.0


def experiment_of(config: Config) -> Experiment:
    """The experiment of a config.

    Raises:
        InputError: its flow cannot be made, or does not go with the rest of it.
    """
    configure()  # before a user's file is tried out
    with _report_user_line(config.label):
        return Experiment.from_config(config)


@contextmanager
def _report_user_line(label: str) -> Iterator[None]:
    """While something inside takes long, say every some seconds which line of a user's file is being run."""
    over, reader = threading.Event(), threading.get_ident()

    def tell() -> None:
        seconds = 0.0
        while not over.wait(_SILENT_SECONDS):
            seconds += _SILENT_SECONDS
            place = _users_line(sys._current_frames().get(reader)) or label
            print(f"reading {label} for {seconds:.0f} s, now at {place}", file=sys.stderr, flush=True)

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
