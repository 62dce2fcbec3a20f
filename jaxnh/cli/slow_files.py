"""Word on the terminal of users' files that take long to be run. No JAX."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SILENT_SECONDS = 5.0


@contextmanager
def report_user_line(label: str) -> Iterator[None]:
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
