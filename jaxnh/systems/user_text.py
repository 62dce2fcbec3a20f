"""A user's file as text: read, parsed, and what names its text alone gives, without JAX and without running it."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxnh.exceptions import UserFileError

OF_RESULTS = (
    "lane", "strobe", "time", "start", "exponent", "level", "attractor", "period", "kind", "status", "residual",
    "multiplier", "transverse", "drift", "energy_lost", "computed",
)  # fmt: skip
"""Variables and dimensions of results, which no axis of a sweep can be called."""

BESIDE_STATES = ("t", "lane", "strobe", "time", "start", "drift", "energy_lost", "status")
"""Variables of results that no state can be called."""


class Names(NamedTuple):
    """Names of a user's system; None where the text alone does not give them.

    Attributes:
        parameters: of the function `system`.
        coordinates: positions, or what a right-hand side or a map acts on.
        states: coordinates, of mechanics each with its velocity NAME_dot, or all of them and then quasi-velocities.
        integrals: of mechanics, functions of the state onto whose levels starts are put.
    """

    parameters: tuple[str, ...] | None = None
    coordinates: tuple[str, ...] | None = None
    states: tuple[str, ...] | None = None
    integrals: tuple[str, ...] | None = None


def read_text(path: Path) -> str:
    """Text of a user's file.

    Raises:
        UserFileError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserFileError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def names_in(text: str, path: Path) -> Names:
    """Names of parameters and states in the text of a user's file.

    Raises:
        UserFileError: it is not Python.
    """
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError) as error:
        line, what = getattr(error, "lineno", None) or 1, getattr(error, "msg", error)
        raise UserFileError(f"{path}:{line}: not valid Python: {what}") from None
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "system"]
    if len(functions) != 1 or functions[0] not in tree.body or functions[0].decorator_list:
        return Names()
    [system] = functions
    arguments = system.args
    if arguments.vararg or arguments.kwarg or arguments.posonlyargs:
        return Names()
    return Names(tuple(argument.arg for argument in (*arguments.args, *arguments.kwonlyargs)), *_coordinates(system))


def states_of(coordinates: Sequence[str], quasi_velocities: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the states of mechanics: each coordinate and its velocity, or coordinates and quasi-velocities."""
    if quasi_velocities:
        return (*coordinates, *quasi_velocities)
    return tuple(word for name in coordinates for word in (name, f"{name}_dot"))


def can_be_states(names: Sequence[str]) -> bool:
    """Return whether names differ from each other and from what else results have."""
    return len(set(names)) == len(names) and not set(names) & set(BESIDE_STATES)


def _coordinates(system: ast.FunctionDef) -> tuple[tuple[str, ...] | None, ...]:
    """Coordinates, states and integrals of the one definition with written-out names; None where there is not one."""
    definitions = [entries for entries in map(_entries, ast.walk(system)) if "coordinates" in entries]
    if len(definitions) != 1 or len(definitions[0].keys() & {"rhs", "T", "map"}) != 1:
        return None, None, None
    [definition] = definitions
    names = _literal_names(definition, "coordinates")
    if names is None:
        return None, None, None
    states: tuple[str, ...] | None = names
    if "rates" in definition:
        quasi, dependent = _literal_names(definition, "quasi_velocities"), _literal_names(definition, "dependent", ())
        if not quasi or dependent is None:
            return None, None, None
        states = states_of(names, [name for name in quasi if name not in dependent])
    elif "T" in definition:
        states = states_of(names)
    integrals: tuple[str, ...] | None = ()
    if "integrals" in definition:
        entries = _entries(definition["integrals"])
        integrals = tuple(entries) or None
    return (names, states, integrals) if can_be_states(states) else (None, None, None)


def _literal_names(
    definition: dict[str, ast.expr], key: str, otherwise: tuple[str, ...] | None = None
) -> tuple[str, ...] | None:
    """Names that a definition writes out under a key; None where they are no literals."""
    if key not in definition:
        return otherwise
    try:
        names = ast.literal_eval(definition[key])
    except ValueError:
        return None
    names = (names,) if isinstance(names, str) else names
    if not isinstance(names, tuple | list) or not all(isinstance(name, str) for name in names):
        return None
    return tuple(names)


def _entries(node: ast.AST) -> dict[str, ast.expr]:
    """Keys and values of {"KEY": VALUE} or dict(KEY=VALUE)."""
    if isinstance(node, ast.Dict):
        pairs = zip(node.keys, node.values, strict=True)
        return {str(key.value): value for key, value in pairs if isinstance(key, ast.Constant)}
    if isinstance(node, ast.Call):
        return {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg}
    return {}
