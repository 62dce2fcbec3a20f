"""Compiled programs kept from run to run under a hash of their ingredients: a later run traces nothing.

The hash is of all that decides a program: the source of the package, versions of libraries, XLA's options,
the processor, devices, the function with everything that it closes over, static arguments, and the shapes of all
others. What cannot be named for certain, as a function of another package, is not kept. JAX's own cache begins where a
program has been traced and lowered, which is most of the time to a result (Newton's: 5 s of 8 s without a cache, and
0.2 s from here); programs kept here are not kept there as well.

Their files (`cache.store`) are code that runs, and deserve as much trust as JAX's cache.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import jax
import numpy as np
from jax import lax
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache

from jaxnh.engine.cache import store
from jaxnh.engine.xla_options import host, machine
from jaxnh.systems.corners import PiecewiseField
from jaxnh.systems.user_file import UserFile

_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "numpy")
_SOURCES = (".py", ".h")
# Settings of JAX that change what is traced or how it is compiled, beside XLA's options.
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_debug_nans",
    "jax_disable_jit",
    "jax_exec_time_optimization_effort",
)
_UNOPTIMISED = "jax_disable_most_optimizations"  # one more of them, which is no attribute of `jax.config`
_LAPACK = b"lapack_"  # names of functions of LAPACK in a program begin with it
_ACCOUNTED = ("jaxnh", *_LIBRARIES, "builtins", "math", "collections")  # modules whose text the versions say


class _NoNameError(Exception):
    """A program has a part that cannot be named."""


# ---- names


def name_of(
    function: Callable[..., Any], static: tuple[Any, ...], arguments: Any, devices: Sequence[Any]
) -> str | None:
    """The name of a compiled program, the same in every process; None where it is not to be kept.

    Args:
        function: of one lane.
        static: arguments that are part of the program.
        arguments: pytree of all others, arrays, whose shapes and types count alone.
        devices: those that it runs on.
    """
    if store.folder() is None:
        return None
    try:
        words = [environment(), of_devices(devices), *_constant(function), *_constant(static), *_shapes(arguments)]
    except _NoNameError:
        return None
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def environment() -> str:
    """All that decides the numbers: versions, the text of this package, settings of JAX."""
    settings = {name: str(getattr(jax.config, name, None)) for name in _SETTINGS}
    settings[_UNOPTIMISED] = str(jax.config.read(_UNOPTIMISED))
    return json.dumps([_versions(), settings, os.environ.get("EQX_ON_ERROR")])


@cache
def _versions() -> list[str]:
    """Versions of Python and libraries, and a hash of the text of this package."""
    libraries = [f"{name} {version(name)}" for name in _LIBRARIES]
    return [sys.version, *libraries, hash_of_sources(Path(__file__).parents[2])]


def hash_of_sources(folder: Path) -> str:
    """Hash of the sources in a folder; bytecode, which comes and goes, is none."""
    text = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.suffix in _SOURCES):
        content = path.read_bytes()
        text.update(f"{path.name} {len(content)} ".encode() + content)
    return text.hexdigest()


def of_devices(devices: Sequence[Any]) -> str:
    """Devices, processor, and XLA's options."""
    first = devices[0]
    kinds = [(device.platform, device.device_kind, device.id) for device in devices]
    return json.dumps([kinds, first.client.platform_version, machine(first), host()], sort_keys=True)


def of_user_file(file: UserFile) -> str | None:
    """A user's file, with what it comes to; None where that is not certain."""
    return f"user's file {file.sha256} {file.traced}" if file.traced is not None else None


def _shapes(value: Any) -> Iterator[str]:
    """A pytree of arguments: its structure, what is fixed in it, and the shapes and types of its arrays."""
    if value is None or isinstance(value, bool | int | float | complex):
        yield type(value).__name__
    elif isinstance(value, np.ndarray | np.generic | jax.Array | jax.ShapeDtypeStruct):
        yield f"array {value.dtype} {value.shape} {getattr(value, 'weak_type', False)}"
    elif isinstance(value, tuple | list):
        yield f"{_class(type(value))} {len(value)}"
        for item in value:
            yield from _shapes(item)
    elif isinstance(value, dict):
        yield f"dict {sorted(value)}"
        for key in sorted(value):
            yield from _shapes(value[key])
    elif is_dataclass(value) and not isinstance(value, type):
        yield _class(type(value))
        for field in fields(value):
            yield field.name
            yield from (_constant if field.metadata.get("static") else _shapes)(getattr(value, field.name))
    else:
        raise _NoNameError(value)


def _constant(value: Any) -> Iterator[str]:
    """A value that is part of a program, to the last bit and with all that it closes over."""
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, np.ndarray | np.generic):
        yield f"{_class(type(value))} {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
        if value.dtype.hasobject:
            raise _NoNameError(value)
    elif isinstance(value, tuple | list):
        yield f"{_class(type(value))} {len(value)}"
        for item in value:
            yield from _constant(item)
    elif isinstance(value, Mapping | frozenset):
        items = list(value.items() if isinstance(value, Mapping) else value)
        yield f"{_class(type(value))} {len(items)}"
        yield from sorted("\t".join(_constant(item)) for item in items)
    elif isinstance(value, UserFile):
        if (said := of_user_file(value)) is None:
            raise _NoNameError(value)
        yield said
    elif isinstance(value, PiecewiseField):  # made of the definition that stands beside it
        yield f"{_class(PiecewiseField)} {value.surfaces!r} {value.attracts.tolist()}"
    elif isinstance(value, MethodType):
        yield from (value.__func__.__qualname__, *_constant(value.__self__))
    elif isinstance(value, partial):
        yield "partial"
        yield from _constant((value.func, value.args, value.keywords))
    elif isinstance(value, FunctionType):
        yield f"{_name_in_package(value)} {list(value.__code__.co_positions())}"
        yield from _constant((value.__defaults__, value.__kwdefaults__))
        for cell in value.__closure__ or ():
            yield from _constant(cell.cell_contents)
    elif isinstance(value, type):
        yield _class(value)
    elif is_dataclass(value):
        yield _class(type(value))
        for field in fields(value):
            yield field.name
            yield from _constant(getattr(value, field.name))
    else:
        raise _NoNameError(value)


def _class(kind: type) -> str:
    name = _name_in_package(kind)
    if "<locals>" in name:
        raise _NoNameError(kind)
    return name


def _name_in_package(thing: Any) -> str:
    """Name of a function or class of a package whose text is accounted for."""
    if thing.__module__.split(".")[0] not in _ACCOUNTED:
        raise _NoNameError(thing)
    return f"{thing.__module__}.{thing.__qualname__}"


# ---- programs


def find(name: str, inputs: Any, devices: Sequence[Any]) -> Any:
    """The compiled program of that name, ready to be called, or None.

    Args:
        inputs: structure of its arguments, ((…), {}).
        devices: those that it runs on.
    """
    data = store.find(name)
    if data is None:
        return None
    try:
        payload, outputs = pickle.load(io.BytesIO(data))
        if _LAPACK in payload:
            _find_lapack()
        return serialize_executable.deserialize_and_load(payload, inputs, outputs, execution_devices=devices)
    except Exception:  # whatever another library says of a file that it cannot load: it is written anew
        return None


def keep(name: str, program: Any) -> None:
    """Keep a program that `compiling` has made for later runs, where that is possible."""
    if store.folder() is None:
        return
    try:
        payload, _, outputs = serialize_executable.serialize(program)
        data = pickle.dumps((payload, outputs))
    except Exception:  # programs that call back, or constants: JAX names no set of errors for what it cannot write
        return
    store.keep(name, data)


@cache
def _find_lapack() -> None:
    """Let jaxlib look up the functions of LAPACK, as where one is lowered: a kept program calls them at once."""
    jax.jit(lax.linalg.lu).lower(jax.ShapeDtypeStruct((1, 1), np.float64))


@contextmanager
def compiling() -> Iterator[None]:
    """Compile inside without JAX's own cache: what comes from there cannot be written a second time (jaxlib 0.10)."""
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
        compilation_cache.reset_cache()
