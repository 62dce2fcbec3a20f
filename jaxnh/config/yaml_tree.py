"""YAML as a tree: text to tree and back, the line of every key, and what of YAML a config has no use for.

What a config is, overrides and the words around a fault are in yaml_source.py. A scanner of events goes before ruamel's
own constructor, whose marks come too late: it has then followed aliases, built what tags ask for, run out of stack.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.constructor import ConstructorError, RoundTripConstructor
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    DocumentStartEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
)
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.reader import ReaderError
from ruamel.yaml.representer import RoundTripRepresenter
from ruamel.yaml.scalarstring import LiteralScalarString

KeyPath = tuple[str | int, ...]
"""Keys, and numbers of list items, from the top level down; () is the whole file."""

_DEEPEST = 16


class Fault(Exception):
    """A fault in a piece of YAML, before it is known whose it is; lines count from 1."""

    def __init__(self, message: str, line: int, key: KeyPath = ()) -> None:
        super().__init__(message)
        self.message, self.line, self.key = message, line, key


class _Float(float):
    """A float that is written as it was read: ruamel's own changes the last of seventeen digits."""

    literal: str


class _Constructor(RoundTripConstructor):
    """Round-trip constructor whose every failure has a line."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except ValueError as error:
            problem = f"the value {str(node.value)[:30]!r} cannot be read"
            raise ConstructorError(None, None, problem, node.start_mark) from error

    def construct_literal_float(self, node: ScalarNode) -> _Float:
        number = _Float(self.construct_yaml_float(node))
        number.literal = node.value
        return number


class _Representer(RoundTripRepresenter):
    def represent_literal_float(self, number: _Float) -> ScalarNode:
        return self.represent_scalar("tag:yaml.org,2002:float", number.literal)


_Constructor.add_constructor("tag:yaml.org,2002:float", _Constructor.construct_literal_float)
_Constructor.add_constructor("tag:yaml.org,2002:timestamp", _Constructor.construct_yaml_str)  # YAML 1.2 has no dates
_Representer.add_representer(_Float, _Representer.represent_literal_float)


def _yaml() -> YAML:
    yaml = YAML()
    yaml.Constructor, yaml.Representer = _Constructor, _Representer
    yaml.preserve_quotes = True
    yaml.width = 4096  # lines are the user's, none is folded
    return yaml


def parse(text: str) -> Any:
    """The round-trip tree of one document.

    Raises:
        Fault: not YAML.
    """
    try:
        return _yaml().load(text)
    except Exception as error:
        raise _yaml_fault(error, text) from error


def dump(tree: CommentedMap) -> str:
    stream = io.StringIO()
    _yaml().dump(tree, stream)
    return stream.getvalue()


def _yaml_fault(error: Exception, text: str) -> Fault:
    """A failure of ruamel.yaml; odd input makes it raise more than its own errors."""
    line, reason = 1, f"{type(error).__name__}: {error}"
    if isinstance(error, MarkedYAMLError):
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        reason = str(error.problem or error.context)
    elif isinstance(error, ReaderError):
        line = text.count("\n", 0, error.position) + 1
        reason = f"the character U+{error.character:04X} is not allowed"
    elif isinstance(error, YAMLError):
        reason = str(error)
    return Fault(f"this is not YAML: {reason}", line)


@dataclass
class _Open:
    """A mapping or list whose end has not come yet: its path, and the key or item number that comes next."""

    path: KeyPath
    is_mapping: bool
    key: str | None = None
    items: int = 0


def scan(text: str) -> dict[KeyPath, tuple[int, int]]:
    """Line and column of every key and list item, without building anything.

    Raises:
        Fault: not YAML, or YAML that a config has no use for and that makes it hard to say where a value came from:
            anchors, tags, keys that are not scalars, duplicate keys, several documents, deep nesting.
    """
    positions: dict[KeyPath, tuple[int, int]] = {}
    stack: list[_Open] = []
    events = iter(_yaml().parse(text))
    while True:
        try:
            event = next(events, None)
        except Exception as error:
            raise _yaml_fault(error, text) from error
        if event is None:
            return positions
        line = event.start_mark.line + 1
        if isinstance(event, CollectionEndEvent):
            stack.pop()
        elif isinstance(event, DocumentStartEvent):
            _check_document(event, line, first=not positions)
        elif isinstance(event, NodeEvent):
            _check_node(event, line, stack)
            path, is_key = _place(event, line, stack)
            if is_key and path in positions:
                first = positions[path][0]
                raise Fault(f"this key is already given on line {first}; each key stands once", line, path)
            positions.setdefault(path, (line, event.start_mark.column + 1))
            if isinstance(event, CollectionStartEvent):
                stack.append(_Open(path, isinstance(event, MappingStartEvent)))


def _check_document(event: DocumentStartEvent, line: int, first: bool) -> None:
    if not first:
        raise Fault("a second document begins here; a config is one document", line)
    if event.version not in (None, (1, 2)):
        raise Fault("a config is YAML 1.2; remove the %YAML line", line=1)


def _check_node(event: NodeEvent, line: int, stack: list[_Open]) -> None:
    path = stack[-1].path if stack else ()
    if isinstance(event, AliasEvent) or event.anchor is not None:
        raise Fault("anchors (&) and aliases (*) are not used in a config; write the value out", line, path)
    if isinstance(event, ScalarEvent | CollectionStartEvent) and event.ctag is not None:
        raise Fault(f"tags ({event.ctag}) are not used in a config; write the value alone", line, path)
    if len(stack) > _DEEPEST:
        raise Fault("this is nested too deeply", line, path[:3])


def _place(event: NodeEvent, line: int, stack: list[_Open]) -> tuple[KeyPath, bool]:
    """Path of a node, and whether it is a key (True) or a value."""
    if not stack:
        return (), False
    above = stack[-1]
    if not above.is_mapping:
        above.items += 1
        return (*above.path, above.items - 1), False
    if above.key is not None:
        path = (*above.path, above.key)
        above.key = None
        return path, False
    if not isinstance(event, ScalarEvent):
        raise Fault("a key must be one word, not a list or a mapping", line, above.path)
    if event.value == "<<":
        raise Fault("merge keys (<<) are not used in a config; write the keys out", line, above.path)
    above.key = key = str(event.value)
    return (*above.path, key), True


def plain(node: Any, path: KeyPath = ()) -> Any:
    """A round-trip tree in Python's own types, which is what the models check in strict mode.

    Raises:
        Fault: a key that YAML reads as something else than text.
    """
    if isinstance(node, CommentedMap):
        for key in node:
            if not isinstance(key, str):
                line = node.lc.key(key)[0] + 1 if key in (node.lc.data or {}) else 1
                raise Fault("a key must be text; YAML reads one here as a number or the like", line, path)
        return {str(key): plain(value, (*path, str(key))) for key, value in node.items()}
    if isinstance(node, list):
        return [plain(item, (*path, i)) for i, item in enumerate(node)]
    for kind in (str, bool, int, float):
        if isinstance(node, kind):
            return kind(node)
    return node


def tree_of(node: Any, positions: dict[KeyPath, tuple[int, int]], path: KeyPath = ()) -> Any:
    """Describe what a dict says as a tree that can be written as YAML, and the number of each key in its order.

    Raises:
        Fault: a key that is not text, a value that YAML has no place for.
    """
    positions.setdefault(path, (len(positions), 1))
    if len(path) > _DEEPEST:
        raise Fault("this is nested too deeply", 1, path[:3])
    if isinstance(node, Mapping):
        tree = CommentedMap()
        for key, value in node.items():
            if not isinstance(key, str):
                raise Fault(f"a key must be text, not {key!r:.40}", 1, path)
            tree[key] = tree_of(value, positions, (*path, key))
        return tree
    if isinstance(node, np.ndarray | np.generic):
        node = node.tolist()
    if isinstance(node, list | tuple):
        return [tree_of(item, positions, (*path, i)) for i, item in enumerate(node)]
    if isinstance(node, Path):
        return str(node)
    if isinstance(node, str) and "\n" in node:
        return LiteralScalarString(node)  # lines stay lines
    if node is None or isinstance(node, str | bool | int | float):
        return node
    raise Fault(f"a config has mappings, lists, text and numbers, and no {type(node).__name__}", 1, path)
