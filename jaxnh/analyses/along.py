"""Lanes along a first axis that changes what all lanes of a program share: each value has its map, all one program.

What runs along an axis asks for one map and hands over the values with the other parameters of its lanes. Along c, d or
ω, or a parameter that the strobe period depends on, that map is a `StrobeAlong`, and `one_by_one` runs the lanes of
every value under the map of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxnh.analyses.base import LaneRunner, Scene, picked
from jaxnh.maps.protocol import Pushed, Strobe, Tangent
from jaxnh.systems.flow import Parameters, State

_TILE = 8  # lanes a tile, whatever was asked for: most values have one lane


class StrobeAlong(Strobe):
    """P(z; p) with a parameter in p that decides the table of the map: it takes part on the host, not in a lane.

    Attributes:
        system: the flow at the first value.
        name: of the parameter.
        at: the map at a value.
    """

    system: Any
    name: str = eqx.field(static=True)
    at: Callable[[float], Strobe] = eqx.field(static=True)

    @property
    def turns(self) -> tuple[float, ...]:
        """As of the map at the first value."""
        return self.at(self.system.parameters[self.name]).turns

    def __call__(self, state: State, p: Parameters) -> State:
        """Not in a lane: `one_by_one` puts the map at a value in its place."""
        raise NotImplementedError

    def push(self, state: State, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushed:
        """Not in a lane: `one_by_one` puts the map at a value in its place."""
        raise NotImplementedError

    def with_room_of(self, other: Strobe) -> StrobeAlong:
        """At every value the map in tables as large as those of the other."""
        assert isinstance(other, StrobeAlong)
        return StrobeAlong(self.system, self.name, lambda value: self.at(value).with_room_of(other.at(value)))


def one_by_one(scene: Scene, lanes: LaneRunner) -> tuple[Scene, LaneRunner]:
    """The scene and the runner for what goes along its first axis; both as they are where lanes may differ in it."""
    return (scene, lanes) if scene.flow_at is None else (_SceneAlong(**vars(scene)), _Values(lanes))


@dataclass(frozen=True)
class _SceneAlong(Scene):
    def strobe(self, refinement: float = 1) -> Strobe:
        if self.flow_at is None:
            return super().strobe(refinement)
        made: dict[float, Strobe] = {}

        def at(value: float) -> Strobe:
            if value not in made:
                made[value] = self.moved(value).strobe(refinement)
            return made[value]

        return StrobeAlong(self.system, self.line.name, at)


class _Values:
    """Runs lanes, those of every value of the axis under the map at it."""

    def __init__(self, lanes: LaneRunner) -> None:
        self._lanes = lanes

    def stage(self, label: str, total: float) -> AbstractContextManager[None]:
        return self._lanes.stage(label, total)

    def __call__(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        *,
        periods: float = 0.0,
        tile: int | None = None,
        static: tuple[Any, ...] = (),
    ) -> Any:
        along, *more = shared
        where = next(i for i, part in enumerate(lanes) if isinstance(part, Mapping))
        p = lanes[where]
        found, order = [], []
        for value in np.unique(p[along.name]).tolist():
            here = np.flatnonzero(p[along.name] == value)
            own = {name: values for name, values in p.items() if name != along.name}
            part = picked((*lanes[:where], own, *lanes[where + 1 :]), here)
            strobe = along.at(value)
            found.append(self._lanes(function, (strobe, *more), part, periods=periods, tile=_TILE, static=static))
            order.append(here)
        back = np.argsort(np.concatenate(order))
        return jax.tree.map(lambda *parts: np.concatenate(parts)[back], *found)
