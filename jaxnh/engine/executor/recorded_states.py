"""Functions of the recorded states of one lane, which stay on the device."""

from __future__ import annotations

from typing import Any

import jax

from jaxnh.maps.iterate import record


def record_beside(maps: Any, count: Any, carried: tuple[Any, Any], p: Any, room: int) -> tuple[Any, Any]:
    """The states of one lane, and what goes on with them."""
    state, beside = carried
    return record(maps, count, state, p, room), beside


def observe_states(*arguments: Any) -> tuple[Any, Any]:
    """The last of so many states (room, …) of one lane, and what a function makes of each of them."""
    *shared, states, _, count, function = arguments
    values = jax.vmap(lambda state: function(*shared, state))(jax.tree.map(lambda x: x[:count], states))
    return jax.tree.map(lambda x: x[max(count - 1, 0)], states), values
