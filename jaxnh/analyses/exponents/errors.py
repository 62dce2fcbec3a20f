"""Error bars of averages along one lane: from block means, and from smooth windows where the motion is regular.

A bar is to cover the average of an endless run in 95 of 100 lanes (measured: `tests/hard/test_exponent_bars.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.exponents.tangent_growth import TangentState
from jaxnh.analyses.intervals import student
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import DEGREE, drift_basis, half_window_weights

_FEWEST = 4  # means of a batch that an error is taken from
_ROUNDING = 1e-10  # of a smooth average a period
_UNSEEN = 3.0  # events that were never seen: their mean number over as long a run is below this, 95 %
_BURST = 7.0  # logarithm of growth in a burst of chaos: from a thousandth of the attractor to all of it
_SETTLED = 4.0  # of the logarithm of volume: what is left of the way to an attractor is below 2 in 100
_CONSTANT = 1e-13  # of the scatter of a divergence that is the same everywhere, by rounding
_POWER_LAW = 4.0  # times what an exponential drift leaves: one like time^(−1/3)
_DRIFT = 20.0  # times what scatters: of Student's t with three degrees of freedom in 3 of 10,000
_DRIFT_OF_BLOCKS = 8.0  # times their scatter, which is 6 of Student's t: windows scatter more than means
_STEADY = 1e-12  # of a drift in a window, a period, and of the mean above one: rounding
_SLOW = 0.8  # von Neumann's ratio of block means: 2 where they are independent, below this in 1 of 500 such runs


class Average(NamedTuple):
    """Means a period of growth, and their errors.

    Attributes:
        mean, error: (lanes, sums).
    """

    mean: Float[np.ndarray, "lanes sums"]
    error: Float[np.ndarray, "lanes sums"]


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


def smooth_parts(growth: TangentState, block: int, number: int) -> Float[np.ndarray, "lanes parts sums"]:
    """Return the part of block `number` in the smooth averages of a lane.

    They are those over the whole, the first half and the second, and the coefficients of growth in the polynomials of
    degree 1 to `DEGREE` of time that are orthonormal under the window.
    """
    points = (np.arange(block * BLOCKS) + 0.5) / (block * BLOCKS)
    *moments, half = (np.stack(sums, axis=-1) for sums in growth.smooth)
    parts = np.zeros((len(half), 3 + DEGREE, half.shape[1]))
    coefficients = np.einsum("ij,jls->lis", drift_basis(points)[0], np.stack(moments))
    parts[:, 0], parts[:, 3:] = coefficients[:, 0], coefficients[:, 1:]
    second = int(number >= BLOCKS // 2)
    parts[:, 1 + second] = half / half_window_weights(points)[1][(points >= 0.5) == second].sum()
    return parts


def average_windows(parts: Float[np.ndarray, "lanes parts sums"], before: float, length: float) -> Average:
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


def widen_by_drift(
    average: Average,
    parts: Float[np.ndarray, "lanes parts sums"],
    rates: Float[np.ndarray, "lanes blocks sums"] | None = None,
    steps: float = 0.0,
) -> Average:
    """Enlarge the errors of means that drift to what the drift may still come to.

    A motion that comes to its attractor slowly has means of which a window shows a small part. About the middle of the
    window growth is μ + μ′τ + μ″τ²/2: its coefficients in orthonormal polynomials fall with the degree, where those of
    all that only scatters, or turns fast, are alike. A slope far above the coefficients of degree 3 and more is a
    drift; of a plain average one far above the scatter of blocks about their line. One like e^−γt has μ′²/μ″ left,
    whatever γ; one like t^−p has (p + 1)/p as much, and more in a wide window: three times where p is 1/2, as of a mean
    that is linear in the amplitude of a motion at the onset of its attractor, and four are allowed for. A fall that
    begins fast, as t^−p soon after t = 0, is a sum of exponentials: its coefficients alternate in sign and fall with
    the degree, as of what scatters they do in 1 of 1,920 lanes; then all of them belong to the drift. Where a drift
    does not slow down, beyond what scatters, there is no end of it in the window, and the error is infinite. Where
    orbits fill a family, as on levels of an integral, steps move a motion along it, as far as their errors add up to:
    of a mean that changes by no more of itself than that, this change is the error.

    Args:
        parts: as of `smooth_parts`, over the whole run.
        rates: of blocks, where the means are plain averages.
        steps: errors of all steps of the run, in sizes of the motion.
    """
    parts = np.where(np.isfinite(parts), parts, 0.0)
    leading = drift_basis((np.arange(4096) + 0.5) / 4096)[1]
    slope, bend = parts[:, 3], parts[:, 4]
    if rates is None:
        noise, freedom, least = np.sqrt(np.mean(parts[:, 5:] ** 2, axis=1)), DEGREE - 2, _DRIFT
        alternating = np.all(parts[:, 3:-1] * parts[:, 4:] < 0.0, axis=1)
        falls = alternating & np.all(np.abs(parts[:, 3:-1]) > np.abs(parts[:, 4:]), axis=1)
        noise = np.where(falls, 0.0, noise)
    else:
        noise, freedom, least = _scatter_about_line(rates), BLOCKS - 2, _DRIFT_OF_BLOCKS
    slows = -np.sign(slope) * bend - student(freedom + 1) * noise
    with np.errstate(divide="ignore", invalid="ignore"):
        left = _POWER_LAW * (slope / leading[1]) ** 2 / (2.0 * np.maximum(slows, 0.0) / leading[2])
        size = np.maximum(np.abs(average.mean), 1.0)
        moved = 2.0 * np.abs(slope) / leading[1]
        left = np.where(moved > steps * size, left, moved)
        alike = np.sqrt(np.mean(parts[:, 5:] ** 2, axis=1))  # as of events at equal times, whose blocks do not scatter
        drifts = (np.abs(slope) > np.maximum(least * noise, _STEADY * size)) & (np.abs(slope) > alike)
    return average._replace(error=np.where(drifts, np.maximum(average.error, left), average.error))


def widen_unsettled(total: Average, rates: Float[np.ndarray, "lanes blocks sums"], periods: int) -> Average:
    """Enlarge the errors of sums of exponents of motions that cannot have settled yet.

    On an attractor whose sum is σ a motion has settled where volumes have shrunk by many factors e. Where they have
    changed by less than e^±4 in all its periods, and by how much depends on where it is, a sum that is not zero is one
    along a transient, or the attractor's is as small; one of 4 over the periods would have been seen to settle.

    Args:
        rates: of volume in blocks, of the whole run.
        periods: from the start to the end, transient and average.
    """
    with np.errstate(invalid="ignore"):
        varies = np.std(rates, axis=1) > _CONSTANT * np.maximum(np.abs(total.mean), 1.0)
    least = _SETTLED / periods
    unsettled = varies & (np.abs(total.mean) > total.error) & (np.abs(total.mean) < least)
    return total._replace(error=np.where(unsettled, np.maximum(total.error, least), total.error))


def _scatter_about_line(rates: Float[np.ndarray, "lanes blocks sums"]) -> Float[np.ndarray, "lanes sums"]:
    """Return the standard error of means of blocks about a straight line; infinite where blocks are no numbers."""
    line = np.arange(rates.shape[1]) - 0.5 * (rates.shape[1] - 1)
    with np.errstate(invalid="ignore"):  # of tangents that have vanished
        about = rates - rates.mean(axis=1, keepdims=True)
        rise = np.einsum("lbs,b->ls", about, line) / np.sum(line**2)
        squares = np.sum((about - rise[:, None] * line[:, None]) ** 2, axis=1)
    scatter = np.sqrt(squares / (rates.shape[1] - 2) / rates.shape[1])
    return np.where(np.isfinite(scatter), scatter, np.inf)


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
    error: Float[np.ndarray, "lanes k"], residual: Float[np.ndarray, " lanes"], rounding: Float[np.ndarray, " lanes"]
) -> Float[np.ndarray, "lanes k"]:
    """Return errors of all exponents of averages, at least the residual of their sum rule where they contradict it.

    Growth along one path and the divergence along it have one sum, whatever the path: what is left is what the steps do
    to tangents, as under strong contraction, and no scatter of block means knows of it. It is not known which exponent
    has it.

    Args:
        residual: sum of the growths less the mean divergence; NaN where there is no such check.
        rounding: what it leaves in the sums that these are means of.
    """
    wrong = np.abs(residual) > np.sum(error, axis=1)
    return np.where(wrong[:, None], np.maximum(error, (np.abs(residual) + rounding)[:, None]), error)


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
