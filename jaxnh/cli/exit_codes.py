"""The end of a command: exit codes with one line each, and signals that ask a run to stop. No numerics, no JAX."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import signal
import sys
import threading
import traceback
from types import TracebackType
from typing import Any

import typer

from jaxnh.exceptions import ArgumentError, InputError, JaxnhError, Stopped

GO_ON = "run the same command again to go on where it stopped"

RESUME = 75
"""Exit code of a run that was stopped and can go on: the temporary failure of sysexits.h."""

_ALLOCATIONS = 100_000
"""Objects between two collections of garbage: what is imported and traced lives on, and a command that looks through it
at each 700th new object, as is the default, loses half a second before its first number."""
_GRACE = 5.0  # seconds after a signal in which work in hand may come to a place to stop
# The base of all faults of a command line, wherever typer keeps its parser.
_UsageError: type[Any] = typer.BadParameter.__mro__[1]


class Stop:
    """Inside this context SIGINT and SIGTERM ask the run to stop, where it comes to a `check`.

    A thread hears the signals, since the interpreter only does between two calls of compiled programs. Where none of
    them ends within 5 seconds the process ends all the same: what is on disk is whole at any moment.

    Attributes:
        signal: name of the signal that came, or "".
    """

    def __init__(self) -> None:
        self.signal = ""
        self._before: dict[int, Any] = {}
        self._over = threading.Event()

    def check(self) -> None:
        """Stop here if asked to.

        Raises:
            Stopped: a signal has come.
        """
        if self.signal:
            raise Stopped(f"stopped by {self.signal}")

    def __enter__(self) -> Stop:
        self._reading, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        self._wakeup = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) != signal.SIG_IGN:
                self._before[number] = signal.signal(number, lambda number, frame: None)
        threading.Thread(target=self._hear, daemon=True).start()
        return self

    def _hear(self) -> None:
        for number in iter(lambda: os.read(self._reading, 1), b""):
            if number[0] in self._before:
                self.signal = signal.Signals(number[0]).name
                break
        if self.signal and not self._over.wait(_GRACE):
            print(f"stopped by {self.signal}; {GO_ON}", file=sys.stderr, flush=True)
            os._exit(RESUME)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._over.set()
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._writing)  # ends the thread


def run_app(app: typer.Typer) -> int:
    """Run a command; each end but the good one has one line, and with JAXNH_DEBUG=1 the traceback before it.

    Returns:
        0 done, 2 bad input, 75 stopped and ready to go on, 130 interrupted with nothing kept, 1 any other failure.
    """
    gc.set_threshold(_ALLOCATIONS)
    atexit.register(gc.freeze)  # else the interpreter looks through all there is, before it ends, for a second
    try:
        code = app(standalone_mode=False)  # a number where typer itself ended the run, as after Control-C
        if isinstance(code, int) and code:
            print("interrupted; nothing was written", file=sys.stderr)
            return code
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    except Exception as error:
        if os.environ.get("JAXNH_DEBUG") == "1":
            traceback.print_exc()
        code, line = _end(error)
        print(line, file=sys.stderr)
        return code
    return 0


def _end(error: Exception) -> tuple[int, str]:
    """Exit code and line of an end that is no good one."""
    if isinstance(error, ArgumentError):
        remedy = f"; --fresh {error.remedy}" if error.remedy else ""
        return 2, f"command line: --{error.argument}: {error.what}{remedy}"
    if isinstance(error, InputError):
        return 2, str(error)
    if isinstance(error, _UsageError):
        return 2, f"command line: {' '.join(str(error.format_message()).split())}"  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(error, Stopped):
        return RESUME, f"{error}; {GO_ON}"
    if isinstance(error, JaxnhError):
        return 1, f"failed: {error}"
    return 1, f"failed: {type(error).__name__}: {' '.join(str(error).split())[:500]}"
