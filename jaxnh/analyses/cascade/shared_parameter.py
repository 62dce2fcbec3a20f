"""Lanes along a first axis that changes what all lanes of a program share: each value has its map, all one program.

What runs along an axis asks for one map and hands over the values with the other parameters of its lanes. Along c, d or
ω, or a parameter that the strobe period depends on, that map is a `MapFamily`, and lanes are run value by value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any

import jax
import numpy as np

from jaxnh.analyses.scene import LaneRunner, Scene, picked

_TILE = 8  # lanes a tile, whatever was asked for: most values have one lane


def value_by_value(scene: Scene, lanes: LaneRunner) -> LaneRunner:
    """A runner for what goes along the first axis of a scene; the runner itself where lanes may differ in it."""
    return lanes if scene.flow_at is None else _LanesByValue(lanes)


class _LanesByValue:
    """Runs lanes, those of every value of the axis under the map at it."""

    def __init__(self, lanes: LaneRunner) -> None:
        self._lanes = lanes

    def stage(self, label: str, total: float) -> AbstractContextManager[None]:
        return self._lanes.stage(label, total)

    def __call__(
        self, function: Callable[..., Any], shared: tuple[Any, ...], lanes: tuple[Any, ...], **how: Any
    ) -> Any:
        along, *more = shared
        where = next(i for i, part in enumerate(lanes) if isinstance(part, Mapping))
        p = lanes[where]
        found, order = [], []
        for value in np.unique(p[along.name]).tolist():
            here = np.flatnonzero(p[along.name] == value)
            own = {name: values for name, values in p.items() if name != along.name}
            part = picked((*lanes[:where], own, *lanes[where + 1 :]), here)
            found.append(self._lanes(function, (along.at(value), *more), part, **{**how, "tile": _TILE}))
            order.append(here)
        back = np.argsort(np.concatenate(order))
        return jax.tree.map(lambda *parts: np.concatenate(parts)[back], *found)
