"""Values of a kernel: arrays of C expressions, or arrays in memory."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

IN_REGISTERS = 64
"""Elements of an array that are variables of their own; of a larger one they stand in memory."""

_KINDS = {
    "float64": "double",
    "float32": "float",
    "int64": "long long",
    "int32": "int",
    "int16": "short",
    "int8": "signed char",
    "uint64": "unsigned long long",
    "uint32": "unsigned int",
    "uint8": "unsigned char",
    "bool": "bool",
}


class UnsupportedError(Exception):
    """A kernel cannot be written: the function has what the generator does not know."""


class Scalars(NamedTuple):
    """An array whose elements are numbers, or C expressions without side effects.

    Attributes:
        elements: array of objects.
        kind: type in C.
    """

    elements: np.ndarray
    kind: str

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape."""
        return self.elements.shape

    @property
    def flat(self) -> list[Any]:
        """Elements, row by row."""
        return list(self.elements.ravel())


class Memory(NamedTuple):
    """An array in memory, row by row.

    Attributes:
        name: pointer in C.
        shape: its shape.
        kind: type in C.
        free: whether nothing else sees it, so that a new value may take its place.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    free: bool = False


Value = Scalars | Memory


def kind_of(dtype: Any) -> str:
    """Return the type in C.

    Raises:
        UnsupportedError: there is none.
    """
    try:
        return _KINDS[np.dtype(dtype).name]
    except (KeyError, TypeError):
        raise UnsupportedError(f"numbers of type {dtype}") from None


def constant(number: Any) -> Scalars:
    """Return an array of known numbers."""
    array = np.asarray(number)
    elements = np.empty(array.shape, object)
    elements[...] = array
    return Scalars(elements, kind_of(array.dtype))


def is_known(element: Any) -> bool:
    """Return whether an element is a number."""
    return not isinstance(element, str)


def text_of(element: Any, kind: str) -> str:
    """Return an element as C."""
    if isinstance(element, str):
        return element
    if kind == "bool":
        return "true" if element else "false"
    if kind in ("double", "float"):
        return _float(float(element), "f" if kind == "float" else "")
    suffix = {"long long": "LL", "unsigned int": "u", "unsigned long long": "ULL"}.get(kind, "")
    if int(element) == -(1 << 63):
        return "(-9223372036854775807LL - 1LL)"
    return f"({int(element)}{suffix})" if int(element) < 0 else f"{int(element)}{suffix}"


def _float(number: float, suffix: str) -> str:
    if math.isnan(number):
        return "NOT_A_NUMBER"
    if math.isinf(number):
        return "INFINITE" if number > 0 else "(-INFINITE)"
    text = f"{float(np.float32(number))!r}f" if suffix else repr(number)
    return f"({text})" if text.startswith("-") else text


def size_of(shape: tuple[int, ...]) -> int:
    """Return the number of elements."""
    return math.prod(shape)


def in_registers(shape: tuple[int, ...]) -> bool:
    """Return whether an array's elements are variables of their own."""
    return size_of(shape) <= IN_REGISTERS
