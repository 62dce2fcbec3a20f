"""A lane runner for work inside a stage that is shown already: the analyses' own stages stay silent."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from jaxnh.analyses.scene import LaneRunner


class StagelessRunner:
    """Runs lanes as another runner does, and begins no stage."""

    def __init__(self, lanes: LaneRunner) -> None:
        self._lanes = lanes

    def __call__(
        self, function: Callable[..., Any], shared: tuple[Any, ...], lanes: tuple[Any, ...], **options: Any
    ) -> Any:
        return self._lanes(function, shared, lanes, **options)

    def stage(self, label: str, total: float) -> AbstractContextManager[None]:
        return nullcontext()
