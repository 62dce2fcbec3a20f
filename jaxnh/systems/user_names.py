"""Names in a user's definition, and the numbers of components that go with them.

What is wrong is said in one line, to which the caller adds the place.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from jaxnh.exceptions import InputError
from jaxnh.systems.quasi_velocities import KEYS
from jaxnh.systems.user_functions import EVENTS, FUNCTIONS
from jaxnh.systems.user_text import BESIDE_STATES, OF_RESULTS, can_be_states, states_of

CLOCKS = ("period", "time_unit")
"""Keys of a definition that say what lengths of time are counted in."""

_OF_ALL = ("coordinates", "angles", "labels", "units", "reversal")
_FIRST_ORDER = ("rhs", "observables", *EVENTS, *CLOCKS, *_OF_ALL)
_MECHANICS = ("T", "Q", "f", "ignorable", "integrals", "outputs", *EVENTS, *KEYS, *CLOCKS, *_OF_ALL)
_MAP = ("map", "inverse", *_OF_ALL[:-1])
_OWN_KEYS = {"map": _MAP, "rhs": _FIRST_ORDER}  # of a system that returns one of these
_AS_IN = {"labels": "displacement", "units": "m"}


def check_keys(definition: Mapping[str, Any]) -> str:
    """Check that the keys of a definition go together, and return the main one: rhs, T or map.

    Raises:
        InputError: one does not, or is unknown, or one is missing.
    """
    main, known = next(((key, keys) for key, keys in _OWN_KEYS.items() if key in definition), ("T", _MECHANICS))
    for name in definition:
        if name not in known:
            raise InputError(_describe_unknown(str(name), main, known))
    for name in (*(("T", "Q") if main == "T" else (main,)), "coordinates"):
        if name not in definition:
            other = ", or a right-hand side rhs, or a map" if name == "T" else ""
            raise InputError(f"system must also return {name}{other}")
    return main


def _describe_unknown(name: str, main: str, known: Sequence[str]) -> str:
    """Describe what is wrong with a key of a definition whose main one, as rhs, is another."""
    if main == "map" and name in CLOCKS:
        return f"a map has no {name}: lengths of time are counted in its iterates; leave it out"
    if name in EVENTS:
        return f"{name} go with a flow; write the jump into the image, or leave {name} out"
    if name in (*FUNCTIONS, *_MECHANICS):
        return f"system returns {main} and {name!r}; a system is a right-hand side, or T and Q, or a map"
    close = difflib.get_close_matches(name, known, n=1)
    meant = f" (did you mean {close[0]}?)" if close else ""
    return f"system returns {name!r}, which is unknown{meant}; known are {', '.join(known)}"


def states_in(definition: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the coordinates of a state: of mechanics with velocities NAME_dot, or with quasi-velocities."""
    names = tuple(definition["coordinates"])
    if "rates" in definition:
        dependent = definition.get("dependent", ())
        return states_of(names, [name for name in definition["quasi_velocities"] if name not in dependent])
    return states_of(names) if "T" in definition else names


def state_sizes(definition: Mapping[str, Any]) -> tuple[int, int]:
    """Numbers of coordinates and of velocities that T, Q and f are functions of."""
    names = definition["coordinates"]
    return len(names), len(definition.get("quasi_velocities", names))


def fault_of_count(definition: Mapping[str, Any], name: str, count: int) -> str:
    """Describe what is wrong with so many numbers that a function of mechanics returns; "" where nothing is."""
    k, n = state_sizes(definition)
    each = "a quasi-velocity" if "rates" in definition else "a coordinate"
    if name == "rates" and count != k:
        return f"rates must return {k} numbers, one a coordinate, not {count}"
    if name == "Q" and count != n:
        return f"Q must return {n} numbers, one {each}, not {count}"
    if name == "f" and (dependent := definition.get("dependent", ())) and count != len(dependent):
        return f"f returns {count} numbers, and must return {len(dependent)}, one for each of {', '.join(dependent)}"
    if name == "f" and count >= n:
        owners = "quasi-velocities" if "rates" in definition else "coordinates"
        return f"f returns {count} numbers; {n} {owners} can have {n - 1} at most"
    return ""


def check_names(definition: Mapping[str, Any], parameters: Sequence[str]) -> None:
    """Check that the names in a definition can be told apart, and are those of what there is.

    Args:
        definition: of a user's file, one name for a tuple of it allowed no more.
        parameters: names of the parameters.

    Raises:
        InputError: they cannot, or are not.
    """
    names = definition["coordinates"]
    _check_identifiers("coordinates", names, '("x", "y")')
    _check_quasi_velocities(definition)
    every = [*states_in(definition), *definition.get("dependent", ())]
    if not can_be_states(every):
        raise InputError(f"coordinates must differ, and not be one of {', '.join(BESIDE_STATES)}")
    for name in every:
        if name in parameters:
            raise InputError(f"{name} names a parameter and a coordinate or velocity; rename one of them")
    _check_functions("integrals", "(q, v, t)", "energy", definition, (*every, *parameters))
    every += definition.get("integrals", ())
    _check_functions("outputs", "(q, v, t, multipliers)", "force", definition, (*every, *parameters))
    every += definition.get("outputs", ())
    _check_functions("observables", "(y, t)", "height", definition, (*every, *parameters))
    every += definition.get("observables", ())
    for kind in ("labels", "units"):
        said = definition.get(kind, {})
        if not isinstance(said, Mapping) or not all(isinstance(word, str) for word in said.values()):
            raise InputError(f'{kind} must be words by name, as in {kind}={{"{every[0]}": "{_AS_IN[kind]}"}}')
        more = ("t",) if kind == "units" and "map" not in definition else ()
        for name in said:
            if name not in (*every, *more, *parameters):
                raise InputError(f"{kind} names {name!r}, which is no parameter, coordinate or velocity")
    for kind in ("angles", "ignorable"):
        for name in definition.get(kind, ()):
            if name not in names:
                raise InputError(f"{kind} names {name!r}, which is no coordinate")
    if len(set(definition.get("ignorable", ()))) == len(names):
        raise InputError("one coordinate at least must not be ignorable")


def _check_functions(
    kind: str, arguments: str, example: str, definition: Mapping[str, Any], taken: Sequence[str]
) -> None:
    """Check that integrals, or outputs, are functions, with names that nothing else has."""
    functions = definition.get(kind, {})
    if not isinstance(functions, Mapping) or not all(map(callable, functions.values())):
        raise InputError(f'{kind} must be functions of {arguments} by name, as in {kind}={{"{example}": {example}}}')
    for name in functions:
        if not isinstance(name, str) or not name.isidentifier() or name in taken or name in OF_RESULTS:
            raise InputError(f"{kind} has {name!r}, which is no name or that of something else")


def _check_identifiers(kind: str, names: Sequence[Any], example: str) -> None:
    if not names or not all(isinstance(name, str) and name.isidentifier() for name in names):
        raise InputError(f"{kind} must be names, as in {kind}={example}")


def _check_quasi_velocities(definition: Mapping[str, Any]) -> None:
    """Check what a definition says of quasi-velocities by name."""
    if "rates" not in definition:
        for key in KEYS:
            if key in definition:
                raise InputError(f"{key} goes with rates(q, u, t), the rates of the coordinates; leave it out")
        return
    if "quasi_velocities" not in definition:
        raise InputError('with rates, system must also return quasi_velocities, their names, as in ("u", "w")')
    names, quasi = definition["coordinates"], definition["quasi_velocities"]
    _check_identifiers("quasi_velocities", quasi, '("u", "w")')
    for name in definition.get("dependent", ()):
        if name not in quasi:
            raise InputError(f"dependent names {name!r}, which is no quasi-velocity")
    if definition.get("dependent") and definition.get("f") is None:
        raise InputError("dependent names quasi-velocities that the constraints f give; there is no f")
    norms = definition.get("norms", ())
    if not isinstance(norms, tuple | list) or not all(isinstance(group, tuple | list) and group for group in norms):
        raise InputError(f'norms must be lists of coordinates, as in norms=[("{names[0]}", ...)]')
    for name in (name for group in norms for name in group):
        if name not in names:
            raise InputError(f"norms has {name!r}, which is no coordinate")
    n, constants = len(quasi), definition.get("structure_constants")
    if constants is not None and not _is_cube(constants, n):
        raise InputError(f"structure_constants must be {n} times {n} times {n} plain numbers, c[i][j][k]")


def _is_cube(constants: Any, n: int, depth: int = 3) -> bool:
    if not depth:
        return isinstance(constants, int | float)
    if not isinstance(constants, tuple | list) or len(constants) != n:
        return False
    return all(_is_cube(part, n, depth - 1) for part in constants)
