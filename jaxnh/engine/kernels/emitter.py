"""C statements of a traced function of one lane."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from jax.extend.core import Literal

from jaxnh.engine.kernels.values import (
    Memory,
    Scalars,
    UnsupportedError,
    Value,
    constant,
    in_registers,
    is_known,
    kind_of,
    size_of,
    text_of,
)

_MOST_LINES = 60_000
_BYTES = {"float": 4, "int": 4, "unsigned int": 4, "bool": 1, "short": 2, "signed char": 1, "unsigned char": 1}


class Rule(Protocol):
    """Statements of one primitive."""

    def __call__(self, emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> Sequence[Value]:
        """Emit them, and return the values of the equation's results."""
        ...


class Emitter:
    """Writes C statements, and evaluates traced programs into them.

    Attributes:
        lines: statements so far.
        tables: arrays of known numbers, by their text: declarations of the file.
        viewed: names of memory that other values see a part of, so that nothing may be changed in place.
    """

    def __init__(self, rules: Mapping[str, Rule]) -> None:
        self.lines: list[str] = []
        self.tables: dict[str, str] = {}
        self.viewed: set[str] = set()
        self._declared: dict[str, tuple[int, int]] = {}  # line and bytes of each array of a lane's own
        self._rules = rules
        self._numbers = itertools.count()

    def line(self, text: str) -> None:
        """Write a statement."""
        if len(self.lines) >= _MOST_LINES:
            raise UnsupportedError(f"a program of more than {_MOST_LINES} statements")
        self.lines.append(text)

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """Write a block of statements."""
        self.line(f"{head} {{")
        yield
        self.line("}")

    def name(self, letter: str = "v") -> str:
        """Return a new name."""
        return f"{letter}{next(self._numbers)}"

    def let(self, kind: str, expression: Any) -> Any:
        """Name an expression; a number is its own name."""
        if is_known(expression):
            return expression
        name = self.name()
        self.line(f"const {kind} {name} = {expression};")
        return name

    def variable(self, kind: str, expression: str = "") -> str:
        """Declare a variable."""
        name = self.name()
        self.line(f"{kind} {name}{f' = {expression}' if expression else ''};")
        return name

    def memory(self, shape: tuple[int, ...], kind: str) -> Memory:
        """Declare an array of the lane's own."""
        name, count = self.name("a"), max(1, size_of(shape))
        self._declared[name] = len(self.lines), count * _BYTES.get(kind, 8)
        self.line(f"{kind} {name}[{count}];")
        return Memory(name, shape, kind, free=True)

    @property
    def own_bytes(self) -> int:
        """Bytes of all arrays of a lane's own."""
        return sum(count for _, count in self._declared.values())

    def placed(self, memory: Memory, place: str) -> bool:
        """Put an array of the lane's own where a pointer says, if it is a whole one; return whether it is."""
        line, count = self._declared.get(memory.name, (0, 0))
        if count != size_of(memory.shape) * _BYTES.get(memory.kind, 8):
            return False
        del self._declared[memory.name]
        self.lines[line] = f"{memory.kind}* {memory.name} = {place};"
        return True

    @contextmanager
    def each(self, count: int) -> Iterator[str]:
        """Write a loop, and give its counter."""
        index = self.name("i")
        with self.block(f"for (int {index} = 0; {index} < {count}; ++{index})"):
            yield index

    def scalars(self, value: Value) -> Scalars:
        """Return a value as variables."""
        if isinstance(value, Scalars):
            return value
        elements = np.empty(value.shape, object)
        flat = [self.let(value.kind, f"{value.name}[{k}]") for k in range(size_of(value.shape))]
        elements[...] = np.array([*flat, None], object)[:-1].reshape(value.shape)
        return Scalars(elements, value.kind)

    def stored(self, value: Value) -> Memory:
        """Return a value as an array in memory: of known numbers, one that all lanes share."""
        if isinstance(value, Memory):
            return value
        texts = [text_of(element, value.kind) for element in value.flat]
        if value.flat and all(map(is_known, value.flat)):
            body = f"{value.kind} NAME[{len(texts)}] = {{{', '.join(texts)}}}"
            name = self.tables.setdefault(body, f"t{len(self.tables)}")
            return Memory(name, value.shape, value.kind)
        memory = self.memory(value.shape, value.kind)
        for k, text in enumerate(texts):
            self.line(f"{memory.name}[{k}] = {text};")
        return memory

    def copied(self, value: Value, place: Memory) -> None:
        """Copy a value to memory."""
        if isinstance(value, Scalars):
            for k, element in enumerate(value.flat):
                self.line(f"{place.name}[{k}] = {text_of(element, value.kind)};")
        elif value.name != place.name:
            with self.each(size_of(place.shape)) as i:
                self.line(f"{place.name}[{i}] = {value.name}[{i}];")

    def settled(self, value: Value) -> Value:
        """Return a small value as variables, and a large one as it is."""
        return self.scalars(value) if in_registers(value.shape) else value

    def evaluate(self, jaxpr: Any, consts: Sequence[Any], inputs: Sequence[Value]) -> list[Value]:
        """Write the statements of a traced program, and return its results."""
        known: dict[Any, Value] = dict(zip(jaxpr.invars, inputs, strict=True))
        known |= zip(jaxpr.constvars, map(_constant, consts), strict=True)
        last = {v: k for k, e in enumerate(jaxpr.eqns) for v in e.invars if not isinstance(v, Literal)}
        last |= {v: len(jaxpr.eqns) for v in jaxpr.outvars if not isinstance(v, Literal)}

        def value(atom: Any, place: int) -> Value:
            if isinstance(atom, Literal):
                return constant(np.asarray(atom.val, atom.aval.dtype))  # pyright: ignore[reportAttributeAccessIssue]
            present = known[atom]
            if isinstance(present, Memory) and present.free and last[atom] > place:
                return present._replace(free=False)
            return present

        for place, equation in enumerate(jaxpr.eqns):
            rule = self._rules.get(equation.primitive.name)
            if rule is None:
                raise UnsupportedError(f"the operation {equation.primitive.name}")
            results = rule(self, equation, [value(atom, place) for atom in equation.invars])
            known |= zip(equation.outvars, map(self.settled, results), strict=True)
        return [value(atom, len(jaxpr.eqns)) for atom in jaxpr.outvars]


def _constant(number: Any) -> Value:
    return number if isinstance(number, Scalars | Memory) else constant(np.asarray(number))


def filled(shape: tuple[int, ...], kind: str, elements: Sequence[Any]) -> Scalars:
    """Return an array of elements, given row by row."""
    array = np.empty(size_of(shape), object)
    for k, element in enumerate(elements):
        array[k] = element
    return Scalars(array.reshape(shape), kind)


def result_kind(equation: Any) -> str:
    """Return the type in C of the first result of an equation."""
    return kind_of(equation.outvars[0].aval.dtype)


def place_at(emitter: Emitter, numbers: np.ndarray, index: str) -> str:
    """Return the text of the index-th of known numbers: evenly spaced, or from a table."""
    steps = np.unique(np.diff(numbers))
    if len(steps) <= 1:
        step = int(steps[0]) if len(steps) else 0
        return f"{int(numbers[0])} + {step} * {index}"
    return f"{emitter.stored(constant(numbers.astype(np.int32))).name}[{index}]"
