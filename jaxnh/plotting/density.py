"""Strobe points as a density: the share of a column's points in every cell, where they are too many to draw."""

from __future__ import annotations

import math

import numpy as np

_COLUMNS, _ROWS = 1200, 500  # a little below the pixels that a diagram gets


def density(b: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Histogram over b and a variable, each column for the same number of neighbouring values of b.

    Args:
        b: (lanes,), in any order.
        values: (lanes, points); what is not finite is left out.

    Returns:
        Edges (columns + 1,) and (rows + 1,), and the share (columns, rows) of a column's points in each cell.
    """
    distinct, place = np.unique(b, return_inverse=True)
    each = math.ceil(len(distinct) / _COLUMNS)
    edges = cell_edges(distinct)
    across = np.append(edges[:-1:each], edges[-1])
    finite = np.isfinite(values)
    low, high = (values[finite].min(), values[finite].max()) if finite.any() else (0.0, 1.0)
    margin = 0.02 * (high - low) or 0.5
    up = np.linspace(low - margin, high + margin, _ROWS + 1)
    row = np.searchsorted(up, values[finite], side="right") - 1
    column = np.broadcast_to((place // each)[:, None], values.shape)[finite]
    columns = len(across) - 1
    counts = np.bincount(column * _ROWS + row, minlength=columns * _ROWS).reshape(columns, _ROWS)
    return across, up, counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)


def cell_edges(centres: np.ndarray) -> np.ndarray:
    """Edges (n + 1,) halfway between rising centres (n,), and as far beyond the first and the last."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    inner = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - inner[0]], inner, [2 * centres[-1] - inner[-1]]])
