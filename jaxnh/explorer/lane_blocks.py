"""Blocks of lanes of a plane, each of which a pixel stands for: mean of a number, majority of a category."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

Rule = Literal["mean", "majority"]
"""Pixels that stand for many lanes: by the mean of those that have a number, or by the most frequent category."""

_FEW_CATEGORIES = 1 << 20  # between the least and the largest whole number, that are counted without sorting


class LaneBlocks(NamedTuple):
    """Blocks of lanes.

    Attributes:
        values: of each block: the mean, NaN where no lane has a number; or the most frequent category, of equally
            frequent ones the least.
        share: of its lanes that have a number, or that category.
    """

    values: Float[np.ndarray, "across up"]
    share: Float[np.ndarray, "across up"]


def lane_blocks(values: np.ndarray, rule: Rule, steps: Sequence[tuple[int, int]]) -> list[LaneBlocks]:
    """Return blocks of lanes, then blocks of these blocks, and so on, each from all of its lanes.

    Args:
        values: of the lanes, (across, up).
        rule: of a block.
        steps: numbers of blocks across and up that make one of the next; the last ones along an axis may be smaller.
    """
    lanes = list(_sums(np.ones(values.shape, np.float32), steps))
    if rule == "mean":
        finite = np.isfinite(values)
        totals = _sums(np.where(finite, values, 0.0).astype(float, copy=False), steps)
        counts = _sums(finite.astype(np.float32), steps)
        return [
            LaneBlocks(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0), count / every)
            for total, count, every in zip(totals, counts, lanes, strict=True)
        ]
    most = [np.zeros(every.shape, np.float32) for every in lanes]
    kinds = [np.zeros(every.shape, values.dtype) for every in lanes]
    for category in _categories(values):
        for k, count in enumerate(_sums((values == category).astype(np.float32), steps)):
            more = count > most[k]
            kinds[k][more], most[k][more] = category, count[more]
    return [LaneBlocks(kind, count / every) for kind, count, every in zip(kinds, most, lanes, strict=True)]


def merge_blocks(blocks: LaneBlocks, lanes: np.ndarray, rule: Rule, step: tuple[int, int]) -> LaneBlocks:
    """Return larger blocks of blocks.

    Of categories that is no count of lanes: a block of blocks has the category that most lanes have in the blocks
    where it is the most frequent, and their share of all lanes, which is the least that the share can be.

    Args:
        blocks: as they are.
        lanes: number of lanes of each of them, (across, up).
        rule: of a block.
        step: as of `lane_blocks`.
    """
    weights = blocks.share * lanes
    [every] = _sums(lanes.astype(np.float32), [step])
    if rule == "mean":
        known = np.where(weights > 0, blocks.values, 0.0) * weights
        ([total], [weight]) = (list(_sums(each, [step])) for each in (known, weights))
        values = np.divide(total, weight, out=np.full(total.shape, np.nan), where=weight > 0)
        return LaneBlocks(values, weight / every)
    most, kinds = np.zeros(every.shape, np.float32), np.zeros(every.shape, blocks.values.dtype)
    for category in _categories(blocks.values):
        [count] = _sums(np.where(blocks.values == category, weights, 0.0).astype(np.float32), [step])
        more = count > most
        kinds[more], most[more] = category, count[more]
    return LaneBlocks(kinds, most / every)


def _categories(values: np.ndarray) -> np.ndarray:
    """Different values, in rising order."""
    if values.dtype.kind in "iu" and values.size:
        low, high = int(values.min()), int(values.max())
        if high - low < _FEW_CATEGORIES:
            return (np.flatnonzero(np.bincount(values.ravel().astype(np.int64) - low)) + low).astype(values.dtype)
    return np.unique(values)


def _sums(values: np.ndarray, steps: Sequence[tuple[int, int]]) -> Iterator[np.ndarray]:
    """Yield sums of blocks, then of blocks of these, and so on."""
    for step in steps:
        for axis, size in enumerate(step):
            wide = [(0, -count % size if k == axis else 0) for k, count in enumerate(values.shape)]
            values = np.pad(values, wide) if wide[axis][1] else values
            parts = (values[k::size] if axis == 0 else values[:, k::size] for k in range(size))
            total = next(parts).copy()
            for part in parts:
                total += part
            values = total
        yield values
