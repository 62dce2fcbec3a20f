"""Completion by the shell: of commands, their options, and keys of a config. No JAX."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxnh.exceptions import InputError, UserFileError
from jaxnh.systems.user_text import Names, names_in, read_text

_SCHEMA = Path(__file__).parents[1] / "config" / "schema.json"
_USERS_OWN = ("UserInitial", "UserSweep", "UserSystem")  # their keys are the names of a user's file


def complete(commands: list[str]) -> int:
    """Answer the shell, or write its script: all commands as one program, which only completion needs.

    Args:
        commands: modules of the package, each with an `app` of one command.
    """
    program = typer.Typer(pretty_exceptions_enable=False)
    for name in commands:
        [command] = import_module(f"jaxnh.cli.commands.{name}").app.registered_commands
        program.command(name)(command.callback)
    program(prog_name="jaxnh")
    return 0


def overrides(ctx: typer.Context, incomplete: str) -> list[str]:
    """Completions of `KEY=VALUE`: dotted keys of a config, as its schema has them, or values of a key.

    Where the config is there and names a user's file, its names are among them, and keys of the particle are not.
    """
    schema = json.loads(_SCHEMA.read_text(encoding="utf-8"))
    names = _names(ctx.params.get("config"))
    if names is not None:
        del schema["else"], schema["properties"]["system"]
    candidates = dict.fromkeys([*_keys(schema, schema, ""), *(_users_keys(names, schema) if names else ())])
    return [text for text in candidates if text.startswith(incomplete)]


ConfigFile = Annotated[Path | None, typer.Argument(help="YAML file of the experiment", show_default=False)]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="[KEY=VALUE]...", help="Values to use in place of the file's", autocompletion=overrides),
]
"""Arguments of commands that take a config."""


def _names(config: Path | str | None) -> Names | None:
    """Names of the user's file of a config; None where it has none, or is not there yet."""
    from jaxnh.config.yaml_source import read  # ruamel.yaml, which no command needs that only reads its arguments

    try:
        system = read(Path(config), []).data.get("system") if config else None
        file = system.get("file") if isinstance(system, dict) else None
        if not config or not isinstance(file, str):
            return None
        path = Path(config).parent / file
        return names_in(read_text(path), path) if path.is_file() else Names()
    except UserFileError:
        return Names()
    except InputError:
        return None


def _users_keys(names: Names, schema: dict[str, Any]) -> Iterator[str]:
    """Keys of the blocks whose keys a user's file names."""
    parameters, states = names.parameters or (), names.states or ()
    yield from (f"system.{name}=" for name in ("file", *parameters))
    yield from (f"initial.{name}=" for name in ("project", *states))
    axis = schema["$defs"]["UserSweep"]["additionalProperties"]
    for name in (*parameters, *states):
        yield from _keys(axis, schema, f"sweep.{name}")


def _keys(node: dict[str, Any], schema: dict[str, Any], path: str) -> Iterator[str]:
    """Dotted keys below a node; one with few values is given with each of them."""
    name = str(node.get("$ref", "")).rpartition("/")[2]
    if name:
        if name not in _USERS_OWN:
            yield from _keys(schema["$defs"][name], schema, path)
        return
    cases = (node[word] for word in ("then", "else") if word in node)
    for case in (*node.get("oneOf", ()), *node.get("anyOf", ()), *cases):
        yield from _keys(case, schema, path)
    for key, value in node.get("properties", {}).items():
        yield from _keys(value, schema, f"{path}.{key}" if path else key)
    if node.get("type") == "null":
        yield f"{path}=null"
    elif path and not node.keys() & {"properties", "oneOf", "anyOf"}:
        values = node.get("enum") or [node.get("const", "")]
        yield from (f"{path}={value}" for value in values)
