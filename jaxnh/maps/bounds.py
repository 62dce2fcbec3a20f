"""Maps of motions that are followed within a box alone: what leaves it for good costs nothing more."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State, masked
from jaxnh.systems.status import ESCAPED


class BoundedMap(ReturnMap):
    """Another map, of states in a box; others have no image (`escaped`), whose components are not finite.

    A motion on its way to infinity may need ever shorter steps there, a million of them in a map (`maps.adaptive`),
    while all lanes of a tile wait. A state that is not finite ends after a few.

    Attributes:
        system: that of the map.
        inner: the map.
        centre, reach: of the box, in section coordinates, (d,): angles are in it wherever they are.
    """

    system: Any
    inner: ReturnMap
    centre: ArrayLike
    reach: ArrayLike

    @property
    def most_lanes(self) -> int | None:
        return self.inner.most_lanes

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the inner map."""
        return self.inner.trip_counts

    def __call__(self, state: State, p: Parameters) -> State:
        return self.inner(self._within(state), p)

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        return self.inner.pushforward(self._within(state), p, tangents, volume=volume)

    def _within(self, state: State) -> State:
        gaps = jnp.abs(jnp.stack(self.chart.components(state)) - jnp.asarray(self.centre))
        angles = jnp.asarray(self.chart.angles)
        return masked(state, jnp.all(angles | (gaps <= jnp.asarray(self.reach))), jnp.int32(ESCAPED))
