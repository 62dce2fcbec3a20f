"""One thread that computes what pages ask for, pass by pass; a new request of a page stops its last one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Generic, TypeVar

from jaxnh.exceptions import Stopped

T = TypeVar("T")

_ENDING = 15.0  # seconds that a pass is waited for at the end: some programs are compiled for so long

Told = Callable[[str, float], None]
"""(what is being done, share that is done, 0 where that is not known) of the pass in hand."""


@dataclass
class Request(Generic[T]):
    """A request to be computed in passes, each a better answer than the one before.

    Attributes:
        passes: the answers, computed as they are taken.
        answer: told of each answer, in the worker's thread.
        failed: told of the exception that ended it early.
        told: of the pass in hand.
        done: told when all passes are over.
        stale: whether it is no longer wanted.
        finished: number of passes that are over.
    """

    passes: Iterator[T]
    answer: Callable[[T], None]
    failed: Callable[[Exception], None]
    told: Told
    done: Callable[[], None] = lambda: None
    stale: bool = field(default=False, init=False)
    finished: int = field(default=0, init=False)


class Worker:
    """Takes passes in turn: first answers before better ones, older requests before newer.

    It is the progress of its sessions, and stops a pass in the middle where its request is stale.
    """

    def __init__(self) -> None:
        self._requests: dict[Hashable, Request[Any]] = {}
        self._changed = threading.Condition()
        self._now: Request[Any] | None = None
        self._over = False
        self._label, self._done, self._total = "", 0.0, 0.0
        self._thread = threading.Thread(target=self._work, name="jaxnh explorer", daemon=True)

    def start(self) -> Worker:
        """Begin to work."""
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the pass in hand, and take no more; a thread inside a program would abort the process at its exit."""
        with self._changed:
            self._over = True
            for request in self._requests.values():
                request.stale = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(_ENDING)

    def ask(self, key: Hashable, request: Request[Any]) -> None:
        """Take a request in place of the last one of the same key."""
        with self._changed:
            if key in self._requests:
                self._requests.pop(key).stale = True
            self._requests[key] = request
            self._changed.notify()

    def ask_ahead(self, passes: Iterator[Any]) -> None:
        """Compute the first pass of an answer that no page has asked for yet: then its programs are at hand.

        A failure is told of where a page asks.
        """
        self.ask("ahead", Request(islice(passes, 1), lambda _: None, lambda _: None, lambda label, share: None))

    def drop(self, key: Hashable) -> None:
        """Drop the request of a key."""
        with self._changed:
            if key in self._requests:
                self._requests.pop(key).stale = True

    # ---- as progress of sessions

    def start_stage(self, label: str, total: float) -> None:
        self._label, self._done, self._total = label, 0.0, total
        self._tell()

    def advance(self, amount: float) -> None:
        self._done += amount
        self._tell()

    def note(self, text: str) -> None:
        self._label = text
        self._tell()

    def _tell(self) -> None:
        if self._now is None:
            return
        if self._now.stale:
            raise Stopped("nobody waits for this any more")
        self._now.told(self._label, min(1.0, self._done / self._total) if self._total else 0.0)

    # ---- how

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._requests and not self._over:
                    self._changed.wait()
                if self._over:
                    return
                key, request = min(self._requests.items(), key=lambda item: item[1].finished)
            self._now = request
            ended = self._pass(request)
            self._now = None
            with self._changed:
                if ended and self._requests.get(key) is request:
                    del self._requests[key]

    def _pass(self, request: Request[Any]) -> bool:
        """One pass; returns whether it was the last."""
        try:
            result = next(request.passes)
        except StopIteration:
            if not request.stale:
                request.done()
            return True
        except Stopped:
            return True
        except Exception as error:  # whatever it is, the page says it, and the next request is computed
            if not request.stale:
                request.failed(error)
            return True
        request.finished += 1
        if not request.stale:
            request.answer(result)
        return False


class Watch:
    """Progress of a session, reported to its worker."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker

    def start(self, label: str, total: float) -> None:
        self._worker.start_stage(label, total)

    def advance(self, amount: float) -> None:
        self._worker.advance(amount)

    def finish(self) -> None: ...

    def note(self, text: str) -> None:
        self._worker.note(text)

    def warn(self, text: str) -> None:
        self._worker.note(text)
