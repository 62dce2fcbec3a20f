"""Homoclinic and heteroclinic points: crossings of unstable and stable manifolds in a plane, by Newton on both."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.manifolds.curves import Curves, ManifoldBranch, tangents
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import concatenate, select

_BLOCK = 64  # segments of a curve whose box is looked at first
_CANDIDATES = 32  # for each crossing that is kept: an orbit crosses in every segment of the curves
_SAME = 1e-5  # of x: images of one point
_STEPS = 8
_LARGEST_STEP = 0.1  # of x
_AT_REST = 1e-7  # sizes


class Meetings(NamedTuple):
    """Points of an unstable and of a stable branch that meet, or nearly.

    Attributes:
        unstable, stable: numbers of the branches, (meetings,).
        x: of both, (meetings, 2).
        arc: sum of both arc lengths, in sizes, (meetings,).
    """

    unstable: Int[np.ndarray, " meetings"]
    stable: Int[np.ndarray, " meetings"]
    x: Float[np.ndarray, "meetings 2"]
    arc: Float[np.ndarray, " meetings"]


class Crossings(NamedTuple):
    """Crossings of an unstable and a stable branch.

    Attributes:
        meetings: the branches, and where on them.
        points: section coordinates, (crossings, 2).
        angle: between both curves, in sizes, (crossings,).
    """

    meetings: Meetings
    points: Float[np.ndarray, "crossings 2"]
    angle: Float[np.ndarray, " crossings"]


def joined(parts: Sequence[Meetings]) -> Meetings:
    """Return meetings together."""
    if not parts:
        return Meetings(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    return concatenate(parts)


def crossing_segments(
    unstable: Sequence[tuple[int, ManifoldBranch]],
    stable: Sequence[tuple[int, ManifoldBranch]],
    size: Float[np.ndarray, " 2"],
    wrap: Wrap,
    angles: bool,
    most: int,
) -> Meetings:
    """Return where segments between points of branches cross, by arc length, for so many crossings to be known."""
    parts = list[Meetings]()
    for number, curve in unstable:
        for other_number, other in stable:
            first, second, share, other_share = _crossed(curve.points[1:], other.points[1:], size, wrap, angles)
            count = len(first)
            x = np.stack([_interpolate(curve.x, first, share), _interpolate(other.x, second, other_share)], axis=1)
            arc = _interpolate(curve.arc, first, share) + _interpolate(other.arc, second, other_share)
            parts.append(Meetings(np.full(count, number), np.full(count, other_number), x, arc))
    every = joined(parts)
    return select(every, np.argsort(every.arc, kind="stable")[: _CANDIDATES * most])


def distinct_orbits(meetings: Meetings, curves: tuple[Curves, Curves], same: float = _SAME) -> Int[np.ndarray, " kept"]:
    """Return the numbers of meetings that are no image of one before.

    An image k turns of the orbits later is by k of x further along the unstable branch, and as much less along the
    stable one; where the multiplier is negative each turn changes the side.

    Args:
        meetings: those of unstable branches that begin at the first points of orbits.
        curves: of unstable and of stable manifolds.
        same: of x, how far images may be from where they should be.
    """
    numbers = meetings.unstable, meetings.stable
    flips = [curve.multiplier[which] < 0.0 for curve, which in zip(curves, numbers, strict=True)]
    passed, total, kept = meetings.x[:, 0], meetings.x.sum(axis=1), list[int]()
    for i in range(len(total)):
        others = np.array(kept, int)
        turns = passed[others] - passed[i]
        whole = np.round(turns)
        alike = (np.abs(total[others] - total[i]) < same) & (np.abs(turns - whole) < same)
        for which, flip in zip(numbers, flips, strict=True):
            turned = (which[others] + which[i]) % 2 == 1
            alike &= (which[others] // 2 == which[i] // 2) & (turned == (flip[i] & (whole % 2 == 1)))
        if not alike.any():
            kept.append(i)
    return np.array(kept, int)


def refine_crossings(lanes: LaneRunner, curves: tuple[Curves, Curves], meetings: Meetings, wrap: Wrap) -> Crossings:
    """Return the crossings near meetings, not numbers where Newton does not come to rest.

    A point is where the tangents of the last step meet. Points of the curves themselves lie on a lattice along these,
    as rounding of the first segment (1e-16/δ of x) moves them; across the curves they are as exact as the map is.

    Args:
        curves: of unstable and of stable manifolds.
    """
    x, count = meetings.x.copy(), len(meetings.x)
    size, numbers = curves[0].size[meetings.unstable], (meetings.unstable, meetings.stable)
    points, angle, rest = np.full((count, 2), np.nan), np.full(count, np.nan), np.zeros(count, bool)
    for _ in range(_STEPS if count else 0):
        at = [
            tangents(lanes, curve, which, x[:, k]) for k, (curve, which) in enumerate(zip(curves, numbers, strict=True))
        ]
        gap = wrap(at[0][0] - at[1][0]) / size
        matrix = np.stack([at[0][1] / size, -at[1][1] / size], axis=2)
        area, product = (
            cross_product(matrix[:, :, 0], matrix[:, :, 1]),
            np.sum(matrix[:, :, 0] * matrix[:, :, 1], axis=1),
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([cross_product(gap, matrix[:, :, 1]), cross_product(matrix[:, :, 0], gap)], axis=1)
            step = step / area[:, None]
            x = x - step * np.minimum(1.0, _LARGEST_STEP / np.abs(step).max(axis=1))[:, None]
            rest = np.linalg.norm(gap, axis=1) < _AT_REST
            points, angle = at[0][0] - step[:, :1] * at[0][1], np.arctan2(np.abs(area), np.abs(product))
    points, angle = np.where(rest[:, None], points, np.nan), np.where(rest, angle, np.nan)
    return Crossings(meetings._replace(x=x), points, angle)


def _crossed(
    curve: Float[np.ndarray, "n 2"], other_curve: Float[np.ndarray, "m 2"], size: np.ndarray, wrap: Wrap, angles: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers of segments of two curves that cross, and the shares of both where they do."""
    first, second = _near_blocks(curve, other_curve, angles)
    results = [(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0))]
    way, other_way = wrap(np.diff(curve, axis=0)) / size, wrap(np.diff(other_curve, axis=0)) / size
    for i, j in zip(first, second, strict=True):
        a = np.arange(i * _BLOCK, min((i + 1) * _BLOCK, len(way)))
        b = np.arange(j * _BLOCK, min((j + 1) * _BLOCK, len(other_way)))
        r, w = way[a][:, None], other_way[b][None]
        between = wrap(other_curve[b][None] - curve[a][:, None]) / size
        with np.errstate(divide="ignore", invalid="ignore"):
            area = cross_product(r, w)
            share, other_share = cross_product(between, w) / area, cross_product(between, r) / area
            met = (share >= 0.0) & (share < 1.0) & (other_share >= 0.0) & (other_share < 1.0)
        k, m = np.nonzero(met)
        results.append((a[k], b[m], share[k, m], other_share[k, m]))
    return tuple(np.concatenate(leaves) for leaves in zip(*results, strict=True))  # pyright: ignore[reportReturnType]


def _near_blocks(first: np.ndarray, second: np.ndarray, angles: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of blocks of segments whose boxes overlap; where there are angles all pairs."""
    boxes = [
        [
            (curve[k : k + _BLOCK + 1].min(axis=0), curve[k : k + _BLOCK + 1].max(axis=0))
            for k in range(0, max(len(curve) - 1, 0), _BLOCK)
        ]
        for curve in (first, second)
    ]
    if not boxes[0] or not boxes[1]:
        return np.zeros(0, int), np.zeros(0, int)
    (low, high), (other_low, other_high) = (np.swapaxes(np.array(each), 0, 1) for each in boxes)
    overlap = (low[:, None] <= other_high[None]) & (other_low[None] <= high[:, None])
    blocks, other_blocks = np.nonzero(np.all(overlap, axis=2) | angles)
    return blocks, other_blocks


def _interpolate(values: Float[np.ndarray, " points"], segment: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return values at shares of segments, which are counted from the second point on."""
    return values[segment + 1] + share * (values[segment + 2] - values[segment + 1])


def cross_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the area that vectors in the plane span, signed."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
