"""Distance of an attractor from a saddle that its motion passes at a distance: by the unstable leaves of the motion.

Near a saddle with multipliers |μ1| > 1 > |μ2| > … a motion comes within ε only if it enters within some ε |μ1|^−k of
the stable manifold, with |μ2|^k = ε. Its nearest of N points is at N^(−1/D), D = 1 + ln |μ1| / −ln |μ2|, which may be
nine, while points are N^(−1/dimension) apart: more points do not help. But an attractor holds the unstable manifolds
of its points. Where one of them crosses the stable manifold of the saddle, the attractor holds the crossing, and with
it the saddle that it comes to.

A piece of such a manifold that reaches to both sides of the saddle is bisected, return by return.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.orbits.shooting import Period
from jaxnh.systems.chart import Chart

_POINTS = 9  # of a piece
_LONGEST = 4096  # points at the end of a motion that are looked at
_GROWTH = np.log(1e3)  # of a piece from where it is straight to where it reaches past the saddle
_WIDTH = 0.05  # of a piece, in its distances from the saddle: straight, and wider than the stable manifold bends
_RETURNS = 1024
_ALONG = 1e-6  # sine of the angle between tangents from two starts that have turned along the leaves
_BESIDE = 32  # nearest points: all on one side by chance in one of 2e9, where sides are alike
_SIDES = 3.0  # pieces as long as so many distances from the saddle may still be straight


class LeafPiece(NamedTuple):
    """Pieces of unstable leaves where motions pass orbits of n returns.

    Attributes:
        passed: number of the motion's point beside the orbit, (cycles,).
        start: number of the point where the piece is short, (cycles,).
        shift: the way from that point to the middle of the piece, in sizes, (cycles, d).
        at: number of the orbit's point, (cycles,).
        known: whether there is such a piece, (cycles,).
    """

    passed: Int[np.ndarray, " cycles"]
    start: Int[np.ndarray, " cycles"]
    shift: Float[np.ndarray, "cycles d"]
    at: Int[np.ndarray, " cycles"]
    known: Bool[np.ndarray, " cycles"]


def leaf_distances(
    period: Period,
    image: Callable[[Float[np.ndarray, "points d"], Int[np.ndarray, " points"]], Float[np.ndarray, "points d"]],
    chart: Chart,
    motion: Float[np.ndarray, "cycles points d"],
    points: Float[np.ndarray, "cycles n d"],
    lane: Int[np.ndarray, " cycles"],
    size: Float[np.ndarray, "cycles d"],
    wanted: Float[np.ndarray, " cycles"],
) -> Float[np.ndarray, " cycles"]:
    """Return how near unstable leaves of motions come to saddle orbits with one unstable multiplier, in sizes.

    It is the largest of the distances from the points of the orbit; infinite where no leaf was seen to pass between the
    sides of the saddle, which does not say that none does.

    Args:
        period: P and ∂P/∂u at points of lanes.
        image: P alone, which is called some thousand times.
        motion: points of the motion that has settled, of each orbit's lane.
        points: of the orbits.
        lane: that they are of.
        size: of the motion in each section coordinate.
        wanted: distances below which nothing nearer is looked for.
    """
    cycles, n, d = points.shape
    motion = motion[:, -_LONGEST:]
    stable = _left_vectors(np.asarray(period(points.reshape(-1, d), np.repeat(lane, n)).monodromy), points, size)
    piece = _pieces(period, chart, motion, points, stable, lane, size)
    nearest, u = np.full((cycles, n), np.inf), np.zeros((cycles, _POINTS, d))
    active, steps = piece.known.copy(), piece.passed - piece.start
    longest = int(np.max(steps, initial=0, where=active))
    at, each = piece.at.copy(), np.arange(cycles)
    share = np.linspace(0.0, 2.0, _POINTS)[None, :, None]
    for turn in range(-longest, _RETURNS):
        begins = active & (steps == -turn)
        first = motion[each, piece.start]
        u[begins] = (first[:, None] + share * (piece.shift * size)[:, None])[begins]
        passing = active & (turn >= 0)
        if passing.any():
            gone, u = _bisect(chart, u, points[each, at], stable[each, at], size, passing, nearest, at)
            active &= ~gone & (nearest.max(axis=1) > wanted)
        moving = np.flatnonzero(active & (turn >= -steps))
        if not active.any():
            break
        if len(moving):
            flat = u[moving].reshape(-1, d)
            u[moving] = image(flat, np.repeat(lane[moving], _POINTS)).reshape(-1, _POINTS, d)
        at = np.where(passing, (at + 1) % n, at)
    return nearest.max(axis=1)


def is_beside(
    period: Period,
    chart: Chart,
    motion: Float[np.ndarray, "cycles points d"],
    points: Float[np.ndarray, "cycles n d"],
    lane: Int[np.ndarray, " cycles"],
    size: Float[np.ndarray, "cycles d"],
) -> Bool[np.ndarray, " cycles"]:
    """Return which saddle orbits have a motion's nearest points all on one side of their stable manifold.

    Args:
        period, chart, motion, points, lane, size: as in `leaf_distances`.
    """
    cycles, n, d = points.shape
    across = _left_vectors(np.asarray(period(points.reshape(-1, d), np.repeat(lane, n)).monodromy), points, size)
    beside = np.zeros(cycles, bool)
    for c in range(cycles):
        for point, vector in zip(points[c], across[c], strict=True):
            away = chart.wrap(motion[c] - point) / size[c]
            nearest = np.argpartition(np.linalg.norm(away, axis=1), min(_BESIDE, len(away) - 1))[:_BESIDE]
            side = away[nearest] @ vector
            beside[c] |= bool(np.all(side > 0.0) or np.all(side < 0.0))
    return beside


def _left_vectors(
    blocks: Float[np.ndarray, "products d d"],
    points: Float[np.ndarray, "cycles n d"],
    size: Float[np.ndarray, "cycles d"],
) -> Float[np.ndarray, "cycles n d"]:
    """Return unit vectors across the stable manifold at each point, in sizes: left ones of the unstable multiplier."""
    cycles, n, d = points.shape
    blocks = blocks.reshape(cycles, n, d, d) * (size[:, None, None, :] / size[:, None, :, None])
    vectors = np.empty((cycles, n, d))
    for k in range(n):
        product = np.broadcast_to(np.eye(d), (cycles, d, d))
        for j in range(n):
            product = blocks[:, (k + j) % n] @ product
        values, left = np.linalg.eig(product.swapaxes(1, 2))
        largest = np.argmax(np.abs(values), axis=1)
        vectors[:, k] = np.real(np.take_along_axis(left, largest[:, None, None], axis=2)[..., 0])
    return vectors / np.linalg.norm(vectors, axis=2, keepdims=True)


def _pieces(
    period: Period,
    chart: Chart,
    motion: Float[np.ndarray, "cycles points d"],
    points: Float[np.ndarray, "cycles n d"],
    stable: Float[np.ndarray, "cycles n d"],
    lane: Int[np.ndarray, " cycles"],
    size: Float[np.ndarray, "cycles d"],
) -> LeafPiece:
    """Return where each motion passes its orbit so that the shortest piece of its leaf reaches to the other side."""
    cycles, count, d = motion.shape
    _, first, again = np.unique(lane, return_index=True, return_inverse=True)
    flat = motion[first].reshape(-1, d)
    blocks = np.asarray(period(flat, np.repeat(lane[first], count)).monodromy).reshape(-1, count, d, d)[again]
    blocks = blocks * (size[:, None, None, :] / size[:, None, :, None])
    direction, growth, differ = np.empty((cycles, count, d)), np.zeros((cycles, count)), np.empty((cycles, count))
    along = np.random.default_rng(0).normal(size=(cycles, 2, d))
    for i in range(count):
        length = np.linalg.norm(along, axis=2)
        growth[:, i] = (growth[:, i - 1] if i else 0.0) + np.log(length[:, 0])
        directions, images = np.moveaxis(along / length[:, :, None], 1, 0)
        direction[:, i] = directions
        turned = np.sum(directions * images, axis=1)[:, None]
        differ[:, i] = np.linalg.norm(images - turned * directions, axis=1)
        along = np.einsum("cij,ckj->cki", blocks[:, i], np.stack([directions, images], axis=1))
    settled = np.minimum.accumulate(differ, axis=1) < _ALONG
    away = chart.wrap(motion[:, :, None] - points[:, None]) / size[:, None, None]
    apart = np.linalg.norm(away, axis=3)
    at, each = np.argmin(apart, axis=2), np.arange(cycles)[:, None]
    apart, across = np.min(apart, axis=2), stable[each, at]
    away = np.take_along_axis(away, at[:, :, None, None], axis=2)[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        way = -np.einsum("cij,cij->ci", away, across) / np.einsum("cij,cij->ci", direction, across)
    highest = np.maximum.accumulate(growth, axis=1)
    short = np.array([np.searchsorted(*row, "right") for row in zip(highest, growth - _GROWTH, strict=True)]) - 1
    possible = (short >= 0) & np.take_along_axis(settled, np.maximum(short, 0), axis=1) & (np.abs(way) < _SIDES * apart)
    with np.errstate(invalid="ignore"):
        cost = np.where(possible, np.maximum(np.abs(way), apart), np.inf)
    index = np.argmin(cost, axis=1)
    each = each[:, 0]
    start = np.maximum(short[each, index], 0)
    shrunk = np.exp(growth[each, start] - growth[each, index])
    shift = direction[each, start] * (way[each, index] * shrunk)[:, None]
    return LeafPiece(index, start, shift, at[each, index], np.isfinite(cost[each, index]))


def _bisect(
    chart: Chart,
    u: Float[np.ndarray, "cycles points d"],
    saddle: Float[np.ndarray, "cycles d"],
    across: Float[np.ndarray, "cycles d"],
    size: Float[np.ndarray, "cycles d"],
    passing: Bool[np.ndarray, " cycles"],
    nearest: Float[np.ndarray, "cycles n"],
    at: Int[np.ndarray, " cycles"],
) -> tuple[Bool[np.ndarray, " cycles"], Float[np.ndarray, "cycles points d"]]:
    """Return which pieces no longer reach to both sides, and the parts of the others that do.

    The distance of both ends of such a part is kept in `nearest` where it is the least.
    """
    away = chart.wrap(u - saddle[:, None]) / size[:, None]
    side, apart = np.einsum("cij,cj->ci", away, across), np.linalg.norm(away, axis=2)
    changes = side[:, :-1] * side[:, 1:] < 0.0
    gone, parts = passing & ~changes.any(axis=1), u.copy()
    for c in np.flatnonzero(passing & ~gone):
        left = int(np.argmax(changes[c]))
        distance = float(np.max(apart[c, left : left + 2]))
        nearest[c, at[c]] = min(nearest[c, at[c]], distance)
        gap = np.linalg.norm(away[c, left + 1] - away[c, left])
        more = int(min(_POINTS, np.ceil(0.5 * _WIDTH * distance / max(gap, np.finfo(float).tiny))))
        low, high = u[c, max(left - more, 0)], u[c, min(left + 1 + more, _POINTS - 1)]
        parts[c] = low + np.linspace(0.0, 1.0, _POINTS)[:, None] * chart.wrap(high - low)
    return gone, parts
