"""Distances between section points, the unit of rounding, and growth by Gram–Schmidt in long double."""

from __future__ import annotations

import numpy as np

from tests.helpers import taylor

UNIT = np.finfo(float).eps / 2  # roundoff of one operation


def apart(one, other):
    """Largest difference of section coordinates (..., 3), angles modulo whole turns: shape (...,)."""
    gap = np.asarray(one, taylor.REAL) - np.asarray(other, taylor.REAL)
    gap[..., 2] -= taylor.turns(gap[..., 2])
    return np.abs(gap).max(axis=-1).astype(float)


def turned(blocks, basis):
    """One turn of a basis (3, 3) through blocks (n, 3, 3), by Gram–Schmidt in long double, and ln of its growth (3,)."""
    logs = np.zeros(3, np.longdouble)
    for block in blocks:
        vectors = (block @ basis).T
        for k in range(3):
            for j in range(k):
                vectors[k] -= (vectors[k] @ vectors[j]) * vectors[j]
            length = np.sqrt(vectors[k] @ vectors[k])
            vectors[k] /= length
            logs[k] += np.log(length)
        basis = vectors.T
    return basis, logs
