"""A function of float64 in double-double arithmetic: its jaxpr, evaluated with every number a sum of two.

Constants, tables among them, are the float64 that they are: what is computed is the very same function, with roundings
of 1e-32 in place of 1e-16.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps import elementary
from jaxnh.maps.double_double import Arithmetic, Double, negative, select
from jaxnh.maps.elementary import cosine, exponential, hyperbolic_tangent, logarithm, sine
from jaxnh.maps.protocol import ReturnMap
from jaxnh.systems.flow import Parameters

Value = Double | Array
"""Value of a variable: a real number, or an integer or truth value as it is."""

# What puts numbers elsewhere and does no arithmetic.
_MOVING = {"broadcast_in_dim", "concatenate", "copy", "dynamic_slice", "reshape", "scatter", "select_n", "slice"}
_MOVING |= {"squeeze", "stack", "transpose"}
_MOVING |= {"dynamic_update_slice", "expand_dims", "gather", "pad", "rev"}
_AS_THEY_ARE = {
    "reduce_precision",
    "optimization_barrier",
    "stop_gradient",
}  # marks for the compiler, or for derivatives
_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}
_ELEMENTARY = {sine: "sin", cosine: "cos", exponential: "exp", logarithm: "log", hyperbolic_tangent: "tanh"}


def extend_precision(function: Callable[..., Any], hidden: ArrayLike) -> Callable[..., Any]:
    """The function with real arguments and results as `Double` in place of arrays.

    Args:
        function: of float64 arrays; the same operations are done whatever their values.
        hidden: see `Arithmetic`.

    Raises:
        NotImplementedError: on the call, where the function has an operation that is not known here.
    """

    def call(*args: Any) -> Any:
        leaves, structure = jax.tree.flatten(args, is_leaf=_real)
        plain = jax.tree.unflatten(structure, [leaf.hi for leaf in leaves])
        jaxpr, shape = jax.make_jaxpr(function, return_shape=True)(*plain)
        results = _evaluate(Arithmetic(jnp.asarray(hidden)), jaxpr, leaves)
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return call


def _real(value: Any) -> bool:
    return isinstance(value, Double)


def _evaluate(arithmetic: Arithmetic, closed: ClosedJaxpr, args: list[Value]) -> list[Value]:
    jaxpr: Jaxpr = closed.jaxpr
    known: dict[Any, Value] = {}

    def read(variable: Any) -> Value:
        return _value(arithmetic, variable.val) if isinstance(variable, Literal) else known[variable]

    known.update(zip(jaxpr.constvars, [_value(arithmetic, constant) for constant in closed.consts], strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))
    for equation in jaxpr.eqns:
        results = _apply(arithmetic, equation, [read(v) for v in equation.invars])
        known.update(zip(equation.outvars, results, strict=True))
    return [read(v) for v in jaxpr.outvars]


def _value(arithmetic: Arithmetic, constant: Any) -> Value:
    constant = jnp.asarray(constant)
    return arithmetic.constant(constant) if jnp.issubdtype(constant.dtype, jnp.floating) else constant


def _apply(arithmetic: Arithmetic, equation: Any, values: list[Value]) -> list[Value]:
    name, params = equation.primitive.name, equation.params
    if name in _CALLS:
        inner = params[_CALLS[name]]
        if (own := _elementary(inner)) and _real(values[0]):
            return [_OPERATIONS[own](arithmetic, params, *values)]
        return _evaluate(arithmetic, inner, values)
    if name in _LOOPS:
        return _LOOPS[name](arithmetic, params, values)
    if name in _AS_THEY_ARE or (
        name == "convert_element_type" and params["new_dtype"] == jnp.float64 and _real(values[0])
    ):
        return values
    if not any(map(_real, values)):
        result = equation.primitive.bind(*values, **params)
        results = result if equation.primitive.multiple_results else [result]
        return [_value(arithmetic, each) for each in results]
    if name in _MOVING:
        return [_move_halves(equation, values)]
    if name not in _OPERATIONS:
        raise NotImplementedError(f"{name} is not known in extended precision")
    return [_OPERATIONS[name](arithmetic, params, *values)]


def _move_halves(equation: Any, values: list[Value]) -> Double:
    """Both halves moved alike."""
    halves = [
        equation.primitive.bind(*[_half(value, i) if _real(value) else value for value in values], **equation.params)
        for i in range(1 if all(value.lo is None for value in values if isinstance(value, Double)) else 2)
    ]
    return Double(halves[0], halves[1] if len(halves) == 2 else None)


def _half(value: Any, number: int) -> Array:
    return value.hi if number == 0 else jnp.zeros_like(value.hi) if value.lo is None else value.lo


def _elementary(inner: Any) -> str:
    """The operation that a call of the package's elementary functions is; "" of any other."""
    source = str(inner.jaxpr.debug_info.func_src_info)
    names = (
        name for own, name in _ELEMENTARY.items() if source.startswith(f"{own.__name__} at {elementary.__file__}:")
    )
    return next(names, "")


def _loop(arithmetic: Arithmetic, params: Mapping[str, Any], values: list[Value]) -> list[Value]:
    of_condition, of_body = params["cond_nconsts"], params["body_nconsts"]
    before, body = values[:of_condition], values[of_condition : of_condition + of_body]

    def unfinished(carried: list[Value]) -> Array:
        (left,) = _evaluate(arithmetic, params["cond_jaxpr"], [*before, *carried])
        assert not isinstance(left, Double)
        return left

    def turn(carried: list[Value]) -> list[Value]:
        return _whole(_evaluate(arithmetic, params["body_jaxpr"], [*body, *carried]))

    return lax.while_loop(unfinished, turn, _whole(values[of_condition + of_body :]))


def _scan(arithmetic: Arithmetic, params: Mapping[str, Any], values: list[Value]) -> list[Value]:
    shared, states = _counts(params)

    def turn(carried: list[Value], row: list[Value]) -> tuple[list[Value], list[Value]]:
        results = _whole(_evaluate(arithmetic, params["jaxpr"], [*values[:shared], *carried, *row]))
        return results[: states - shared], results[states - shared :]

    start, rows = _whole(values[shared:states]), values[states:]
    ended, stacked = lax.scan(turn, start, rows, length=params["length"], reverse=params["reverse"])
    return [*ended, *stacked]


def _counts(params: Mapping[str, Any]) -> tuple[int, int]:
    """Values of a scan that all its turns share, and these with those that are carried."""
    if "num_consts" in params:
        return params["num_consts"], params["num_consts"] + params["num_carry"]
    shared, carried, _ = params["ft_in"].unpack()  # since JAX 0.11
    return len(shared), len(shared) + len(carried)


_LOOPS: dict[str, Callable[[Arithmetic, Mapping[str, Any], list[Value]], list[Value]]] = {"while": _loop, "scan": _scan}


def _whole(values: list[Value]) -> list[Value]:
    """Flatten to both halves of every number, as loops carry them."""
    return [Double(v.hi, _half(v, 1)) if isinstance(v, Double) else v for v in values]


def _power(arithmetic: Arithmetic, params: Mapping[str, Any], a: Double) -> Double:
    result = a
    for _ in range(abs(params["y"]) - 1):
        result = arithmetic.mul(result, a)
    return result if params["y"] > 0 else arithmetic.div(arithmetic.constant(1), result)


def _real_power(arithmetic: Arithmetic, _: Mapping[str, Any], a: Double, b: Double) -> Double:
    power = arithmetic.exp(arithmetic.mul(b, arithmetic.log(a)))
    return select(a.hi == 0.0, Double(jnp.zeros_like(a.hi), None), power)


def _equal(_: Arithmetic, __: Mapping[str, Any], a: Double, b: Double) -> Array:
    return (a.hi == b.hi) & (_half(a, 1) == _half(b, 1))


def _sum(arithmetic: Arithmetic, params: Mapping[str, Any], a: Double) -> Double:
    """Sum over axes, one after the other."""
    for axis in sorted(params["axes"], reverse=True):
        parts = [
            Double(*(None if half is None else lax.index_in_dim(half, k, axis, keepdims=False) for half in a))
            for k in range(a.hi.shape[axis])
        ]
        a = functools.reduce(arithmetic.add, parts, arithmetic.constant(0))
    return a


def _with_axes(x: Double, order: Sequence[int], new: Sequence[int]) -> Double:
    """An array with its axes in an order, and then with new ones of length one at places."""
    return Double(*(None if half is None else lax.expand_dims(jnp.transpose(half, order), new) for half in x))


def _product_of_arrays(arithmetic: Arithmetic, params: Mapping[str, Any], a: Double, b: Double) -> Double:
    """Sum of products over the axes that two arrays have in common but for those that stay."""
    (summed_a, summed_b), (kept_a, kept_b) = params["dimension_numbers"]
    own_a, own_b = (
        [axis for axis in range(x.hi.ndim) if axis not in (*summed, *kept)]
        for x, summed, kept in ((a, summed_a, kept_a), (b, summed_b, kept_b))
    )
    before_b = len(kept_a) + len(own_a)
    first = _with_axes(a, (*kept_a, *own_a, *summed_a), range(before_b, before_b + len(own_b)))
    second = _with_axes(b, (*kept_b, *own_b, *summed_b), range(len(kept_b), before_b))
    product = arithmetic.mul(first, second)
    return _sum(arithmetic, {"axes": range(product.hi.ndim - len(summed_a), product.hi.ndim)}, product)


_OPERATIONS: dict[str, Callable[..., Value]] = {
    "add": lambda arithmetic, _, a, b: arithmetic.add(a, b),
    "add_any": lambda arithmetic, _, a, b: arithmetic.add(a, b),
    "sub": lambda arithmetic, _, a, b: arithmetic.add(a, negative(b)),
    "mul": lambda arithmetic, _, a, b: arithmetic.mul(a, b),
    "div": lambda arithmetic, _, a, b: arithmetic.div(a, b),
    "rem": lambda arithmetic, _, a, b: arithmetic.rem(a, b),
    "neg": lambda _, __, a: negative(a),
    "abs": lambda _, __, a: select(a.hi < 0.0, negative(a), a),
    "sign": lambda _, __, a: Double(jnp.sign(a.hi), None),
    "max": lambda arithmetic, _, a, b: select(arithmetic.less(a, b), b, a),
    "min": lambda arithmetic, _, a, b: select(arithmetic.less(b, a), b, a),
    "reduce_sum": _sum,
    "dot_general": _product_of_arrays,
    "integer_pow": _power,
    "pow": _real_power,
    "square": lambda arithmetic, _, a: arithmetic.mul(a, a),
    "sqrt": lambda arithmetic, _, a: arithmetic.sqrt(a),
    "exp": lambda arithmetic, _, a: arithmetic.exp(a),
    "expm1": lambda arithmetic, _, a: arithmetic.expm1(a),
    "log": lambda arithmetic, _, a: arithmetic.log(a),
    "tanh": lambda arithmetic, _, a: arithmetic.tanh(a),
    "sin": lambda arithmetic, _, a: arithmetic.sin_cos(a)[0],
    "cos": lambda arithmetic, _, a: arithmetic.sin_cos(a)[1],
    "atan2": lambda arithmetic, _, a, b: arithmetic.atan2(a, b),
    "eq": _equal,
    "ne": lambda arithmetic, params, a, b: ~_equal(arithmetic, params, a, b),
    "lt": lambda arithmetic, _, a, b: arithmetic.less(a, b),
    "gt": lambda arithmetic, _, a, b: arithmetic.less(b, a),
    "le": lambda arithmetic, params, a, b: arithmetic.less(a, b) | _equal(arithmetic, params, a, b),
    "ge": lambda arithmetic, params, a, b: arithmetic.less(b, a) | _equal(arithmetic, params, a, b),
    "is_finite": lambda _, __, a: jnp.isfinite(a.hi),
}


class PointAndTangent(NamedTuple):
    """P at a point and what it makes of a direction there, in section coordinates, (d,) each.

    Attributes:
        image: P(u; p).
        vector: ∂P/∂u w.
    """

    image: Double
    vector: Double


def push_point(strobe: ReturnMap, hidden: ArrayLike, u: Double, w: Double, p: Mapping[str, Double]) -> PointAndTangent:
    """One period of one lane from u (d,) along w (d,), and with parameters p of its own; see `extend_precision`."""
    chart = strobe.chart

    def plain(u: Array, w: Array, p: Parameters) -> tuple[Array, Array]:
        return jax.jvp(lambda u: chart.point(strobe(chart.state(u), p)), (u,), (w,))

    return PointAndTangent(*extend_precision(plain, hidden)(u, w, p))
