"""Error bars of averages along one lane: from block means, and from smooth windows where the motion is regular.

A bar is to cover the average of an endless run in 95 of 100 lanes (measured: `tests/hard/test_exponent_bars.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.exponents.tangent_growth import TangentState
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import half_window_weights, window_weights

_FEWEST = 4  # means of a batch that an error is taken from
_ROUNDING = 1e-10  # of a smooth average a period
_UNSEEN = 3.0  # events that were never seen: their mean number over as long a run is below this, 95 %
_BURST = 7.0  # logarithm of growth in a burst of chaos: from a thousandth of the attractor to all of it
_SLOW = 0.8  # von Neumann's ratio of block means: 2 where they are independent, below this in 1 of 500 such runs


class Average(NamedTuple):
    """Means a period of growth, and their errors.

    Attributes:
        mean, error: (lanes, sums).
    """

    mean: Float[np.ndarray, "lanes sums"]
    error: Float[np.ndarray, "lanes sums"]


def student(count: int) -> float:
    """Return Student's two-sided quantile of 95 % for the mean of so many numbers, by one less degrees of freedom."""
    from scipy.special import stdtrit  # here, as it takes a tenth of a second to import

    return float(stdtrit(count - 1, 0.975))


def average_blocks(rates: Float[np.ndarray, "lanes blocks sums"]) -> Average:
    """Return the mean over blocks, and its error at 95 % by the scatter of blocks and of batches of them.

    Neighbouring blocks may be correlated. Batches of two and four blocks are so less, and their fewer means have a
    wider Student's t: the largest of the errors is taken, and never less than how far the sum strays from its line.
    What has vanished in a block, where maps lose rank, is −∞ without error.
    """
    vanished = np.any(np.isneginf(rates), axis=1)
    rates = np.where(np.isfinite(rates), rates, np.nan)  # of a lane that fails there are infinite ones
    blocks = rates.shape[1]
    mean = rates.mean(axis=1)
    error = np.zeros_like(mean)
    size = 1
    while blocks // size >= _FEWEST:
        count = blocks // size
        batches = rates[:, : count * size].reshape(len(rates), count, size, -1).mean(axis=2)
        error = np.maximum(error, student(count) * batches.std(axis=1, ddof=1) / math.sqrt(count))
        size *= 2
    strayed = np.cumsum(rates - mean[:, None], axis=1) / blocks
    low, high = np.minimum(strayed.min(axis=1), 0.0), np.maximum(strayed.max(axis=1), 0.0)
    return Average(np.where(vanished, -np.inf, mean), np.where(vanished, 0.0, np.maximum(error, high - low)))


def change(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return how far two estimates of exponents are from each other, of which some may be −∞."""
    with np.errstate(invalid="ignore"):
        return np.where(first == second, 0.0, np.abs(first - second))


def smooth_parts(growth: TangentState, block: int, number: int) -> Float[np.ndarray, "lanes 3 sums"]:
    """Return the part of block `number` in the smooth averages over the whole, the first half and the second."""
    points = (np.arange(block * BLOCKS) + 0.5) / (block * BLOCKS)
    whole, half = (np.stack(sums, axis=-1) for sums in growth.smooth)
    parts = np.zeros((len(half), 3, half.shape[1]))
    parts[:, 0] = whole / window_weights(points).sum()
    second = int(number >= BLOCKS // 2)
    parts[:, 1 + second] = half / half_window_weights(points)[1][(points >= 0.5) == second].sum()
    return parts


def average_windows(parts: Float[np.ndarray, "lanes 3 sums"], before: float, length: float) -> Average:
    """Return the smooth average over the whole, and its error by those over its halves.

    Both halves know less than the whole; their distance is the error of an average that converges faster than its
    length grows. Where a tangent grows in proportion to time, as by shear on tori, rates fall like 1/t and no average
    converges faster than that: the distance of the halves is enlarged to what such a fall leaves in the whole.

    Args:
        before: periods that the tangents were carried before the average.
        length: periods of the average.
    """
    x = (np.arange(4096) + 0.5) / 4096
    falling = length / (max(before, 1.0) + x * length)
    whole, half = half_window_weights(x)
    first, second = (np.average(falling[part], weights=half[part]) for part in (x < 0.5, x > 0.5))
    left = np.average(falling, weights=whole) / (first - second)
    apart = np.abs(parts[:, 1] - parts[:, 2])
    beside = np.abs(parts[:, 0] - 0.5 * (parts[:, 1] + parts[:, 2]))
    return Average(parts[:, 0], max(1.0, left) * apart + beside + _ROUNDING)


def widen_to_zero(average: Average, before: float, length: float) -> Average:
    """Enlarge the errors of means that may be zero, as far as a finite window can tell, to reach zero.

    Over a window the logarithm of a tangent of regular motion may change without any exponent: by one as it turns or
    the flow's speed changes along the motion, and by 2 ln of the ratio of times as it grows or shrinks like a power of
    time up to the second (shear on tori, motion that slows down at a fold).

    Args:
        before, length: as in `average_windows`.
    """
    least = (1.0 + 2.0 * math.log1p(length / max(before, 1.0))) / length
    return average._replace(error=average.error + np.where(np.abs(average.mean) <= least, np.abs(average.mean), 0.0))


def widen_to_sum_rule(
    error: Float[np.ndarray, "lanes k"], residual: Float[np.ndarray, " lanes"]
) -> Float[np.ndarray, "lanes k"]:
    """Return errors of all exponents of averages, at least the residual of their sum rule where they contradict it.

    Growth along one path and the divergence along it have one sum, whatever the path: what is left is what the steps do
    to tangents, as under strong contraction, and no scatter of block means knows of it. It is not known which exponent
    has it.

    Args:
        residual: sum of the growths less the mean divergence.
    """
    wrong = np.abs(residual) > np.sum(error, axis=1)
    return np.where(wrong[:, None], np.maximum(error, np.abs(residual)[:, None]), error)


def unseen_bursts(rates: Float[np.ndarray, "lanes blocks sums"], length: float) -> Float[np.ndarray, " lanes"]:
    """Return what bursts of chaos that were never seen may add to the mean of the largest exponent, a period.

    Where block means only drift, as in the laminar phase of intermittency, the run is shorter than the time between
    events, and its scatter says nothing of them. By the rule of three their number is below three a run.

    Args:
        rates: of the largest exponent alone.
        length: periods of the average.
    """
    with np.errstate(invalid="ignore"):
        about = rates - rates.mean(axis=1, keepdims=True)
        ratio = np.sum(np.diff(rates, axis=1) ** 2, axis=(1, 2)) / np.sum(about**2, axis=(1, 2))
    return np.where(ratio < _SLOW, _UNSEEN * _BURST / length, 0.0)
