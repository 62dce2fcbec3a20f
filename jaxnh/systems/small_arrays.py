"""Functions that users write with small arrays, taken apart into equations of their numbers.

A program over lanes has each number of a state as a vector of lanes. An array of such numbers needs another axis, so
that rolling, stacking or multiplying it copies lanes about, and each of its equations is a loop of a few elements.
Number by number the same function is one straight line of vectors of lanes.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun, primitives

from jaxnh.systems.straight_pieces import called_function
from jaxnh.systems.tracing import INLINED

_MOST_EQUATIONS = 600  # of numbers: with more a program is compiled for longer than arrays take
# fmt: off
_ELEMENTWISE = frozenset((
    "abs", "acos", "acosh", "add", "and", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "clamp",
    "convert_element_type", "copy", "cos", "cosh", "div", "eq", "erf", "exp", "exp2", "expm1", "floor", "ge",
    "gt", "integer_pow", "is_finite", "le", "log", "log1p", "logistic", "lt", "max", "min", "mul", "ne", "neg",
    "not", "or", "pow", "rem", "round", "rsqrt", "select_n", "sign", "sin", "sinh", "sqrt", "square", "sub",
    "tan", "tanh", "xor",
))
# fmt: on
_REDUCTIONS = {
    "reduce_sum": lax.add,
    "reduce_prod": lax.mul,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_and": lax.bitwise_and,
    "reduce_or": lax.bitwise_or,
}


class _UnknownEquationError(Exception):
    """An equation has no known form in numbers, or there are too many."""


Numbers = np.ndarray
"""Numbers of an array, as an array of objects: constants of NumPy, or values of the program that is traced, each ()."""


def by_numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of numbers, each (), without the small arrays that it makes of them.

    It is left as it is where it makes none, where they have many numbers, and where it does with them what has no
    simple form in numbers, as sorting.
    """

    @functools.wraps(function)
    def by_numbers(*arguments: Any) -> Any:
        leaves = jax.tree.leaves(arguments)
        if any(np.shape(leaf) for leaf in leaves):
            return function(*arguments)
        closed, out = jax.make_jaxpr(function, return_shape=True)(*arguments)
        made = [variable.aval.shape for equation in closed.jaxpr.eqns for variable in equation.outvars]
        if not any(made) or any(leaf.shape for leaf in jax.tree.leaves(out)):
            return function(*arguments)

        def evaluated(*leaves: Any) -> list[Any]:
            results = _Evaluation().run(closed, [_numbers(leaf) for leaf in leaves])
            return [result[()] for result in results]

        try:  # traced apart, so that nothing is left of it where it comes to no end
            program = jax.make_jaxpr(evaluated)(*leaves)
        except _UnknownEquationError:
            return function(*arguments)
        return jax.tree.unflatten(jax.tree.structure(out), jaxpr_as_fun(program)(*leaves))

    return by_numbers


class _Evaluation:
    """Evaluation of equations number by number."""

    def __init__(self) -> None:
        self._equations = 0

    def run(self, closed: ClosedJaxpr, arguments: Sequence[Numbers]) -> list[Numbers]:
        """Results of a program."""
        known = dict(zip(closed.jaxpr.constvars, map(_numbers, closed.consts), strict=True))
        known |= dict(zip(closed.jaxpr.invars, arguments, strict=True))

        def read(atom: Any) -> Numbers:
            return _numbers(atom.val) if isinstance(atom, Literal) else known[atom]

        for equation in closed.jaxpr.eqns:
            results = self._results(equation, list(map(read, equation.invars)))
            known |= dict(zip(equation.outvars, results, strict=True))
        return list(map(read, closed.jaxpr.outvars))

    def _results(self, equation: Any, operands: list[Numbers]) -> list[Numbers]:
        """Results of one equation."""
        name, parameters = equation.primitive.name, equation.params
        function = called_function(equation)
        if function in (jnp.remainder, jnp.floor_divide):  # as a whole, so that where it jumps is known (`corners`)
            return [self._each(equation, operands, equation.outvars[0].aval.shape, function)]
        if name in INLINED:
            program = parameters.get("jaxpr", parameters.get("call_jaxpr"))
            if not isinstance(program, ClosedJaxpr):
                program = ClosedJaxpr(program, ())
            return self.run(program, operands)
        shape = equation.outvars[0].aval.shape
        if name in _ELEMENTWISE:
            return [self._each(equation, operands, shape)]
        if name in _REDUCTIONS:
            return [self._reduced(_REDUCTIONS[name], operands[0], parameters["axes"])]
        if name == "dot_general":
            return [self._product(equation, *operands)]
        if name == "unstack":
            return list(np.moveaxis(operands[0], parameters["axis"], 0))
        if name in _REARRANGED and (
            name in _JOINING
            or not any(isinstance(value, Tracer) for operand in operands[1:] for value in operand.ravel())
        ):
            return [_REARRANGED[name](operands, parameters, shape)]
        raise _UnknownEquationError

    def _each(
        self, equation: Any, operands: list[Numbers], shape: tuple[int, ...], function: Callable[..., Any] | None = None
    ) -> Numbers:
        """An equation that treats each element by itself, or a function that it calls."""
        self._count(math.prod(shape))
        types = [atom.aval.dtype for atom in equation.invars]
        result = np.empty(shape, object)
        each = [np.broadcast_to(operand, shape) for operand in operands]
        for index in np.ndindex(shape):
            values = [
                value if isinstance(value, Tracer) else np.asarray(value, kind)
                for value, kind in zip((operand[index] for operand in each), types, strict=True)
            ]
            if equation.primitive is primitives.pow_p and _is_whole(values[1]):
                result[index] = lax.integer_pow(values[0], int(values[1]))
            elif function:
                result[index] = function(*values)
            else:
                result[index] = equation.primitive.bind(*values, **equation.params)
        return result

    def _reduced(self, join: Callable[[Any, Any], Any], operand: Numbers, axes: Sequence[int]) -> Numbers:
        """A sum, a product or an extremum over some axes."""
        kept = [axis for axis in range(operand.ndim) if axis not in axes]
        moved = operand.transpose([*kept, *axes]).reshape(*(operand.shape[axis] for axis in kept), -1)
        if not moved.shape[-1]:
            raise _UnknownEquationError
        self._count(moved.size)
        result = np.empty(moved.shape[:-1], object)
        for index in np.ndindex(result.shape):
            result[index] = functools.reduce(join, moved[index])
        return result

    def _product(self, equation: Any, first: Numbers, second: Numbers) -> Numbers:
        """Sums of products, in which a constant zero leaves no trace."""
        (of_one, of_other), batches = equation.params["dimension_numbers"]
        typed = functools.partial(lax.convert_element_type, new_dtype=equation.outvars[0].aval.dtype)
        if batches[0]:
            raise _UnknownEquationError
        self._count(first.size * second.size)
        rows, columns = (
            np.moveaxis(part, axes, range(len(axes))).reshape(math.prod(part.shape[axis] for axis in axes), -1)
            for part, axes in ((first, of_one), (second, of_other))
        )
        kept = [
            [n for axis, n in enumerate(part.shape) if axis not in axes]
            for part, axes in ((first, of_one), (second, of_other))
        ]
        result = np.empty((rows.shape[1], columns.shape[1]), object)
        for i, j in np.ndindex(result.shape):
            pairs = [(a, b) for a, b in zip(rows[:, i], columns[:, j], strict=True) if not (_is_zero(a) or _is_zero(b))]
            result[i, j] = (
                functools.reduce(lax.add, [lax.mul(typed(a), typed(b)) for a, b in pairs]) if pairs else np.float64(0.0)
            )
        return result.reshape((*kept[0], *kept[1]))

    def _count(self, equations: int) -> None:
        self._equations += equations
        if self._equations > _MOST_EQUATIONS:
            raise _UnknownEquationError


# ---- equations that only rearrange numbers


def _broadcast(operands: list[Numbers], parameters: Mapping[str, Any], shape: tuple[int, ...]) -> Numbers:
    placed = [1] * len(shape)
    for axis, n in zip(parameters["broadcast_dimensions"], operands[0].shape, strict=True):
        placed[axis] = n
    return np.broadcast_to(operands[0].reshape(placed), shape)


def _sliced(operands: list[Numbers], parameters: Mapping[str, Any], shape: tuple[int, ...]) -> Numbers:
    steps = parameters["strides"] or (1,) * len(shape)
    ends = zip(parameters["start_indices"], parameters["limit_indices"], steps, strict=True)
    return operands[0][tuple(slice(*each) for each in ends)]


def _sliced_from(operands: list[Numbers], _: Mapping[str, Any], shape: tuple[int, ...]) -> Numbers:
    whole = operands[0]
    starts = [min(max(int(at[()]), 0), n - size) for at, n, size in zip(operands[1:], whole.shape, shape, strict=True)]
    return whole[tuple(slice(start, start + size) for start, size in zip(starts, shape, strict=True))]


def _counted(_: list[Numbers], parameters: Mapping[str, Any], shape: tuple[int, ...]) -> Numbers:
    placed = [-1 if axis == parameters["dimension"] else 1 for axis in range(len(shape))]
    numbers = np.arange(shape[parameters["dimension"]], dtype=parameters["dtype"]).reshape(placed)
    return _numbers(np.broadcast_to(numbers, shape))


_REARRANGED: Mapping[str, Callable[[list[Numbers], Mapping[str, Any], tuple[int, ...]], Numbers]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda operands, parameters, _: np.concatenate(operands, parameters["dimension"]),
    "dynamic_slice": _sliced_from,
    "expand_dims": lambda operands, _, shape: operands[0].reshape(shape),
    "iota": _counted,
    "reshape": lambda operands, _, shape: operands[0].reshape(shape),
    "rev": lambda operands, parameters, _: np.flip(operands[0], parameters["dimensions"]),
    "slice": _sliced,
    "squeeze": lambda operands, _, shape: operands[0].reshape(shape),
    "stack": lambda operands, parameters, _: np.stack(operands, parameters["axis"]),
    "transpose": lambda operands, parameters, _: operands[0].transpose(parameters["permutation"]),
}
_JOINING = ("concatenate", "stack")


# ---- numbers


def _numbers(value: Any) -> Numbers:
    """The numbers of a constant, or of a value of a program."""
    result = np.empty(np.shape(value), object)
    traced = isinstance(value, Tracer)
    values = value if traced else np.asarray(value)
    for index in np.ndindex(result.shape):
        result[index] = values[index] if result.shape else (value if traced else values[()])
    return result


def _is_zero(value: Any) -> bool:
    return not isinstance(value, Tracer) and value == 0.0


def _is_whole(value: Any) -> bool:
    return not isinstance(value, Tracer) and float(value).is_integer() and abs(float(value)) <= 64
