"""Flows x″ = F(x, t) − γ x′, so that methods of Nyström's step them, and how: recognised by tracing the field.

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
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State
from jaxnh.systems.tracing import Program, cached_by_structure, constants

_MOST_COMPONENTS = 12  # of a state: each pair of them is traced
_LARGEST_FORCE = 100  # equations: in larger ones the stages would have to be a loop


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
    """A flow as a system of second order.

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
        program = self._damping
        slots = dict(zip(program.inputs, [jnp.float64(0.0), *jax.tree.leaves(system)], strict=False))
        needed = program.needed(program.outputs)
        program.run(slots, lambda step: not needed.isdisjoint(step.makes))
        return np.array([float(value) for value in program.results(slots)])


@cached_by_structure
def second_order(system: Flow) -> SecondOrder | None:
    """Return the flow as a system of second order, None where it is none. Traced once for all flows of a structure."""
    field = _Field(system)
    small = field.carried_whole and field.count <= _MOST_COMPONENTS and field.size <= 2 * _LARGEST_FORCE
    halves = field.halves() if small else None
    if halves is None:
        return None
    slopes = [[field.matrix[j][i] for i in halves.velocities] for j in halves.velocities]
    if any(slope != 0.0 for k, row in enumerate(slopes) for n, slope in enumerate(row) if k != n):
        return None
    damped = any(row[k] != 0.0 for k, row in enumerate(slopes))
    if damped and field.system.autonomous:  # the steps of a section are of any length: no table has their exponentials
        return None
    damping = field.damping(halves)
    if damping is None:
        return None
    split = field.force(halves)
    return SecondOrder(halves, split, damped, damping) if split.size <= _LARGEST_FORCE else None


class _Field:
    """The rates of a flow's states, leaf by leaf, looked at by tracing.

    Attributes:
        system: the flow, its numbers of no meaning.
        count: leaves of a state.
        carried_whole: whether steps carry all of a state.
        own: parameters of lanes' own.
    """

    def __init__(self, system: Flow) -> None:
        section = jax.ShapeDtypeStruct((system.chart.dimension,), jnp.float64)
        state, carried = jax.eval_shape(
            lambda u: (system.chart.state(u), system.reduction.reduce(system.chart.state(u))), section
        )
        self.system, self._structure = system, jax.tree.structure(state)
        self.count = self._structure.num_leaves
        self.carried_whole = jax.tree.structure(carried) == self._structure
        self.own = dict.fromkeys(system.roles.of_lanes, 0.0)
        self._zeros = [0.0] * self.count

    @property
    def size(self) -> int:
        """Equations of the rates."""
        program = Program(self.rates, 0.0, self.system, self._zeros, self.own)
        needed = program.needed(program.outputs)
        return sum(not needed.isdisjoint(step.makes) for step in program.steps)

    def rates(self, t: Any, system: Flow, leaves: Sequence[Any], own: Mapping[str, Any]) -> list[Any]:
        """Return the rate of every leaf."""
        return jax.tree.leaves(system.rhs(t, jax.tree.unflatten(self._structure, leaves), own))

    def slopes(self, j: int, t: Any, system: Flow, leaves: Sequence[Any], own: Mapping[str, Any]) -> list[Any]:
        """Return the derivative of every rate in leaf j."""

        def moved(x: Any) -> list[Any]:
            return self.rates(t, system, [*leaves[:j], x, *leaves[j + 1 :]], own)

        return jax.jvp(moved, (leaves[j],), (jnp.ones_like(leaves[j]),))[1]

    @functools.cached_property
    def matrix(self) -> list[list[float | None]]:
        """∂rate_i/∂leaf_j, [j][i]; None where it is not the same for all states, times and parameters."""

        def every(*at: Any) -> list[list[Any]]:
            return [self.slopes(j, *at) for j in range(self.count)]

        return constants(every, 0.0, self.system, self._zeros, self.own)

    def halves(self) -> Halves | None:
        """Positions and their velocities, where there are no other leaves that move."""

        def at_zero(t: Any, system: Flow, own: Mapping[str, Any]) -> list[Any]:
            return self.rates(t, system, [jnp.zeros(())] * self.count, own)

        still = constants(self.rates, 0.0, self.system, self._zeros, self.own)
        start = constants(at_zero, 0.0, self.system, self.own)
        pairs: dict[int, int] = {}
        for i in range(self.count):
            if start[i] == 0.0:
                column = [self.matrix[j][i] for j in range(self.count)]
                if column.count(0.0) == self.count - 1 and column.count(1.0) == 1 and column[i] == 0.0:
                    pairs[i] = column.index(1.0)
        moving = {*pairs, *pairs.values()}
        others = [i for i in range(self.count) if i not in moving]
        if not pairs or len(moving) != 2 * len(pairs) or any(still[i] != 0.0 for i in others):
            return None
        return Halves(tuple(pairs), tuple(pairs.values()))

    def damping(self, halves: Halves) -> Program | None:
        """γ of each position of (t, flow, leaves, own); None where time, states or lanes decide it."""

        def gammas(*at: Any) -> list[Any]:
            return [-self.slopes(j, *at)[j] for j in halves.velocities]

        program = Program(gammas, 0.0, self.system, self._zeros, self.own)
        shared = len(jax.tree.leaves(self.system))
        decided = program.output_depends([1] + [0] * shared + [1] * (len(program.inputs) - 1 - shared))
        return None if decided else program

    def force(self, halves: Halves) -> TimeSplit:
        """The rates of the velocities where these are zero, of (t, flow, (positions, own))."""

        def force(t: Any, system: Flow, lane: tuple[list[Any], Mapping[str, Any]]) -> list[Any]:
            x, own = lane
            leaves = [jnp.zeros_like(x[0])] * self.count
            for i, position in zip(halves.positions, x, strict=True):
                leaves[i] = position
            rates = self.rates(t, system, leaves, own)
            return [rates[j] for j in halves.velocities]

        return TimeSplit(force, self.system, ([0.0] * len(halves.positions), self.own))
