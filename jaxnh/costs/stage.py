"""A lane runner for work inside a stage that is shown already: the analyses' own stages stay silent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from jaxnh.analyses.batch import LaneRunner, Link
from jaxnh.maps.family import Maps
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State


class StagelessRunner:
    """Runs lanes as another runner does, and begins no stage."""

    def __init__(self, lanes: LaneRunner) -> None:
        self._lanes = lanes

    def __call__(
        self, function: Callable[..., Any], shared: tuple[Any, ...], lanes: tuple[Any, ...], **options: Any
    ) -> Any:
        return self._lanes(function, shared, lanes, **options)

    def iterate(self, maps: Maps, n: int, lanes: tuple[State, Parameters], *, tile: int | None = None) -> State:
        return self._lanes.iterate(maps, n, lanes, tile=tile)

    def record(self, maps: Maps, count: int, lanes: tuple[State, Parameters], *, tile: int | None = None) -> State:
        return self._lanes.record(maps, count, lanes, tile=tile)

    def observe(
        self,
        maps: Maps,
        count: int,
        lanes: tuple[State, Parameters],
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        *,
        tile: int | None = None,
    ) -> tuple[Any, State]:
        return self._lanes.observe(maps, count, lanes, function, shared, tile=tile)

    def chain(self, links: Sequence[Link], lanes: tuple[Any, ...], *, tile: int | None = None) -> list[Any]:
        return self._lanes.chain(links, lanes, tile=tile)

    def stage(self, label: str, total: float) -> AbstractContextManager[None]:
        return nullcontext()
