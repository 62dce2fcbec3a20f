"""A map for every value of a parameter that all lanes of a program share: their clock, or what is in their table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx

from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State


class MapFamily(ReturnMap):
    """P(z; p) with a parameter in p that decides the table of the map: it takes part on the host, not in a lane.

    Attributes:
        system: the flow at the first value.
        name: of the parameter.
        at: the map at a value.
    """

    system: Any
    name: str = eqx.field(static=True)
    at: Callable[[float], ReturnMap] = eqx.field(static=True)

    @property
    def turns(self) -> tuple[float, ...]:
        """As of the map at the first value."""
        return self.at(self.system.parameters[self.name]).turns

    def __call__(self, state: State, p: Parameters) -> State:
        """Not in a lane: `analyses.along` puts the map at a value in its place."""
        raise NotImplementedError

    def push(self, state: State, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushforward:
        """Not in a lane: `analyses.along` puts the map at a value in its place."""
        raise NotImplementedError

    def with_room_of(self, other: ReturnMap) -> MapFamily:
        """At every value the map in tables as large as those of the other."""
        assert isinstance(other, MapFamily)
        return MapFamily(self.system, self.name, lambda value: self.at(value).with_room_of(other.at(value)))
