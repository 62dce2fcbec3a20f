"""Files that are kept from run to run, in the folder `jaxnh` of JAX's cache, each under a hash of what decides it.

A file that is truncated, damaged or of another name is written anew. One that has not been read in sixty
days, as those of an earlier version, is removed when another is written. JAXNH_KEEP_PROGRAMS=0 switches all of it off.
"""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import suppress
from pathlib import Path

import jax

from jaxnh.exceptions import ResultError
from jaxnh.storage.atomic import replace_atomically

_UNUSED_SECONDS = 60 * 24 * 3600.0
_HEAD = 64 + 1  # of a file: the checksum of what follows


def folder() -> Path | None:
    """Return the folder of these files; None where nothing is kept."""
    root = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if not root or "://" in root or os.environ.get("JAXNH_KEEP_PROGRAMS") == "0":
        return None
    return Path(root) / "jaxnh" if jax.config.jax_enable_compilation_cache else None  # pyright: ignore[reportAttributeAccessIssue]


def find(name: str) -> bytes | None:
    """Return the content kept under a name; None where there is none, or nothing sound."""
    where = folder()
    try:
        content = (where / name).read_bytes() if where else b""
    except OSError:
        return None
    data = content[_HEAD:]
    if content[:_HEAD] != _head(name, data):
        return None
    with suppress(OSError):
        os.utime(where / name)  # pyright: ignore[reportOptionalOperand]
    return data


def keep(name: str, data: bytes) -> None:
    """Keep something for later runs, where that is possible."""
    where = folder()
    if where is None:
        return
    try:
        where.mkdir(parents=True, exist_ok=True)
        with replace_atomically(where / name) as file:
            file.write(_head(name, data) + data)
            file.settle()
    except (OSError, ResultError):
        return
    _forget(where)


def _forget(where: Path) -> None:
    """Remove files that no run has read in a long time."""
    with suppress(OSError), os.scandir(where) as files:
        for file in files:
            if time.time() - file.stat().st_mtime > _UNUSED_SECONDS:
                os.unlink(file)


def _head(name: str, data: bytes) -> bytes:
    return hashlib.sha256(name.encode() + data).hexdigest().encode() + b"\n"
