"""Batches of a run, and slices of the lanes of one, in threads: while one is between two calls, the others compute."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, as_completed, wait
from typing import TypeVar

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.progress import Progress
from jaxnh.exceptions import Stopped

Batch = TypeVar("Batch")
Slice = TypeVar("Slice")
Result = TypeVar("Result")


class _ProgressOfSlices:
    """Progress of slices side by side within one stage that is shown already.

    Attributes:
        halted: whether all slices are to end at their next call, as one has failed or the run is stopped.
    """

    def __init__(self, shown: Progress) -> None:
        self._shown, self._one_at_a_time, self.halted = shown, threading.Lock(), False

    def start(self, label: str, total: float) -> None: ...

    def advance(self, amount: float) -> None:
        if self.halted:
            raise Stopped("another slice has ended early")
        with self._one_at_a_time:
            self._shown.advance(amount)

    def finish(self) -> None: ...

    def note(self, text: str) -> None:
        with self._one_at_a_time:
            self._shown.note(text)

    def warn(self, text: str) -> None:
        with self._one_at_a_time:
            self._shown.warn(text)


def run_slices(
    lanes: LaneExecutor,
    slices: Sequence[Slice],
    stage: tuple[str, float],
    function: Callable[[Slice, LaneExecutor], Result],
) -> list[Result]:
    """The function of each slice of some lanes, side by side on the cores, in order.

    Args:
        lanes: executor whose cores they share; their accounts are added up in it.
        stage: what all of them are shown as: a label and lane-periods.
        function: of a slice and the executor for it.
    """
    progress = _ProgressOfSlices(lanes.progress)
    executors = lanes.share(len(slices), progress)
    with lanes.stage(*stage), ThreadPoolExecutor(len(slices), "slice") as workers:
        futures = [workers.submit(function, *each) for each in zip(slices, executors, strict=True)]
        try:
            ended = wait(futures, return_when=FIRST_EXCEPTION).done
            for future in ended:
                future.result()
        except BaseException:
            progress.halted = True
            raise
        finally:
            lanes.accounts.add([executor.accounts for executor in executors])
    return [future.result() for future in futures]


def run_side_by_side(
    lanes: LaneExecutor, batches: Sequence[Batch], in_turn: Callable[[Iterator[Batch], LaneExecutor], object]
) -> None:
    """Run batches by several runners side by side, each of which takes the next batch when it has finished one.

    Args:
        lanes: executor to split into runners; their accounts are added up in it.
        in_turn: called for every runner with its batches; where one fails, the others get no more.
    """
    runners, left = lanes.split(), deque(batches)

    def taken() -> Iterator[Batch]:
        while True:
            try:
                batch = left.popleft()
            except IndexError:
                return
            yield batch

    with ThreadPoolExecutor(len(runners)) as workers:
        futures = [workers.submit(in_turn, taken(), runner) for runner in runners]
        try:
            for end in as_completed(futures):
                end.result()
        finally:
            left.clear()
    lanes.accounts.add([runner.accounts for runner in runners])
