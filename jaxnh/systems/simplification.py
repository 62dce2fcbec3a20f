"""A function's equations in fewer operations: numbers folded, signs and factors moved to where they cost nothing.

What users write and what differentiation makes of it is full of products with one, sums with zero and signs that meet
again. XLA takes out the plain ones of these, and after it has counted them; what a step is written out of is decided by
the number of equations that are left here. Results are those of the function but for rounding.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import primitives

from jaxnh.systems.tracing import KnownValue, Program, Slot

Value = Slot | KnownValue


class Operation(NamedTuple):
    """An operation on numbers.

    Attributes:
        primitive: of JAX.
        params: its parameters.
        effects: none.
    """

    primitive: Any
    params: Mapping[str, Any] = {}
    effects: Any = frozenset()


_COMMUTING = ("add", "add_any", "mul")


@functools.cache
def _operation(name: str) -> Operation:
    """An operation on one or two numbers, with what this JAX gives it for parameters."""
    numbers = (1.0,) if name == "neg" else (1.0, 1.0)
    [equation] = jax.make_jaxpr(getattr(lax, name))(*numbers).jaxpr.eqns
    return Operation(equation.primitive, equation.params)


class SimplifiedProgram(Program):
    """The equations of a function, those on single numbers in double precision as few as simple rules make them."""

    def _add(self, equation: Any, reads: tuple[Value, ...]) -> tuple[Value, ...]:
        out = equation.outvars
        on_numbers = all(
            not np.shape(atom.aval) and atom.aval.dtype == jnp.float64 for atom in (*equation.invars, *out)
        )
        if len(out) != 1 or not on_numbers or equation.effects or equation.primitive.name.startswith("custom_"):
            return super()._add(equation, reads)
        name = equation.primitive.name
        if name == "convert_element_type":
            return reads
        if all(isinstance(read, KnownValue) for read in reads):
            with jax.ensure_compile_time_eval():
                return (_constant(equation.primitive.bind(*(read.value for read in reads), **equation.params)),)
        if name == "integer_pow" and equation.params["y"] < 0:
            return (_negative_power(self, *reads, equation.params["y"]),)
        rule = _RULES.get(name)
        return (rule(self, *reads) if rule else self.written(Operation(equation.primitive, equation.params), *reads),)

    def written(self, operation: Operation, *reads: Value) -> Slot:
        """The slot of an operation, which is added where there is none like it."""
        if operation.primitive.name in _COMMUTING:
            reads = tuple(sorted(reads, key=_place))
        [slot] = self._made_by(operation, reads, 1)
        return slot

    def parts(self, name: str, value: Value) -> tuple[Value, ...]:
        """What an operation of a name reads that makes a value; nothing of other values."""
        step = None if isinstance(value, KnownValue) else self.step_of(value)
        return step.reads if step is not None and step.equation.primitive.name == name else ()

    def scaled(self, value: Value) -> tuple[float, Value]:
        """A value as a number times another one."""
        if inner := self.parts("neg", value):
            return -1.0, inner[0]
        if (inner := self.parts("mul", value)) and isinstance(inner[0], KnownValue):
            return float(inner[0].value), inner[1]
        return 1.0, value


def _constant(value: Any) -> KnownValue:
    return KnownValue(np.float64(value))


def _place(value: Value) -> tuple[int, float]:
    """Numbers come first."""
    return (0, float(value.value)) if isinstance(value, KnownValue) else (1, value)


def _is(value: Value, number: float) -> bool:
    return isinstance(value, KnownValue) and float(value.value) == number


def _sum(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    if _is(x, 0.0) or _is(y, 0.0):
        return y if _is(x, 0.0) else x
    if inner := program.parts("neg", y):
        return _difference(program, x, *inner)
    if inner := program.parts("neg", x):
        return _difference(program, y, *inner)
    return program.written(_operation("add"), x, y)


def _difference(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    if _is(y, 0.0):
        return x
    if _is(x, 0.0):
        return _negative(program, y)
    if inner := program.parts("neg", y):
        return _sum(program, x, *inner)
    if inner := program.parts("neg", x):
        return _negative(program, _sum(program, *inner, y))
    return program.written(_operation("sub"), x, y)


def _negative(program: SimplifiedProgram, x: Value) -> Value:
    if isinstance(x, KnownValue):
        return _constant(-x.value)
    if inner := program.parts("neg", x):
        return inner[0]
    if inner := program.parts("sub", x):
        return _difference(program, inner[1], inner[0])
    factor, rest = program.scaled(x)
    return _multiple(program, -factor, rest) if factor != 1.0 else program.written(_operation("neg"), x)


def _multiple(program: SimplifiedProgram, factor: float, x: Value) -> Value:
    """A number times a value, which is none."""
    if factor == 0.0:
        return _constant(0.0)
    if factor == 1.0:
        return x
    return _negative(program, x) if factor == -1.0 else program.written(_operation("mul"), _constant(factor), x)


def _product(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    if isinstance(y, KnownValue):
        x, y = y, x
    if isinstance(x, KnownValue):
        factor, rest = program.scaled(y)
        return _multiple(program, float(x.value) * factor, rest)
    (first, x), (second, y) = program.scaled(x), program.scaled(y)
    return _multiple(program, first * second, program.written(_operation("mul"), x, y))


def _quotient(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    """A product with the reciprocal, which other quotients and derivatives share."""
    if isinstance(y, KnownValue):
        inverse = 1.0 / float(y.value) if float(y.value) else np.inf
        if not 0.0 < abs(inverse) < np.inf:
            return program.written(_operation("div"), x, y)
        return _product(program, x, _constant(inverse))
    factor, rest = program.scaled(y)
    if abs(factor) != 1.0:
        factor, rest = 1.0, y
    return _product(program, x, _multiple(program, factor, program.written(_operation("div"), _constant(1.0), rest)))


def _negative_power(program: SimplifiedProgram, x: Value, exponent: int) -> Value:
    """A power of the reciprocal; positive powers stay, as XLA finds out by itself where they are shared."""
    inverse = _quotient(program, _constant(1.0), x)
    return inverse if exponent == -1 else program.written(_power(-exponent), inverse)


def _power(exponent: int) -> Operation:
    return Operation(primitives.integer_pow_p, {"y": exponent})


_RULES: dict[str, Callable[..., Value]] = {
    "add": _sum,
    "add_any": _sum,
    "sub": _difference,
    "neg": _negative,
    "mul": _product,
    "div": _quotient,
}
