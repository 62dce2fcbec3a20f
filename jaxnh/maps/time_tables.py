"""What of a field depends on time alone, taken out of the lanes: a table at the times of the stages, shared by all.

A field is traced into its list of equations. Those that reach from t to a number without the state of a lane or its
own parameters need to be solved once a time, and not in every lane: forcing, a moving constraint, any function of t.
What is left is the field of the lanes, which takes their values from the table. Users need not say a word about it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jax.extend.core import primitives

from jaxnh.maps.elementary import cosine, sine

_SHARED, _TIME, _LANE = 0, 1, 2  # what a value depends on, at most
_INLINED = ("jit", "pjit", "closed_call", "core_call")
_IN_LANES: dict[Any, Callable[[Any], Any]] = {primitives.sin_p: sine, primitives.cos_p: cosine}

Slot = int
"""Number of a value."""


class _Step(NamedTuple):
    """One equation: a primitive, what it reads (slots, or numbers of the program), and what it makes."""

    equation: Any
    reads: tuple[Any, ...]
    makes: tuple[Slot, ...]


class _Known(NamedTuple):
    """A number that the program itself has."""

    value: Any


class TimeSplit:
    """A function of (t, shared, lane) in two: what t decides, and what the lane does with it.

    Attributes:
        size: number of equations that are left to the lanes.
        shapes: of the values in the table, one each.
    """

    def __init__(self, function: Callable[[Any, Any, Any], Any], shared: Any, lane: Any) -> None:
        """Trace it.

        Args:
            function: (t, shared, lane) to a pytree; t of shape ().
            shared: pytree of what all lanes have alike.
            lane: pytree of what each lane has of its own, leaves of any shape.
        """
        time = jax.ShapeDtypeStruct((), jnp.float64)
        closed, self._out = jax.make_jaxpr(function, return_shape=True)(time, _abstract(shared), _abstract(lane))
        self._steps: list[_Step] = []
        self._level: list[int] = []
        counts = 1, len(jax.tree.leaves(shared)), len(jax.tree.leaves(lane))
        levels = np.repeat((_TIME, _SHARED, _LANE), counts)
        self._inputs = [self._slot(int(level)) for level in levels]
        self._ends = np.cumsum(counts).tolist()
        self._outputs = self._inline(closed.jaxpr, closed.consts, self._inputs)
        reads = [slot for step in self._steps if self._of(step) == _LANE for slot in step.reads]
        read = {slot for slot in (*reads, *self._outputs) if not isinstance(slot, _Known)}
        self._table = sorted(s for s in read if self._level[s] == _TIME)
        self.size = sum(self._of(step) == _LANE for step in self._steps)

    @property
    def width(self) -> int:
        """Number of values in the table at a time."""
        return len(self._table)

    def table(self, t: Any, shared: Any) -> tuple[Any, ...]:
        """The values at times t of any shape (...), each (..., its own shape)."""
        if not self._table:
            return ()

        def at(t: Any) -> tuple[Any, ...]:
            found = dict(zip(self._inputs, [t, *jax.tree.leaves(shared)], strict=False))
            self._run(found, (_SHARED, _TIME), {})
            return tuple(found[slot] for slot in self._table)

        times = jnp.asarray(t)
        values = jax.vmap(at)(times.ravel())
        return tuple(value.reshape(*times.shape, *value.shape[1:]) for value in values)

    def rest(self, values: Sequence[Any], shared: Any, lane: Any) -> Any:
        """What the function is, with the values of the table at its time."""
        found = dict(zip(self._inputs[1:], [*jax.tree.leaves(shared), *jax.tree.leaves(lane)], strict=True))
        found |= dict(zip(self._table, values, strict=True))
        self._run(found, (_SHARED, _LANE), _IN_LANES)
        leaves = [slot.value if isinstance(slot, _Known) else found[slot] for slot in self._outputs]
        return jax.tree.unflatten(jax.tree.structure(self._out), leaves)

    # ---- how

    def _slot(self, level: int) -> Slot:
        self._level.append(level)
        return len(self._level) - 1

    def _of(self, step: _Step) -> int:
        return self._level[step.makes[0]] if step.makes else _SHARED

    def _inline(self, jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
        """Add the equations of a program, those of the programs that it calls among them; slots of its results."""
        slots: dict[Any, Any] = dict(zip(jaxpr.invars, inputs, strict=True))
        slots |= {v: _Known(c) for v, c in zip(jaxpr.constvars, constants, strict=True)}

        def read(atom: Any) -> Any:
            return _Known(atom.val) if isinstance(atom, core.Literal) else slots[atom]

        for equation in jaxpr.eqns:
            reads = tuple(read(atom) for atom in equation.invars)
            if equation.primitive.name in _INLINED:
                inner = equation.params.get("jaxpr") or equation.params["call_jaxpr"]
                made = self._inline(inner.jaxpr, inner.consts, reads)
            else:
                level = max((self._level[slot] for slot in reads if not isinstance(slot, _Known)), default=_SHARED)
                made = [self._slot(level) for _ in equation.outvars]
                self._steps.append(_Step(equation, reads, tuple(made)))
            slots |= dict(zip(equation.outvars, made, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _run(self, found: dict[Slot, Any], levels: tuple[int, ...], instead: dict[Any, Callable[[Any], Any]]) -> None:
        """Solve the equations of these levels, with functions of one number in place of some primitives."""
        for step in self._steps:
            if self._of(step) not in levels:
                continue
            values = [slot.value if isinstance(slot, _Known) else found[slot] for slot in step.reads]
            primitive = step.equation.primitive
            own = instead.get(primitive) if self._of(step) == _LANE else None
            if own is not None:
                found[step.makes[0]] = own(*values)
                continue
            if primitive.name.startswith("custom_"):  # its parameters are not those that it is bound with
                results = _program(step.equation)(*values)
            else:
                results = primitive.bind(*values, **step.equation.params)
            found |= dict(zip(step.makes, results if primitive.multiple_results else [results], strict=True))


def _program(equation: Any) -> Callable[..., Sequence[Any]]:
    """A function of what an equation reads, literals among it."""
    reads = [core.Var(atom.aval) for atom in equation.invars]
    one = core.Jaxpr((), reads, equation.outvars, [equation.replace(invars=reads)], equation.effects)
    return core.jaxpr_as_fun(core.ClosedJaxpr(one, ()))


def _abstract(tree: Any) -> Any:
    """The tree with shapes in place of numbers, all of them of double precision."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.float64), tree)
