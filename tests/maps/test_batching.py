"""Numbers that a loop begins with, as numbers of the lane: the same ones, and the loop's body batched once."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxnh.maps.batching import as_batched


def batched(begin):
    """How often the body of a loop in a loop is batched, where what the inner one carries begins so."""
    seen = []

    @jax.custom_batching.custom_vmap
    def twice(x):
        return 2.0 * x

    @twice.def_vmap
    def _(size, is_batched, x):
        seen.append(size)
        return 2.0 * x, is_batched[0]

    def inner(_, carry):
        return carry[0] + twice(carry[1]), carry[1]

    def outer(x):
        def body(_, carry):
            total, sum_ = carry
            return total + 1.0, sum_ + lax.fori_loop(0, 3, inner, (begin(0.0, x), x))[0]

        return lax.fori_loop(0, 2, body, (begin(1.0, x), begin(0.0, x)))

    total, sum_ = jax.vmap(outer)(jnp.arange(4.0))
    np.testing.assert_array_equal(total, np.full(4, 3.0))
    np.testing.assert_array_equal(sum_, 12.0 * np.arange(4.0))
    return len(seen)


def test_the_body_of_a_loop_is_batched_once():
    assert batched(as_batched) == 1
    assert batched(lambda value, x: jnp.asarray(value)) > 1


def test_the_same_numbers():
    """Of whatever type, in lanes that have failed too."""
    carry = {"sum": jnp.zeros(2), "count": jnp.int32(3), "far": jnp.array(-jnp.inf), "found": jnp.bool_(True)}
    program = jax.jit(jax.vmap(lambda x: as_batched(carry, x)))
    lanes = jnp.array([0.0, 1.0, jnp.nan, jnp.inf])
    for found, leaf in zip(jax.tree.leaves(program(lanes)), jax.tree.leaves(carry), strict=True):
        assert found.dtype == leaf.dtype
        np.testing.assert_array_equal(found, np.broadcast_to(leaf, (4, *leaf.shape)))
