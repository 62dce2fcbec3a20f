"""Orbits on the curve of a family over a parameter, and the equations of cycles for the core. Host code.

The unknowns are all n points of the orbit and the parameter, so that folds are points like others (Keller, in
Applications of Bifurcation Theory, 1977, 359). Lengths are measured in sizes of the motion and in the width of the
range of the parameter: |(U, λ)|² = mean over the points of |u/size|², + (λ/width)². Every lane is a curve of its own.

An equilibrium is the orbit of one point of the map u + f(u; λ), with the rate f of the coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits import cyclic
from jaxnh.orbits.continuation import core, paths
from jaxnh.orbits.continuation.core import ROUGH, Evaluation, LinearSolution, Solution
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

_SAME = 1e-6  # sizes: an orbit this near to one of a shorter period is that one


class PeriodAndParameter(Protocol):
    """P, ∂P/∂u and ∂P/∂λ of lanes: `derivatives` of one period with a parameter named."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"], /) -> Derivatives:
        """Evaluate at points and values of the parameter, a lane each."""
        ...


class Family(NamedTuple):
    """A map with a parameter, and what is large there.

    Attributes:
        period: the map and its derivatives over lanes.
        wrap: of differences of section coordinates.
        size: of the motion in each section coordinate, (d,).
        low, high: ends of the range of the parameter.
        field: whether the map is u + f(u), and its orbits equilibria of a field f.
        at_once: branches that are followed side by side: together they fill tiles, and few are followed twice.
    """

    period: PeriodAndParameter
    wrap: Wrap
    size: Float[np.ndarray, " d"]
    low: float
    high: float
    field: bool = False
    at_once: int = 32

    @property
    def width(self) -> float:
        """Width of the parameter's range."""
        return self.high - self.low


class PathVector(NamedTuple):
    """Directions or differences of orbits and parameters, side by side: (lanes, n, d) and (lanes,)."""

    points: Float[np.ndarray, "lanes n d"]
    value: Float[np.ndarray, " lanes"]


class CurveOrbits(NamedTuple):
    """Orbits on curves, a lane each.

    Attributes:
        points: section coordinates, (lanes, n, d).
        value: of the parameter, (lanes,).
        way: direction of the curve, of length one.
        blocks: ∂P/∂u at each point, in units of sizes, (lanes, n, d, d).
        crossing: determinant of the equations around the orbit with the direction as one more; it changes sign where
            another curve passes through, and nowhere else, (lanes,).
        residual: largest component of P(u_i) − u_{i+1} in sizes, (lanes,).
        missed: how far Newton has gone from the guess, in lengths, (lanes,).
        converged: whether Newton has come to rest, (lanes,).
        other_way: the direction across `way` that solves the linear equations where two curves cross, of length one.
    """

    points: Float[np.ndarray, "lanes n d"]
    value: Float[np.ndarray, " lanes"]
    way: PathVector
    blocks: Float[np.ndarray, "lanes n d d"]
    crossing: Float[np.ndarray, " lanes"]
    residual: Float[np.ndarray, " lanes"]
    missed: Float[np.ndarray, " lanes"]
    converged: Bool[np.ndarray, " lanes"]
    other_way: PathVector

    def take(self, lanes: Int[np.ndarray, " some"] | Bool[np.ndarray, " lanes"] | slice) -> CurveOrbits:
        """Return the entries of a subset of lanes."""
        return select(self, lanes)


def inner(family: Family, first: PathVector, second: PathVector) -> Float[np.ndarray, " lanes"]:
    """Inner products of ways."""
    by_points = np.mean(np.sum((first.points / family.size) * (second.points / family.size), axis=2), axis=1)
    return by_points + first.value * second.value / family.width**2


def length(family: Family, way: PathVector) -> Float[np.ndarray, " lanes"]:
    """Lengths of ways."""
    return np.sqrt(inner(family, way, way))


def times(factor: Float[np.ndarray, " lanes"], way: PathVector) -> PathVector:
    """Ways times numbers."""
    return PathVector(factor[:, None, None] * way.points, factor * way.value)


def minus(first: PathVector, factor: Float[np.ndarray, " lanes"], second: PathVector) -> PathVector:
    """Ways less so many times others."""
    more = times(factor, second)
    return PathVector(first.points - more.points, first.value - more.value)


def along_parameter(family: Family, lanes: int, n: int) -> PathVector:
    """The way of length one in which the parameter alone changes."""
    return PathVector(np.zeros((lanes, n, len(family.size))), np.full(lanes, family.width))


def correct(
    family: Family,
    points: Float[np.ndarray, "lanes n d"],
    value: Float[np.ndarray, " lanes"],
    across: PathVector,
    tolerance: float = ROUGH,
    slack: Float[np.ndarray, " lanes"] | None = None,
) -> CurveOrbits:
    """The orbits on curves nearest to guesses in the hyperplanes across ways, and the direction of the curve there.

    Angles go on from those of the guess. The direction of the curve has a positive share of the way.

    Args:
        family: the map.
        points, value: guesses.
        across: ways, to which steps of Newton are orthogonal.
        tolerance: length of a step after which an orbit is known.
        slack: lengths of steps that need not be half of the last, by default none.
    """
    z, normal = (join_path(part) for part in (PathVector(points, value), across))
    equations = CycleEquations(family, points.shape[1])
    return orbits_of(family, core.correct(equations, z, normal, tolerance, slack=slack))


def join_path(path: PathVector) -> Float[np.ndarray, "lanes N"]:
    """Points and parameters as unknowns side by side, N = nd + 1."""
    lanes, n, d = path.points.shape
    return np.concatenate([path.points.reshape(lanes, n * d), path.value[:, None]], axis=1)


def split_path(family: Family, z: Float[np.ndarray, "lanes N"]) -> PathVector:
    """Points and parameters of unknowns."""
    d = len(family.size)
    return PathVector(z[:, :-1].reshape(len(z), (z.shape[1] - 1) // d, d), z[:, -1])


def orbits_of(family: Family, solution: Solution) -> CurveOrbits:
    """The orbits of solutions of `CycleEquations`."""
    (points, value), way, other = (split_path(family, z) for z in (solution.z, solution.way, solution.other))
    known = (solution.blocks, solution.determinant, solution.residual, solution.missed, solution.converged)
    return CurveOrbits(points, value, way, *known, other)


def solution_of(orbits: CurveOrbits) -> Solution:
    """Orbits as solutions of `CycleEquations`."""
    z, way, other = (
        join_path(part) for part in (PathVector(orbits.points, orbits.value), orbits.way, orbits.other_way)
    )
    return Solution(z, way, other, orbits.crossing, orbits.blocks, orbits.residual, orbits.missed, orbits.converged)


class CycleEquations:
    """P(u_i; λ) = u_{i+1} around orbits of n points, as equations of the core (`core.CurveEquations`)."""

    def __init__(self, family: Family, n: int) -> None:
        self.family, self._n = family, n
        self.unit = np.append(np.tile(family.size, n) * np.sqrt(n), family.width)
        self.low, self.high = np.array([family.low]), np.array([family.high])

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """u_{i+1} − P(u_i), ∂P/∂u and ∂P/∂λ, in units of sizes and of the width."""
        points, value = split_path(self.family, z)
        lanes, n, d = points.shape
        size = self.family.size
        image, matrix, column = self.family.period(points.reshape(-1, d), np.repeat(value, n))
        assert column is not None
        missing = self.family.wrap(np.roll(points, -1, 1) - np.asarray(image).reshape(points.shape)) / size
        blocks = np.asarray(matrix).reshape(lanes, n, d, d) * (size / size[:, None])
        columns = np.asarray(column).reshape(points.shape) * (self.family.width / size)
        return Evaluation(missing.reshape(lanes, n * d), blocks, columns)

    def solve(self, at: Evaluation, /) -> LinearSolution:
        """Solve by elimination around the orbit; no product is formed."""
        there = np.broadcast_to(-np.eye(at.blocks.shape[-1]), at.blocks.shape)
        cycle = cyclic.eliminate(at.blocks, there)
        solved = cyclic.underdetermined(cycle, at.residual.reshape(at.slopes.shape), at.slopes)
        size, width = self.family.size, self.family.width
        parts = ((solved.y, solved.x), (solved.way, solved.rate), (solved.other_way, solved.other_rate))
        least, null, other = (join_path(PathVector(points * size, value * width)) for points, value in parts)
        return LinearSolution(least, null, other, cyclic.determinant(cycle._replace(closed=solved.square)))

    def difference(self, gap: Float[np.ndarray, "lanes N"], /) -> Float[np.ndarray, "lanes N"]:
        """Angles wrapped."""
        points, value = split_path(self.family, gap)
        return join_path(PathVector(self.family.wrap(points), value))

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterator[Float[np.ndarray, "lanes N"]]:
        """The same orbit from each of its points on."""
        points, value = split_path(self.family, z)
        return (join_path(PathVector(np.roll(points, m, 1), value)) for m in range(self._n))

    def room(self, now: Solution, /) -> Float[np.ndarray, " lanes"]:
        """Half of how far orbits that have just been born in a doubling are from its orbit."""
        none = np.zeros(len(now.z))
        if self._n % 2:
            return none + np.inf
        points, way = (split_path(self.family, z).points for z in (now.z, now.way))
        gap, change = (PathVector(_half_turn(part), none) for part in (points, way))
        gap = gap._replace(points=self.family.wrap(gap.points))
        apart = inner(self.family, gap, change) > 0.0
        return np.where(apart, 0.5 * length(self.family, gap), np.inf)

    def endings(
        self, now: Solution, taken: Solution, /
    ) -> tuple[dict[int, Bool[np.ndarray, " lanes"]], Bool[np.ndarray, " lanes"]]:
        """Orbits that are, or have been on the way, ones of a shorter period; and whether they still are.

        That is a doubling that the branch is born in. Beyond it, it has the same orbits again, half a period on.
        """
        before, after = (split_path(self.family, part.z).points for part in (now, taken))
        collapsed, merged = collapses(before, after, self.family.wrap, self.family.size)
        return {paths.COLLAPSED: collapsed}, merged


def collapses(
    before: Float[np.ndarray, "lanes n d"],
    after: Float[np.ndarray, "lanes n d"],
    wrap: Wrap,
    size: Float[np.ndarray, " d"],
) -> tuple[Bool[np.ndarray, " lanes"], Bool[np.ndarray, " lanes"]]:
    """Tell whether orbits come to those of a shorter period from one place to the next, or are there.

    Gaps between points change by what the points do: of angles one that grows beyond half a turn is not turned round.
    """
    n = before.shape[1]
    collapsed, merged = np.zeros((2, len(before)), bool)
    with np.errstate(invalid="ignore"):
        moved = wrap(after - before)
        for m in (n // q for q in range(2, n + 1) if n % q == 0 and all(q % r for r in range(2, q))):
            gap, change = wrap(before - np.roll(before, -m, 1)) / size, (moved - np.roll(moved, -m, 1)) / size
            shortest = wrap(after - np.roll(after, -m, 1)) / size
            merged |= np.sqrt(np.mean(np.sum(shortest**2, axis=2), axis=1)) < _SAME
            collapsed |= merged | (np.sum(np.sum(gap * (gap + change), axis=2), axis=1) <= 0.0)
    return collapsed, merged


def _half_turn(points: np.ndarray) -> np.ndarray:
    """Differences from each point (or vector) to the one half a period later."""
    return points - np.roll(points, points.shape[1] // 2, 1)
