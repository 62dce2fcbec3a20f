"""Batches of a run in threads, on each device one at a time: while one is between two calls, the others compute."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from queue import SimpleQueue
from typing import TypeVar

from jaxnh.engine.lanes import Lanes

Batch = TypeVar("Batch")


def side_by_side(lanes: Lanes, batches: Sequence[Batch], one: Callable[[Batch, Lanes], object]) -> None:
    """Call `one` for each of some batches, with a runner that no other is using, and add up what the runners did."""
    runners, idle = lanes.apart(), SimpleQueue[Lanes]()
    for runner in runners:
        idle.put(runner)

    def next_one(batch: Batch) -> None:
        runner = idle.get()
        try:
            one(batch, runner)
        finally:
            idle.put(runner)

    with ThreadPoolExecutor(len(runners)) as workers:
        begun = [workers.submit(next_one, batch) for batch in batches]
        try:
            for end in as_completed(begun):
                end.result()
        finally:
            for batch in begun:
                batch.cancel()
    lanes.add(runners)
