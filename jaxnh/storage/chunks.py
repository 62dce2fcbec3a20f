"""Shapes of the blocks that large variables lie in, HDF5's chunks. No files."""

from __future__ import annotations

import math

_CHUNK = 1 << 20  # bytes a block


def row_chunks(shape: tuple[int, ...], itemsize: int, rows: int = 0) -> tuple[int, ...]:
    """Blocks of about so many whole rows, a power of two, or of about a megabyte."""
    rows = rows or max(1, _CHUNK * shape[0] // (math.prod(shape) * itemsize))
    rows = min(shape[0], 1 << (rows.bit_length() - 1))
    return (rows, *shape[1:])


def slab_chunks(slab: tuple[int, ...], shape: tuple[int, ...], itemsize: int, most: int) -> tuple[int, ...]:
    """Blocks for a variable that is written in slabs of one shape side by side: a slab, or even parts of one.

    They have about a megabyte, and those that lie along the first dimensions together fit in `most` bytes where that
    can be, so that `blocks` reads them once each.
    """
    chunks = list(slab)
    for k in range(len(chunks)):
        while chunks[k] > 1 and math.prod(chunks) * itemsize > _CHUNK:
            chunks[k] = -(-chunks[k] // 2)
    k = next((k for k, size in enumerate(chunks) if size > 1), len(chunks) - 1)
    while chunks[k] > 1 and chunks[k] * math.prod(shape[k + 1 :]) * itemsize > most:
        chunks[k] = -(-chunks[k] // 2)
    return tuple(chunks)
