"""The derivative of a field as its matrix, number by number: what is zero or one in it costs nothing along a tangent.

A field that is linearised along each tangent by itself does for each all that the chain rule has between the state and
the rates. Its matrix has that once, and a tangent costs a product for each entry that is neither zero nor one. Of most
flows the matrix is sparse, and of a mechanical one half of its rows are those of the velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.maps.time_tables import IN_LANES, TimeSplit, lane_of, time_split
from jaxnh.systems.flow import Flow
from jaxnh.systems.simplification import SimplifiedProgram
from jaxnh.systems.state import State
from jaxnh.systems.tracing import KnownValue, cached_by_structure

_WORTHWHILE = 5 / 6  # of the equations: with little fewer, entries kept for all tangents cost more than they save
_LARGEST_FIELD = 150  # equations: of larger ones the matrix takes half a second and more to trace


class FieldJacobian:
    """Rates of a state of numbers, and their derivatives in each of these.

    Attributes:
        size: number of equations of both.
        products: number of operations that a tangent takes.
    """

    def __init__(self, split: TimeSplit, shared: Any, state: Any, own: Mapping[str, Any]) -> None:
        """Trace it.

        Args:
            split: the field, of (time, shared, (state, own)).
            shared, state, own: pytrees like those that it will be called with; leaves of the state are numbers.
        """
        self._count, structure = len(jax.tree.leaves(state)), jax.tree.structure(state)

        def columns(values: Sequence[Any], shared: Any, state: Any, own: Mapping[str, Any]) -> tuple[Any, list[Any]]:
            def rates(*leaves: Any) -> list[Any]:
                lane = jax.tree.unflatten(structure, leaves), own
                return jax.tree.leaves(split.rest(values, shared, lane, instead={}))

            at = tuple(jax.tree.leaves(state))
            units = np.eye(len(at))
            moved = [jax.jvp(rates, at, tuple(map(jnp.asarray, unit)))[1] for unit in units]
            return rates(*at), moved

        self._program = program = SimplifiedProgram(columns, [0.0] * split.width, shared, state, own)
        self._needed = program.needed(program.outputs)
        entries = program.outputs[self._count :]
        self._entries = [
            {j: entries[j * self._count + i] for j in range(self._count) if not _is_zero(entries[j * self._count + i])}
            for i in range(self._count)
        ]
        self.size = program.count(program.outputs)
        given = [entry for row in self._entries for entry in row.values()]
        self.products = len(given) + sum(not (isinstance(e, KnownValue) and abs(_number(e)) == 1.0) for e in given)
        self.products -= sum(bool(row) for row in self._entries)

    def __call__(
        self, values: Sequence[Any], shared: Any, state: Any, own: Mapping[str, Any]
    ) -> tuple[Any, list[dict[int, Any]]]:
        """The rates, and for each of them its derivatives that are not known to vanish by the number of the leaf."""
        program = self._program
        slots = dict(zip(program.inputs, jax.tree.leaves((list(values), shared, state, own)), strict=True))
        program.run(slots, lambda step: not self._needed.isdisjoint(step.makes), IN_LANES)

        def read(slot: Any) -> Any:
            return _number(slot) if isinstance(slot, KnownValue) else slots[slot]

        rates = [slot.value if isinstance(slot, KnownValue) else slots[slot] for slot in program.outputs[: self._count]]
        rows = [{j: read(slot) for j, slot in row.items()} for row in self._entries]
        return jax.tree.unflatten(jax.tree.structure(state), rates), rows


@cached_by_structure
def field_jacobian(system: Flow) -> FieldJacobian:
    """The derivative of a flow's rate as its matrix; traced once for all flows of a structure."""
    return FieldJacobian(time_split(system), system, *lane_of(system))


def has_cheap_jacobian(system: Flow, tangents: int) -> bool:
    """Return whether so many tangents take clearly fewer equations by the matrix of a rate than each by itself."""
    if tangents < 2 or not _may_have_jacobian(system):
        return False
    matrix, each = field_jacobian(system), time_split(system).size + tangents * _slope_size(system)
    return matrix.size + tangents * matrix.products < _WORTHWHILE * each


@cached_by_structure
def _may_have_jacobian(system: Flow) -> bool:
    """Return whether a flow's state has numbers alone, and its rate is not too large."""
    arrays = any(np.shape(leaf) for leaf in jax.tree.leaves(lane_of(system)[0]))
    return not arrays and time_split(system).size <= _LARGEST_FIELD


def equations_with_tangents(system: Flow, tangents: int) -> int:
    """Number of equations of a flow's rate with so many tangents, by the matrix where that has fewer."""
    if has_cheap_jacobian(system, tangents):
        matrix = field_jacobian(system)
        return matrix.size + tangents * matrix.products
    return time_split(system).size + (tangents * _slope_size(system) if tangents else 0)


@cached_by_structure
def _slope_size(system: Flow) -> int:
    """Number of equations that a tangent by itself adds to a flow's rate."""
    split, (state, own) = time_split(system), lane_of(system)

    def moved(values: Sequence[Any], system: Flow, z: State, own: Any, dz: State) -> Any:
        return jax.jvp(lambda z: split.rest(values, system, (z, own), instead={}), (z,), (dz,))

    program = SimplifiedProgram(moved, [0.0] * split.width, system, state, own, state)
    return program.count(program.outputs) - split.size


def tangent_rate(rows: Sequence[Mapping[int, Any]], tangent: Any) -> Any:
    """Product of a matrix's entries, by row and column, with a tangent whose leaves are the columns."""
    leaves, structure = jax.tree.flatten(tangent)
    moved = []
    for row, leaf in zip(rows, leaves, strict=True):
        terms = [_times(entry, leaves[j]) for j, entry in row.items()]
        moved.append(sum(terms[1:], terms[0]) if terms else jnp.zeros_like(leaf))
    return jax.tree.unflatten(structure, moved)


def _times(entry: Any, x: Any) -> Any:
    if isinstance(entry, float) and abs(entry) == 1.0:
        return x if entry > 0.0 else -x
    return entry * x


def _number(value: KnownValue) -> float:
    return float(np.asarray(value.value))


def _is_zero(slot: Any) -> bool:
    return isinstance(slot, KnownValue) and _number(slot) == 0.0
