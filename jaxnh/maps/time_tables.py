"""Time-dependent part of a field, taken out of the lanes: a table at the times of the stages, shared by all.

A field is traced into its list of equations. Those that reach from t to a number without the state of a lane or its
own parameters need to be solved once a time, and not in every lane: forcing, a moving constraint, any function of t.
What is left is the field of the lanes, which takes their values from the table. Users need not say a word about it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.extend.core import primitives

from jaxnh.maps.elementary import cosine, exponential, hyperbolic_tangent, logarithm, sine
from jaxnh.systems.flow import Flow
from jaxnh.systems.simplification import SimplifiedProgram
from jaxnh.systems.state import State
from jaxnh.systems.tracing import KnownValue, Step, cached_by_structure

_TIME, _LANE = 1, 2  # what a value depends on, at most


def _of_values(function: Callable[[Array], Array]) -> Callable[..., Array]:
    return lambda x, **_: function(x)


def _sum(x: Array, *, axes: Sequence[int], **_: Any) -> Array:
    """Σ over axes, as a product with ones.

    Of a sum XLA computes the terms in the loop that adds them, one at a time: of many lanes' sines that takes four
    times as long.
    """
    if not axes or x.dtype != jnp.float64:
        return jnp.sum(x, axis=tuple(axes))
    ones = jnp.ones([x.shape[axis] for axis in axes])
    return lax.dot_general(x, ones, ((tuple(axes), tuple(range(len(axes)))), ((), ())))


IN_LANES: dict[Any, Callable[..., Any]] = {
    primitives.sin_p: _of_values(sine),
    primitives.cos_p: _of_values(cosine),
    primitives.exp_p: _of_values(exponential),
    primitives.log_p: _of_values(logarithm),
    primitives.tanh_p: _of_values(hyperbolic_tangent),
    primitives.reduce_sum_p: _sum,
}
"""Functions of lanes in place of those that XLA has."""


class TimeSplit:
    """A function of (t, shared, lane) in two: what t decides, and what the lane does with it.

    Attributes:
        size: number of equations that are left to the lanes.
    """

    def __init__(self, function: Callable[[Any, Any, Any], Any], shared: Any, lane: Any) -> None:
        """Trace it.

        Args:
            function: (t, shared, lane) to a pytree; t of shape ().
            shared: pytree of what all lanes have alike.
            lane: pytree of what each lane has of its own, leaves of any shape.
        """
        self._program = program = SimplifiedProgram(function, 0.0, shared, lane)
        of_shared, of_lane = (len(jax.tree.leaves(tree)) for tree in (shared, lane))
        self._level = program.depends([_TIME] + [0] * of_shared + [_LANE] * of_lane)
        self._needed = program.needed(program.outputs)
        lanes = [step for step in program.steps if self._in_lanes(step)]
        read = {slot for step in lanes for slot in step.reads if not isinstance(slot, KnownValue)}
        read |= {slot for slot in program.outputs if not isinstance(slot, KnownValue)}
        self._table = sorted(slot for slot in read if self._level[slot] == _TIME)
        self._before = program.needed(self._table)
        self.size = len(lanes)

    @property
    def width(self) -> int:
        """Number of values in the table at a time."""
        return len(self._table)

    def table(self, t: Any, shared: Any) -> tuple[Any, ...]:
        """The values at times t of any shape (...), each (..., its own shape)."""
        if not self._table:
            return ()

        def at(t: Any) -> tuple[Any, ...]:
            slots = dict(zip(self._program.inputs, [t, *jax.tree.leaves(shared)], strict=False))
            self._program.run(slots, lambda step: not self._before.isdisjoint(step.makes))
            return tuple(slots[slot] for slot in self._table)

        times = jnp.asarray(t)
        values = jax.vmap(at)(times.ravel())
        return tuple(value.reshape(*times.shape, *value.shape[1:]) for value in values)

    def rest(
        self, values: Sequence[Any], shared: Any, lane: Any, instead: Mapping[Any, Callable[..., Any]] = IN_LANES
    ) -> Any:
        """Evaluate the function with the values of the table at its time, and functions in place of primitives."""
        leaves = [*jax.tree.leaves(shared), *jax.tree.leaves(lane)]
        slots = dict(zip(self._program.inputs[1:], leaves, strict=True))
        slots |= dict(zip(self._table, values, strict=True))
        self._program.run(slots, self._after, instead)
        return self._program.results(slots)

    def _in_lanes(self, step: Step) -> bool:
        return self._level[step.makes[0]] == _LANE and not self._needed.isdisjoint(step.makes)

    def _after(self, step: Step) -> bool:
        return self._level[step.makes[0]] != _TIME and not self._needed.isdisjoint(step.makes)


@cached_by_structure
def time_split(system: Flow) -> TimeSplit:
    """Split a flow's rate into what depends on time alone and the rest; traced once for all flows of a structure."""

    def rate(t: Any, system: Flow, lane: tuple[State, Mapping[str, Any]]) -> State:
        state, own = lane
        return system.reduction.rhs(t, state, own)

    return TimeSplit(rate, system, lane_of(system))


def lane_of(system: Flow) -> tuple[State, dict[str, float]]:
    """The parts of a lane that steps carry, by its shapes, and parameters that it may have of its own."""
    section = jax.ShapeDtypeStruct((system.chart.dimension,), jnp.float64)
    state = jax.eval_shape(lambda u: system.reduction.reduce(system.chart.state(u)), section)
    return state, dict.fromkeys(system.roles.of_lanes, 0.0)
