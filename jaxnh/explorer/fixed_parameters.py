"""Parameters of a result, read from the config that it carries: fixed values, and ranges. Nothing is run; no JAX."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from jaxnh.config.config import Config, config_of
from jaxnh.config.yaml_source import from_text
from jaxnh.exceptions import InputError

_OPERATORS: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def fixed_parameters(attrs: Mapping[Any, Any]) -> dict[str, float]:
    """Return the parameters that have one value in a result, those of axes with one value too.

    Args:
        attrs: of the root of a result; without a config there is nothing to be read.
    """
    config, user_text = _config(attrs)
    if config is None:
        return {}
    own = _defaults(user_text) if user_text else {}
    own |= {
        name: float(value)
        for name, value in config.system.model_dump().items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    grids = config.sweep.grids
    single = {name: float(grid.first) for name, grid in grids.items() if grid.size == 1}
    return {name: value for name, value in own.items() if name not in grids} | single


def swept_ranges(attrs: Mapping[Any, Any]) -> dict[str, tuple[float, float]]:
    """Return least and largest value of each axis of more than one value; as of `fixed_parameters`."""
    config, _ = _config(attrs)
    if config is None:
        return {}
    grids = {name: grid.grid() for name, grid in config.sweep.grids.items() if grid.size > 1}
    return {name: (float(values.min()), float(values.max())) for name, values in grids.items()}


def _config(attrs: Mapping[Any, Any]) -> tuple[Config | None, str]:
    """The config of a result and the text of its user's file; None where there is none, or one of another version."""
    text, user_text = attrs.get("config"), str(attrs.get("system_file") or "")
    try:
        return (config_of(from_text(str(text)), user_text=user_text or None) if text else None), user_text
    except InputError:
        return None, user_text


def _defaults(text: str) -> dict[str, float]:
    """Defaults of the parameters of a user's system that are written as numbers, or as sums and products of some."""
    systems = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef) and node.name == "system"]
    defaults = dict[str, float]()
    for system in systems:
        given = system.args
        pairs = [
            *zip(given.args[len(given.args) - len(given.defaults) :], given.defaults, strict=True),
            *zip(given.kwonlyargs, given.kw_defaults, strict=True),
        ]
        for argument, node in pairs:
            try:
                defaults[argument.arg] = _number(node)
            except (ValueError, ArithmeticError):
                continue  # what is not written out is not known
    return defaults


def _number(node: ast.expr | None) -> float:
    """The number that an expression of literals is.

    Raises:
        ValueError: there is something else in it.
        ArithmeticError: it has no value.
    """
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_number(node.left), _number(node.right))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_number(node.operand)
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    raise ValueError("no number")
