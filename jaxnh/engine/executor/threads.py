"""Batches of a run in threads, one at a time on each device: while one is between two calls, the others compute."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import TypeVar

from jaxnh.engine.executor.lanes import LaneExecutor

Batch = TypeVar("Batch")


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
