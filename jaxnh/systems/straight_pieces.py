"""Equations of straight pieces, each with a corner or a jump: which values it compares, and how it is written out."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend import core

COMPARISONS = {"gt": 1.0, "ge": 1.0, "lt": -1.0, "le": -1.0}
"""Comparisons, and the side of a surface on which each is true."""

OPERANDS = {"abs": ((0, None),), "sign": ((0, None),), "max": ((0, 1),), "min": ((0, 1),), "clamp": ((1, 0), (1, 2))}
OPERANDS |= dict.fromkeys(COMPARISONS, ((0, 1),))
"""Places of the two operands of each surface of an equation; None: zero."""

MOST_SURFACES = 64
"""Most surfaces of a field: each is looked at after every step."""

_EXTREMES = {"reduce_max": lax.max, "reduce_min": lax.min}
_LINEAR = ("add", "sub", "mul", "neg", "select_n", "convert_element_type", "broadcast_in_dim", "jit", "pjit")


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
    """The program in place of an equation of straight pieces, as `jax.nn.relu`, or of an extreme of few numbers."""
    if equation.primitive.name in _EXTREMES:
        number, made = equation.invars[0].aval, equation.outvars[0].aval
        if not 0 < number.size - made.size <= MOST_SURFACES or not is_real(equation):
            return None
        axes, extreme = equation.params["axes"], _EXTREMES[equation.primitive.name]

        def by_pairs(numbers: Any) -> Any:
            first = jnp.moveaxis(numbers, axes, range(len(axes))).reshape(-1, *made.shape)
            return functools.reduce(extreme, list(first))

        return jax.make_jaxpr(by_pairs)(number)
    if not equation.primitive.name.startswith("custom_jvp"):
        return None
    names = {each.primitive.name for each in equations_within(equation)}
    linear = not names.isdisjoint(OPERANDS) and names <= {*OPERANDS, *_LINEAR}
    return equation.params["call_jaxpr"] if linear else None
