"""Functions of a user's definition: how they are called, and whether those of jumps and switches can be."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
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

COMPILED_FOR_ONE_CALL = {"xla_backend_optimization_level": 0}
"""Options of XLA for programs that run once, on few numbers: 16 of middling size took 2.5 s of processor for 4.6."""

_FLAGS = {"jumps": "rest", "switches": "sliding"}
"""A key more of these, True or False: whether motions may rest on a wall, or slide along a surface."""

_ARGUMENTS = {
    "map": "(y)",
    "inverse": "(y)",
    "rhs": "(y, t)",
    "rates": "(q, u, t)",
    **dict.fromkeys("TQf", "(q, v, t)"),
}

_EXAMPLES = {
    "jumps": 'jumps=[{"when": wall, "direction": "up", "then": bounce}]',
    "switches": 'switches=[{"on": surface}]',
    "f": 'f=[{"constraint": blade, "when": lowered}]',
}


class EventFault(Exception):
    """Jumps or switches that are none.

    Attributes:
        line: where a function begins that is meant; 0 where none is.
    """

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(message)
        self.line = line


def with_events(definition: Mapping[str, Any], main: str) -> dict[str, Any]:
    """The definition with its jumps, switches and constraints checked, and functions of these that see one state.

    Constraints of a list that come and go become `constraints`, the others one function `f`.

    Args:
        definition: its main key is one of its functions.
        main: that key: rhs, T or map.

    Raises:
        EventFault: they are none, or a function is no function, in words.
    """
    arguments, made = ("q", "v", "t") if main == "T" else ("y", "t"), dict(definition)
    if isinstance(made.get("f"), tuple | list):
        made |= _listed_constraints(made["f"])
    for name, takes_what in _ARGUMENTS.items():
        if made.get(name) is not None and not callable(made[name]):
            raise EventFault(f"{name} must be a function of {takes_what}")
    made |= {kind: _checked_events(kind, definition[kind], arguments) for kind in EVENTS if kind in definition}
    forces = "Q" if main == "T" else "rhs"
    if made.get("switches") and not takes(made[forces], len(arguments) + 1):
        signature = f"({', '.join(arguments)}, side)"
        message = f"with switches {forces} is a function of {signature}; side has +1.0 or -1.0 for each switch"
        raise EventFault(message, line_of_code(made[forces], 0))
    return made


def _listed_constraints(given: Sequence[Any]) -> dict[str, Any]:
    """The constraints of a list: f, those that hold at all times, and those that come and go."""
    permanent, switched = list[Callable[..., Any]](), list[Mapping[str, Any]]()
    for number, each in enumerate(given):
        where = f"f[{number}]"
        if not isinstance(each, Mapping):
            if not callable(each) or not takes(each, 3):
                message = f"{where} must be a function of (q, v, t), or a mapping, as in {_EXAMPLES['f']}"
                raise EventFault(message, line_of_code(each, 0))
            permanent.append(components_of(each))
            continue
        _check_known(where, each, ("constraint", "when"))
        parts = {key: _event_function("f", where, key, each, ("q", "v", "t")) for key in ("constraint", "when")}
        switched.append({**parts, "name": where})

    def f(q: Any, v: Any, t: Any) -> tuple[Any, ...]:
        return tuple(x for each in permanent for x in each(q, v, t))

    if permanent:
        f.__wrapped__ = permanent[0]  # pyright: ignore[reportFunctionMemberAccess]
    return {"f": f if permanent else None, "constraints": tuple(switched)}


def _checked_events(kind: str, given: Any, arguments: Sequence[str]) -> tuple[Mapping[str, Any], ...]:
    if not isinstance(given, tuple | list) or not all(isinstance(event, Mapping) for event in given):
        raise EventFault(f"{kind} must be a list of mappings, as in {_EXAMPLES[kind]}")
    return tuple(_checked_event(kind, f"{kind}[{number}]", event, arguments) for number, event in enumerate(given))


def _checked_event(kind: str, where: str, given: Mapping[str, Any], arguments: Sequence[str]) -> Mapping[str, Any]:
    needed, flag = EVENTS[kind], _FLAGS[kind]
    impact = kind == "jumps" and len(arguments) == 3
    _check_known(where, given, (*needed, *(["restitution"] if impact else []), flag))
    event = {"direction": "up", **given} if kind == "jumps" else dict(given)
    if not isinstance(event.get(flag, False), bool):
        raise EventFault(f"{where}.{flag} must be True or False, not {event[flag]!r}")
    if "restitution" in event:
        if "then" in event:
            raise EventFault(f"{where} has then and restitution, which exclude each other")
        if isinstance(event["restitution"], bool | str) or callable(event["restitution"]):
            raise EventFault(f"{where}.restitution must be a number: speed after an impact over that before it")
        needed = tuple(key for key in needed if key != "then")
    for key in needed:
        if key == "direction":
            if event[key] not in DIRECTIONS:
                words = ", ".join(DIRECTIONS)
                raise EventFault(f"{where}.direction must be one of {words}, not {event[key]!r}")
        else:
            event[key] = _event_function(kind, where, key, event, arguments)
    return event


def _check_known(where: str, given: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in given:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            meant = f" (did you mean {close[0]}?)" if close else ""
            raise EventFault(f"{where} has {key!r}, which is unknown{meant}; known are {', '.join(known)}")


def _event_function(
    kind: str, where: str, key: str, event: Mapping[str, Any], arguments: Sequence[str]
) -> Callable[..., Any]:
    """A function of an event that sees the numbers of one state."""
    if key not in event:
        raise EventFault(f"{where} must also have {key}, as in {_EXAMPLES[kind]}")
    function = event[key]
    if not callable(function) or not takes(function, len(arguments)):
        raise EventFault(f"{where}.{key} must be a function of ({', '.join(arguments)})", line_of_code(function, 0))
    vector = key == "constraint" or (key == "then" and len(arguments) == 2)
    return pointwise(components_of(function) if vector else function)


def functions_of(definition: Mapping[str, Any]) -> dict[str, Callable[..., Any]]:
    """Functions of a definition by name, of (state, t), or of the state; a field by the branch that a state is in."""
    functions = {name: definition[name] for name in FUNCTIONS if definition.get(name) is not None}
    switches = definition.get("switches", ())
    if switches:
        name = "rhs" if "rhs" in definition else "Q"

        @functools.wraps(definition[name])
        def by_side(*at: Any) -> Any:
            return definition[name](*at, tuple(jnp.where(each["on"](*at) >= 0.0, 1.0, -1.0) for each in switches))

        functions[name] = by_side
    for kind, keys in EVENTS.items():
        for number, event in enumerate(definition.get(kind, ())):
            functions |= {f"{kind}[{number}].{key}": event[key] for key in keys if key != "direction" and key in event}
    for each in definition.get("constraints", ()):
        functions |= {f"{each['name']}.{key}": each[key] for key in ("constraint", "when")}
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


def count_of(result: Any) -> int:
    """The number of components of what a function returned; -1 of what has none."""
    if isinstance(result, tuple | list):
        return len(result)
    return result.shape[0] if getattr(result, "ndim", 0) == 1 else -1


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
