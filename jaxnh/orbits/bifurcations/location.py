"""Bifurcations on branches: where test functions are zero between two points of a branch. Host code.

As for doublings (`doubling_points`), no derivative of a test function is asked for: it is computed at a few nodes along
the chord between the two points, a polynomial through them has the root, and narrower rounds follow until rounding is
reached. The parameter there is that of a polynomial through the nodes as well, also where it turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector, correct, inner, length, minus, times
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.kinds import (
    BRANCH_POINT,
    DOUBLING,
    FOLD,
    NEIMARK_SACKER,
    eigenvalues,
    kinds,
    test_functions,
)
from jaxnh.orbits.continuation.paths import COLLAPSED, NEAR
from jaxnh.orbits.multipliers import multipliers
from jaxnh.systems.rows import select, write_rows

NODES = np.cos(np.pi * (np.arange(6) + 0.5) / 6)
"""Chebyshev nodes of [−1, 1]."""

_DEGREE = 3  # two less than what would go through all nodes: the rest shows truncation and rounding
_FIT = np.linalg.pinv(np.vander(NODES, _DEGREE + 1, increasing=True))
_THROUGH = np.linalg.inv(np.vander(NODES, increasing=True))
_NARROWER = 64  # from round to round
_ROUNDS = 4
_ENOUGH = 1e-3  # of how far a zero is from that of the map before: a less error of it widens no bar
_CLOSER = 10  # times that a bracket in which no polynomial fits is narrowed to where the test function changes sign
_NEAR = (1 / 64, 1 / 4, 2.0)  # of a chord, about the place of a zero of a less fine map
_SAFETY = 2.0  # the largest of six misfits, of two degrees of freedom, against the error of a fit
_OUT = 32.0  # times how far Newton may end from its guess, that its steps may be long
_ROUNDINGS = 8.0  # of a determinant
_BEYOND = 1.5  # nodes' width that a root may lie outside
_NOISE = 0.05  # of the width of the first nodes: a root less sharp than this is one of rounding
_ON_CIRCLE = 1e-4  # of a modulus from one, where the product of two multipliers is one to rounding
_REAL = 1e-6  # imaginary part of a multiplier, of its modulus
_FAR = 100.0  # ratio of two real multipliers that do not merge and part again within a step
_STILL = 1e-8  # rates of the parameter that the corrector's last step does not tell from zero
_BESIDE = np.array([-2.0, -1.0, 1.0, 2.0]) / 64  # of a chord, places beside a branch point
_BETWEEN = np.array([-1.0, 4.0, 4.0, -1.0]) / 6  # weights of the cubic through them in their middle


class Brackets(NamedTuple):
    """Stretches of branches between two points, between which a test function changes sign.

    Attributes:
        branch: number of the branch, (some,).
        place: of the first of the two points on it, (some,).
        kind: of bifurcation, a number in `KINDS`, (some,).
        points: first points and the chord to the next, each (some, n, d), with their parameters (some,).
        chord: from the first to the second.
        ways: directions of the curve at both, as lengths of the chord.
    """

    branch: Int[np.ndarray, " some"]
    place: Int[np.ndarray, " some"]
    kind: Int[np.ndarray, " some"]
    start: PathVector
    chord: PathVector
    ways: tuple[PathVector, PathVector]


class BifurcationPoints(NamedTuple):
    """Zeros of test functions.

    Attributes:
        share: of the chord, in direction of it, where they are, (some,).
        value: of the parameter, by the polynomial: where two branches cross no orbit by itself decides it, (some,).
        error: of the value of the parameter, by rounding and interpolation, (some,).
        bend: second derivative of the parameter along the curve, in widths of the range, (some,).
        orbits: at the zeros.
        exists: whether there is one, (some,).
        nodes: orbits at `NODES` over the chord, (some, nodes, n, d) and (some, nodes).
    """

    share: Float[np.ndarray, " some"]
    value: Float[np.ndarray, " some"]
    error: Float[np.ndarray, " some"]
    bend: Float[np.ndarray, " some"]
    orbits: CurveOrbits
    exists: Bool[np.ndarray, " some"]
    nodes: PathVector


def brackets(family: Family, branches: Sequence[Branch]) -> Brackets | None:
    """All that test functions show on branches of one period; None where they show nothing."""
    order, changed = kinds(family), list[tuple[int, int, int]]()
    for number, branch in enumerate(branches):
        changes = np.diff(np.signbit(branch.tests), axis=0) & np.isfinite(branch.tests[1:] + branch.tests[:-1])
        turns = np.maximum(np.abs(branch.tests[1:, order.index(FOLD)]), np.abs(branch.tests[:-1, order.index(FOLD)]))
        changes[:, order.index(FOLD)] &= turns > _STILL
        # Where both change, the branch turns because another one crosses it there: it is that one's pitchfork.
        changes[:, order.index(FOLD)] &= ~changes[:, order.index(BRANCH_POINT)]
        if NEIMARK_SACKER in order:
            far = _real_and_far(branch.multipliers)
            changes[:, order.index(NEIMARK_SACKER)] &= ~(far[1:] & far[:-1])  # a neutral saddle, no bifurcation
        changes[0] &= branch.ends[0] != COLLAPSED  # there it is the doubling of another branch that shows
        changes[-1] &= branch.ends[1] != COLLAPSED
        changed += [(number, int(i), order[k]) for i, k in zip(*np.nonzero(changes), strict=True)]
    if not changed:
        return None
    branch, place, kind = (np.array(column) for column in zip(*changed, strict=True))

    def at(step: int) -> tuple[PathVector, PathVector]:
        rows = [(branches[b], i + step) for b, i, _ in changed]
        where = PathVector(np.stack([b.points[i] for b, i in rows]), np.array([b.value[i] for b, i in rows]))
        return where, PathVector(
            np.stack([b.way.points[i] for b, i in rows]), np.array([b.way.value[i] for b, i in rows])
        )

    (start, first), (end, second) = at(0), at(1)
    chord = PathVector(end.points - start.points, end.value - start.value)
    size = length(family, chord)
    return Brackets(branch, place, kind, start, chord, (times(size, first), times(size, second)))


def _real_and_far(values: Complex[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
    """Return whether the two multipliers whose product is nearest to one are real, and far from merging."""
    i, j = np.triu_indices(values.shape[1], 1)
    if not len(i):
        return np.zeros(len(values), bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.abs(values))
        nearest = np.argmin(np.nan_to_num(np.abs(logs[:, i] + logs[:, j]), nan=np.inf), axis=1)[:, None]
        gap = np.take_along_axis(np.abs(logs[:, i] - logs[:, j]), nearest, axis=1)[:, 0]
    real = np.abs(np.imag(values)) <= _REAL * np.abs(values)
    return np.take_along_axis(real[:, i] & real[:, j], nearest, axis=1)[:, 0] & (gap > np.log(_FAR))


def locate(
    family: Family, stretch: Brackets, near: BifurcationPoints | None = None, half: float = 0.5
) -> BifurcationPoints:
    """The zeros in brackets, or near those of another map.

    Args:
        family: the map.
        stretch: where.
        near: zeros of a map that is nearly the same.
        half: of the chord, that the first nodes reach to either side.
    """
    count = len(stretch.kind)
    share, none = np.full(count, 0.5) if near is None else near.share.copy(), np.full(count, np.nan)
    value, error, bend, exists = none, np.full(count, np.inf), np.zeros(count), np.zeros(count, bool)
    rounds, start = np.zeros(count, int), np.full(count, half)
    along, widths, open_ = _cubics(stretch) if near is None else near.nodes, np.full(count, half), np.arange(count)
    for number in range(_ROUNDS + _CLOSER):
        part, of_part = select((stretch, along), open_)
        shares = share[open_, None] + widths[open_, None] * NODES
        nodes = _orbits(family, part, shares, of_part)
        values = nodes.value.reshape(shares.shape)
        tests = _own_test(family, nodes, np.repeat(part.kind, len(NODES))).reshape(shares.shape)
        noise = _noise(family, nodes.blocks[:: len(NODES)], part.kind)
        root, blur, at_root, off, turn = roots(tests, values, noise)
        blur = blur * widths[open_]
        whole = nodes.converged.reshape(shares.shape).all(axis=1)
        if near is None and not number:
            along.points[whole], along.value[whole] = nodes.points.reshape(along.points.shape)[whole], values[whole]
        with np.errstate(invalid="ignore"):
            good = whole & np.isfinite(root) & (blur < _NOISE * start[open_]) & (off < 0.25 * error[open_])
        closer, low, high = _around_change(tests, whole & ~good & ~exists[open_])
        there = open_[closer]
        share[there] += 0.5 * widths[there] * (low + high)
        widths[there] *= 0.5 * (high - low)
        start[there] = widths[there]
        open_, width, root = open_[good], widths[open_][good], root[good]
        share[open_] += width * root
        value[open_], error[open_], exists[open_] = at_root[good], off[good], True
        bend[open_] = turn[good] / family.width / (length(family, part.chord)[good] * width) ** 2
        widths[open_] /= np.where(np.abs(root) <= 1.0, _NARROWER, 1.0)
        rounds[open_] += 1
        going = rounds[open_] < _ROUNDS
        if near is not None:
            going &= error[open_] > _ENOUGH * np.abs(value[open_] - near.value[open_])
        open_ = np.sort(np.concatenate([open_[going], there]))
        if not len(open_):
            break
    orbits = _at_roots(family, stretch, share, along)
    ways = _crossing_directions(family, stretch, share, orbits)
    exists &= orbits.converged
    orbits = orbits._replace(value=value, way=ways[0], other_way=ways[1])
    return BifurcationPoints(share, value, error, bend, orbits, exists, along)


def locate_near(family: Family, stretch: Brackets, near: BifurcationPoints) -> BifurcationPoints:
    """The zeros near those of a less fine map, in wider and wider parts of the curve where there are none.

    Zeros may be apart by more than a step of the curve where that is short, as beside steep multipliers.
    """
    located = locate(family, stretch, near, _NEAR[0])
    for half in _NEAR[1:]:
        left = np.flatnonzero(~located.exists)
        if not len(left):
            break
        part, near_part = select((stretch, near), left)
        again = locate(family, part, near_part, half)
        write_rows(located, left, again)
    return located


def _around_change(
    tests: Float[np.ndarray, "some nodes"], asked: Bool[np.ndarray, " some"]
) -> tuple[Int[np.ndarray, " changed"], Float[np.ndarray, " changed"], Float[np.ndarray, " changed"]]:
    """Brackets among those asked for in which the sign changes, and between which places, in nodes' widths.

    Of several changes the first is taken. Where there is none it is beyond the outer node where the function is less.
    """
    chosen = np.flatnonzero(asked)
    tests = tests[chosen]
    changes = np.diff(np.signbit(tests), axis=1)
    k, last = np.argmax(changes, axis=1), np.abs(tests[:, -1]) < np.abs(tests[:, 0])
    outer = np.where(last, NODES[-1], NODES[0])
    none, beyond = ~changes.any(axis=1), np.sign(outer) * (2.0 - np.abs(outer))
    ends = np.stack([np.where(none, outer, NODES[k]), np.where(none, beyond, NODES[k + 1])])
    return chosen, ends.min(axis=0), ends.max(axis=0)


def neutral_pair(family: Family, orbits: CurveOrbits) -> Bool[np.ndarray, " some"]:
    """Return whether two real multipliers of product one, or eigenvalues of sum zero, make the zero: no bifurcation."""
    nearest = critical(family, eigenvalues(family, orbits))
    off = np.abs(np.real(nearest)) if family.field else np.abs(np.abs(nearest) - 1.0)
    return ~(off < _ON_CIRCLE)


def critical(family: Family, values: Complex[np.ndarray, "some d"]) -> Complex[np.ndarray, " some"]:
    """Complex multiplier of each orbit nearest the unit circle (eigenvalue nearest the axis), above the real line.

    NaN where all are real.
    """
    away = np.abs(np.real(values)) if family.field else np.abs(np.abs(values) - 1.0)
    away = np.where(np.imag(values) > _REAL * np.abs(values), away, np.inf)
    chosen = np.take_along_axis(values, np.argmin(away, axis=1)[:, None], axis=1)[:, 0]
    return np.where(np.isfinite(away.min(axis=1)), chosen, np.nan)


def _cubics(stretch: Brackets) -> PathVector:
    """Cubics through both ends of chords at `NODES` over them."""
    start, chord, (first, second) = stretch.start, stretch.chord, stretch.ways
    s = 0.5 + 0.5 * NODES
    parts = (s * s * (3.0 - 2.0 * s), chord), (s * (1.0 - s) ** 2, first), (-s * s * (1.0 - s), second)
    points = start.points[:, None] + sum(weight[:, None, None] * way.points[:, None] for weight, way in parts)
    return PathVector(points, start.value[:, None] + sum(weight * way.value[:, None] for weight, way in parts))


def _orbits(family: Family, stretch: Brackets, share: Float[np.ndarray, "some k"], along: PathVector) -> CurveOrbits:
    """The orbits of the curve in the hyperplanes across chords at shares of them, from polynomials through nodes."""
    place = np.vander(2.0 * share.ravel() - 1.0, len(NODES), increasing=True)
    weights = (place[:, :, None] * _THROUGH).sum(axis=1).reshape(*share.shape, len(NODES))
    points = np.sum(weights[..., None, None] * along.points[:, None], axis=2).reshape(-1, *along.points.shape[2:])
    value = np.sum(weights * along.value[:, None], axis=2).ravel()
    stretch = jax.tree.map(lambda leaf: np.repeat(leaf, share.shape[1], axis=0), stretch)
    start, chord = stretch.start, stretch.chord
    # Onto the hyperplane: the polynomial's own share of the chord is not quite the one asked for.
    size = inner(family, chord, chord)
    gone = inner(family, PathVector(points - start.points, value - start.value), chord) / size
    more = times(share.ravel() - gone, chord)
    across, near = times(1.0 / np.sqrt(size), chord), NEAR * np.sqrt(size)
    guess = points + more.points, value + more.value
    orbits = correct(family, *guess, across, FINE, near)
    # Beside steep multipliers Newton from orbits of a less fine map goes out by chords and comes back: where it ends
    # says whether it has gone over to another curve.
    left = np.flatnonzero(~orbits.converged)
    if len(left):
        points, value, across, near = select((*guess, across, near), left)
        again = correct(family, points, value, across, FINE, _OUT * near)
        again = again._replace(converged=again.converged & (again.missed <= near))
        write_rows(orbits, left, again)
    return orbits


def _at_roots(family: Family, stretch: Brackets, share: Float[np.ndarray, " some"], along: PathVector) -> CurveOrbits:
    """The orbits at roots; where another branch crosses, from those beside: there Newton's equations are singular."""
    orbits = _orbits(family, stretch, share[:, None], along)
    cross = np.flatnonzero(stretch.kind == BRANCH_POINT)
    if not len(cross):
        return orbits
    part, of_part = select((stretch, along), cross)
    beside = _orbits(family, part, share[cross, None] + _BESIDE, of_part)
    points = beside.points.reshape(len(cross), len(_BESIDE), *beside.points.shape[1:])
    middle = np.sum(points * _BETWEEN[:, None, None], axis=1)
    value = np.sum(beside.value.reshape(len(cross), -1) * _BETWEEN, axis=1)
    chord = times(1.0 / length(family, part.chord), part.chord)
    crossings = correct(family, middle, value, chord, np.inf)
    crossings = crossings._replace(converged=crossings.converged & beside.converged.reshape(len(cross), -1).all(axis=1))
    write_rows(orbits, cross, crossings)
    return orbits


def _crossing_directions(
    family: Family, stretch: Brackets, share: Float[np.ndarray, " some"], orbits: CurveOrbits
) -> tuple[PathVector, PathVector]:
    """Directions of the curve itself, and of one that crosses it: linear equations do not know which is which."""
    s, left, (first, second) = share, 1.0 - share, stretch.ways
    parts = (6.0 * s * left, stretch.chord), (left * (1.0 - 3.0 * s), first), (s * (3.0 * s - 2.0), second)
    ways = [times(weight, way) for weight, way in parts]
    along = PathVector(np.sum([way.points for way in ways], axis=0), np.sum([way.value for way in ways], axis=0))
    way, other_way = orbits.way, orbits.other_way
    a, b = inner(family, along, way), inner(family, along, other_way)
    size = np.hypot(a, b)
    a, b = np.where(size > 0.0, a / size, 1.0), np.where(size > 0.0, b / size, 0.0)
    crossing = stretch.kind == BRANCH_POINT
    a, b = np.where(crossing, a, 1.0), np.where(crossing, b, 0.0)
    return minus(times(a, way), -b, other_way), minus(times(a, other_way), b, way)


def _own_test(family: Family, nodes: CurveOrbits, kind: Int[np.ndarray, " nodes"]) -> Float[np.ndarray, " nodes"]:
    """Test function of the kind of each node, NaN where there is no orbit."""
    column = np.array([kinds(family).index(k) for k in kind.tolist()], int)
    with np.errstate(all="ignore"):
        safe = nodes._replace(blocks=np.where(nodes.converged[:, None, None, None], nodes.blocks, 0.0))
        return np.take_along_axis(test_functions(family, safe), column[:, None], axis=1)[:, 0]


def _noise(
    family: Family, blocks: Float[np.ndarray, "some n d d"], kind: Int[np.ndarray, " some"]
) -> Float[np.ndarray, " some"]:
    """Rounding of the test functions of maps that are determinants, by the sizes of the terms that cancel in them."""
    size = np.zeros(len(kind))
    rows = np.flatnonzero(np.isin(kind, (DOUBLING, NEIMARK_SACKER)) & np.isfinite(blocks).all(axis=(1, 2, 3)))
    if family.field or not len(rows):
        return size
    moduli = np.abs(multipliers(blocks[rows]))
    i, j = np.triu_indices(moduli.shape[1], 1)
    single, pairs = (np.prod(1.0 + terms, axis=1) for terms in (moduli, moduli[:, i] * moduli[:, j]))
    size[rows] = _ROUNDINGS * np.finfo(float).eps * np.where(kind[rows] == DOUBLING, single, pairs)
    return size


def roots(
    tests: Float[np.ndarray, "some nodes"],
    values: Float[np.ndarray, "some nodes"],
    noise: Float[np.ndarray, " some"] | float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Roots of polynomials through test functions, in nodes' widths, with their errors.

    And values there, their errors, and their second derivatives. Not a number where there is no root near.

    Args:
        noise: of the test functions, that nodes have in common.
    """
    reference = values[:, :1]
    fit, line = _fit(tests), _fit(values - reference)
    misfit, off = (np.abs(x - _polynomial(c, NODES)).max(axis=1) for x, c in ((tests, fit), (values - reference, line)))
    root = np.full(len(tests), np.nan)
    for k in np.flatnonzero(np.isfinite(fit).all(axis=1)):
        all_ = np.polynomial.polynomial.polyroots(fit[k])
        real = np.real(all_)[(np.abs(np.imag(all_)) < 1e-6) & (np.abs(np.real(all_)) < _BEYOND)]
        root[k] = real[np.argmin(np.abs(real))] if len(real) else np.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = _polynomial(_derivative(fit), root[:, None])[:, 0]
        root = root - _polynomial(fit, root[:, None])[:, 0] / slope
        blur = _SAFETY * misfit / np.abs(slope)
        rise = _polynomial(_derivative(line), root[:, None])[:, 0]
        bend = _polynomial(_derivative(_derivative(line)), root[:, None])[:, 0]
        rounding = np.spacing(np.abs(reference[:, 0]))
        rounding += np.abs(rise / slope) * noise
        error = _SAFETY * off + np.abs(rise) * blur + 0.5 * np.abs(bend) * blur**2 + rounding
        value = reference[:, 0] + _polynomial(line, root[:, None])[:, 0]
    return root, blur, value, error, bend


def _fit(values: Float[np.ndarray, "some nodes"]) -> Float[np.ndarray, "some terms"]:
    return np.sum(values[:, None, :] * _FIT, axis=2)


def _polynomial(terms: Float[np.ndarray, "some terms"], at: np.ndarray) -> np.ndarray:
    """Values (some, points) at points (points,) or (some, points)."""
    values = np.zeros(np.broadcast_shapes((len(terms), 1), np.shape(np.atleast_2d(at))))
    for k in range(terms.shape[1])[::-1]:
        values = values * at + terms[:, k, None]
    return values


def _derivative(terms: Float[np.ndarray, "some terms"]) -> Float[np.ndarray, "some fewer"]:
    return terms[:, 1:] * np.arange(1, terms.shape[1])
