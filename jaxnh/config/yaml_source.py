"""A config as text or as a dict: where every key of it is, overrides, and the one line that reports a fault.

What the keys mean (experiment.py) and how a wrong value is put in words (messages.py) is not known here.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
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

from jaxnh.exceptions import ConfigError

KeyPath = tuple[str | int, ...]
"""Keys, and numbers of list items, from the top level down; () is the whole file."""

_DEEPEST = 16
_NAMELESS = "experiment"  # in messages, where there is no file


class _Fault(Exception):
    """What is wrong with a piece of YAML, before it is known whose it is; lines count from 1."""

    def __init__(self, message: str, line: int, key: KeyPath = ()) -> None:
        super().__init__(message)
        self.message, self.line, self.key = message, line, key


@dataclass(frozen=True)
class Source:
    """A config as read, with the overrides applied.

    Attributes:
        path: the file, as the user named it; None where there is none.
        data: the content in plain dicts, lists, strings, numbers, booleans and None.
        positions: (line, column) of each key and list item, both from 1; in a dict the number of each key in its order.
        overridden: what overrides gave, in their order; created mappings by their outermost key.
        numbered: whether positions are of lines of a text.
        given: the text, where no override has changed what it says.
        tree: the content as it is written as YAML where they have.
    """

    path: Path | None
    data: dict[str, Any]
    positions: Mapping[KeyPath, tuple[int, int]]
    overridden: Sequence[KeyPath]
    numbered: bool
    given: str | None
    tree: dict[str, Any]

    @cached_property
    def text(self) -> str:
        """The YAML as run: the text given, or with overrides its tree written again, comments kept."""
        return _dump(self.tree) if self.given is None else self.given

    def is_overridden(self, key: KeyPath) -> bool:
        """Whether the value of a key came from an override."""
        return any(key[: len(root)] == root for root in self.overridden)

    def blame(self, keys: Sequence[KeyPath]) -> KeyPath:
        """Of keys that do not go together, the one to report: an overridden one, else one that the file has."""
        for wanted in (self.is_overridden, self.positions.__contains__):
            for key in keys:
                if wanted(key):
                    return key
        return keys[0]

    def position(self, key: KeyPath) -> tuple[int, int]:
        """Line and column of a key, or of the nearest key above it that the file has."""
        while key not in self.positions:
            key = key[:-1]
        return self.positions[key]

    def order(self, key: KeyPath) -> tuple[bool, tuple[int, int]]:
        """Sort key of faults: in the order of the file, then those of the command line."""
        return self.is_overridden(key), self.position(key)

    def error(self, key: KeyPath, message: str) -> ConfigError:
        """The line that reports a fault at a key."""
        if not self.numbered:
            return _config_error(_NAMELESS, key, message)
        line = f"{self.path or _NAMELESS}:{self.position(key)[0]}"
        return _config_error("command line" if self.is_overridden(key) else line, key, message)


def read(path: Path, overrides: Sequence[str] = ()) -> Source:
    """Read a config file and apply KEY=VALUE overrides to it.

    Raises:
        ConfigError: no such file, not UTF-8 YAML, not a mapping at the top level, an override that cannot be applied.
    """
    return _of_text(_decode(path), path, overrides)


def from_text(text: str) -> Source:
    """The text of a config file as a source, without a file.

    Raises:
        ConfigError: not YAML, not a mapping at the top level.
    """
    return _of_text(text, None, ())


def from_dict(content: Mapping[str, Any], overrides: Sequence[str] = ()) -> Source:
    """A dict that says what a config file would say as a source, with KEY=VALUE overrides applied to it.

    Raises:
        ConfigError: no mapping, something in it that YAML has no place for, an override that cannot be applied.
    """
    positions: dict[KeyPath, tuple[int, int]] = {}
    try:
        tree = _of_python(content, positions)
        if not isinstance(tree, CommentedMap):
            raise _Fault("a config is a mapping of keys to values", line=1)
    except _Fault as fault:
        raise _config_error(_NAMELESS, fault.key, fault.message) from None
    roots = [_override(tree, override, _NAMELESS) for override in overrides]
    return Source(None, _plain(tree), positions, roots, False, None, tree)


def _of_text(text: str, path: Path | None, overrides: Sequence[str]) -> Source:
    try:
        positions, tree = _scan(text), _parse(text)
        if tree is None:
            raise _Fault("the file is empty; system, sweep and analyses are needed", line=1)
        if not isinstance(tree, CommentedMap):
            raise _Fault("the top level must be a mapping of keys to values", line=positions[()][0])
        _plain(tree)  # here only for its faults, which have lines as long as no override has touched the tree
    except _Fault as fault:
        raise _config_error(f"{path or _NAMELESS}:{fault.line}", fault.key, fault.message) from None
    roots = [_override(tree, override, "command line") for override in overrides]
    return Source(path, _plain(tree), positions, roots, True, None if overrides else text, tree)


def _config_error(where: str, key: KeyPath | str, message: str) -> ConfigError:
    """One line, whatever line breaks and control characters the pieces have."""
    name = key if isinstance(key, str) else ".".join(map(str, key))
    name = name if name.isprintable() else ascii(name)
    return ConfigError(": ".join((where, *([name] if name else []), " ".join(message.split()))))


def _decode(path: Path) -> str:
    """Text of a file, a byte order mark removed."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: this is a directory, not a config file") from None
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise ConfigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}:{line}: this is not UTF-8 text; a config is a YAML file") from None


# ---- YAML


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


def _parse(text: str) -> Any:
    """The round-trip tree of one document.

    Raises:
        _Fault: not YAML.
    """
    try:
        return _yaml().load(text)
    except Exception as error:
        raise _yaml_fault(error, text) from error


def _dump(tree: CommentedMap) -> str:
    stream = io.StringIO()
    _yaml().dump(tree, stream)
    return stream.getvalue()


def _yaml_fault(error: Exception, text: str) -> _Fault:
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
    return _Fault(f"this is not YAML: {reason}", line)


@dataclass
class _Open:
    """A mapping or list whose end has not come yet: its path, and the key or item number that comes next."""

    path: KeyPath
    is_mapping: bool
    key: str | None = None
    items: int = 0


def _scan(text: str) -> dict[KeyPath, tuple[int, int]]:
    """Line and column of every key and list item, without building anything.

    Raises:
        _Fault: not YAML, or YAML that a config has no use for and that makes it hard to say where a value came from:
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
                raise _Fault(f"this key is already given on line {first}; each key stands once", line, path)
            positions.setdefault(path, (line, event.start_mark.column + 1))
            if isinstance(event, CollectionStartEvent):
                stack.append(_Open(path, isinstance(event, MappingStartEvent)))


def _check_document(event: DocumentStartEvent, line: int, first: bool) -> None:
    if not first:
        raise _Fault("a second document begins here; a config is one document", line)
    if event.version not in (None, (1, 2)):
        raise _Fault("a config is YAML 1.2; remove the %YAML line", line=1)


def _check_node(event: NodeEvent, line: int, stack: list[_Open]) -> None:
    path = stack[-1].path if stack else ()
    if isinstance(event, AliasEvent) or event.anchor is not None:
        raise _Fault("anchors (&) and aliases (*) are not used in a config; write the value out", line, path)
    if isinstance(event, ScalarEvent | CollectionStartEvent) and event.ctag is not None:
        raise _Fault(f"tags ({event.ctag}) are not used in a config; write the value alone", line, path)
    if len(stack) > _DEEPEST:
        raise _Fault("this is nested too deeply", line, path[:3])


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
        raise _Fault("a key must be one word, not a list or a mapping", line, above.path)
    if event.value == "<<":
        raise _Fault("merge keys (<<) are not used in a config; write the keys out", line, above.path)
    above.key = key = str(event.value)
    return (*above.path, key), True


def _plain(node: Any, path: KeyPath = ()) -> Any:
    """A round-trip tree in Python's own types, which is what the models check in strict mode.

    Raises:
        _Fault: a key that YAML reads as something else than text.
    """
    if isinstance(node, CommentedMap):
        for key in node:
            if not isinstance(key, str):
                line = node.lc.key(key)[0] + 1 if key in (node.lc.data or {}) else 1
                raise _Fault("a key must be text; YAML reads one here as a number or the like", line, path)
        return {str(key): _plain(value, (*path, str(key))) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(item, (*path, i)) for i, item in enumerate(node)]
    for plain in (str, bool, int, float):
        if isinstance(node, plain):
            return plain(node)
    return node


def _of_python(node: Any, positions: dict[KeyPath, tuple[int, int]], path: KeyPath = ()) -> Any:
    """What a dict says as a tree that can be written as YAML, and the number of each key in its order.

    Raises:
        _Fault: a key that is not text, a value that YAML has no place for.
    """
    positions.setdefault(path, (len(positions), 1))
    if len(path) > _DEEPEST:
        raise _Fault("this is nested too deeply", 1, path[:3])
    if isinstance(node, Mapping):
        tree = CommentedMap()
        for key, value in node.items():
            if not isinstance(key, str):
                raise _Fault(f"a key must be text, not {key!r:.40}", 1, path)
            tree[key] = _of_python(value, positions, (*path, key))
        return tree
    if isinstance(node, np.ndarray | np.generic):
        node = node.tolist()
    if isinstance(node, list | tuple):
        return [_of_python(item, positions, (*path, i)) for i, item in enumerate(node)]
    if isinstance(node, Path):
        return str(node)
    if node is None or isinstance(node, str | bool | int | float):
        return node
    raise _Fault(f"a config has mappings, lists, text and numbers, and no {type(node).__name__}", 1, path)


# ---- overrides


def _override(tree: CommentedMap, override: str, where: str) -> KeyPath:
    """Apply KEY=VALUE to the tree, and return the path of what is new: the key's own, or of the mapping made for it.

    `where` is what messages begin with.

    Raises:
        ConfigError: no KEY or no =, a VALUE that is not YAML, or a KEY that leads into something without keys.
    """
    name, equals, literal = override.partition("=")
    name = name.strip()
    if not equals:
        raise _config_error(where, name, "an override is KEY=VALUE; this one has no =")
    steps = name.split(".")
    if not all(steps):
        raise _config_error(where, override, "an override is KEY=VALUE, KEY as in system.d; this key is empty")
    try:
        _scan(literal)
        value = _parse(literal)
        _plain(value)
        return _assign(tree, steps, value)
    except _Fault as fault:
        raise _config_error(where, name, fault.message) from None


def _assign(tree: CommentedMap, steps: Sequence[str], value: Any) -> KeyPath:
    """Set the value at a path of keys and item numbers; mappings that are missing, or null, are made."""
    node: Any = tree
    path: KeyPath = ()
    root: KeyPath | None = None
    for depth, step in enumerate(steps, start=1):
        key = _key(node, step, path)
        path = (*path, key)
        if depth == len(steps):
            node[key] = value
        elif isinstance(key, str) and node.get(key) is None:
            root = root or (path if key not in node else (*path, steps[depth]))
            node[key] = CommentedMap()
        node = node[key]
    return root or path


def _key(node: Any, step: str, path: KeyPath) -> str | int:
    """One step of an override's path, as the node at `path` has it.

    Raises:
        _Fault: the node is a single value, or a list without this item.
    """
    name = ".".join(map(str, path))
    if isinstance(node, CommentedMap):
        return step
    if not isinstance(node, list):
        raise _Fault(f"{name} is a single value; it has no keys", line=1)
    if step not in map(str, range(len(node))):
        have = f"its items are 0 to {len(node) - 1}" if node else "it is empty"
        raise _Fault(f"{name} is a list; it has no item {step!r}, {have}", line=1)
    return int(step)
