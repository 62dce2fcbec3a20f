"""Operations on numbers: element by element, and reductions."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.lax import RoundingMethod

from jaxnh.engine.kernels.arrays import rearranged
from jaxnh.engine.kernels.emitter import Emitter, Rule, filled, place_at, result_kind
from jaxnh.engine.kernels.values import (
    Memory,
    Scalars,
    UnsupportedError,
    Value,
    in_registers,
    is_known,
    size_of,
    text_of,
)

_INFIX = {"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/", "eq": "==", "ne": "!=", "lt": "<", "le": "<="}
_INFIX |= {"gt": ">", "ge": ">=", "shift_left": "<<", "shift_right_logical": ">>"}
_CALLED = {"max": "larger", "min": "smaller", "rem": "remainder_of", "sign": "sign_of"}
_CALLED |= {"is_finite": "is_finite", "logistic": "logistic", "integer_abs": "abs", "atan2": "atan2", "pow": "pow"}
_UNCHANGED = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("exp", "exp2", "expm1", "log", "log2", "log1p", "sqrt", "rsqrt", "cbrt", "floor", "ceil"),
    *("erf", "erfc", "nextafter"),
)
_CALLED |= {name: name for name in _UNCHANGED}
_SAME = ("stop_gradient", "copy", "copy_p", "optimization_barrier")

# Of known whole numbers and truth values, so that places in arrays are known where they can be.
_KNOWN: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "neg": operator.neg,
    "max": max,
    "min": min,
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
    "clamp": lambda low, x, high: min(max(x, low), high),
    "select_n": lambda which, *cases: cases[int(which)],
}


def _logical(name: str) -> Callable[[str, str, str], str]:
    wide = {"and": "&", "or": "|", "xor": "^"}[name]
    narrow = {"and": "&&", "or": "||", "xor": "!="}[name]
    return lambda kind, x, y: f"{x} {narrow if kind == 'bool' else wide} {y}"


def _select(_: str, which: str, *cases: str) -> str:
    if len(cases) == 2:
        return f"{which} ? {cases[1]} : {cases[0]}"
    chain = cases[-1]
    for k in reversed(range(len(cases) - 1)):
        chain = f"({which} == {k} ? {cases[k]} : {chain})"
    return chain


def _power(exponent: int, x: str) -> str:
    if exponent == 0:
        return "1"
    if exponent < 0:
        return f"1 / ({_power(-exponent, x)})"
    return f"power<{exponent}>({x})"


def _expression(equation: Any) -> Callable[..., str]:
    """Return the text of an operation of one element of each operand, from the type of the first and their texts."""
    name, params = equation.primitive.name, equation.params
    if name in _INFIX:
        return lambda kind, x, y: f"{x} {_INFIX[name]} {y}"
    if name in _CALLED:
        return lambda kind, *x: f"{_CALLED[name]}({', '.join(x)})"
    if name in _SAME:
        return lambda kind, x: x
    if name in ("and", "or", "xor"):
        return _logical(name)
    if name == "integer_pow":
        return lambda kind, x: _power(params["y"], x)
    if name in ("convert_element_type", "reduce_precision"):
        target = result_kind(equation)
        return lambda kind, x: f"({target})({x})" if kind != target else x
    if name == "bitcast_convert_type":
        target = result_kind(equation)
        return lambda kind, x: f"bits_as<{target}>({x})"
    special: dict[str, Callable[..., str]] = {
        "neg": lambda kind, x: f"-{x}",
        "not": lambda kind, x: f"!{x}" if kind == "bool" else f"~{x}",
        "abs": lambda kind, x: f"fabs({x})" if kind in ("double", "float") else f"({x} < 0 ? -{x} : {x})",
        "square": lambda kind, x: f"{x} * {x}",
        "one_minus_square": lambda kind, x: f"(1 + {x}) * (1 - {x})",
        "shift_right_arithmetic": lambda kind, x, y: f"{x} >> {y}",
        "round": lambda kind, x: (
            f"{'rint' if params['rounding_method'] == RoundingMethod.TO_NEAREST_EVEN else 'round'}({x})"
        ),
        "select_n": _select,
        "clamp": lambda kind, low, x, high: f"smaller(larger({x}, {low}), {high})",
    }
    return special[name]


def elementwise(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write an operation element by element."""
    shape, kind = tuple(equation.outvars[0].aval.shape), result_kind(equation)
    if equation.primitive.name in _SAME:
        return [*inputs]
    expression = _expression(equation)
    inputs = [_broadcast(emitter, value, shape) for value in inputs]
    if not in_registers(shape):
        return [_in_memory(emitter, shape, kind, expression, inputs)]
    columns = [_spread(emitter.scalars(value), size_of(shape)) for value in inputs]
    kinds = [value.kind for value in inputs]
    results = []
    for row in zip(*columns, strict=True):
        if _folds(equation.primitive.name, kinds, row):
            results.append(_known_result(equation, kind, row))
        elif (same := _neutral(equation.primitive.name, kinds, row)) is not None:
            results.append(same)
        else:
            results.append(emitter.let(kind, expression(kinds[0], *map(text_of, row, kinds))))
    return [filled(shape, kind, results)]


def _neutral(name: str, kinds: Sequence[str], row: Sequence[Any]) -> Any:
    """Return the operand that a sum with zero or a product with one is, as XLA has it; None where it is neither."""
    if len(row) != 2 or kinds[0] not in ("double", "float"):
        return None
    zeros, ones = ([is_known(x) and x == number for x in row] for number in (0.0, 1.0))
    if name in ("add", "add_any") and any(zeros):
        return row[0] if zeros[1] else row[1]
    if name == "mul" and any(ones):
        return row[0] if ones[1] else row[1]
    right = (name == "sub" and zeros[1]) or (name == "div" and ones[1])
    return row[0] if right else None


def _broadcast(emitter: Emitter, value: Value, shape: tuple[int, ...]) -> Value:
    """Return a value of another shape repeated along axes of length one; a single number stays one."""
    if value.shape == shape or size_of(value.shape) == 1:
        return value
    return rearranged(emitter, lambda x: np.broadcast_to(x, shape), [value])


def _spread(value: Scalars, count: int) -> list[Any]:
    return value.flat if value.elements.size == count else value.flat * count


def _folds(name: str, kinds: Sequence[str], row: Sequence[Any]) -> bool:
    if name == "select_n":
        return is_known(row[0])
    whole = all(map(is_known, row)) and not any(kind in ("double", "float") for kind in kinds)
    return whole and (name in _KNOWN or name in ("and", "or", "not", "convert_element_type"))


def _known_result(equation: Any, kind: str, row: Sequence[Any]) -> Any:
    name = equation.primitive.name
    if name == "select_n":
        return row[1 + int(row[0])]
    if name == "convert_element_type":
        result = row[0]
    elif name == "not":
        result = not row[0] if kind == "bool" else ~int(row[0])
    elif name in ("and", "or"):
        result = (operator.and_ if name == "and" else operator.or_)(row[0], row[1])
    else:
        result = _KNOWN[name](*(int(x) for x in row))
    return np.asarray(result).astype(equation.outvars[0].aval.dtype)[()]


def _in_memory(
    emitter: Emitter, shape: tuple[int, ...], kind: str, expression: Callable[..., str], inputs: Sequence[Value]
) -> Memory:
    operands = [value if size_of(value.shape) > 1 else emitter.scalars(value) for value in inputs]
    memory, kinds = emitter.memory(shape, kind), [value.kind for value in inputs]
    operands = [emitter.stored(value) if size_of(value.shape) > 1 else value for value in operands]
    with emitter.each(size_of(shape)) as i:
        texts = [f"{v.name}[{i}]" if isinstance(v, Memory) else text_of(v.flat[0], v.kind) for v in operands]
        emitter.line(f"{memory.name}[{i}] = {expression(kinds[0], *texts)};")
    return memory


_REDUCTIONS: dict[str, Callable[[str, str, str], str]] = {
    "reduce_sum": lambda kind, x, y: f"{x} + {y}",
    "reduce_prod": lambda kind, x, y: f"{x} * {y}",
    "reduce_max": lambda kind, x, y: f"larger({x}, {y})",
    "reduce_min": lambda kind, x, y: f"smaller({x}, {y})",
    "reduce_and": _logical("and"),
    "reduce_or": _logical("or"),
}


def reduction(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a reduction over axes."""
    (value,), kind = inputs, result_kind(equation)
    join, axes = _REDUCTIONS[equation.primitive.name], equation.params["axes"]
    shape = tuple(equation.outvars[0].aval.shape)
    if size_of(value.shape) == 0:
        raise UnsupportedError("a reduction of nothing")
    if in_registers(value.shape):
        elements = np.moveaxis(emitter.scalars(value).elements, axes, range(len(axes)))
        rows = elements.reshape(-1, size_of(shape)).T
        return [filled(shape, kind, [_joined(emitter, kind, join, list(row)) for row in rows])]
    source = emitter.stored(value)
    places = np.moveaxis(np.arange(size_of(value.shape)).reshape(value.shape), axes, range(len(axes)))
    places = places.reshape(-1, size_of(shape))  # places[k, result]
    offsets, firsts = places[:, 0] - places[0, 0], places[0]

    def total_at(first: Any) -> str:
        total = emitter.variable(kind, f"{source.name}[{first}]")
        with emitter.each(len(offsets) - 1) as i:
            element = f"{source.name}[{first} + {place_at(emitter, offsets[1:], i)}]"
            emitter.line(f"{total} = {join(kind, total, element)};")
        return total

    if in_registers(shape):
        return [filled(shape, kind, [total_at(first) for first in firsts])]
    memory = emitter.memory(shape, kind)
    with emitter.each(size_of(shape)) as i:
        first = emitter.let("int", place_at(emitter, firsts, i))
        emitter.line(f"{memory.name}[{i}] = {total_at(first)};")
    return [memory]


def _joined(emitter: Emitter, kind: str, join: Callable[[str, str, str], str], row: list[Any]) -> Any:
    total = row[0]
    for element in row[1:]:
        total = emitter.let(kind, join(kind, text_of(total, kind), text_of(element, kind)))
    return total


def extreme_place(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write argmin or argmax along one axis; NaN counts as the extreme, as JAX has it."""
    (value,), kind = inputs, result_kind(equation)
    (axis,), shape = equation.params["axes"], tuple(equation.outvars[0].aval.shape)
    if not in_registers(value.shape):
        raise UnsupportedError("a place of the extreme of a large array")
    values = emitter.scalars(value)
    rows = np.moveaxis(values.elements, axis, -1).reshape(size_of(shape), -1)
    beats = "beats_below" if equation.primitive.name == "argmin" else "beats_above"
    results = []
    for row in rows:
        best, place = emitter.let(value.kind, text_of(row[0], value.kind)), "0"
        for k, element in enumerate(row[1:], 1):
            wins = emitter.let("bool", f"{beats}({text_of(element, value.kind)}, {text_of(best, value.kind)})")
            place = emitter.let(kind, f"{text_of(wins, 'bool')} ? {k} : {place}")
            best = emitter.let(value.kind, f"{wins} ? {text_of(element, value.kind)} : {text_of(best, value.kind)}")
        results.append(place)
    return [filled(shape, kind, results)]


def cumulative(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a running sum or product along an axis."""
    (value,), params = inputs, equation.params
    if not in_registers(value.shape):
        raise UnsupportedError("running sums of a large array")
    mark = {"cumsum": "+", "cumprod": "*"}[equation.primitive.name]
    rows = np.moveaxis(emitter.scalars(value).elements, params["axis"], 0).copy()
    order = range(len(rows) - 2, -1, -1) if params["reverse"] else range(1, len(rows))
    step = 1 if params["reverse"] else -1
    for k in order:
        for place in np.ndindex(rows.shape[1:]):
            before, value_text = (text_of(rows[(j, *place)], value.kind) for j in (k + step, k))
            rows[(k, *place)] = emitter.let(value.kind, f"{before} {mark} {value_text}")
    return [Scalars(np.moveaxis(rows, 0, params["axis"]), value.kind)]


def rules() -> dict[str, Rule]:
    """The rules of operations on numbers, by the name of the primitive."""
    single = (
        "round",
        "one_minus_square",
        "shift_right_arithmetic",
        "neg",
        "not",
        "abs",
        "square",
        "select_n",
        "clamp",
        "and",
        "or",
        "xor",
        "integer_pow",
    )
    converted = ("convert_element_type", "reduce_precision", "bitcast_convert_type")
    table: dict[str, Rule] = dict.fromkeys((*_INFIX, *_CALLED, *_SAME, *single, *converted), elementwise)
    table |= dict.fromkeys(_REDUCTIONS, reduction)
    table |= dict.fromkeys(("argmin", "argmax"), extreme_place)
    return table | dict.fromkeys(("cumsum", "cumprod"), cumulative)
