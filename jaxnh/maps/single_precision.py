"""Single precision, where it is asked for: a strobe map whose arithmetic within a period is in float32."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State


class SingleStrobe(ReturnMap):
    """Another strobe map in single precision: float32 within a period, float64 at both its ends.

    Attributes:
        system: the flow.
        inner: the map, its arrays in float32.
    """

    system: Flow
    inner: ReturnMap

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the inner map."""
        return self.inner.trip_counts

    def __call__(self, state: State, p: Parameters) -> State:
        return _cast(self.inner(*_cast((state, dict(p)), jnp.float32)), jnp.float64)

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        return _cast(
            self.inner.pushforward(*_cast((state, dict(p), tangents), jnp.float32), volume=volume), jnp.float64
        )


def in_precision(strobe: ReturnMap, precision: str) -> ReturnMap:
    """A strobe map, or several stacked, as it is, or with its arithmetic in "float32"."""
    if precision != "float32":
        return strobe
    inner = jax.tree.map(lambda v: np.asarray(v, np.float32) if np.result_type(v).kind == "f" else v, strobe)
    return SingleStrobe(strobe.system, inner)


def _cast(tree: Any, real: Any) -> Any:
    """A pytree with its real numbers in another precision."""
    return jax.tree.map(lambda v: jnp.asarray(v, real) if jnp.issubdtype(jnp.result_type(v), jnp.floating) else v, tree)
