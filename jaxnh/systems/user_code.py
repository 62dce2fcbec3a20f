"""Explanations of errors in a user's Python: where it failed, and what to write instead.

Functions of a user's system are traced: they run once, with numbers that are not known yet. Python's own functions of
numbers, and its choices between numbers, need known ones; JAX has others for both.
"""

from __future__ import annotations

import ast
import builtins
import traceback
from collections.abc import Iterator, Mapping
from types import BuiltinFunctionType, ModuleType, TracebackType
from typing import Any

import jax.numpy as jnp
from jax.errors import ConcretizationTypeError, TracerArrayConversionError, TracerIntegerConversionError

_NOT_KNOWN = (ConcretizationTypeError, TracerArrayConversionError, TracerIntegerConversionError)
_LONGEST = 300  # letters of a message that is Python's own
_LONGEST_CODE = 40  # letters of the user's code within a message
_IMPORT = "import jax.numpy as jnp"
_CHANGING = "what changes during the run"
_OTHER_NAMES = {"fabs": "abs", "pow": "power", "fmod": "fmod", "array": "array"}  # of functions, in jax.numpy


def explain_error(error: Exception, text: str, path: str) -> tuple[int | None, str]:
    """Line of a file that an exception came from, None where it did not, and what is wrong in one line.

    Args:
        error: as it was caught.
        text: of the file.
        path: under which the text was compiled.
    """
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
    if not frames:
        return None, _plain(error)
    last = frames[-1]
    if not isinstance(error, _NOT_KNOWN) and not isinstance(error.__cause__, _NOT_KNOWN):
        return last.lineno, _plain(error)
    place = last.lineno or 1, last.colno or 0, last.end_lineno or last.lineno or 1, last.end_colno or 0
    advice = _advice(ast.parse(text), text, place, _names_at(error.__traceback__, path))
    return (
        last.lineno,
        advice or f"this needs a number that is known before the run: use functions of jax.numpy ({_IMPORT})",
    )


def _plain(error: Exception) -> str:
    """Kind and first paragraph of an exception."""
    return f"{type(error).__name__}: {' '.join(str(error).split(chr(10) * 2)[0].split())[:_LONGEST]}"


def _names_at(trace: TracebackType | None, path: str) -> Mapping[str, Any]:
    """Names that the code of a file had where it failed last."""
    names: Mapping[str, Any] = {}
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == path:
            names = {**vars(builtins), **trace.tb_frame.f_globals, **trace.tb_frame.f_locals}
        trace = trace.tb_next
    return names


def _advice(tree: ast.Module, text: str, place: tuple[int, int, int, int], names: Mapping[str, Any]) -> str:
    """Advise what to write instead of the code at (line, column, last line, last column); "" without advice."""
    inside = [node for node in ast.walk(tree) if _holds(node, place)]  # outermost first
    for node in reversed(inside):
        for words in (_advice_on_call(node, names), _advice_on_choice(node, text, place)):
            if words:
                return words
    return ""


def _holds(node: ast.AST, place: tuple[int, int, int, int]) -> bool:
    """Return whether an expression or statement has a place in it."""
    if not isinstance(node, ast.expr | ast.stmt) or node.end_lineno is None or node.end_col_offset is None:
        return False
    begin, end = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
    return begin <= place[:2] and place[2:] <= end


def _advice_on_call(node: ast.AST, names: Mapping[str, Any]) -> str:
    """Name the function to call instead of one that takes known numbers alone."""
    if not isinstance(node, ast.Call):
        return ""
    called, function = ast.unparse(node.func), _value(node.func, names)
    if function in (max, min):
        return f"{called}() cannot choose by {_CHANGING}: use jnp.{called}imum ({_IMPORT})"
    if function in (float, int, bool, round):
        return f"{called}() takes a plain number, not {_CHANGING}: leave it out, or use functions of jax.numpy"
    home = _module_of(function)
    if home not in ("math", "cmath", "numpy", "scipy"):
        return ""
    name = _OTHER_NAMES.get(getattr(function, "__name__", ""), getattr(function, "__name__", ""))
    if home == "scipy":
        instead = f"jax.scipy has some of SciPy's functions; use jax.scipy in place of {called}"
    else:
        instead = f"use jnp.{name}" if hasattr(jnp, name) else "use functions of jax.numpy"
    return f"{called} takes plain numbers, not {_CHANGING}: {instead} ({_IMPORT})"


def _module_of(function: Any) -> str:
    """The package that a function is from, "" where that is not said."""
    if isinstance(function, BuiltinFunctionType) and isinstance(function.__self__, ModuleType):
        return function.__self__.__name__.split(".")[0]
    home = getattr(function, "__module__", None) or type(function).__module__
    return str(home).split(".")[0]


def _value(node: ast.expr, names: Mapping[str, Any]) -> Any:
    """Return the value of a name, or of a module's name; None for other expressions."""
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute):
        return getattr(_value(node.value, names), node.attr, None)
    return None


def _advice_on_choice(node: ast.AST, text: str, place: tuple[int, int, int, int]) -> str:
    """Advise on a choice between numbers, and on an array that is changed in place."""
    condition = "(condition, a, b)"
    for statement, test in _conditions(node):
        if _holds(test, place):
            shown = ast.get_source_segment(text, test) or ""
            if shown and len(shown) <= _LONGEST_CODE and "\n" not in shown:
                condition = f"({shown}, a, b)"
            return f"{statement} cannot decide by {_CHANGING}: use jnp.where{condition} ({_IMPORT})"
    if isinstance(node, ast.BoolOp):
        word = "and" if isinstance(node.op, ast.And) else "or"
        return f"{word} cannot decide by {_CHANGING}: use jnp.logical_{word} ({_IMPORT})"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return f"not cannot decide by {_CHANGING}: use jnp.logical_not ({_IMPORT})"
    if isinstance(node, ast.Compare) and len(node.ops) > 1:
        return f"a comparison of three cannot decide by {_CHANGING}: use jnp.logical_and ({_IMPORT})"
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AugAssign) else []
    if any(isinstance(target, ast.Subscript) for target in targets):
        return f"NumPy's arrays hold plain numbers, not {_CHANGING}: return a tuple of numbers"
    return ""


def _conditions(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Conditions that a statement or an expression decides by, with its word."""
    if isinstance(node, ast.If | ast.IfExp):
        yield "if", node.test
    elif isinstance(node, ast.While):
        yield "while", node.test
    elif isinstance(node, ast.Assert):
        yield "assert", node.test
