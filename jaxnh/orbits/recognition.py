"""Periodic orbits that are known already: equal ones modulo shift, and repeats of shorter ones. Host code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import concatenate, select

SAME = 1e-6
"""Distance, in sizes of the motion, below which two orbits are one: Newton leaves 1e-9."""


class Cycles(NamedTuple):
    """Periodic orbits of n returns, of several lanes.

    Attributes:
        lane: number of the lane of each, (cycles,).
        points: section coordinates of all its points, (cycles, n, d).
        rounds: in how many rounds of the search it was met, (cycles,).
    """

    lane: Int[np.ndarray, " cycles"]
    points: Float[np.ndarray, "cycles n d"]
    rounds: Int[np.ndarray, " cycles"]


def no_cycles(n: int, d: int) -> Cycles:
    """Return an empty set of orbits of n returns in d section coordinates."""
    return Cycles(np.zeros(0, int), np.zeros((0, n, d)), np.zeros(0, int))


def primitive_period(
    points: Float[np.ndarray, "cycles n d"],
    size: Float[np.ndarray, "#cycles d"] | Float[np.ndarray, " d"],
    wrap: Wrap,
) -> Int[np.ndarray, " cycles"]:
    """Return the least number of returns after which n points repeat, a divisor of n."""
    n, size = points.shape[1], np.broadcast_to(size, (len(points), points.shape[2]))
    least = np.full(len(points), n)
    for m in (m for m in range(n - 1, 0, -1) if n % m == 0):
        least[_distance(points, np.roll(points, m, 1), size, wrap) < SAME] = m
    return least


def equal_cycles(
    lane: Int[np.ndarray, " cycles"],
    points: Float[np.ndarray, "cycles n d"],
    size: Float[np.ndarray, "#cycles d"] | Float[np.ndarray, " d"],
    wrap: Wrap,
) -> Int[np.ndarray, " cycles"]:
    """Return for each orbit the number of the first that it equals, in the same lane and from whatever point on.

    Orbits are sorted by a mean over their points, which equal ones share, and only neighbours are compared.
    """
    size = np.broadcast_to(size, (len(points), points.shape[2]))
    label, mean = np.arange(len(lane)), _mean_over_points(points, size)
    order = np.lexsort((label, mean, lane))
    apart = (np.diff(lane[order]) != 0) | (np.diff(mean[order]) > SAME)
    group = np.zeros(len(lane), int)
    group[order] = np.concatenate([[0], np.cumsum(apart)])[: len(lane)]
    left = np.arange(len(lane))
    while len(left):
        _, first, which = np.unique(group[left], return_index=True, return_inverse=True)
        leader = left[first[which]]  # the first of those left in the group of each
        same = shift_distance(points[left], points[leader], size[left], wrap) < SAME
        label[left[same]] = leader[same]
        left = left[~same]
    return label


def shift_distance(
    points: Float[np.ndarray, "cycles n d"],
    others: Float[np.ndarray, "cycles n d"],
    size: Float[np.ndarray, "cycles d"],
    wrap: Wrap,
) -> Float[np.ndarray, " cycles"]:
    """Return the distance of orbits from others, one each, from the point on from which it is least."""
    shifts = (_distance(points, np.roll(others, m, 1), size, wrap) for m in range(points.shape[1]))
    return np.minimum.reduce(list(shifts))


def merge_cycles(
    known: Cycles, more: Cycles, size: Float[np.ndarray, "lanes d"], wrap: Wrap, sample: bool = True
) -> Cycles:
    """Return known orbits, and after them those of others that are new.

    Args:
        known, more: orbits, of as many returns.
        size: of the motion in each section coordinate.
        wrap: of differences of section coordinates.
        sample: whether the others are what a round has met, which is counted.
    """
    both = concatenate([known, more])
    label = equal_cycles(both.lane, both.points, size[both.lane], wrap)
    if sample:
        both.rounds[np.unique(label[len(known.lane) :])] += 1
    return select(both, np.flatnonzero(label == np.arange(len(label))))


def _distance(
    points: Float[np.ndarray, "cycles n d"],
    others: Float[np.ndarray, "cycles n d"],
    size: Float[np.ndarray, "cycles d"],
    wrap: Wrap,
) -> Float[np.ndarray, " cycles"]:
    return np.max(np.abs(wrap(points - others)) / size[:, None], axis=(1, 2))


def _mean_over_points(
    points: Float[np.ndarray, "cycles n d"], size: Float[np.ndarray, "cycles d"]
) -> Float[np.ndarray, " cycles"]:
    """Return the mean of sines of the coordinates, of which those that are angles have the size one."""
    phases = 1.0 + np.arange(points.shape[2])  # a coordinate and its opposite differ
    return np.mean(np.sin(points / size[:, None] + phases), axis=(1, 2))
