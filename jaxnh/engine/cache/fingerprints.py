"""Fingerprints of calls of programs, the same in every process: a stopped run's results are known by them."""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

_READ = 256  # arrays whose digests are known, at most


class CallFingerprints:
    """Fingerprints of calls. Arrays that many calls share are read once and must not be written to."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, bytes]] = {}  # by the address of an array

    def of(self, function: Callable[..., Any], shared: tuple[Any, ...], *arguments: Any) -> str:
        """A hash of the function and all arguments, numbers bit for bit."""
        leaves, structure = jax.tree.flatten(arguments)
        common, of_shared = jax.tree.flatten(shared)
        digest = hashlib.sha256(_words(function, of_shared, structure))
        for leaf in common:
            for part in self._digest(leaf):
                digest.update(part)
        for leaf in leaves:
            for part in _content(leaf):
                digest.update(part)
        return digest.hexdigest()

    def _digest(self, leaf: Any) -> Sequence[Any]:
        """The digest of an array's content, or what else is no array."""
        if not isinstance(leaf, np.ndarray):
            return _content(leaf)
        if id(leaf) not in self._known:
            if len(self._known) >= _READ:
                self._known.clear()
            digest = hashlib.sha256()
            for part in _content(leaf):
                digest.update(part)
            self._known[id(leaf)] = leaf, digest.digest()
        return (self._known[id(leaf)][1],)


@functools.lru_cache(_READ)
def _words(function: Callable[..., Any], *structures: Any) -> bytes:
    return _without_addresses(" ".join([_qualified_name(function), *map(str, structures)]))


def _content(leaf: Any) -> Sequence[Any]:
    """A number or array with its kind and shape, a function by its name: bytes in parts, an array where it stands."""
    if callable(leaf):
        return (_without_addresses(_qualified_name(leaf)),)
    data = np.asarray(leaf)
    if data.dtype.kind == "U":
        return (str(data).encode(),)
    return f"{data.dtype} {data.shape}".encode(), np.ascontiguousarray(data).reshape(-1).view(np.uint8)


def _qualified_name(function: Any) -> str:
    return f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', function)}"


def _without_addresses(words: str) -> bytes:
    """Words without the addresses of functions, which differ from process to process."""
    return re.sub(r" at 0x[0-9a-f]+", "", words).encode()
