"""Which flows are x″ = F(x, t) − γ x′, so that methods of Nyström's step them, and how: found by tracing the field.

Damping that is linear is taken out of the steps exactly: u = x exp(γ t/2), t from the beginning of the step, obeys
u″ = exp(γ t/2) F(x, t) + γ²/4 u, in which no velocity is left. Its exponentials are in the table of the steps.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.maps.time_tables import TimeSplit
from jaxnh.systems.flow import Flow, State
from jaxnh.systems.tracing import Known, Program, constants

_MOST_COMPONENTS = 12  # of a state: each pair of them is traced
_LARGEST_FORCE = 100  # equations: in larger ones the stages would have to be a loop
_TIME, _LANE = 1, 1


class Halves(NamedTuple):
    """Numbers of the leaves of a state that are positions, and of their velocities, in one order."""

    positions: tuple[int, ...]
    velocities: tuple[int, ...]

    def parts(self, state: State) -> tuple[list[Any], list[Any]]:
        """Positions and velocities."""
        leaves = jax.tree.leaves(state)
        return [leaves[i] for i in self.positions], [leaves[j] for j in self.velocities]

    def joined(self, state: State, x: Sequence[Any], v: Sequence[Any]) -> State:
        """The state with other positions and velocities."""
        leaves, structure = jax.tree.flatten(state)
        for i, j, position, velocity in zip(self.positions, self.velocities, x, v, strict=True):
            leaves[i], leaves[j] = position, velocity
        return jax.tree.unflatten(structure, leaves)


class SecondOrder:
    """What makes a flow one of second order.

    Attributes:
        halves: of its states.
        split: F of (t, flow, (positions, own)) in what time decides and what lanes do.
        damped: whether there is a γ that is not zero.
    """

    def __init__(self, halves: Halves, split: TimeSplit, damped: bool, damping: Program) -> None:
        self.halves, self.split, self.damped, self._damping = halves, split, damped, damping

    def damping(self, system: Flow) -> np.ndarray:
        """γ of each position, (positions,)."""
        if not self.damped:
            return np.zeros(len(self.halves.positions))
        program, found = self._damping, dict[int, Any]()
        found = dict(zip(program.inputs, [jnp.float64(0.0), *jax.tree.leaves(system)], strict=False))
        needed = program.needed(program.outputs)
        program.run(found, lambda step: not needed.isdisjoint(step.makes))
        return np.array([float(value) for value in program.results(found)])


def second_order(system: Flow) -> SecondOrder | None:
    """What makes a flow one of second order; None where it is none. Traced once for all flows of a structure."""
    return _second_order(jax.tree.structure(system), tuple(np.shape(leaf) for leaf in jax.tree.leaves(system)))


@functools.lru_cache(maxsize=256)
def _second_order(structure: Any, shapes: tuple[tuple[int, ...], ...]) -> SecondOrder | None:
    system = jax.tree.unflatten(structure, [np.zeros(shape) for shape in shapes])
    state = jax.eval_shape(system.unchart, jax.ShapeDtypeStruct((system.dimension,), jnp.float64))
    count = len(jax.tree.leaves(state))
    if count > _MOST_COMPONENTS:
        return None
    own = dict.fromkeys(system.own, 0.0)

    def rates(t: Any, system: Flow, leaves: Sequence[Any], own: Mapping[str, Any]) -> list[Any]:
        return jax.tree.leaves(system.rhs(t, jax.tree.unflatten(jax.tree.structure(state), leaves), own))

    def slopes(t: Any, system: Flow, leaves: Sequence[Any], own: Mapping[str, Any]) -> list[list[Any]]:
        """∂rate_i/∂leaf_j, [j][i]."""

        def by(j: int) -> list[Any]:
            def moved(x: Any) -> list[Any]:
                return rates(t, system, [*leaves[:j], x, *leaves[j + 1 :]], own)

            return jax.jvp(moved, (leaves[j],), (jnp.ones_like(leaves[j]),))[1]

        return [by(j) for j in range(count)]

    zeros = [0.0] * count
    matrix = constants(slopes, 0.0, system, zeros, own)  # None where not the same for all
    at_zero = constants(lambda t, system, own: rates(t, system, [jnp.zeros(())] * count, own), 0.0, system, own)
    still = constants(rates, 0.0, system, zeros, own)
    pairs: dict[int, int] = {}
    for i in range(count):
        column = [matrix[j][i] for j in range(count)]
        if at_zero[i] == 0.0 and column.count(0.0) == count - 1 and column.count(1.0) == 1 and column[i] == 0.0:
            pairs[i] = column.index(1.0)
    moving = {*pairs, *pairs.values()}
    unmoved = all(still[i] == 0.0 for i in range(count) if i not in moving)
    if not pairs or not unmoved or len(moving) != 2 * len(pairs):
        return None
    halves = Halves(tuple(pairs), tuple(pairs.values()))
    crossed = [matrix[j][i] for i in halves.velocities for j in halves.velocities if i != j]
    if any(slope != 0.0 for slope in crossed):
        return None
    own_slopes = [matrix[j][j] for j in halves.velocities]
    damped = any(slope != 0.0 for slope in own_slopes)
    if damped and system.autonomous:  # the steps of a section are of any length: no table has their exponentials
        return None

    def gammas(t: Any, system: Flow, leaves: Sequence[Any], own: Mapping[str, Any]) -> list[Any]:
        found = slopes(t, system, leaves, own)
        return [-found[j][j] for j in halves.velocities]

    damping = Program(gammas, 0.0, system, zeros, own)
    shared = len(jax.tree.leaves(system))
    level = damping.depends([_TIME] + [0] * shared + [_LANE] * (len(damping.inputs) - 1 - shared))
    if any(not isinstance(slot, Known) and level[slot] for slot in damping.outputs):
        return None

    def force(t: Any, system: Flow, lane: tuple[list[Any], Mapping[str, Any]]) -> list[Any]:
        x, own = lane
        leaves = [jnp.zeros_like(x[0])] * count
        for i, position in zip(halves.positions, x, strict=True):
            leaves[i] = position
        found = rates(t, system, leaves, own)
        return [found[j] for j in halves.velocities]

    split = TimeSplit(force, system, ([0.0] * len(pairs), own))
    return SecondOrder(halves, split, damped, damping) if split.size <= _LARGEST_FORCE else None
