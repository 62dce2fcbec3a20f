"""A function as its list of equations: which results depend on which arguments, and parts of it run alone.

What a program calls is written out in it, so that one equation of a function that is compiled by itself may be known
where another is not. Equal equations are one: the field of a mechanical system, traced with its tangents, has half as
many then, and a tenth as many sines.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend import core

INLINED = ("jit", "pjit", "closed_call", "core_call")
"""Names of equations that call a program."""

_NO_DEVICES = jax.sharding.AbstractMesh((), ())

Answer = TypeVar("Answer")
Slot = int
"""Number of a value of a program."""


class KnownValue(NamedTuple):
    """A number that the program itself has."""

    value: Any


class Step(NamedTuple):
    """One equation: what it does, what it reads, and what it makes."""

    equation: Any
    reads: tuple[Slot | KnownValue, ...]
    makes: tuple[Slot, ...]


class Program:
    """The equations of a function, in order, equal ones once.

    Attributes:
        steps: the equations.
        inputs: a slot for each leaf of its arguments.
        outputs: a slot, or a number, for each leaf of what it returns.
        structure: of what it returns.
        shapes: of its leaves, with their types.
        unread: slots of numbers of an outer program that the function closes over, with their values.
    """

    def __init__(
        self, function: Callable[..., Any], *arguments: Any, written_out: Callable[[Any], Any] = lambda _: None
    ) -> None:
        """Trace it.

        Args:
            function: of pytrees.
            arguments: pytrees of numbers or arrays; their shapes are read, and all are taken in double precision.
            written_out: the program in place of an equation, whose own equations are listed, or None.
        """
        closed, out = jax.make_jaxpr(function, return_shape=True)(
            *(jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), jnp.float64), a) for a in arguments)
        )
        self._program, self._constants = closed.jaxpr, closed.consts
        self._written_out = written_out
        self.steps: list[Step] = []
        self.size = 0
        self.inputs = [self._slot() for _ in closed.jaxpr.invars]
        self.structure, self.shapes = jax.tree.structure(out), jax.tree.leaves(out)
        self.unread: dict[Slot, Any] = {}
        self._made: dict[Any, tuple[Slot, ...]] = {}
        self._maker: dict[Slot, Step] = {}
        self.outputs = self._inline(closed.jaxpr, closed.consts, self.inputs)

    @property
    def sha256(self) -> str | None:
        """Hash, in hex, of the equations and the numbers in them; None where a derivative is defined beside them."""
        text = str(self._program)
        if "custom_" in text or self.unread:
            return None
        digest = hashlib.sha256(text.encode())
        for value in map(np.asarray, self._constants):
            digest.update(f"{value.dtype} {value.shape}".encode() + value.tobytes())
        return digest.hexdigest()

    def depends(self, levels: Sequence[int]) -> list[int]:
        """Return for each slot the largest number, above zero, of an argument that it depends on; 0: none."""
        numbers = [0] * self.size
        for slot, level in zip(self.inputs, levels, strict=True):
            numbers[slot] = level
        for slot in self.unread:
            numbers[slot] = max(levels, default=1)
        for step in self.steps:
            level = max((numbers[slot] for slot in step.reads if not isinstance(slot, KnownValue)), default=0)
            for slot in step.makes:
                numbers[slot] = level
        return numbers

    def output_depends(self, levels: Sequence[int]) -> bool:
        """Return whether any result depends on an argument whose number is above zero."""
        numbers = self.depends(levels)
        return any(not isinstance(slot, KnownValue) and numbers[slot] > 0 for slot in self.outputs)

    def needed(self, slots: Sequence[Slot | KnownValue]) -> set[Slot]:
        """All slots that these are made of, and they."""
        reached = {slot for slot in slots if not isinstance(slot, KnownValue)}
        for step in reversed(self.steps):
            if not reached.isdisjoint(step.makes):
                reached |= {slot for slot in step.reads if not isinstance(slot, KnownValue)}
        return reached

    def count(self, slots: Sequence[Slot | KnownValue]) -> int:
        """Return how many equations make all that these slots are made of."""
        needed = self.needed(slots)
        return sum(not needed.isdisjoint(step.makes) for step in self.steps)

    def run(
        self,
        slot_values: dict[Slot, Any],
        wanted: Callable[[Step], bool],
        instead: Mapping[Any, Callable[..., Any]] | None = None,
    ) -> None:
        """Solve the equations that are wanted, in order, reading known values of slots and adding results to them.

        Args:
            instead: functions in place of primitives, of what these read and of their parameters by name, or in place
                of the equations that make slots, of what these read.
        """
        for step in filter(wanted, self.steps):
            values = [slot.value if isinstance(slot, KnownValue) else slot_values[slot] for slot in step.reads]
            primitive = step.equation.primitive
            if instead and (replacement := instead.get(step.makes[0])) is not None:
                results = [replacement(*values)]
            elif instead and (replacement := instead.get(primitive)) is not None:
                results = [replacement(*values, **step.equation.params)]
            elif primitive.name.startswith("custom_"):  # its parameters are not those that it is bound with
                results = _alone(step.equation, self._program)(*values)
            else:
                bound = primitive.bind(*values, **step.equation.params)
                results = bound if primitive.multiple_results else [bound]
            slot_values |= dict(zip(step.makes, results, strict=True))

    def __call__(self, *arguments: Any) -> Any:
        """Return what the function does at other arguments of the same structure and shapes."""
        needed, values = self.needed(self.outputs), dict(zip(self.inputs, jax.tree.leaves(arguments), strict=True))
        values |= self.unread
        self.run(values, lambda step: not needed.isdisjoint(step.makes))
        return self.results(values)

    def results(self, slot_values: Mapping[Slot, Any]) -> Any:
        """Return the function's results from the values of slots."""
        leaves = [slot.value if isinstance(slot, KnownValue) else slot_values[slot] for slot in self.outputs]
        return jax.tree.unflatten(self.structure, leaves)

    def _slot(self) -> Slot:
        self.size += 1
        return self.size - 1

    def _inline(
        self, jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Slot | KnownValue]
    ) -> list[Slot | KnownValue]:
        """Add the equations of a program, those of the programs that it calls among them; what it returns."""
        slots: dict[Any, Slot | KnownValue] = dict(zip(jaxpr.invars, inputs, strict=True))
        for variable, value in zip(jaxpr.constvars, constants, strict=True):
            slots[variable] = self._slot() if isinstance(value, Tracer) else KnownValue(value)
            if isinstance(value, Tracer):
                self.unread[slots[variable]] = value  # pyright: ignore[reportArgumentType]

        def read(atom: Any) -> Slot | KnownValue:
            return KnownValue(atom.val) if isinstance(atom, core.Literal) else slots[atom]

        for equation in jaxpr.eqns:
            reads = tuple(read(atom) for atom in equation.invars)
            inner = self._written_out(equation)
            if inner is None and equation.primitive.name in INLINED:
                inner = equation.params["jaxpr"]
            if inner is not None:
                made: Sequence[Slot | KnownValue] = self._inline(inner.jaxpr, inner.consts, reads)
            else:
                made = self._add(equation, reads)
            slots |= dict(zip(equation.outvars, made, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def step_of(self, slot: Slot) -> Step | None:
        """Return the equation that makes a slot; None of an argument."""
        return self._maker.get(slot)

    def _add(self, equation: Any, reads: tuple[Slot | KnownValue, ...]) -> tuple[Slot | KnownValue, ...]:
        """Add an equation, where there is none like it; what it makes."""
        return self._made_by(equation, reads, len(equation.outvars))

    def _made_by(self, equation: Any, reads: tuple[Slot | KnownValue, ...], count: int) -> tuple[Slot, ...]:
        name = _name_of(equation, reads)
        if name is None or name not in self._made:
            made = tuple(self._slot() for _ in range(count))
            self.steps.append(Step(equation, reads, made))
            self._made[name or len(self.steps)] = made
            self._maker |= dict.fromkeys(made, self.steps[-1])
            return made
        return self._made[name]


def _name_of(equation: Any, reads: Sequence[Slot | KnownValue]) -> Any:
    """A key of an equation that others with the same results have too; None of one that has no like."""
    parameters = []
    for key, value in equation.params.items():
        if isinstance(value, core.ClosedJaxpr | core.Jaxpr):
            if getattr(value, "consts", ()):
                return None
            parameters.append((key, str(value)))
        else:
            parameters.append((key, value))
    name = equation.primitive, tuple(parameters), tuple(map(_name_of_read, reads))
    try:
        hash(name)
    except TypeError:
        return None
    return None if equation.effects else name


def _name_of_read(read: Slot | KnownValue) -> Any:
    if not isinstance(read, KnownValue):
        return read
    value = np.asarray(read.value)
    return type(read.value), value.dtype.str, value.shape, value.tobytes()


def traced_once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of pytrees of the same structure in every call, traced in the first; later ones are its equations."""
    programs: list[Program] = []

    def call(*arguments: Any) -> Any:
        if not programs:
            programs.append(Program(function, *arguments))
        return programs[0](*arguments)

    return call


def constants(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return a function's results that depend on no argument as floats, and None in place of the others."""
    program = Program(function, *arguments)
    depends = program.depends([1] * len(program.inputs))
    free = [slot for slot in program.outputs if isinstance(slot, KnownValue) or not depends[slot]]
    needed, values = program.needed(free), dict[Slot, Any]()
    with jax.ensure_compile_time_eval():
        program.run(values, lambda step: not needed.isdisjoint(step.makes))
    leaves = []
    for slot in program.outputs:
        value = slot.value if isinstance(slot, KnownValue) else values.get(slot)
        leaves.append(None if value is None or jnp.ndim(value) else float(value))
    return jax.tree.unflatten(program.structure, leaves)


def slope(function: Callable[..., Any], at: Sequence[Any], i: int) -> Any:
    """∂function/∂at[i] at components `at`, the others being constants of the program."""
    unit = jnp.ones_like(at[i])
    return jax.jvp(lambda x: function(*at[:i], x, *at[i + 1 :]), (at[i],), (unit,))[1]


def jacobian_trace(rate: Callable[[Any], Any], y: Any, counted: Callable[[Any], Any]) -> Any:
    """Σ ∂rate_i/∂y_i over the components of a state that a function picks of it; one derivative each, no matrix."""
    leaves, structure = jax.tree.flatten(y)
    numbers = jax.tree.leaves(counted(jax.tree.unflatten(structure, list(range(len(leaves))))))

    def component(i: int) -> Callable[[Any], Any]:
        def moved(x: Any) -> Any:
            return jax.tree.leaves(rate(jax.tree.unflatten(structure, [*leaves[:i], x, *leaves[i + 1 :]])))[i]

        return moved

    slopes = [jax.jvp(component(i), (leaves[i],), (jnp.ones_like(leaves[i]),))[1] for i in numbers]
    return sum(slopes[1:], slopes[0])


def cached_by_structure(look: Callable[[Any], Answer]) -> Callable[[Any], Answer]:
    """Cache what tracing tells of a pytree, whose numbers are zeros then, for each structure and shapes of its leaves.

    What is traced while a program for some devices is made is of that program's devices, unless it is traced apart.
    """

    @functools.lru_cache(maxsize=256)
    def cached(structure: Any, shapes: tuple[tuple[int, ...], ...]) -> Answer:
        with jax.sharding.use_abstract_mesh(_NO_DEVICES):
            return look(jax.tree.unflatten(structure, [np.zeros(shape) for shape in shapes]))

    @functools.wraps(look)
    def answer(tree: Any) -> Answer:
        return cached(jax.tree.structure(tree), tuple(np.shape(leaf) for leaf in jax.tree.leaves(tree)))

    return answer


def listed_once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of pytrees of numbers whose equations are listed once for each structure of its arguments.

    In a program its calls are these equations, equal ones once; elsewhere it is called as it is written.
    """

    @cached_by_structure
    def listed(arguments: Sequence[Any]) -> Program:
        return Program(function, *arguments)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        if not any(isinstance(leaf, Tracer) for leaf in leaves) or not all(map(_is_double, leaves)):
            return function(*arguments)
        arguments = jax.tree.unflatten(structure, [jnp.asarray(leaf, float) for leaf in leaves])
        return listed(arguments)(*arguments)

    return call


def _is_double(leaf: Any) -> bool:
    return not jnp.ndim(leaf) and jnp.result_type(leaf) == jnp.float64


def _alone(equation: Any, program: Any) -> Callable[..., Sequence[Any]]:
    """A function of what an equation of a program reads, literals among it."""
    reads = [core.Var(atom.aval) for atom in equation.invars]
    single = program.replace(
        constvars=(),
        invars=reads,
        outvars=equation.outvars,
        eqns=[equation.replace(invars=reads)],
        effects=equation.effects,
    )
    return core.jaxpr_as_fun(core.ClosedJaxpr(single, ()))
