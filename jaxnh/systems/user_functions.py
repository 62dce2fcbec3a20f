"""Functions of a user's definition: how they are called, and whether those of jumps and switches can be."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.piecewise_smooth import DIRECTIONS

FUNCTIONS = ("map", "rhs", "rates", "T", "Q", "f")
"""Keys of a definition whose values are functions."""

LISTS_OF_NAMES = ("coordinates", "angles", "ignorable", "quasi_velocities", "dependent")
"""Keys of a definition whose values are names; one alone needs no tuple."""

EVENTS = {"jumps": ("when", "direction", "then"), "switches": ("on",)}
"""Keys of a definition whose values are lists of mappings, and the keys of these."""

_FLAGS = {"jumps": "rest", "switches": "sliding"}
"""A key more of these, True or False: whether motions may rest on a wall, or slide along a surface."""

_EXAMPLES = {
    "jumps": 'jumps=[{"when": wall, "direction": "up", "then": bounce}]',
    "switches": 'switches=[{"on": surface}]',
}


class EventFault(Exception):
    """Jumps or switches that are none.

    Attributes:
        line: where a function begins that is meant; 0 where none is.
    """

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(message)
        self.line = line


def checked_events(kind: str, given: Any) -> tuple[Mapping[str, Any], ...]:
    """The jumps or switches of a definition, with functions that see the numbers of one state.

    Raises:
        EventFault: they are none, in words.
    """
    if not isinstance(given, tuple | list) or not all(isinstance(event, Mapping) for event in given):
        raise EventFault(f"{kind} must be a list of mappings, as in {_EXAMPLES[kind]}")
    return tuple(_checked_event(kind, f"{kind}[{number}]", event) for number, event in enumerate(given))


def _checked_event(kind: str, where: str, given: Mapping[str, Any]) -> Mapping[str, Any]:
    needed, flag = EVENTS[kind], _FLAGS[kind]
    known = (*needed, flag)
    for key in given:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            meant = f" (did you mean {close[0]}?)" if close else ""
            raise EventFault(f"{where} has {key!r}, which is unknown{meant}; known are {', '.join(known)}")
    event = {"direction": "up", **given} if kind == "jumps" else dict(given)
    if not isinstance(event.get(flag, False), bool):
        raise EventFault(f"{where}.{flag} must be True or False, not {event[flag]!r}")
    for key in needed:
        if key not in event:
            raise EventFault(f"{where} must also have {key}, as in {_EXAMPLES[kind]}")
        if key == "direction":
            if event[key] not in DIRECTIONS:
                words = ", ".join(DIRECTIONS)
                raise EventFault(f"{where}.direction must be one of {words}, not {event[key]!r}")
        elif not callable(event[key]) or not takes(event[key], 2):
            raise EventFault(f"{where}.{key} must be a function of (y, t)", line_of_code(event[key], 0))
        else:
            event[key] = pointwise(components_of(event[key]) if key == "then" else event[key])
    return event


def functions_of(definition: Mapping[str, Any]) -> dict[str, Callable[..., Any]]:
    """Functions of a definition by name, of (state, t), or of the state; a field by the branch that a state is in."""
    functions = {name: definition[name] for name in FUNCTIONS if definition.get(name) is not None}
    switches = definition.get("switches", ())
    if switches:

        @functools.wraps(definition["rhs"])
        def rhs(y: Any, t: Any) -> Any:
            return definition["rhs"](y, t, tuple(jnp.where(each["on"](y, t) >= 0.0, 1.0, -1.0) for each in switches))

        functions["rhs"] = rhs
    for kind, keys in EVENTS.items():
        for number, event in enumerate(definition.get(kind, ())):
            functions |= {f"{kind}[{number}].{key}": event[key] for key in keys if key != "direction"}
    return functions


def takes(function: Any, count: int) -> bool:
    """Return whether a function can be called with so many arguments, as far as its signature says."""
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # it has none
        return True
    return True


def line_of_code(function: Any, otherwise: int) -> int:
    """The line where a function begins, of one that is written in Python."""
    code = getattr(inspect.unwrap(function) if callable(function) else None, "__code__", None)
    return code.co_firstlineno if code else otherwise


def components_of(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that returns a tuple, also of the one number that it says."""

    @functools.wraps(function)
    def components(*arguments: Any) -> Any:
        result = function(*arguments)
        if isinstance(result, tuple | list):
            return result
        return tuple(result) if getattr(result, "ndim", 0) == 1 else (result,)

    return components


def pointwise(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only ever sees the numbers of one state, also where it is asked for many of any one shape.

    So it may make arrays of its numbers, multiply matrices, and take `jax.grad` of a number.
    """

    @functools.wraps(function)
    def pointwise(*arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        shape = np.broadcast_shapes(*map(np.shape, leaves))
        if not shape:
            return function(*arguments)
        each = [jnp.broadcast_to(leaf, shape).ravel() for leaf in leaves]
        result = jax.vmap(lambda *numbers: function(*jax.tree.unflatten(structure, numbers)))(*each)
        return jax.tree.map(lambda leaf: leaf.reshape(shape), result)

    return pointwise


def with_lists_of_names(definition: Mapping[str, Any]) -> dict[str, Any]:
    """The definition with one name as a tuple of it."""
    names = {key: (definition[key],) for key in LISTS_OF_NAMES if isinstance(definition.get(key), str)}
    return {**definition, **names}
