"""Unstable manifolds of one dimension as curves of points, whose distances and turns are small.

A branch is the curve x -> G^k(u ± δ m^τ v), k + τ = x, with G a turn of the orbit, m > 1 the modulus of its
multiplier, where this is negative with another sign for each turn, v the direction at the point u, and δ small: the
images of a fundamental segment, one after the other (Hobson, J. Comput. Phys. 104 (1993) 14). Points are inserted
between neighbours, as images of points of the first segment and not by interpolation, until distances and turns are
small (Krauskopf and Osinga, J. Comput. Phys. 146 (1998) 404). A straight first segment is off by δ² across the
manifold, which the images contract.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.manifolds.saddles import Germs
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import derivatives, section_map
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

ENDS = ("none", "length", "max_points", "settled", "lost")
"""Meanings of the flags of how a branch ends."""

NONE, LENGTH, MAX_POINTS, SETTLED, LOST = range(len(ENDS))

_END = 1e-5  # sizes: of the first segment, at most, so that it is straight
_LONGEST = 1e-6  # sizes: δ at most; rounding of points moves images along the curve by 1e-16/δ of x
_SHORT = 1e-11  # sizes: a start below it says nothing

_VISIBLE = 1e-3  # sizes: where points begin
_SAGITTA = 0.05  # of the spacing: largest product of the turn at a point and the distance to a neighbour
_SHARP, _SHORTEST = 0.3, 1e-4  # rad, and of the spacing: neighbours turn by more only where they are nearer
_PARTS = 8  # of a segment that is added
_FINEST, _ROUNDING = 1e-9, 1e-15  # of x, and in sizes over δ: neighbours are not brought nearer
_STILL = 1e-6  # sizes: a branch that has grown by less in a segment has settled
_MOST_SEGMENTS = 512  # beyond those that are too short to be seen
_MOST_TURNS = 4096
_BLOWN = 1e6  # sizes: points further away are none
_BROKEN = 1e3  # times as fast in x as beside it: between points on both sides of a jump
_SAFETY = 2.0
_LAST_DIGITS = 4.0  # of the largest coordinate: rounding of an image, whose operations are a few


class Curves(NamedTuple):
    """Branches of manifolds as functions of x.

    Attributes:
        strobe: the map, or its inverse.
        p: parameters of each, by name, (branches,).
        points, directions: (branches, d); a direction has the length 1 in sizes.
        multiplier: of a turn of the orbit, (branches,).
        delta: δ, in sizes, (branches,).
        earlier: segments that points begin earlier than need be, (branches,).
        returns: of the map in a turn.
        size: (branches, d).
    """

    strobe: Maps
    p: Mapping[str, Float[np.ndarray, " branches"]]
    points: Float[np.ndarray, "branches d"]
    directions: Float[np.ndarray, "branches d"]
    multiplier: Float[np.ndarray, " branches"]
    delta: Float[np.ndarray, " branches"]
    earlier: Int[np.ndarray, " branches"]
    returns: int
    size: Float[np.ndarray, "branches d"]

    @property
    def growth(self) -> Float[np.ndarray, " branches"]:
        """Logarithm of m, (branches,)."""
        return np.log(np.abs(self.multiplier))


def curves_of(
    strobe: Maps,
    p: Mapping[str, Float[np.ndarray, " branches"]],
    germs: Germs,
    returns: int,
    size: Float[np.ndarray, "branches d"],
    again: bool = False,
) -> Curves:
    """Return the curves that begin with germs of orbits of so many returns, one each.

    Args:
        again: whether points begin at half of δ or nearer, whole segments earlier, where that is not below rounding.
    """
    modulus = np.abs(germs.multiplier)
    delta = np.minimum(_LONGEST, _END / modulus)
    with np.errstate(invalid="ignore", divide="ignore"):
        segments = np.clip(np.ceil(np.log(2.0) / np.log(modulus)), 1, _MOST_TURNS)
        earlier = np.where(again & (delta > _SHORT * modulus**segments), segments, 0).astype(int)
    return Curves(strobe, p, germs.points, germs.directions, germs.multiplier, delta, earlier, returns, size)


class ManifoldBranch(NamedTuple):
    """Points of one branch, the point of the orbit first.

    Attributes:
        x: (points,), −∞ at the first.
        points: section coordinates, (points, d).
        arc: length up to each, in sizes, (points,).
        end: number in `ENDS`.
    """

    x: Float[np.ndarray, " points"]
    points: Float[np.ndarray, "points d"]
    arc: Float[np.ndarray, " points"]
    end: int


def positions(
    lanes: LaneRunner, curves: Curves, which: Int[np.ndarray, " some"], x: Float[np.ndarray, " some"]
) -> Float[np.ndarray, "some d"]:
    """Return points of curves."""
    returns, u = _begin(curves, which, x)
    return np.asarray(lanes(section_map, (curves.strobe,), (returns, u, select(dict(curves.p), which))))


def tangents(
    lanes: LaneRunner, curves: Curves, which: Int[np.ndarray, " some"], x: Float[np.ndarray, " some"]
) -> tuple[Float[np.ndarray, "some d"], Float[np.ndarray, "some d"]]:
    """Return points of curves and their derivatives in x."""
    returns, u = _begin(curves, which, x)
    at = lanes(derivatives, (curves.strobe,), (returns, u, select(dict(curves.p), which)))
    moved = (u - curves.points[which]) * curves.growth[which, None]
    return np.asarray(at.image), np.einsum("nij,nj->ni", np.asarray(at.monodromy), moved)


def _begin(
    curves: Curves, which: Int[np.ndarray, " some"], x: Float[np.ndarray, " some"]
) -> tuple[Int[np.ndarray, " some"], Float[np.ndarray, "some d"]]:
    segment, earlier = np.floor(x), curves.earlier[which]
    turns = (segment + earlier).astype(np.int32)
    share = curves.delta[which] * np.exp(curves.growth[which] * (x - segment - earlier))
    share = np.where((curves.multiplier[which] < 0.0) & (turns % 2 == 1), -share, share)
    return turns * np.int32(curves.returns), curves.points[which] + share[:, None] * curves.directions[which]


def grow(
    lanes: LaneRunner, curves: Curves, wrap: Wrap, length: float, spacing: float, most: int
) -> list[ManifoldBranch | None]:
    """Return the branches up to an arc length, in sizes; None where the manifold has not one dimension."""
    count = len(curves.growth)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.floor(np.log(_VISIBLE / curves.delta) / curves.growth)
    alive = np.isfinite(curves.growth) & np.isfinite(curves.points).all(axis=1) & (first < _MOST_TURNS)
    growing = {
        int(b): _Growing(curves, int(b), float(first[b]), wrap, length, spacing, most) for b in np.flatnonzero(alive)
    }
    asked = {b: branch.begin() for b, branch in growing.items()}
    while asked:
        which = np.concatenate([np.full(len(x), b) for b, x in asked.items()])
        points = positions(lanes, curves, which, np.concatenate(list(asked.values())))
        places = np.cumsum([len(x) for x in asked.values()])[:-1]
        for (b, x), new in zip(asked.items(), np.split(points, places), strict=True):
            growing[b].insert(x, new)
        wanted = {b: growing[b].wants() for b in asked}
        asked = {b: x for b, x in wanted.items() if len(x)}
    return [growing[b].branch() if b in growing else None for b in range(count)]


class _Growing:
    """A branch while it grows."""

    def __init__(
        self, curves: Curves, number: int, first: float, wrap: Wrap, length: float, spacing: float, most: int
    ) -> None:
        self.start, self.size, self.first = curves.points[number], curves.size[number], first
        self.wrap, self.length, self.spacing, self.most = wrap, length, spacing, most
        self.finest = max(_FINEST, _ROUNDING / float(curves.delta[number]))
        self.x, self.u, self.end = np.zeros(0), np.zeros((0, len(self.start))), NONE

    def begin(self) -> Float[np.ndarray, " some"]:
        return self.first + np.arange(_PARTS + 1) / _PARTS

    def insert(self, x: Float[np.ndarray, " some"], u: Float[np.ndarray, "some d"]) -> None:
        """Add points in their order."""
        with np.errstate(invalid="ignore"):
            fine = (np.abs(u) < _BLOWN * self.size).all(axis=1)
        order = np.argsort(np.concatenate([self.x, x]), kind="stable")
        self.x = np.concatenate([self.x, x])[order]
        self.u = np.concatenate([self.u, np.where(fine[:, None], u, np.nan)])[order]

    def wants(self) -> Float[np.ndarray, " some"]:
        """Return values of x to be added, none once the branch is done."""
        arc, chord = self._arc()
        known = len(arc)  # points before the first that is none
        gaps = self._coarse(chord) & (arc[:-1] < self.length) & (np.diff(self.x[:known]) > self.finest)
        middles = 0.5 * (self.x[: known - 1] + self.x[1:known])[gaps]
        if known < len(self.x) and arc[-1] < self.length and self.x[known] - self.x[known - 1] > self.finest:
            middles = np.append(middles, 0.5 * (self.x[known - 1] + self.x[known]))
        if not len(middles) and arc[-1] >= self.length:
            self.end = LENGTH
        elif known >= self.most:
            self.end = MAX_POINTS
        elif len(middles):
            return middles[: self.most - known]
        elif known < len(self.x):
            self.end = LOST
        elif self._settled(arc):
            self.end = SETTLED
        else:
            return self.x[-1] + (1 + np.arange(_PARTS)) / _PARTS
        return np.zeros(0)

    def _settled(self, arc: Float[np.ndarray, " known"]) -> bool:
        before = np.searchsorted(self.x, self.x[-1] - 1.0)
        return bool(arc[-1] - arc[before] < _STILL or self.x[-1] > self.first + _MOST_SEGMENTS)

    def _arc(self) -> tuple[Float[np.ndarray, " known"], Float[np.ndarray, "known d"]]:
        """Return arc lengths of the points before the first that is none, and chords between them, in sizes."""
        bad = np.flatnonzero(~np.all(np.isfinite(self.u), axis=1))
        known = int(bad[0]) if len(bad) else len(self.u)
        chord = self.wrap(np.diff(self.u[:known], axis=0)) / self.size if known > 1 else np.zeros((0, len(self.size)))
        begin = np.linalg.norm(self.wrap(self.u[:1] - self.start) / self.size) if known else 0.0
        return begin + np.concatenate([np.zeros(min(known, 1)), np.cumsum(np.linalg.norm(chord, axis=1))]), chord

    def _coarse(self, chord: Float[np.ndarray, "gaps d"]) -> np.ndarray:
        """Return which gaps are too long, or turn too much for their length."""
        distance = np.linalg.norm(chord, axis=1)
        if len(distance) < 2:
            return distance > self.spacing
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = np.sum(chord[1:] * chord[:-1], axis=1) / (distance[1:] * distance[:-1])
        turn = np.nan_to_num(np.arccos(np.clip(cosine, -1.0, 1.0)))
        turn = np.maximum(np.append(turn, 0.0), np.insert(turn, 0, 0.0))
        bent = (turn * distance > _SAGITTA * self.spacing) | ((turn > _SHARP) & (distance > _SHORTEST * self.spacing))
        return (distance > self.spacing) | bent

    def branch(self) -> ManifoldBranch | None:
        """Return the points up to the length."""
        arc, _ = self._arc()
        if not len(arc):
            return None
        kept = min(int(np.searchsorted(arc, self.length)) + 1, len(arc), self.most - 1)
        x, u = np.insert(self.x[:kept], 0, -np.inf), np.insert(self.u[:kept], 0, self.start, axis=0)
        return ManifoldBranch(x, u, np.insert(arc[:kept], 0, 0.0), self.end)


def error_of_distance(
    distance: Float[np.ndarray, " *shape"], largest: Float[np.ndarray, " *shape"]
) -> Float[np.ndarray, " *shape"]:
    """Return the error across of curves that twice the steps and a start nearer to the saddle move by a distance.

    Of a method of order p the error is 2^p / (2^p - 1) of what twice the steps change, at most twice it. Of a start
    that is off by δ² it is at most 4/3 of what a start at half of δ changes, whatever the images contract it by on the
    way. Both are zero where rounding alone is left, that of the last image.

    Args:
        distance: in sizes.
        largest: modulus of the coordinates, in sizes.
    """
    return _SAFETY * distance + _LAST_DIGITS * np.finfo(float).eps * largest


def distance_from(branch: ManifoldBranch, points: Float[np.ndarray, "points d"], size: np.ndarray, wrap: Wrap) -> float:
    """Return the largest distance, in sizes, of points from the curve of a branch near its points beside them.

    What lies along the curve is no distance: where a point is on it depends on m and δ. The curve between points is a
    parabola in x; points that lie along it further off than its neighbours are compared with all straight pieces, and
    so are those next to where a jump breaks it.
    """
    x, u = branch.x[1:], branch.points[1:]
    if len(x) < 3:
        return np.nan
    ahead, back = wrap(u[2:] - u[1:-1]) / size, wrap(u[:-2] - u[1:-1]) / size
    right, left = (x[2:] - x[1:-1])[:, None], (x[:-2] - x[1:-1])[:, None]
    bend = (ahead / right - back / left) / (right - left)
    slope = ahead / right - bend * right
    # At an end it is that of the neighbour, and goes on beyond by as much as it comes from there.
    slope = np.concatenate([slope[:1] + 2.0 * bend[:1] * left[:1], slope, slope[-1:] + 2.0 * bend[-1:] * right[-1:]])
    bend = np.concatenate([bend[:1], bend, bend[-1:]])
    low, high = np.append(left[:1, 0], -np.diff(x)), np.append(np.diff(x), right[-1:, 0])
    gap = wrap(points - u) / size
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.sum(gap * slope, axis=1) / np.sum(slope * slope, axis=1)
        across = np.linalg.norm(gap - shift[:, None] * slope - shift[:, None] ** 2 * bend, axis=1)
    speed = np.linalg.norm(wrap(np.diff(u, axis=0)) / size, axis=1) / np.diff(x)
    broken = speed > _BROKEN * np.maximum(np.append(speed[1:], 0.0), np.append(0.0, speed[:-1]))
    beside = broken[:-1] | broken[1:]
    beside = np.concatenate([beside[:1], beside, beside[-1:]])
    far = (beside | ~((low <= shift) & (shift <= high))) & np.isfinite(points).all(axis=1)
    across[far] = [_distance_from_pieces(u, point, size, wrap) for point in points[far]]
    return float(np.nanmax(across, initial=0.0))


def _distance_from_pieces(u: Float[np.ndarray, "points d"], point: np.ndarray, size: np.ndarray, wrap: Wrap) -> float:
    """Return the distance of a point from the nearest straight piece between neighbours, in sizes."""
    pieces, away = wrap(np.diff(u, axis=0)) / size, wrap(point - u[:-1]) / size
    squares = np.maximum(np.sum(pieces * pieces, axis=1), np.finfo(float).tiny)  # neighbours may be equal
    share = np.clip(np.sum(away * pieces, axis=1) / squares, 0.0, 1.0)
    return float(np.min(np.linalg.norm(away - share[:, None] * pieces, axis=1)))
