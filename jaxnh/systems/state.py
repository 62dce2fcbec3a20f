"""States of lanes: pytrees of numbers, and the components that errors are measured in."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

Number = Any
"""A number, or many of any one shape (...,): a JAX array in a lane, a NumPy array or a float on the host.

Python has no type for what arithmetic takes of all three; this name says what is meant.
"""

Vector = tuple[Number, ...]
"""Cartesian components."""

State = Any
"""A pytree of components of shape (...,): (q, n) of a particle at a prescribed speed, `Motion`, `Crossing`."""

LaneStates = tuple[Any, ...]
"""The states of lanes side by side, a pytree of NumPy arrays (lanes, ...): every kind of state is a tuple of its parts.

Records that go from one function of lanes to the next have this type and not `State`, which any value passes for.
"""


@functools.singledispatch
def error_components(y: State) -> State:
    """The components of a state that an error is a difference of: all but those that only report."""
    return y


def is_finite(y: State) -> np.ndarray:
    """Return which of some states (...,) are finite, on the host."""
    return np.all([np.isfinite(leaf) for leaf in jax.tree.leaves(error_components(y))], axis=0)


@functools.singledispatch
def masked(y: State, kept: Number, reason: Number | None = None) -> State:
    """The state of a lane that is kept; of one that is not, not a number but for what it reports.

    Args:
        reason: status of a lane that is not kept, a whole number; one that a state has already stays.
    """

    def component(x: Array) -> Array:
        if reason is None:
            return jnp.where(kept, x, jnp.nan)
        return jnp.where(kept | jnp.isnan(x), x, _nan_with_status(reason).astype(x.dtype))

    return jax.tree.map(component, y)


# A NaN has 51 bits that mean nothing, and neither a selection nor a copy changes them: with the status of a failed lane
# there, states of every flow tell it, and no program has a number more. `tests/maps/test_adaptive.py` reads it back.
_QUIET_NAN = 0x7FF8_0000_0000_0000
_STATUS_BITS = 0xFF


def _nan_with_status(code: Number) -> Array:
    """Not a number, with a status in its lowest bits."""
    bits = jnp.asarray(code).astype(jnp.int64) | jnp.int64(_QUIET_NAN)
    return lax.bitcast_convert_type(bits, jnp.float64)


def status_in_nan(x: np.ndarray) -> np.ndarray:
    """Return the status that `masked` has left in numbers, zero where there is none; on the host."""
    bits = np.ascontiguousarray(x, np.float64).view(np.int64) & _STATUS_BITS
    return np.where(np.isnan(x), bits, 0)
