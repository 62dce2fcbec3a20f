"""How a command ends: exit codes with one line each, and signals that ask a run to stop. No numerics, no JAX."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import Any

import typer

from jaxnh.storage import hdf5 as store

RESUME = 75
"""Exit code of a run that was stopped and can go on: the temporary failure of sysexits.h."""

GO_ON = "run the same command again to go on"

_GRACE = 20.0  # seconds after a signal in which work in hand may come to a place to stop
# The base of all faults of a command line, wherever typer keeps its parser.
_UsageError: Any = typer.BadParameter.__mro__[1]


class Refused(Exception):
    """Bad input; the message is the line to print."""


class Failed(Exception):
    """A run cannot go on; the message says why, and what is kept."""


class Unfinished(Exception):
    """A run was stopped; the same command goes on. The message says how far it came."""


def check_output(path: Path) -> None:
    """Make the folder of an output.

    Raises:
        Refused: nothing can be written there.
    """
    try:
        store.check_writable(path)
    except store.StoreError as error:
        raise Refused(f"command line: --output: {error}") from None


class Stop:
    """Inside this context SIGINT and SIGTERM ask the run to stop, where it comes to a `check`.

    A thread hears the signals, since the interpreter only does between two calls of compiled programs. Where none of
    them ends within 20 seconds the process ends all the same: what is on disk is whole at any moment.

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
            Unfinished: a signal has come.
        """
        if self.signal:
            raise Unfinished(f"stopped by {self.signal}")

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
    """Run a command; each end but the good one has one line and no traceback.

    Returns:
        0 done, 2 bad input, 75 stopped and ready to go on, 130 interrupted with nothing kept, 1 any other failure.
    """
    try:
        code = app(standalone_mode=False)  # a number where typer itself ended the run, as after Control-C
        if isinstance(code, int) and code:
            print("interrupted; nothing was written", file=sys.stderr)
            return code
    except Refused as refusal:
        print(refusal, file=sys.stderr)
        return 2
    except _UsageError as error:
        print(f"command line: {' '.join(str(error.format_message()).split())}", file=sys.stderr)
        return 2
    except Unfinished as end:
        print(f"{end}; {GO_ON}", file=sys.stderr)
        return RESUME
    except Failed as end:
        print(f"failed: {end}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        print(f"failed: {type(error).__name__}: {' '.join(str(error).split())[:500]}", file=sys.stderr)
        return 1
    return 0
