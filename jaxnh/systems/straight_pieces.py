"""Equations of straight pieces, each with a corner or a jump: which values it compares, and how it is written out."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend import core

from jaxnh.systems.tracing import INLINED, Program

COMPARISONS = {"gt": 1.0, "ge": 1.0, "lt": -1.0, "le": -1.0}
"""Comparisons, and the side of a surface on which each is true."""

OPERANDS = {"abs": ((0, None),), "sign": ((0, None),), "max": ((0, 1),), "min": ((0, 1),), "clamp": ((1, 0), (1, 2))}
OPERANDS |= dict.fromkeys(COMPARISONS, ((0, 1),)) | {"floor": ((0, None),)}
"""Places of the two operands of each surface of an equation; None: zero, of floor every integer."""

WITHOUT_SURFACE = ("floor", "ceil", "round", "rem", "argmax", "argmin", "sort", "reduce_max", "reduce_min")
"""Names of equations that jump, or have corners, and that no surface is for as they are."""

MOST_SURFACES = 64
"""Most surfaces of a field: each is looked at after every step."""

_EXTREMES = {"reduce_max": lax.max, "reduce_min": lax.min}
_BY_FLOOR: dict[str, Callable[..., Any]] = {
    "ceil": lambda x: -lax.floor(-x),
    "round": lambda x: lax.floor(x + 0.5),
    "rem": lambda x, y: x - y * lax.sign(x / y) * lax.floor(lax.abs(x / y)),
}
_LINEAR = ("add", "sub", "mul", "neg", "select_n", "convert_element_type", "broadcast_in_dim", "jit", "pjit")
_TABLE = "_interp"


def _interpolated(x: Any, places: Any, values: Any) -> Any:
    """The straight pieces between points, and jumps where two of them are at one place, as a sum over neighbours."""
    total = values[0]
    for k in range(len(places) - 1):
        width, rise = places[k + 1] - places[k], values[k + 1] - values[k]
        jump = jnp.where(x >= places[k + 1], rise, 0.0)
        slope = rise / jnp.where(width == 0.0, 1.0, width)
        total += jnp.where(width == 0.0, jump, slope * (lax.clamp(places[k], x, places[k + 1]) - places[k]))
    return total


def _interpolated_within(x: Any, places: Any, values: Any, left: Any, right: Any) -> Any:
    """The same with values of its own beyond both ends."""
    beyond = jnp.where(x > places[-1], right, _interpolated(x, places, values))
    return jnp.where(x < places[0], left, beyond)


def _interpolated_again(x: Any, places: Any, values: Any, period: Any) -> Any:
    """The same over and over."""
    period = jnp.abs(period)
    places, values = lax.sort_key_val(places % period, values)
    places = jnp.concatenate([places[-1:] - period, places, places[:1] + period])
    return _interpolated(x % period, places, jnp.concatenate([values[-1:], values, values[:1]]))


_COMPILED: dict[tuple[str, int], tuple[Callable[..., Any], Callable[..., Any]]] = {
    ("remainder", 2): (jnp.remainder, lambda x, y: x - y * lax.floor(x / y)),
    ("floor_divide", 2): (jnp.floor_divide, lambda x, y: lax.floor(x / y)),
    (_TABLE, 3): (jnp.interp, _interpolated),
    (_TABLE, 4): (lambda x, places, values, period: jnp.interp(x, places, values, period=period), _interpolated_again),
    (_TABLE, 5): (jnp.interp, _interpolated_within),
}
"""Functions of `jax.numpy` by the name that a program calls them by and their operands, and what they are in pieces."""


def is_real(equation: Any) -> bool:
    """Return whether an equation reads real numbers alone."""
    return all(jnp.issubdtype(atom.aval.dtype, jnp.floating) for atom in equation.invars)


def equations_within(equation: Any) -> Iterator[Any]:
    """Equations of the programs that an equation calls, as of a loop."""
    for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: isinstance(x, core.Jaxpr)):
        inner = getattr(value, "jaxpr", value)
        if isinstance(inner, core.Jaxpr):
            for each in inner.eqns:
                yield each
                yield from equations_within(each)


def written_in_pieces(equation: Any) -> Any:
    """The program in place of an equation of straight pieces, as `jax.nn.relu`, or of an extreme of few numbers.

    What jumps at evenly spaced values, as `jnp.mod`, is written by floor; `jnp.interp` of few points by its pieces.
    """
    name = equation.primitive.name
    if name in _EXTREMES:
        return _extreme_by_pairs(equation)
    if is_real(equation) and (function := _in_pieces(equation)):
        return jax.make_jaxpr(function)(*(atom.aval for atom in equation.invars))
    if not name.startswith("custom_jvp"):
        return None
    names = {each.primitive.name for each in equations_within(equation)}
    linear = not names.isdisjoint(OPERANDS) and names <= {*OPERANDS, *_LINEAR}
    return equation.params["call_jaxpr"] if linear else None


def _extreme_by_pairs(equation: Any) -> Any:
    """The program of the largest or smallest of few numbers, two at a time; None of many."""
    number, made = equation.invars[0].aval, equation.outvars[0].aval
    if not 0 < number.size - made.size <= MOST_SURFACES or not is_real(equation):
        return None
    axes, extreme = equation.params["axes"], _EXTREMES[equation.primitive.name]

    def by_pairs(numbers: Any) -> Any:
        first = jnp.moveaxis(numbers, axes, range(len(axes))).reshape(-1, *made.shape)
        return functools.reduce(extreme, list(first))

    return jax.make_jaxpr(by_pairs)(number)


def called_function(equation: Any) -> Callable[..., Any] | None:
    """The function of `jax.numpy` that an equation calls, of those that are written in pieces; None of others."""
    if equation.primitive.name not in INLINED or (name := _name_of(equation)) not in _COMPILED:
        return None
    if not is_real(equation) or len({atom.aval.dtype for atom in equation.invars}) > 1:
        return None
    function = _COMPILED[name][0]
    (known,) = jax.make_jaxpr(function)(*(atom.aval for atom in equation.invars)).eqns
    return function if str(known.params["jaxpr"]) == str(equation.params["jaxpr"]) else None


def _in_pieces(equation: Any) -> Callable[..., Any] | None:
    """A function of floor, or of the pieces of a table, in place of an equation of real numbers; None of others."""
    if called_function(equation) is None:
        return _BY_FLOOR.get(equation.primitive.name)
    name = _name_of(equation)
    if name[0] == _TABLE:
        x, places = (atom.aval for atom in equation.invars[:2])
        if x.shape or places.size + 2 > MOST_SURFACES:
            return None
    return _COMPILED[name][1]


def _name_of(equation: Any) -> tuple[str, int]:
    return equation.params.get("name", ""), len(equation.invars)


def floor_of_parity(x: Any, side: Any) -> Any:
    """The largest integer from below, or beyond the next integer that before it: even above the surface, else odd."""
    odd = jnp.where(side > 0.0, 0.0, 1.0)
    return 2.0 * lax.round(0.5 * (x - 0.5 - odd), lax.RoundingMethod.AWAY_FROM_ZERO) + odd


def names_without_surface(function: Callable[..., Any], *arguments: Any) -> tuple[str, ...]:
    """Names of the equations of a function that change without a surface which steps could end on, as floor does.

    Args:
        function, arguments: as of `Program`.
    """
    names = list[str]()
    for step in Program(function, *arguments).steps:
        custom = step.equation.primitive.name.startswith("custom_")
        within = () if custom else tuple(equations_within(step.equation))
        names += [each.primitive.name for each in within if each.primitive.name in OPERANDS and is_real(each)]
        names += [each.primitive.name for each in (step.equation, *within) if _has_no_surface(each)]
    return tuple(dict.fromkeys(name.removeprefix("reduce_") for name in names))


def _has_no_surface(equation: Any) -> bool:
    """Return whether an equation jumps, or has corners, that no surface is for, as written by a user."""
    parity = equation.params.get("rounding_method") == lax.RoundingMethod.AWAY_FROM_ZERO
    return equation.primitive.name in WITHOUT_SURFACE and not parity
