"""Distances between section points, and the unit of rounding."""

from __future__ import annotations

import numpy as np

from tests.helpers import taylor

UNIT = np.finfo(float).eps / 2  # roundoff of one operation


def largest_difference(one, other):
    """Largest difference of section coordinates (..., 3), angles modulo whole turns: shape (...,)."""
    gap = np.asarray(one, taylor.REAL) - np.asarray(other, taylor.REAL)
    gap[..., 2] -= taylor.turns(gap[..., 2])
    return np.abs(gap).max(axis=-1).astype(float)
