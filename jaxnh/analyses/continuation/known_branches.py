"""Comparison of orbits with the branches that are known. Host code: branches are cubics between their points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.orbits.continuation.arclength import Family, PathVector, inner, length
from jaxnh.orbits.continuation.branches import Branch

SAME = 1e-4
"""Lengths: cubics between points are nearer to the branch than this, and other branches are further, mostly."""
_ALONG = 100.0  # times that: where a branch is steep in its orbits, a cubic is as far off along it at one value
_HALVINGS = 40
_REACH = 2.0  # chords: a cubic goes no further than 1.3 from its beginning


class KnownBranches:
    """Branches of one period, point after point in one table: an orbit is compared with all of them at once.

    Args:
        family: the map.
        branches: those that are known to begin with; of other periods they do not count.
        period: points of an orbit.
    """

    def __init__(self, family: Family, branches: Sequence[Branch], period: int) -> None:
        self._family, self._period, self._count = family, period, 0
        self._value, self._rate = np.zeros((2, 0))
        self._points, self._way = np.zeros((2, 0, period, len(family.size)))
        self._begins = np.zeros(0, bool)
        for branch in branches:
            self.add(branch)

    def add(self, branch: Branch) -> None:
        """Have one branch more."""
        if branch.period != self._period:
            return
        count, more = self._count, len(branch.value)
        self._count += more
        begins = np.arange(more) == 0
        columns = (branch.value, branch.way.value, branch.points, branch.way.points, begins)
        tables = (self._value, self._rate, self._points, self._way, self._begins)
        tables = [_with_room(table, self._count) for table in tables]
        for table, column in zip(tables, columns, strict=True):
            table[count : self._count] = column
        self._value, self._rate, self._points, self._way, self._begins = tables

    def has(self, points: Float[np.ndarray, "n d"], value: float, near: float = SAME) -> bool:
        """Return whether an orbit at a parameter value is on one of them, whichever of its points comes first."""
        first, ends = self._passing(value)
        if len(first):
            chord = length(
                self._family, PathVector(*(part[first + 1] - part[first] for part in (self._points, self._value)))
            )
            first = first[_distances_from(self._family, self._points[first], points) <= _REACH * chord + near]
        there, ways = self._orbits(first, ends, value)
        return bool(len(there) and _distances_across(self._family, there, ways, points, _ALONG * near).min() <= near)

    def orbits_at(self, value: float) -> Float[np.ndarray, "some n d"]:
        """Their orbits at a value of the parameter, nearly; where one turns, perhaps two."""
        return self._orbits(*self._passing(value), value)[0]

    def _passing(self, value: float) -> tuple[Int[np.ndarray, " some"], Int[np.ndarray, " ends"]]:
        """Points between which and the next branches may pass a value, and ends of branches that are at it."""
        count = self._count
        above, rate, begins = self._value[:count] - value, self._rate[:count], self._begins[:count]
        passes = (above[:-1] <= 0.0) != (above[1:] <= 0.0)
        turns = (rate[:-1] < 0.0) != (rate[1:] < 0.0)
        last = np.append(begins[1:], True)
        return np.flatnonzero((passes | turns) & ~begins[1:]), np.flatnonzero((begins | last[:count]) & (above == 0.0))

    def _orbits(
        self, first: Int[np.ndarray, " some"], ends: Int[np.ndarray, " ends"], value: float
    ) -> tuple[Float[np.ndarray, "more n d"], PathVector]:
        """Return orbits at a value, and the directions of branches there."""
        pairs = np.stack([first, first + 1])
        between, ways = _on_cubics(
            self._family,
            self._points[pairs],
            self._value[pairs],
            PathVector(self._way[pairs], self._rate[pairs]),
            value,
        )
        every = PathVector(
            np.concatenate([self._way[ends], ways.points]), np.concatenate([self._rate[ends], ways.value])
        )
        return np.concatenate([self._points[ends], between]), every


def is_on_branch(family: Family, branches: Sequence[Branch], points: Float[np.ndarray, "n d"], value: float) -> bool:
    """Return whether an orbit at a parameter value is on one of the branches, whichever of its points comes first."""
    return KnownBranches(family, branches, len(points)).has(points, value)


def orbits_at(family: Family, branches: Sequence[Branch], value: float) -> Float[np.ndarray, "some n d"]:
    """The orbits of branches of one period at a value of the parameter, nearly; where one turns, perhaps two."""
    return KnownBranches(family, branches, branches[0].period).orbits_at(value)


def same_orbit(family: Family, first: Float[np.ndarray, "n d"], second: Float[np.ndarray, "n d"], near: float) -> bool:
    """Return whether two orbits are as near as this in lengths, whichever of their points comes first."""
    return len(first) == len(second) and bool(_distances_from(family, first[None], second)[0] <= near)


def _with_room(table: np.ndarray, count: int) -> np.ndarray:
    """The table, or a copy of it of twice the length where it has no room for so many rows."""
    if count <= len(table):
        return table
    larger = np.zeros((2 * count, *table.shape[1:]), table.dtype)
    larger[: len(table)] = table
    return larger


def _on_cubics(
    family: Family,
    points: Float[np.ndarray, "2 some n d"],
    values: Float[np.ndarray, "2 some"],
    ways: PathVector,
    value: float,
) -> tuple[Float[np.ndarray, "more n d"], PathVector]:
    """Return the orbits at a value on cubics between points of branches and their next, and the cubics' directions."""
    size = length(family, PathVector(points[1] - points[0], values[1] - values[0]))
    rates, slopes = size * ways.value, size[:, None, None] * ways.points

    def rise(s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return _cubic_slope(s, values[:, rows], rates[:, rows])

    def above(s: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return _cubic(s, values[:, rows], rates[:, rows]) - value

    zeros, ones, every = np.zeros(len(size)), np.ones(len(size)), np.arange(len(size))
    turn, turns = zeros.copy(), np.flatnonzero(rise(zeros, every) * rise(ones, every) < 0.0)
    turn[turns] = _zeros(partial(rise, rows=turns), zeros[turns], ones[turns])
    orbits, directions = list[np.ndarray](), list[PathVector]()
    for low, high in ((zeros, turn), (turn, ones)):
        rows = np.flatnonzero((above(low, every) <= 0.0) != (above(high, every) <= 0.0))
        places = _zeros(partial(above, rows=rows), low[rows], high[rows])
        orbits.append(_cubic(places[:, None, None], points[:, rows], slopes[:, rows]))
        turned = _cubic_slope(places[:, None, None], points[:, rows], slopes[:, rows])
        directions.append(PathVector(turned, _cubic_slope(places, values[:, rows], rates[:, rows])))
    return np.concatenate(orbits), PathVector(*map(np.concatenate, zip(*directions, strict=True)))


def _cubic(s: np.ndarray, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Hermite's polynomials from one end (s = 0) to the other (s = 1)."""
    left = 1.0 - s
    bent = s * s * (3.0 - 2.0 * s)
    return ends[0] + bent * (ends[1] - ends[0]) + s * left * left * slopes[0] - s * s * left * slopes[1]


def _cubic_slope(s: np.ndarray, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Derivatives in s of Hermite's polynomials."""
    left = 1.0 - s
    return 6.0 * s * left * (ends[1] - ends[0]) + left * (1.0 - 3.0 * s) * slopes[0] + s * (3.0 * s - 2.0) * slopes[1]


def _zeros(
    function: Callable[[np.ndarray], np.ndarray], low: Float[np.ndarray, " some"], high: Float[np.ndarray, " some"]
) -> Float[np.ndarray, " some"]:
    """Bisect for the places where functions change sign."""
    if not len(low):
        return low
    positive: Bool[np.ndarray, " some"] = function(high) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        beyond = (function(middle) > 0.0) == positive
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return 0.5 * (low + high)


def _distances_from(
    family: Family, orbits: Float[np.ndarray, "orbits n d"], orbit: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, " orbits"]:
    """Distances of orbits from an orbit, in lengths, the least over its first points."""
    none = np.zeros(len(orbits))
    shifted = (np.roll(orbit, m, 0) for m in range(len(orbit)))
    return np.min([length(family, PathVector(family.wrap(orbits - start), none)) for start in shifted], axis=0)


def _distances_across(
    family: Family,
    orbits: Float[np.ndarray, "orbits n d"],
    ways: PathVector,
    orbit: Float[np.ndarray, "n d"],
    far: float,
) -> Float[np.ndarray, " orbits"]:
    """Distances of branches through orbits, in their directions there, from an orbit; whole ones of those far away."""
    none, unit = np.zeros(len(orbits)), length(family, ways)
    least = np.full(len(orbits), np.inf)
    for m in range(len(orbit)):
        way = PathVector(family.wrap(orbits - np.roll(orbit, m, 0)), none)
        whole = length(family, way)
        with np.errstate(invalid="ignore"):  # ends of a branch of one point have no direction
            along = np.nan_to_num(inner(family, way, ways) / unit)
        across = np.sqrt(np.maximum(whole**2 - along**2, 0.0))
        least = np.minimum(least, np.where(whole <= far, across, whole))
    return least
