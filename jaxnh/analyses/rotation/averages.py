"""Weighted Birkhoff averages, lifts of points on a circle, and fractions; arrays on the host, angles in turns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.smooth_window import window_weights

_ORDER = 1e-3  # turns that points may be out of their cyclic order by, as points that approach a curve are
_FASTEST, _RATES, _NODES = 30.0, 200, 256  # of the growth of a displacement: rates that are told apart


class BirkhoffAverage(NamedTuple):
    """A weighted Birkhoff average.

    Attributes:
        value: over all points, (lanes,).
        difference: between the averages of the two halves, (lanes,).
        error: the larger one of this and of the distance of the average from that of the second half, (lanes,).
    """

    value: Float[np.ndarray, " lanes"]
    difference: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]


def birkhoff_average(values: Float[np.ndarray, "lanes points"]) -> BirkhoffAverage:
    """Return the average of values with the weight exp(-1/(x(1-x))), x the place in the run.

    On quasiperiodic motion its error falls faster than any power of the number of points (Das, Saiki, Sander and
    Yorke, Nonlinearity 30 (2017) 4111); the halves, of which each errs by more than the whole, tell the error.
    """
    first, second = half_averages(values)
    whole = _weighted(values)
    difference = np.abs(first - second)
    return BirkhoffAverage(whole, difference, np.maximum(difference, np.abs(whole - second)))


def half_averages(values: Float[np.ndarray, "lanes points"]) -> Float[np.ndarray, "2 lanes"]:
    """Return the averages with that weight over the first and the second half of values."""
    half = values.shape[1] // 2
    return np.stack([_weighted(part) for part in (values[:, :half], values[:, -half:])])


def displacement(
    first: Float[np.ndarray, " lanes"], second: Float[np.ndarray, " lanes"], slowest: float
) -> Float[np.ndarray, " lanes"]:
    """Return what a change comes to that grows like 1 − e^(−λt), from its averages over two successive windows.

    Their ratio falls from 3 to 1 as λ grows.

    Args:
        slowest: the least λ that counts, in units of 1/length of a window; whatever grows more slowly is not yet there
            at the end of the motion that it is the error of.
    """
    rate = np.geomspace(slowest, max(_FASTEST, 2.0 * slowest), _RATES)
    at = (np.arange(_NODES) + 0.5) / _NODES
    weights = window_weights(at)
    left = np.exp(-np.outer(rate, at)) @ weights / weights.sum()
    seen = 1.0 - left * np.exp(-rate)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(first > 0.0, second / first, np.inf)
        share = np.interp(ratio, (seen / (1.0 - left))[::-1], seen[::-1])
        return np.maximum(first, second) / np.where(second > first, share, 1.0)


def _weighted(values: Float[np.ndarray, "lanes points"]) -> Float[np.ndarray, " lanes"]:
    count = values.shape[1]
    weights = window_weights((np.arange(count) + 0.5) / count)
    return np.sum(weights * values, axis=1) / np.sum(weights)


def cyclic_advances(
    turns: Float[np.ndarray, "lanes points"],
) -> tuple[Float[np.ndarray, "lanes advances"], Bool[np.ndarray, " lanes"]]:
    """Return by how much each point of a circle advances to the next one, and whether the images keep the cyclic order.

    A map of a circle that keeps orientation has a lift that grows, F(x + 1) = F(x) + 1. The images of points in order
    are then in order, which gives all advances F(x) - x but for one common number of whole turns. It is chosen such
    that the first advance is in [0, 1).

    Args:
        turns: successive points in turns, of which whole ones do not count.
    """
    begin, image = turns[:, :-1] % 1.0, turns[:, 1:] % 1.0
    order = np.argsort(begin, axis=1, kind="stable")
    sorted_begin, sorted_image = (np.take_along_axis(x, order, axis=1) for x in (begin, image))
    steps = _steps(sorted_image)
    keeps_order = np.rint(steps.sum(axis=1)) == np.rint(_steps(sorted_begin).sum(axis=1))
    grown = sorted_image[:, :1] + np.concatenate(
        [np.zeros_like(steps[:, :1]), np.cumsum(steps[:, :-1], axis=1)], axis=1
    )
    whole = np.rint(grown - sorted_image)
    advances = np.empty_like(begin)
    np.put_along_axis(advances, order, sorted_image + whole - sorted_begin, axis=1)
    return advances - np.floor(advances[:, :1]), keeps_order


def _steps(turns: Float[np.ndarray, "lanes points"]) -> Float[np.ndarray, "lanes points"]:
    """Return the steps forward from each point to the next one, and from the last one to the first."""
    return (np.diff(turns, axis=1, append=turns[:, :1]) + _ORDER) % 1.0 - _ORDER


def least_fraction(
    value: Float[np.ndarray, " lanes"], error: Float[np.ndarray, " lanes"], largest: int
) -> tuple[Int[np.ndarray, " lanes"], Int[np.ndarray, " lanes"]]:
    """Return numerator and denominator of the fraction of least denominator within the error; denominator 0: none.

    Args:
        value, error: finite or not.
        largest: of the denominators.
    """
    numerator, denominator = (np.zeros(len(value), np.int64) for _ in range(2))
    for q in range(1, largest + 1):
        with np.errstate(invalid="ignore"):
            p = np.rint(q * value)
            fits = (denominator == 0) & (np.abs(value - p / q) <= error)
        numerator[fits], denominator[fits] = p[fits].astype(np.int64), q
    return numerator, denominator
