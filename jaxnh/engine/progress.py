"""Progress of runs and sessions, as callbacks. Nothing is printed here."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Protocol

from jaxnh.exceptions import JaxnhWarning


class Progress(Protocol):
    """Progress of a computation, as it is reported. A method may raise an exception to stop it."""

    def start(self, label: str, total: float) -> None:
        """Begin a stage of `total` lane-periods, 0 where that is not known."""

    def advance(self, amount: float) -> None:
        """Report more lane-periods as done."""

    def finish(self) -> None:
        """End the stage."""

    def note(self, text: str) -> None:
        """Report a note, as of tiles that are there already."""

    def warn(self, text: str) -> None:
        """Report a fault that was mended, as a damaged tile that is computed again, or what a result warns of."""


class NullProgress:
    """Progress that is not reported; warnings are `JaxnhWarning`."""

    def start(self, label: str, total: float) -> None: ...

    def advance(self, amount: float) -> None: ...

    def finish(self) -> None: ...

    def note(self, text: str) -> None: ...

    def warn(self, text: str) -> None:
        warnings.warn(text, JaxnhWarning, stacklevel=2)


class CallbackProgress(NullProgress):
    """Progress as calls of one function: (label, lane-periods done, lane-periods in all) of the stage in hand."""

    def __init__(self, function: Callable[[str, float, float], None]) -> None:
        self._function = function
        self._label, self._done, self._total = "", 0.0, 0.0

    def start(self, label: str, total: float) -> None:
        self._label, self._done, self._total = label, 0.0, total
        self._function(label, 0.0, total)

    def advance(self, amount: float) -> None:
        self._done += amount
        self._function(self._label, self._done, self._total)

    def finish(self) -> None:
        self._function(self._label, self._total or self._done, self._total)


class InterruptibleProgress:
    """Progress passed on, with a check at every call that may raise `Stopped`.

    Attributes:
        shown: the progress that it is passed to; may be changed on the way.
    """

    def __init__(self, shown: Progress, check: Callable[[], None]) -> None:
        self.shown, self._check = shown, check

    def start(self, label: str, total: float) -> None:
        self._check()
        self.shown.start(label, total)

    def advance(self, amount: float) -> None:
        self.shown.advance(amount)
        self._check()

    def finish(self) -> None:
        self.shown.finish()

    def note(self, text: str) -> None:
        self.shown.note(text)

    def warn(self, text: str) -> None:
        self.shown.warn(text)
