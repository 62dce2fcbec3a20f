"""Manifolds of dimension two of a flow as triangles, whose corners are points of motions side by side.

Motions begin on a rim, and have corners at equal parts of their way. Where neighbours part another one begins between
them, on the rim too: no corner is interpolated. It counts from the last part at which both were near, so that corners
are about evenly spaced (Krauskopf, Osinga et al., Int. J. Bifurcation Chaos 15 (2005) 763, compare this with other
methods by the Lorenz manifold).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.manifolds.motions import ORDER, Front, follow_motion
from jaxnh.systems.flow import Flow
from jaxnh.systems.rows import concatenate, select

ENDS = ("none", "length", "max_points")
"""Meanings of the flags of how a surface ends."""

NONE, LENGTH, MAX_POINTS = range(len(ENDS))

_PARTS = 32  # of a motion in a call
_TILE = 32
_MOST = 64  # steps of a part
_ROUNDS = 256
_OPEN = 2.0  # spacings: neighbours further apart have no triangle between them


class SurfaceMesh(NamedTuple):
    """Corners and triangles of a manifold.

    Attributes:
        points: (points, d), in sizes of the coordinates.
        error: distance of each from the manifold, (points,), in sizes.
        arc: distance from the equilibrium or cycle to each, (points,), in sizes.
        triangles: numbers of corners, (triangles, 3).
        end: number in `ENDS`.
        gaps: pairs of neighbours that part within the digits of where they begin: the surface is open between them.
    """

    points: Float[np.ndarray, "points d"]
    error: Float[np.ndarray, " points"]
    arc: Float[np.ndarray, " points"]
    triangles: Int[np.ndarray, "triangles 3"]
    end: int
    gaps: int


def fitting(mesh: SurfaceMesh, most: int) -> SurfaceMesh:
    """Return a mesh, or its first corner alone where it has more than may be even so far as it is cut."""
    if len(mesh.points) <= most:
        return mesh
    centre = mesh.points[:1], mesh.error[:1], mesh.arc[:1]
    return SurfaceMesh(*centre, np.zeros((0, 3), int), MAX_POINTS, mesh.gaps)


class Rim(Protocol):
    """The places that the motions of a surface begin at.

    Attributes:
        closed: whether the last of them is next to the first.
        parts: of motions.
        first: places of the first motions in their order, (motions, k).
        inner: corners on the other side of the rim.
    """

    @property
    def closed(self) -> bool: ...

    @property
    def parts(self) -> int: ...

    @property
    def first(self) -> Float[np.ndarray, "motions k"]: ...

    @property
    def inner(self) -> int: ...

    def between(self, first: np.ndarray, second: np.ndarray) -> Float[np.ndarray, "pairs k"]:
        """Return places between two, pair by pair."""
        ...

    def begin(self, places: Float[np.ndarray, "motions k"]) -> Front:
        """Return the motions that begin at places."""
        ...


class Growth(NamedTuple):
    """The rules that surfaces grow by.

    Attributes:
        flow: without a clock.
        size: of the coordinates, (surfaces, d).
        p: parameters of each, by name, (surfaces,).
        sign: 1 of unstable manifolds, −1 of stable ones.
        spacing: largest distance of neighbours, in sizes.
        most: corners, at most.
        tolerance: error that steps are chosen by, in sizes.
        timed: whether parts of motions are so long in time, and not as arcs.
    """

    flow: Flow
    size: Float[np.ndarray, "surfaces d"]
    p: Mapping[str, Float[np.ndarray, " surfaces"]]
    sign: float
    spacing: float
    most: int
    tolerance: float
    timed: bool = False

    def take(self, which: Int[np.ndarray, " some"]) -> Growth:
        """Return the same of some surfaces, or of surfaces of some lanes."""
        return self._replace(size=self.size[which], p=select(dict(self.p), which))


def grow_fans(lanes: LaneRunner, growth: Growth, rims: Sequence[Rim]) -> list[Fan]:
    """Return the motions that begin on rims, one fan a surface, with as many steps as the tolerance needs.

    Each surface has steps of its own, whatever others it is grown with. Where more of them leave as large an error, it
    is of rounding.
    """
    fans, steps = [Fan(rim, growth) for rim in rims], np.ones(len(rims), int)
    before, number = np.full(len(rims), np.inf), np.arange(len(rims))
    while len(number):
        for count in np.unique(steps[number]).tolist():
            part = number[steps[number] == count]
            grown = _grow(lanes, growth.take(part), [rims[k] for k in part], count)
            for k, fan in zip(part.tolist(), grown, strict=True):
                fans[k] = fan
        largest = np.array([fans[k].largest_error for k in number])
        again = (largest > growth.tolerance) & (largest < 0.5 * before[number]) & (steps[number] < _MOST)
        before[number] = largest
        number, largest = number[again], largest[again]
        finer = np.maximum(1.0, np.ceil(np.log2(largest / growth.tolerance) / ORDER))
        steps[number] = np.minimum(steps[number] * 2 ** finer.astype(int), _MOST)
    return fans


def _grow(lanes: LaneRunner, growth: Growth, rims: Sequence[Rim], steps: int) -> list[Fan]:
    """Return fans of motions with so many steps for each part."""
    fans = [Fan(rim, growth) for rim in rims]
    wanted = [rim.first for rim in rims]
    for _ in range(_ROUNDS):
        which = np.repeat(np.arange(len(fans)), [len(places) for places in wanted])
        if not len(which):
            break
        front = concatenate(rim.begin(places) for rim, places in zip(rims, wanted, strict=True) if len(places))
        points, error = follow(lanes, growth, steps, which, front, max(fan.parts for fan in fans))
        for number, fan in enumerate(fans):
            own = which == number
            if own.any():
                fan.insert(wanted[number], points[own], error[own])
        wanted = [fan.wanted() for fan in fans]
    return fans


def follow(
    lanes: LaneRunner, growth: Growth, steps: int, which: Int[np.ndarray, " motions"], front: Front, parts: int
) -> tuple[Float[np.ndarray, "motions parts+1 d"], Float[np.ndarray, "motions parts+1"]]:
    """Return the points of motions of surfaces, the first included, and their errors."""
    points = [np.asarray(front.point)[:, None]]
    errors = [(np.linalg.norm(front.error, axis=1) + front.rounding)[:, None]]
    shared = growth.flow, np.int32(steps), np.float64(growth.sign)
    size, p = growth.size[which], select(dict(growth.p), which)
    for _ in range(math.ceil(parts / _PARTS)):
        more = lanes(follow_motion, shared, (front, size, p), tile=_TILE, static=(_PARTS, growth.timed))
        points.append(np.asarray(more.points))
        errors.append(np.asarray(more.error))
        front = more.front
    return np.concatenate(points, axis=1)[:, : parts + 1], np.concatenate(errors, axis=1)[:, : parts + 1]


class Fan:
    """Motions from a rim side by side.

    Attributes:
        places: of the rim, in order, (motions, k).
        points, error: at the ends of parts, (motions, parts + 1, …).
        born: number of the part from whose end on a motion counts, (motions,).
        parts: that are kept.
        end, gaps: as of a surface.
    """

    def __init__(self, rim: Rim, growth: Growth) -> None:
        self._rim, self._spacing, self._most = rim, growth.spacing, growth.most
        self.parts, self.end, self.gaps = rim.parts, LENGTH, 0
        self.places = np.zeros((0, rim.first.shape[1]))
        self.points, self.error = np.zeros((0, self.parts + 1, growth.size.shape[1])), np.zeros((0, self.parts + 1))
        self.born = np.zeros(0, int)
        self._next = np.zeros(len(rim.first), int), np.zeros(len(rim.first), int)  # numbers and births of those wanted

    @property
    def counted(self) -> Bool[np.ndarray, "motions parts+1"]:
        """Return which points are corners."""
        cut = self.parts + 1
        return np.isfinite(self.error[:, :cut]) & (np.arange(cut) >= self.born[:, None])

    @property
    def largest_error(self) -> float:
        """Return the largest error of a corner."""
        return float(np.max(self.error[:, : self.parts + 1], where=self.counted, initial=0.0))

    def insert(self, places: np.ndarray, points: np.ndarray, error: np.ndarray) -> None:
        """Add the motions that were wanted."""
        cut, (numbers, births) = self.parts + 1, self._next
        self.places = np.insert(self.places, numbers, places, axis=0)
        self.points = np.insert(self.points[:, :cut], numbers, points[:, :cut], axis=0)
        self.error = np.insert(self.error[:, :cut], numbers, error[:, :cut], axis=0)
        self.born = np.insert(self.born, numbers, births)

    def wanted(self) -> Float[np.ndarray, "motions k"]:
        """Return where further motions are to begin, none once neighbours are near each other."""
        self._fit()
        first = np.arange(len(self.places) if self._rim.closed else len(self.places) - 1)
        other = (first + 1) % len(self.places)
        cut, since = self.parts + 1, np.maximum(self.born[first], self.born[other])
        with np.errstate(invalid="ignore"):
            gap = np.linalg.norm(self.points[first, :cut] - self.points[other, :cut], axis=2)
            wide = (gap > self._spacing) & (np.arange(cut) >= since[:, None])
        apart = np.flatnonzero(wide.any(axis=1))
        between = self._rim.between(self.places[first[apart]], self.places[other[apart]])
        starts = np.asarray(self._rim.begin(between).point) if len(apart) else np.zeros((0, self.points.shape[2]))
        new = np.all([np.any(starts != self.points[end[apart], 0], axis=1) for end in (first, other)], axis=0)
        self.gaps, apart = int(np.sum(~new)), apart[new]
        self._next = apart + 1, np.maximum(np.argmax(wide[apart], axis=1) - 1, since[apart])
        return between[new]

    def _fit(self) -> None:
        """Cut the motions, or those that are last on an open rim, where there are more corners than may be."""
        counted = self.counted
        axis = 0 if self._rim.closed else 1
        numbers = self._rim.inner + np.cumsum(counted.sum(axis=axis))
        if numbers[-1] <= self._most:
            return
        room, self.end = max(int(np.searchsorted(numbers, self._most, side="right")), 2), MAX_POINTS
        if self._rim.closed:
            self.parts = min(self.parts, room - 1)
        else:
            self.places, self.points, self.error, self.born = (
                leaf[:room] for leaf in (self.places, self.points, self.error, self.born)
            )

    def bands(self, numbers: Int[np.ndarray, "motions parts+1"]) -> list[tuple[int, int, int]]:
        """Return the triangles between ends of parts, where neighbours are near each other on both.

        Args:
            numbers: of the corners, negative of points that are none.
        """
        triangles, gap = list[tuple[int, int, int]](), _OPEN * self._spacing
        for k in range(self.parts):
            lower, upper = np.flatnonzero(numbers[:, k] >= 0), np.flatnonzero(numbers[:, k + 1] >= 0)
            pairs = list(zip(lower.tolist(), np.roll(lower, -1).tolist(), strict=True))
            alive = set(upper.tolist())
            for i, j in pairs if self._rim.closed else pairs[:-1]:
                if i == j or i not in alive or j not in alive:
                    continue
                a, b = np.searchsorted(upper, [i, j]).tolist()
                chain = upper[a : b + 1] if a < b else np.concatenate([upper[a:], upper[: b + 1]])
                widths = np.linalg.norm(np.diff(self.points[chain, k + 1], axis=0), axis=1)
                if max(widths.max(), np.linalg.norm(self.points[i, k] - self.points[j, k])) <= gap:
                    triangles += strip(int(numbers[i, k]), int(numbers[j, k]), numbers[chain, k + 1].tolist())
        return triangles


def strip(i: int, j: int, chain: Sequence[int]) -> list[tuple[int, int, int]]:
    """Return the triangles between two corners and a chain of others, the ends of which are next to them."""
    middle = len(chain) // 2
    below = [(i, chain[k], chain[k + 1]) for k in range(middle)]
    above = [(j, chain[k], chain[k + 1]) for k in range(middle, len(chain) - 1)]
    return below + ([(i, chain[middle], j)] if i != j else []) + above
