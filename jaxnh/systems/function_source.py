"""The text of a file that defines a system as a Python function does that is in memory, in a notebook or a module.

A result keeps the text that it was computed from, and other processes run it. So the source of the function is taken
with all that it takes from around it: imports, numbers, arrays, and other functions of the user's own.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import sys
import sysconfig
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import jax
import numpy as np

from jaxnh.exceptions import InputError

_LIBRARIES = tuple(sysconfig.get_paths()[name] for name in ("stdlib", "platstdlib", "purelib", "platlib"))
_ENTRY = "system"  # the function that a file must have
_LAMBDA = "<lambda>"


def source_text(function: Callable[..., Any]) -> str:
    """Return the text of a file whose function `system` is this function.

    Raises:
        InputError: its source cannot be read, or it uses something that a file cannot say.
    """
    if not inspect.isfunction(function) or function.__name__ == _LAMBDA:
        known_as = getattr(function, "__name__", type(function).__name__)
        raise InputError(f"a system is a function written with def, and {known_as} is not")
    parts = dict[str, str]()
    _gather(function, function.__name__, parts, {})
    *needed, own = parts.values()
    imports = [part for part in needed if part.startswith(("import ", "from "))]
    others = [part for part in needed if part not in imports]
    alias = [] if function.__name__ == _ENTRY else [f"{_ENTRY} = {function.__name__}\n"]
    return "\n".join(["".join(f"{part}\n" for part in imports), *others, own, *alias]).lstrip("\n")


def _gather(function: FunctionType, name: str, parts: dict[str, str], known: dict[str, Any]) -> None:
    """Put what a function takes from around it into the parts, by name, each before what needs it, then its source.

    Raises:
        InputError: a name is one thing to one function and another to another, as of two modules.
    """
    parts[name], known[name] = "", function  # a function that calls itself
    around = inspect.getclosurevars(function)
    values = {**around.globals, **around.nonlocals, **_defaults(function, around.globals)}
    for other in sorted(_names_of(function.__code__) & function.__globals__.keys()):
        values.setdefault(other, function.__globals__[other])
    for other, value in values.items():
        if other not in known:
            known[other] = value
            _put(other, value, function, parts, known)
        elif known[other] is not value and not (_is_literal(value) and repr(value) == repr(known[other])):
            raise _clash(other, function)
    del parts[name]
    parts[name] = _source(function)


def _clash(name: str, function: FunctionType) -> InputError:
    """Return the error of a name that is two things."""
    return InputError(
        f"{name} is one thing to {function.__name__} and another to a function that goes with it, and a file has one; "
        "rename one of them"
    )


def _put(name: str, value: Any, user: FunctionType, parts: dict[str, str], known: dict[str, Any]) -> None:
    """Put the definition of one name into the parts."""
    if isinstance(value, ModuleType):
        parts[name] = f"import {value.__name__}" + ("" if value.__name__ == name else f" as {name}")
    elif inspect.isfunction(value) and value.__name__ == _LAMBDA and not _installed(value):
        if not isinstance(tree := _tree(value), ast.Assign) or ast.unparse(tree.targets[0]) != name:
            raise InputError(f"{user.__name__} uses {name}, a lambda without a line of its own; write it with def")
        _gather(value, name, parts, known)
    elif inspect.isfunction(value) and not _installed(value):
        if value.__name__ != name and known.setdefault(value.__name__, value) is not value:
            raise _clash(value.__name__, user)
        _gather(value, name, parts, known)
        if value.__name__ != name:
            parts[name] += f"\n{name} = {value.__name__}\n"
    elif isinstance(value, np.ndarray | jax.Array):
        parts.setdefault("numpy", "import numpy")
        parts[name] = f"{name} = numpy.array({np.asarray(value).tolist()!r})\n"
    elif _is_literal(value):
        parts[name] = f"{name} = {value!r}\n"
    elif (home := _home(value)) is not None:
        module, known_as = home
        parts[name] = f"from {module} import {known_as}" + ("" if known_as == name else f" as {name}")
    else:
        raise InputError(
            f"{user.__name__} uses {name}, {_describe(value)}, which its text alone does not say; "
            "give numbers as parameters of the function, or make it a file of its own"
        )


def _source(function: FunctionType) -> str:
    """The source of a function, at the left margin."""
    try:
        return textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        raise InputError(
            f"the source of {function.__name__} cannot be read, as of what is typed at the prompt of plain Python; "
            "write it in a file or in a notebook"
        ) from None


def _tree(function: FunctionType) -> ast.stmt | None:
    """The statement that defines a function; None of a lambda in the midst of one."""
    try:
        (statement,) = ast.parse(_source(function)).body
    except (SyntaxError, ValueError):
        return None
    return statement


def _names_of(code: CodeType) -> set[str]:
    """Names that a function's code, and that of functions within it, may take from its module."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return {*code.co_names, *(name for each in inner for name in _names_of(each))} - vars(builtins).keys()


def _defaults(function: FunctionType, known: Mapping[str, Any]) -> dict[str, Any]:
    """Names that the head of a function takes from its module: in defaults, annotations and decorators."""
    tree = _tree(function)
    head = tree.value if isinstance(tree, ast.Assign) else tree
    assert isinstance(head, ast.FunctionDef | ast.Lambda)
    heads = [*head.args.defaults, *head.args.kw_defaults]
    if isinstance(head, ast.FunctionDef):
        heads += [*head.decorator_list, head.returns]
    heads += [argument.annotation for argument in (*head.args.args, *head.args.kwonlyargs)]
    nodes = (node for head in heads if head is not None for node in ast.walk(head))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return {name: function.__globals__[name] for name in names & function.__globals__.keys() if name not in known}


def _installed(function: FunctionType) -> bool:
    """Return whether a function is of a module that other processes can import by name, and not the user's own."""
    if function.__module__.split(".")[0] == __name__.split(".")[0]:
        return True
    path = getattr(sys.modules.get(function.__module__), "__file__", None)
    return path is not None and any(Path(path).is_relative_to(folder) for folder in _LIBRARIES)


def _home(value: Any) -> tuple[str, str] | None:
    """The module that something can be imported from and its name there."""
    module, name = getattr(value, "__module__", None), getattr(value, "__name__", None)
    if not module or not name or module == "__main__":
        return None
    return (module, name) if getattr(sys.modules.get(module), name, None) is value else None


def _is_literal(value: Any) -> bool:
    """Return whether the text of a value is the value."""
    if isinstance(value, tuple | list):
        return all(map(_is_literal, value))
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_literal(entry) for key, entry in value.items())
    return (
        isinstance(value, bool | int | float | complex | str | None)
        and value == value
        and value not in (float("inf"), -float("inf"))
    )


def _describe(value: Any) -> str:
    """A value in a message."""
    kind = type(value).__name__
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"
