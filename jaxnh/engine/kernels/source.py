"""The text of a kernel that runs a traced function of one lane, a thread a lane."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxnh.engine.kernels import arithmetic, arrays, control
from jaxnh.engine.kernels.emitter import Emitter, filled
from jaxnh.engine.kernels.values import Memory, UnsupportedError, Value, in_registers, kind_of, size_of, text_of

NAME = "lanes"
"""The kernel's name; its arguments are pointers to the number of lanes, to what they share and have, and to results."""

THREADS = 128
"""Threads of a block."""

_MOST_BYTES = 1 << 15  # of arrays of a lane's own, which a card keeps for all lanes that it may hold: 9 GB


class Kernel(NamedTuple):
    """A kernel's text and its results.

    Attributes:
        text: C++ that is CUDA as well.
        results: shapes and types of one lane's results.
        structure: pytree that they are the leaves of.
    """

    text: str
    results: tuple[jax.ShapeDtypeStruct, ...]
    structure: Any


def write_kernel(function: Callable[..., Any], shared: Any, lane: Any) -> Kernel:
    """Write the kernel of function(shared, lane), for any number of lanes.

    Args:
        function: pure function of what all lanes share and of one lane.
        shared: pytree of shapes and types.
        lane: pytree of shapes and types of a lane.

    Raises:
        UnsupportedError: the function has an operation that kernels do not know.
    """
    closed, out = jax.make_jaxpr(function, return_shape=True)(shared, lane)
    emitter = Emitter(_rules())
    inputs, declared = [], list[str]()
    for number, leaf in enumerate(jax.tree.leaves(shared)):
        inputs.append(_argument(emitter, f"p{number}", tuple(leaf.shape), leaf.dtype, declared))
    for number, leaf in enumerate(jax.tree.leaves(lane)):
        name, size = f"q{number}", size_of(tuple(leaf.shape))
        inputs.append(_argument(emitter, name, tuple(leaf.shape), leaf.dtype, declared, f"lane * {size}LL"))
    values = emitter.evaluate(closed.jaxpr, closed.consts, inputs)
    results = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(out))
    for number, (value, result) in enumerate(zip(values, results, strict=True)):
        _write_result(emitter, f"r{number}", value, tuple(result.shape))
        declared.append(f"{kind_of(result.dtype)}* __restrict__ r{number}")
    if emitter.own_bytes > _MOST_BYTES:
        raise UnsupportedError(f"{emitter.own_bytes} bytes of memory a lane")
    names = [text.rsplit(" ", 1)[1] for text in declared]
    text = "\n".join(
        [
            f"#define THREADS {THREADS}",
            _prelude(),
            *(f"TABLE {body.replace('NAME', name)};" for body, name in emitter.tables.items()),
            f"ONE_LANE void one(const long long lane, {', '.join(declared)}) {{",
            *emitter.lines,
            "}",
            f"LANES {NAME}(const long long* __restrict__ count, {', '.join(declared)}) {{",
            f"EACH_LANE(*count) one(lane, {', '.join(names)});",
            "}",
            "",
        ]
    )
    return Kernel(text, results, jax.tree.structure(out))


def _argument(
    emitter: Emitter, name: str, shape: tuple[int, ...], dtype: Any, declared: list[str], place: str = "0"
) -> Value:
    kind = kind_of(dtype)
    declared.append(f"const {kind}* __restrict__ {name}")
    if not in_registers(shape) or (place == "0" and shape):  # of what lanes share an entry may be looked up
        return Memory(f"({name} + {place})", shape, kind)
    return filled(shape, kind, [emitter.let(kind, f"{name}[{place} + {k}]") for k in range(size_of(shape))])


def _write_result(emitter: Emitter, name: str, value: Value, shape: tuple[int, ...]) -> None:
    size = size_of(shape)
    if isinstance(value, Memory):
        if not emitter.placed(value, f"({name} + lane * {size}LL)"):
            with emitter.each(size) as i:
                emitter.line(f"{name}[lane * {size}LL + {i}] = {value.name}[{i}];")
        return
    for k, element in enumerate(value.flat):
        emitter.line(f"{name}[lane * {size}LL + {k}] = {text_of(element, value.kind)};")


@cache
def _rules() -> Any:
    return arithmetic.rules() | arrays.rules() | control.rules()


@cache
def _prelude() -> str:
    return resources.files("jaxnh.engine.kernels").joinpath("prelude.h").read_text(encoding="utf-8")


def shapes_of(tree: Any) -> Any:
    """Return shapes and types of a pytree's leaves."""
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), getattr(leaf, "dtype", None) or np.result_type(leaf)), tree
    )
