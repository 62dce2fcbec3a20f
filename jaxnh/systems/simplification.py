"""A function's equations in fewer operations: numbers folded, signs and factors moved to where they cost nothing.

What users write and what differentiation makes of it is full of products with one, sums with zero and signs that meet
again. XLA takes out the plain ones of these, and after it has counted them; what a step is written out of is decided by
the number of equations that are left here. Results are those of the function but for rounding, and in exact arithmetic
they are the same: numbers are put together where nothing is rounded, so that extended precision has them too.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, NamedTuple, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import primitives

from jaxnh.systems.tracing import KnownValue, Program, Slot

Value = Slot | KnownValue
"""An operand of an equation."""


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
_FOLDED: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "add_any": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "neg": operator.neg,
}


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
        name, several = equation.primitive.name, equation.primitive.multiple_results
        if len(out) != 1 or several or not on_numbers or equation.effects or name.startswith("custom_"):
            return super()._add(equation, reads)
        if name == "convert_element_type":
            return reads
        known = [Fraction(_float(read)) for read in reads if _is_finite(read)]
        if len(known) == len(reads) and name in _FOLDED and (folded := _rounded(_FOLDED[name](*known))) is not None:
            return (_constant(folded),)
        if name == "integer_pow" and equation.params["y"] < 0:
            return (_negative_power(self, reads[0], equation.params["y"]),)
        rule = _RULES.get(name)
        return (rule(self, *reads) if rule else self.written(Operation(equation.primitive, equation.params), *reads),)

    def written(self, operation: Operation, *reads: Value) -> Slot:
        """The slot of an operation, which is added where there is none like it."""
        if operation.primitive.name in _COMMUTING:
            reads = tuple(sorted(reads, key=_place))
        [slot] = self._made_by(operation, reads, 1)
        return slot

    def parts(self, name: str, value: Value) -> tuple[Value, ...]:
        """Return the operands of the operation of a name that makes a value; none of other values."""
        step = None if isinstance(value, KnownValue) else self.step_of(value)
        return step.reads if step is not None and step.equation.primitive.name == name else ()

    def scaled(self, value: Value) -> tuple[float, Value | None]:
        """A value as a number times another one, or None of a number."""
        if isinstance(value, KnownValue):
            return _float(value), None
        if inner := self.parts("neg", value):
            return -1.0, inner[0]
        if (inner := self.parts("mul", value)) and isinstance(inner[0], KnownValue):
            return _float(inner[0]), inner[1]
        return 1.0, value


def _constant(value: float) -> KnownValue:
    return KnownValue(np.float64(value))


def _float(value: KnownValue) -> float:
    return float(value.value)


def _is_finite(value: Value) -> TypeGuard[KnownValue]:
    return isinstance(value, KnownValue) and math.isfinite(_float(value))


def _rounded(exact: Fraction) -> float | None:
    """A number in double precision; None where it would be rounded."""
    try:
        value = float(exact)
    except OverflowError:
        return None
    return value if Fraction(value) == exact else None


def _times(x: float, y: float) -> float | None:
    """The product of two numbers; None where it would be rounded."""
    return _rounded(Fraction(x) * Fraction(y)) if math.isfinite(x) and math.isfinite(y) else None


def _place(value: Value) -> tuple[int, float]:
    """Numbers come first."""
    return (0, _float(value)) if isinstance(value, KnownValue) else (1, value)


def _is_zero(value: Value) -> bool:
    return isinstance(value, KnownValue) and _float(value) == 0.0


def _sum(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    if _is_zero(x) or _is_zero(y):
        return y if _is_zero(x) else x
    if inner := program.parts("neg", y):
        return _difference(program, x, *inner)
    if inner := program.parts("neg", x):
        return _difference(program, y, *inner)
    return program.written(_operation("add"), x, y)


def _difference(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    if _is_zero(y):
        return x
    if _is_zero(x):
        return _negative(program, y)
    if inner := program.parts("neg", y):
        return _sum(program, x, *inner)
    if inner := program.parts("neg", x):
        return _negative(program, _sum(program, inner[0], y))
    return program.written(_operation("sub"), x, y)


def _negative(program: SimplifiedProgram, x: Value) -> Value:
    if isinstance(x, KnownValue):
        return _constant(-x.value)
    if inner := program.parts("neg", x):
        return inner[0]
    if inner := program.parts("sub", x):
        return _difference(program, inner[1], inner[0])
    factor, rest = program.scaled(x)
    if factor == 1.0 or rest is None:
        return program.written(_operation("neg"), x)
    return _multiple(program, -factor, rest)


def _multiple(program: SimplifiedProgram, factor: float, x: Value) -> Value:
    """A number times a value, which is none."""
    if factor == 0.0:
        return _constant(0.0)
    if factor == 1.0:
        return x
    return _negative(program, x) if factor == -1.0 else program.written(_operation("mul"), _constant(factor), x)


def _product(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    (first, x_rest), (second, y_rest) = program.scaled(x), program.scaled(y)
    factor = _times(first, second)
    if factor is None:
        return program.written(_operation("mul"), x, y)
    if x_rest is None or y_rest is None:
        rest = y_rest if x_rest is None else x_rest
        return _constant(factor) if rest is None else _multiple(program, factor, rest)
    return _multiple(program, factor, program.written(_operation("mul"), x_rest, y_rest))


def _quotient(program: SimplifiedProgram, x: Value, y: Value) -> Value:
    """A product with the reciprocal, which other quotients and derivatives share; of a number where that is exact."""
    factor, rest = program.scaled(y)
    inverse = _rounded(1 / Fraction(factor)) if factor and math.isfinite(factor) else None
    if rest is None and inverse is None:
        return program.written(_operation("div"), x, y)
    if rest is None or inverse is None:
        one_over = _constant(inverse) if inverse is not None else _reciprocal(program, y)
        return _product(program, x, one_over)
    return _product(program, x, _multiple(program, inverse, _reciprocal(program, rest)))


def _reciprocal(program: SimplifiedProgram, x: Value) -> Value:
    return program.written(_operation("div"), _constant(1.0), x)


def _negative_power(program: SimplifiedProgram, x: Value, exponent: int) -> Value:
    """A power of the reciprocal; positive powers stay, as XLA finds out by itself where they are shared."""
    inverse = _reciprocal(program, x)
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
