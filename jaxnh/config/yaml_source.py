"""A config as text or as a dict: where every key of it is, overrides, and the one line that reports a fault.

What the keys mean (experiment.py) and how a wrong value is put in words (messages.py) is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap

from jaxnh.config.yaml_tree import Fault, KeyPath, dump, parse, plain, scan, tree_of
from jaxnh.exceptions import ConfigError

_NAMELESS = "experiment"  # in messages, where there is no file
_WITH_DEFAULTS = ("system", "initial", "sweep")  # blocks whose keys can be left out by KEY=null


@dataclass(frozen=True)
class ConfigSource:
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
    tree: CommentedMap

    @cached_property
    def text(self) -> str:
        """The YAML as run: the text given, or with overrides its tree written again, comments kept."""
        return dump(self.tree) if self.given is None else self.given

    def is_overridden(self, key: KeyPath) -> bool:
        """Return whether the value of a key came from an override."""
        return any(key[: len(root)] == root for root in self.overridden)

    def blame(self, keys: Sequence[KeyPath]) -> KeyPath:
        """Return the one to report of keys that do not go together: an overridden one, else one that the file has."""
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


def read(path: Path, overrides: Sequence[str] = ()) -> ConfigSource:
    """Read a config file and apply KEY=VALUE overrides to it.

    Raises:
        ConfigError: no such file, not UTF-8 YAML, not a mapping at the top level, an override that cannot be applied.
    """
    return from_text(_decode(path), path, overrides)


def from_text(text: str, path: Path | None = None, overrides: Sequence[str] = ()) -> ConfigSource:
    """The text of a config file as a source, with KEY=VALUE overrides applied to it.

    Args:
        path: the file that it stands for, which is not read; None: messages name none.

    Raises:
        ConfigError: not YAML, not a mapping at the top level, an override that cannot be applied.
    """
    try:
        positions, tree = scan(text), parse(text)
        if tree is None:
            raise Fault("the file is empty; system, sweep and analyses are needed", line=1)
        if not isinstance(tree, CommentedMap):
            raise Fault("the top level must be a mapping of keys to values", line=positions[()][0])
        plain(tree)  # here only for its faults, which have lines as long as no override has touched the tree
    except Fault as fault:
        raise _config_error(f"{path or _NAMELESS}:{fault.line}", fault.key, fault.message) from None
    roots = [_override(tree, override, "command line") for override in overrides]
    _drop_nulls(tree, roots, positions)
    return ConfigSource(path, plain(tree), positions, roots, True, None if overrides else text, tree)


def from_dict(content: Mapping[str, Any], overrides: Sequence[str] = ()) -> ConfigSource:
    """A dict that says what a config file would say as a source, with KEY=VALUE overrides applied to it.

    Raises:
        ConfigError: no mapping, something in it that YAML has no place for, an override that cannot be applied.
    """
    positions: dict[KeyPath, tuple[int, int]] = {}
    try:
        tree = tree_of(content, positions)
        if not isinstance(tree, CommentedMap):
            raise Fault("a config is a mapping of keys to values", line=1)
    except Fault as fault:
        raise _config_error(_NAMELESS, fault.key, fault.message) from None
    roots = [_override(tree, override, _NAMELESS) for override in overrides]
    _drop_nulls(tree, roots, positions)
    return ConfigSource(None, plain(tree), positions, roots, False, None, tree)


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
    if not literal.strip():
        raise _config_error(where, name, "an override is KEY=VALUE; this one has no value (null leaves a key out)")
    try:
        scan(literal)
        value = parse(literal)
        plain(value)
        return _assign(tree, steps, value)
    except Fault as fault:
        raise _config_error(where, name, fault.message) from None


def _drop_nulls(tree: CommentedMap, overridden: Sequence[KeyPath], positions: Mapping[KeyPath, object]) -> None:
    """Leave out the parameters, starts and axes that the text has and overrides say are null."""
    for path in overridden:
        if len(path) == 2 and path[0] in _WITH_DEFAULTS and path in positions:
            block, name = tree.get(path[0]), path[1]
            if isinstance(block, CommentedMap) and block.get(name, ...) is None:
                del block[name]


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
        Fault: the node is a single value, or a list without this item.
    """
    name = ".".join(map(str, path))
    if isinstance(node, CommentedMap):
        return step
    if not isinstance(node, list):
        raise Fault(f"{name} is a single value; it has no keys", line=1)
    if step not in map(str, range(len(node))):
        have = f"its items are 0 to {len(node) - 1}" if node else "it is empty"
        raise Fault(f"{name} is a list; it has no item {step!r}, {have}", line=1)
    return int(step)
