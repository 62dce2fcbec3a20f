"""Orbits on the curve of a family over a parameter: Newton across the curve, and the curve's direction. Host code.

The unknowns are all n points of the orbit and the parameter, so that folds are points like others (Keller, in
Applications of Bifurcation Theory, 1977, 359). Lengths are measured in sizes of the motion and in the width of the
range of the parameter: |(U, λ)|² = mean over the points of |u/size|², + (λ/width)². Every lane is a curve of its own.

An equilibrium is the orbit of one point of the map u + f(u; λ), with the rate f of the coordinates.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits import cyclic
from jaxnh.systems.chart import Wrap

FINE = 1e-9
"""Step of Newton, in lengths, after which an orbit is known to rounding."""

ROUGH = 1e-6
"""Step of Newton, in lengths, whose square is small enough: between the marked points of a branch."""

_NEWTON_STEPS = 12
_CONTRACTION = 0.5  # of successive steps; Newton that contracts less is on its way to another curve


class PeriodAndParameter(Protocol):
    """P, ∂P/∂u and ∂P/∂λ of lanes: `derivatives` of one period with a parameter named."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"], /) -> Derivatives:
        """At points and values of the parameter, a lane each."""
        ...


class Family(NamedTuple):
    """A map with a parameter, and what is large there.

    Attributes:
        period: the map and its derivatives over lanes.
        wrap: of differences of section coordinates.
        size: of the motion in each section coordinate, (d,).
        low, high: ends of the range of the parameter.
        field: whether the map is u + f(u), and its orbits equilibria of a field f.
    """

    period: PeriodAndParameter
    wrap: Wrap
    size: Float[np.ndarray, " d"]
    low: float
    high: float
    field: bool = False

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

        def some(leaf: np.ndarray) -> np.ndarray:
            return leaf[lanes]

        return jax.tree.map(some, self)


def inner(family: Family, one: PathVector, other: PathVector) -> Float[np.ndarray, " lanes"]:
    """Inner products of ways."""
    by_points = np.mean(np.sum((one.points / family.size) * (other.points / family.size), axis=2), axis=1)
    return by_points + one.value * other.value / family.width**2


def length(family: Family, way: PathVector) -> Float[np.ndarray, " lanes"]:
    """Lengths of ways."""
    return np.sqrt(inner(family, way, way))


def times(factor: Float[np.ndarray, " lanes"], way: PathVector) -> PathVector:
    """Ways times numbers."""
    return PathVector(factor[:, None, None] * way.points, factor * way.value)


def minus(one: PathVector, factor: Float[np.ndarray, " lanes"], other: PathVector) -> PathVector:
    """Ways less so many times others."""
    more = times(factor, other)
    return PathVector(one.points - more.points, one.value - more.value)


def along_parameter(family: Family, lanes: int, n: int) -> PathVector:
    """The way of length one in which the parameter alone changes."""
    return PathVector(np.zeros((lanes, n, len(family.size))), np.full(lanes, family.width))


def correct(
    family: Family,
    points: Float[np.ndarray, "lanes n d"],
    value: Float[np.ndarray, " lanes"],
    across: PathVector,
    tolerance: float = ROUGH,
    near: Float[np.ndarray, " lanes"] | None = None,
) -> CurveOrbits:
    """The orbits on curves nearest to guesses in the hyperplanes across ways, and the direction of the curve there.

    Only lanes where each step is at most half of the one before, or is short, come to rest. Angles go on from those of
    the guess. The direction of the curve has a positive share of the way.

    Args:
        family: the map.
        points, value: guesses.
        across: ways, to which steps of Newton are orthogonal.
        tolerance: length of a step after which an orbit is known.
        near: lengths of steps that are too short to lead elsewhere, and need not be half of those before.
    """
    orbits, last = _initial_orbits(points, value), np.full(len(value), np.inf)
    open_ = np.arange(len(value))
    for _ in range(_NEWTON_STEPS + 1):
        missing, blocks, columns = _equations(family, orbits.points[open_], orbits.value[open_])
        orbits.residual[open_], orbits.blocks[open_] = np.abs(missing).max(axis=(1, 2)), blocks
        finite = np.isfinite(missing).all(axis=(1, 2)) & np.isfinite(blocks).all(axis=(1, 2, 3))
        finite &= np.isfinite(columns).all(axis=(1, 2))
        open_, missing, blocks, columns = open_[finite], missing[finite], blocks[finite], columns[finite]
        if not len(open_):
            break
        here = PathVector(across.points[open_], across.value[open_])
        moved, way, other, crossing = _solutions(family, missing, blocks, columns, here)
        at_rest = last[open_] <= tolerance
        done = open_[at_rest]
        for leaf, new in zip((*orbits.way, *orbits.other_way, orbits.crossing), (*way, *other, crossing), strict=True):
            leaf[done] = new[at_rest]
        orbits.converged[done] = True
        size = length(family, moved)
        with np.errstate(invalid="ignore"):
            contracts = size <= np.maximum(_CONTRACTION * last[open_], 0.0 if near is None else near[open_])
            going = ~at_rest & contracts & np.isfinite(size)
        open_ = open_[going]
        last[open_] = size[going]
        orbits.points[open_] += moved.points[going]
        orbits.value[open_] += moved.value[going]
        if not len(open_):
            break
    orbits.missed[:] = length(family, PathVector(orbits.points - points, orbits.value - value))
    return orbits


def _initial_orbits(points: Float[np.ndarray, "lanes n d"], value: Float[np.ndarray, " lanes"]) -> CurveOrbits:
    """Return orbits at guesses, without anything else known yet."""
    lanes, _, d = points.shape

    def unknown(*shape: int) -> np.ndarray:
        return np.full((lanes, *shape), np.nan)

    way, other = (PathVector(unknown(*points.shape[1:]), unknown()) for _ in range(2))
    blocks = unknown(points.shape[1], d, d)
    none = (unknown(), unknown(), unknown(), np.zeros(lanes, bool))
    return CurveOrbits(np.array(points), np.array(value), way, blocks, *none, other)


def _equations(
    family: Family, points: Float[np.ndarray, "lanes n d"], value: Float[np.ndarray, " lanes"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u_{i+1} − P(u_i), ∂P/∂u and ∂P/∂λ, in units of sizes and of the width: (lanes, n, d), (.., d, d), (.., d)."""
    lanes, n, d = points.shape
    size = family.size
    image, matrix, column = family.period(points.reshape(-1, d), np.repeat(value, n))
    assert column is not None
    missing = family.wrap(np.roll(points, -1, 1) - np.asarray(image).reshape(points.shape)) / size
    blocks = np.asarray(matrix).reshape(lanes, n, d, d) * (size / size[:, None])
    return missing, blocks, np.asarray(column).reshape(points.shape) * (family.width / size)


def _solutions(
    family: Family, missing: np.ndarray, blocks: np.ndarray, columns: np.ndarray, across: PathVector
) -> tuple[PathVector, PathVector, PathVector, np.ndarray]:
    """The step of Newton across ways, the direction of the curve, that of another one, and the determinant with it."""
    there = np.broadcast_to(-np.eye(blocks.shape[-1]), blocks.shape)
    cycle = cyclic.eliminate(blocks, there)
    solved = cyclic.underdetermined(cycle, missing, columns)
    way = PathVector(solved.way * family.size, solved.rate * family.width)
    step = PathVector(solved.y * family.size, solved.x * family.width)
    share = inner(family, way, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        back = inner(family, step, across) / share
    step = minus(step, back, way)
    scale = np.where(share < 0.0, -1.0, 1.0) / length(family, way)
    crossing = cyclic.determinant(cycle._replace(closed=solved.square)) * np.sign(scale)
    way = times(scale, way)
    other = PathVector(solved.other_way * family.size, solved.other_rate * family.width)
    other = minus(other, inner(family, other, way), way)
    return step, way, times(1.0 / length(family, other), other), crossing
