"""Names in a user's file as its text alone has them: what can be said of keys, and completed, without running it."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple


class Names(NamedTuple):
    """What the text says; None where it does not say.

    Attributes:
        parameters: of the function `system`.
        states: coordinates, of mechanics each with its velocity NAME_dot.
    """

    parameters: tuple[str, ...] | None = None
    states: tuple[str, ...] | None = None


def users_file(config: Path, data: Mapping[str, Any]) -> Path | None:
    """The user's file that the content of a config names; None where it names none."""
    system = data.get("system")
    file = system.get("file") if isinstance(system, Mapping) else None
    return config.parent / file if isinstance(file, str) else None


def names_in(path: Path) -> Names:
    """Parameters and states of a user's file; nothing of one that cannot be read."""
    try:
        tree = ast.parse(path.read_bytes())
    except (OSError, SyntaxError, ValueError):
        return Names()
    found = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "system"]
    if len(found) != 1 or found[0] not in tree.body or found[0].decorator_list:
        return Names()
    [system] = found
    given = system.args
    if given.vararg or given.kwarg or given.posonlyargs:
        return Names()
    return Names(tuple(one.arg for one in (*given.args, *given.kwonlyargs)), _states(system))


def _states(system: ast.FunctionDef) -> tuple[str, ...] | None:
    """Names of the one definition with written-out coordinates; None where there is none, or another as well."""
    definitions = [one for one in map(_entries, ast.walk(system)) if "coordinates" in one]
    if len(definitions) != 1 or not definitions[0].keys() & {"rhs", "T"}:
        return None
    [definition] = definitions
    try:
        names = ast.literal_eval(definition["coordinates"])
    except ValueError:
        return None
    names = (names,) if isinstance(names, str) else names
    if not isinstance(names, tuple | list) or not all(isinstance(name, str) for name in names):
        return None
    return tuple(names) if "rhs" in definition else tuple(_with_velocities(names))


def _entries(node: ast.AST) -> dict[str, ast.expr]:
    """What {"KEY": VALUE} or dict(KEY=VALUE) says."""
    if isinstance(node, ast.Dict):
        pairs = zip(node.keys, node.values, strict=True)
        return {str(key.value): value for key, value in pairs if isinstance(key, ast.Constant)}
    if isinstance(node, ast.Call):
        return {one.arg: one.value for one in node.keywords if one.arg}
    return {}


def _with_velocities(names: tuple[str, ...] | list[str]) -> Iterator[str]:
    for name in names:
        yield from (name, f"{name}_dot")
