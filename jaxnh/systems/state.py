"""States of lanes: pytrees of numbers, and the components that errors are measured in."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

Number = Any
"""A number, or many of any one shape (...,): a JAX array in a lane, a NumPy array or a float on the host.

Python has no type for what arithmetic takes of all three; this name says what is meant.
"""

Vector = tuple[Number, ...]
"""Cartesian components."""

State = Any
"""A pytree of components of shape (...,): (q, n) of a particle at a prescribed speed, `Motion`, `Crossing`."""


@functools.singledispatch
def error_components(y: State) -> State:
    """The components of a state that an error is a difference of: all but those that only report."""
    return y


@functools.singledispatch
def masked(y: State, kept: Number) -> State:
    """The state of a lane that is kept; of one that is not, not a number but for what it reports."""

    def component(x: Array) -> Array:
        return jnp.where(kept, x, jnp.nan)

    return jax.tree.map(component, y)
