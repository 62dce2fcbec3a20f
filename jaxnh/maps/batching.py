"""Numbers that a loop begins with, as numbers of the lane: `jax.vmap` then traces the body of the loop once."""

from __future__ import annotations

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

Carry = TypeVar("Carry")


def as_batched(carry: Carry, lane: ArrayLike) -> Carry:
    """Mark numbers as different from lane to lane for `jax.vmap`.

    It finds out by tracing the body of a loop that what begins as a constant does not stay one, and then traces it
    again: two loops, one in the other, four times. The price is a choice between equals, once where the loop begins.

    Args:
        carry: pytree of what a loop carries.
        lane: a number of the lane, ().
    """
    either = jnp.asarray(lane) == 0

    def number(leaf: Any) -> Array:
        return jnp.where(either, leaf, leaf)

    return jax.tree.map(number, carry)
