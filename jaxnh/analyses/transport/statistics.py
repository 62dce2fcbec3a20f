"""Exponents of growth, drift and diffusion, from records of motions; arrays on the host, time in strobes.

Statistical errors are those of the jackknife over independent parts (Miller, Biometrika 61 (1974) 1) with Student's
quantile. How far an estimate is from its limit is told by how much it changes from one octave of time to the next.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.analyses.exponents.errors import average_blocks
from jaxnh.analyses.intervals import student
from jaxnh.analyses.options.base import BLOCKS

_OCTAVES = 4  # windows of growth, each twice as long as the one before
_REMAINDER = 2.0  # r/(1 - r) with r = 2/3: of corrections that fall by that factor in an octave, as t^-0.58, or faster
_FEWEST = 4  # motions whose scatter is looked at
_SHORTEST = 4  # points of a window of a path
_PRECISE = 0.15  # statistical error of an exponent, and relative one of a coefficient, that windows are chosen by


class EstimateWithError(NamedTuple):
    """Estimates and their errors at 95 %, of one shape."""

    value: np.ndarray
    error: np.ndarray


class Diffusion(NamedTuple):
    """Statistics of paths.

    Attributes:
        drift: mean displacement a strobe, (coordinates, lanes).
        exponent: of the power of time that squared displacements about the drift grow as, (lanes,).
        coefficient: D, where the mean squared displacement in n dimensions becomes 2 n D times the time, (lanes,).
        extent: largest mean square of the distance from the mean in a window, (lanes,).
    """

    drift: EstimateWithError
    exponent: EstimateWithError
    coefficient: EstimateWithError
    extent: Float[np.ndarray, " lanes"]


def growth_exponent(values: Float[np.ndarray, "lanes motions strobes"]) -> EstimateWithError:
    """Return the exponent of the power of time that the root mean square of values grows as, (lanes,).

    The windows are the strobes from n/16 to n/8, from n/8 to n/4, and so on to the last one, n. From one to the next
    t^a grows by 2^a; the exponent is that of the last two. Where it tends to its limit with corrections that are powers
    of time, what is left of them is bounded by a multiple of its last change; half of the change before counts as well,
    in case the last one is small by chance. A strobe at the ends of the shortest window is allowed for.
    """
    count = values.shape[2] // 2**_OCTAVES
    ends = count * 2 ** np.arange(_OCTAVES + 1)
    groups = np.array_split(np.arange(values.shape[1]), min(values.shape[1], BLOCKS))
    windows = [values[:, :, begin:end] ** 2 for begin, end in itertools.pairwise(ends)]
    sums = np.array([[window[:, group].sum(axis=(1, 2)) for window in windows] for group in groups])
    total = sums.sum(axis=0)
    exponents = 0.5 * np.log2(0.5 * total[1:] / total[:-1])
    before, last = np.abs(np.diff(exponents, axis=0))
    error = _REMAINDER * np.maximum(last, 0.5 * before) + 1.0 / count
    if values.shape[1] >= _FEWEST:
        without = total - sums
        error += _jackknife(0.5 * np.log2(without[:, -1] / without[:, -2]))
    return EstimateWithError(exponents[-1], error)


def diffusion(paths: Float[np.ndarray, "coordinates lanes motions places"]) -> Diffusion:
    """Return drift, exponent and coefficient of the diffusion of paths, whose places are a strobe apart.

    In windows of L places the mean square of the distance from the window's mean, the drift taken out, grows as the
    mean squared displacement does, smoothly also where the motion is bounded or turns. Where correlations fall fast it
    becomes a constant plus n D L/3, so that D is that of its rise from L to 4 L.
    """
    dimension, _, motions, places = paths.shape
    part = (places - 1) // BLOCKS
    rates = np.diff(paths[..., : BLOCKS * part + 1 : part], axis=3).mean(axis=2) / part
    averages = average_blocks(np.moveaxis(rates, 0, 2))
    error = averages.error.T
    if motions >= _FEWEST:  # stretches of a motion that remembers for long are alike, and motions are independent
        whole = (paths[..., BLOCKS * part] - paths[..., 0]) / (BLOCKS * part)
        error = np.maximum(error, student(motions) * whole.std(axis=2, ddof=1) / math.sqrt(motions))
    drift = EstimateWithError(averages.mean.T, error)
    about = paths - drift.value[..., None, None] * np.arange(places)
    short = _SHORTEST * 2 ** np.arange(_octaves(motions, places))
    pairs = [_window_pairs(about, int(length)) for length in short]
    means = np.array([pair.mean(axis=2) for pair in pairs])  # (octaves, 2, lanes)
    powers = 0.5 * np.log2(means[:, 1] / means[:, 0])
    scatter = np.array([_jackknife(_leave_one_out(pair)) for pair in pairs])
    rises = (means[:, 1] - means[:, 0]) / (dimension * short[:, None])
    of_rises = [student(pair.shape[2]) * np.std(pair[1] - pair[0], axis=1, ddof=1) for pair in pairs]
    rise_errors = np.array([x / math.sqrt(pair.shape[2]) for x, pair in zip(of_rises, pairs, strict=True)])
    rise_errors /= dimension * short[:, None]
    exponent = _at_longest(powers, scatter, scatter <= _PRECISE, may_not_fall=True)
    rate = _at_longest(rises, rise_errors, rise_errors <= _PRECISE * rises)  # asked for where that exponent is one
    return Diffusion(drift, exponent, rate, means[:, 1].max(axis=0))


def _at_longest(
    values: Float[np.ndarray, "octaves lanes"],
    scatter: Float[np.ndarray, "octaves lanes"],
    precise: Bool[np.ndarray, "octaves lanes"],
    *,
    may_not_fall: bool = False,
) -> EstimateWithError:
    """Return the estimates of the longest windows that are precise, with a multiple of the last change in their errors.

    Where none are, it is those of the second length. Changes that fall by a factor r in each octave have r/(1 − r) of
    the last one to come, here by that of `_REMAINDER`. Longer windows enlarge an error by what they contradict it.

    Args:
        values: estimates in windows of all lengths.
        scatter: their errors at 95 %.
        precise: which windows may be chosen.
        may_not_fall: whether changes may fall more slowly, beyond their scatter, whose own factor then counts: where
            they do not fall there is no bound, as of motions in the midst of what they remember. Half of the change
            before counts as well, in case the last one is small by chance, and all that longer windows are off.
    """
    octaves, lanes = values.shape
    longest = np.where(precise.any(axis=0), octaves - 1 - np.argmax(precise[::-1], axis=0), 1)
    at = np.maximum(longest, 1), np.arange(lanes)
    changes, apart = np.abs(np.diff(values, axis=0)), np.abs(values - values[at])
    last, before = changes[at[0] - 1, at[1]], changes[np.maximum(at[0] - 2, 0), at[1]]
    error, contradiction = scatter[at] + _REMAINDER * last, apart - scatter - scatter[at]
    if may_not_fall:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(last < before, last / before, 1.0)
            slow = (last > np.hypot(scatter[at], scatter[at[0] - 1, at[1]])) & (at[0] > 1)
            remainder = np.where(slow, np.maximum(_REMAINDER, ratio / (1.0 - ratio)), _REMAINDER)
        error = scatter[at] + remainder * np.maximum(last, 0.5 * before)
        contradiction = np.where(apart > np.hypot(scatter, scatter[at]), apart, 0.0)
    longer = np.arange(octaves)[:, None] > at[0]
    return EstimateWithError(values[at], error + np.max(np.where(longer, contradiction, 0.0), axis=0, initial=0.0))


def _octaves(motions: int, places: int) -> int:
    """Return how many lengths of windows there are: four times the longest fits, and that BLOCKS times in all paths."""
    longest = min(places, motions * places // BLOCKS) // 4
    return max(int(math.log2(longest / _SHORTEST)) + 1, 2)


def _window_pairs(
    paths: Float[np.ndarray, "coordinates lanes motions places"], length: int
) -> Float[np.ndarray, "2 lanes blocks"]:
    """Return the mean square distance from the mean in windows of a length, and in those of four of them, of blocks."""
    dimension, lanes, motions, places = paths.shape
    count = places // (4 * length)
    blocks = paths[..., : count * 4 * length].reshape(dimension, lanes, motions * count, 4, length)
    within = blocks.var(axis=4).mean(axis=3).sum(axis=0)
    between = blocks.mean(axis=4).var(axis=3).sum(axis=0)
    return np.stack([within, within + between])


def _leave_one_out(pair: Float[np.ndarray, "2 lanes blocks"]) -> Float[np.ndarray, "blocks lanes"]:
    """Return the exponent without each of the blocks."""
    without = pair.sum(axis=2, keepdims=True) - pair
    return 0.5 * np.log2(without[1] / without[0]).T


def _jackknife(without: Float[np.ndarray, "parts lanes"]) -> Float[np.ndarray, " lanes"]:
    """Return the error at 95 % of an estimate, from the estimates without each of the parts."""
    count = len(without)
    return student(count) * np.sqrt((count - 1) * without.var(axis=0))
