"""The return map of a map: the map itself, without steps and exact to rounding."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.maps.general_flow import own_parameters, stack_leaves
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.systems.discrete_map import DiscreteMap
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State


class IterationStrobe(ReturnMap):
    """One iterate of a map.

    Attributes:
        system: the map.
        number: zero; a stack of one map has the axis that `lax.scan` goes along also where there are no parameters.
    """

    system: DiscreteMap
    number: ArrayLike = np.float64(0.0)

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """None: there is no loop."""
        return ()

    def __call__(self, state: State, p: Parameters) -> State:
        return self.system.image(state, own_parameters(self.system, p))

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        own = own_parameters(self.system, p)
        image, linear = jax.linearize(self.system.image, state, own)
        still = jax.tree.map(jnp.zeros_like, own)
        moved = tuple(t._replace(state=linear(t.state, {**still, **(t.p or {})})) for t in tangents)
        first = jax.tree.leaves(state)[0]
        shrunk = self.system.divergence(0.0, state, own) if volume else jnp.zeros_like(first)
        return Pushforward(image, moved, shrunk)

    def stacked(self) -> IterationStrobe:
        """This map as a stack of one, as `lax.scan` takes it."""
        stack: Any = stack_leaves(self, (1,))
        return stack
