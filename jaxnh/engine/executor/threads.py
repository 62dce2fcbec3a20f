"""Batches of a run in threads, on each device one at a time: while one is between two calls, the others compute."""

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
    """Have some batches done by runners side by side, each of which takes the next when it has done one.

    Args:
        lanes: of which the runners are, and which what they did is added up in.
        in_turn: called for every runner with the batches that come to it; where one fails, the others get no more.
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
        begun = [workers.submit(in_turn, taken(), runner) for runner in runners]
        try:
            for end in as_completed(begun):
                end.result()
        finally:
            left.clear()
    lanes.accounts.add([runner.accounts for runner in runners])
