"""Rows of NumPy arrays and of pytrees of them, as those of lanes or of orbits, along the first axis of all leaves."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Int

_Tree = TypeVar("_Tree")


def select(tree: _Tree, rows: Any) -> _Tree:
    """Return rows of all leaves: what an index of NumPy takes, as a slice, numbers, a mask or one number."""
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def write_rows(tree: Any, rows: Any, others: Any) -> None:
    """Write others into the place of rows of all leaves."""
    for leaf, other in zip(jax.tree.leaves(tree), jax.tree.leaves(others), strict=True):
        leaf[rows] = other


def concatenate(trees: Iterable[_Tree], axis: int = 0) -> _Tree:
    """Return the rows of trees, one after the other, or what is along another axis."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=axis), *trees)


def spread_indices(count: int, most: int) -> Int[np.ndarray, " some"]:
    """Return at most `most` numbers below a count, evenly spaced, with both ends."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
