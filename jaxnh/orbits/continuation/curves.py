"""Curves of bifurcations of periodic orbits over two parameters, followed by arclength, many side by side. Host code.

The unknowns are all n points of an orbit and both parameters; the equations are those of the orbit and that the test
function of the bifurcation is zero: det(M − 1), det(M + 1) or det(M ∧ M − 1) (`kinds`), whose derivatives are
differences of ∂P/∂u. Folds of the curve in either parameter are points like others, and so are cusps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, closed_determinant, second_compound
from jaxnh.orbits.multipliers import angle_cosine, multipliers
from jaxnh.systems.chart import Wrap

ENDS = ("range", "collapsed", "closed", "no_convergence", "most_points", "resonance")
"""Why a curve ends: a parameter leaves its range; the orbit is one of half the period; the curve is closed; Newton does
not converge at the smallest step; as many points are known as were asked for; the multipliers become real, at a
resonance 1:1 or 1:2, from where on no torus is born."""

RANGE, COLLAPSED, CLOSED, NO_CONVERGENCE, MOST_POINTS, RESONANCE = range(len(ENDS))

_SHIFT = 1e-6  # of differences, in lengths: Newton's steps shrink by such a factor
_NEWTON_STEPS = 10
_AT_REST = 1e-9  # step, in lengths, after which the next one is rounding
_CONTRACTION = 0.5
_BENT = 0.95  # cosine of the angle between directions at the ends of a step, at least
_MISSED = 0.15  # of a step that Newton goes back, at most
_WANTED = 0.04  # what steps are chosen for
_SMALLEST = 1e-7  # step
_GROWTH = 1.5
_FIRST = 0.1  # of the largest step
_LEAST_LOOP = 8


class PeriodAndParameters(Protocol):
    """P, ∂P/∂u and ∂P/∂(both parameters) of lanes."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, "lanes 2"], /) -> Derivatives:
        """At points and values of the parameters, a lane each; `by_parameter` is (lanes, d, 2)."""
        ...


class ParameterPlane(NamedTuple):
    """A map over a plane of two parameters, and what is large there.

    Attributes:
        period: the map and its derivatives over lanes.
        wrap: of differences of section coordinates.
        size: of the motion in each section coordinate, (d,).
        low, high: ends of the ranges of the parameters, (2,).
    """

    period: PeriodAndParameters
    wrap: Wrap
    size: Float[np.ndarray, " d"]
    low: Float[np.ndarray, " 2"]
    high: Float[np.ndarray, " 2"]

    def unit(self, n: int) -> Float[np.ndarray, " N"]:
        """Units of the unknowns, such that squares of lengths are means over the points: N = nd + 2."""
        return np.concatenate([np.tile(self.size, n) * np.sqrt(n), self.high - self.low])


class CurvePoints(NamedTuple):
    """Points on curves, a lane each.

    Attributes:
        z: unknowns in their units, (lanes, N).
        way: direction of the curve, of length one, (lanes, N).
        blocks: ∂P/∂u at each point of the orbit, in sizes of the motion, (lanes, n, d, d).
        missed: how far Newton has gone from the guess, (lanes,).
        converged: whether Newton has come to rest, (lanes,).
    """

    z: Float[np.ndarray, "lanes N"]
    way: Float[np.ndarray, "lanes N"]
    blocks: Float[np.ndarray, "lanes n d d"]
    missed: Float[np.ndarray, " lanes"]
    converged: Bool[np.ndarray, " lanes"]

    def take(self, lanes: Int[np.ndarray, " some"] | Bool[np.ndarray, " lanes"] | slice) -> CurvePoints:
        """Return the entries of a subset of lanes."""
        return CurvePoints(*(leaf[lanes] for leaf in self))


@dataclass(frozen=True)
class Curve:
    """A curve, point by point.

    Attributes:
        kind: of bifurcation, a number in `kinds.KINDS`.
        points: of the orbits, section coordinates, (k, n, d).
        values: of both parameters, (k, 2).
        track: unknowns, directions and derivatives there.
        multipliers: (k, d).
        ends: why it ends where it begins, and at its end, numbers in `ENDS`.
    """

    kind: int
    points: Float[np.ndarray, "k n d"]
    values: Float[np.ndarray, "k 2"]
    track: CurvePoints
    multipliers: Complex[np.ndarray, "k d"]
    ends: tuple[int, int]

    @property
    def period(self) -> int:
        """Points of an orbit."""
        return self.points.shape[1]

    def part(self, points: slice) -> Curve:
        """Some points of the curve, one after the other."""
        return replace(
            self,
            points=self.points[points],
            values=self.values[points],
            track=self.track.take(points),
            multipliers=self.multipliers[points],
        )


def test_function(kind: int, blocks: Float[np.ndarray, "lanes n d d"]) -> Float[np.ndarray, " lanes"]:
    """The test function of a kind, which is zero on its curves."""
    if kind == FOLD:
        return closed_determinant(blocks, 1.0)
    if kind == DOUBLING:
        return closed_determinant(blocks, -1.0)
    return closed_determinant(second_compound(blocks), 1.0)


def join_unknowns(
    plane: ParameterPlane, points: Float[np.ndarray, "lanes n d"], values: Float[np.ndarray, "lanes 2"]
) -> Float[np.ndarray, "lanes N"]:
    """Orbits and parameters as unknowns in their units."""
    lanes, n, _ = points.shape
    return np.concatenate([points.reshape(lanes, -1), values], axis=1) / plane.unit(n)


def split_unknowns(plane: ParameterPlane, z: Float[np.ndarray, "lanes N"]) -> tuple[np.ndarray, np.ndarray]:
    """Orbits (lanes, n, d) and parameters (lanes, 2) of unknowns."""
    d = len(plane.size)
    n = (z.shape[1] - 2) // d
    whole = z * plane.unit(n)
    return whole[:, :-2].reshape(len(z), n, d), whole[:, -2:]


def correct(
    plane: ParameterPlane,
    kind: int,
    z: Float[np.ndarray, "lanes N"],
    across: Float[np.ndarray, "lanes N"] | None = None,
    near: Float[np.ndarray, " lanes"] | float = 0.0,
) -> CurvePoints:
    """The points of curves nearest to guesses in the hyperplanes across ways; directions have a share along these.

    Args:
        plane: the map.
        kind: of bifurcation.
        z: guesses.
        across: ways, to which steps of Newton are orthogonal; without, they are orthogonal to the curve.
        near: lengths of steps that need not be half of those before.
    """
    lanes, size = z.shape
    d = len(plane.size)
    n = (size - 2) // d
    track = CurvePoints(
        z.copy(),
        np.full_like(z, np.nan),
        np.full((lanes, n, d, d), np.nan),
        np.full(lanes, np.nan),
        np.zeros(lanes, bool),
    )
    last, open_ = np.full(lanes, np.inf), np.arange(lanes)
    near = np.broadcast_to(near, lanes)
    for _ in range(_NEWTON_STEPS + 1):
        missing, slopes, blocks = _equations(plane, kind, track.z[open_])
        finite = np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(missing).all(axis=1)
        open_, missing, slopes, blocks = open_[finite], missing[finite], slopes[finite], blocks[finite]
        if not len(open_):
            break
        track.blocks[open_] = blocks
        moved, way = _solve(missing, slopes, None if across is None else across[open_])
        at_rest = last[open_] <= _AT_REST
        track.converged[open_[at_rest]], track.way[open_[at_rest]] = True, way[at_rest]
        length = np.linalg.norm(moved, axis=1)
        going = ~at_rest & np.isfinite(length) & (length <= np.maximum(_CONTRACTION * last[open_], near[open_]))
        open_ = open_[going]
        last[open_] = length[going]
        track.z[open_] += moved[going]
        if not len(open_):
            break
    track.missed[:] = np.linalg.norm(track.z - z, axis=1)
    return track


def follow(
    plane: ParameterPlane, kind: int, begun: CurvePoints, largest: float = 0.02, most: int = 500
) -> list[tuple[CurvePoints, int]]:
    """The curves on from points in the directions of their ways: their points, and why they end, numbers in `ENDS`."""
    lanes = len(begun.z)
    history, end = [[begun.take(slice(k, k + 1))] for k in range(lanes)], np.full(lanes, MOST_POINTS)
    now = CurvePoints(*map(np.copy, begun))  # it changes in place, and the first points of histories do not
    size, open_ = np.full(lanes, _FIRST * largest), np.arange(lanes)
    while len(open_):
        step = size[open_]
        taken = correct(plane, kind, now.z + step[:, None] * now.way, now.way, 0.3 * step)
        with np.errstate(invalid="ignore"):
            share = taken.missed / step
            good = taken.converged & (np.sum(taken.way * now.way, axis=1) >= _BENT) & (share <= _MISSED)
        outside = good & _outside(plane, taken.z)
        if outside.any():
            edge = _cut_at_edge(plane, kind, now.take(outside), taken.take(outside))
            for leaf, new in zip(taken, edge, strict=True):
                leaf[outside] = new
            good[outside] &= edge.converged
        ended = _endings(plane, kind, [history[k] for k in open_.tolist()], now, taken, step)
        done = good & outside
        end[open_[done]] = RANGE
        for reason, which in ended.items():
            new = good & ~done & which
            end[open_[new]] = reason
            done |= new
        moved = np.linalg.norm(taken.z - now.z, axis=1) > _SMALLEST  # not where it begins at the edge of the plane
        for place in np.flatnonzero(good & moved).tolist():
            history[open_[place]].append(taken.take(slice(place, place + 1)))
        factor = np.where(good, np.clip(_WANTED / np.maximum(share, _SMALLEST), 0.5, _GROWTH), 0.5)
        size[open_] = np.minimum(step * factor, largest)
        lost = ~good & (size[open_] <= _SMALLEST)
        end[open_[lost]] = NO_CONVERGENCE
        done |= lost | (np.array([len(history[k]) for k in open_.tolist()]) >= most)
        for leaf, new in zip(now, taken, strict=True):
            leaf[good] = new[good]
        now, open_ = now.take(~done), open_[~done]
    joined = [CurvePoints(*map(np.concatenate, zip(*part, strict=True))) for part in history]
    return list(zip(joined, end.tolist(), strict=True))


def follow_both_ways(
    plane: ParameterPlane,
    kind: int,
    points: Float[np.ndarray, "lanes n d"],
    values: Float[np.ndarray, "lanes 2"],
    largest: float = 0.02,
    most: int = 500,
) -> list[Curve | None]:
    """The curves through bifurcations of a kind, each from end to end; None where Newton does not confirm one."""
    z = join_unknowns(plane, points, values)
    corrected = correct(plane, kind, z)
    begun = corrected.take(corrected.converged)
    lanes = len(begun.z)
    back = begun._replace(way=-begun.way)
    twice = CurvePoints(*(np.concatenate(leaves) for leaves in zip(begun, back, strict=True)))
    halves = follow(plane, kind, twice, largest, most)
    curves = list[Curve | None]([None] * len(z))
    for k, (ahead, end), (behind, start) in zip(
        np.flatnonzero(corrected.converged).tolist(), halves[:lanes], halves[lanes:], strict=True
    ):
        track = ahead
        if end != CLOSED:
            turned = CurvePoints(*(leaf[:0:-1] for leaf in behind))
            turned = turned._replace(way=-turned.way)
            track = CurvePoints(*(np.concatenate(leaves) for leaves in zip(turned, ahead, strict=True)))
        orbits, both = split_unknowns(plane, track.z)
        ends = (CLOSED, CLOSED) if end == CLOSED else (start, end)
        curves[k] = Curve(kind, orbits, both, track, multipliers(track.blocks), ends)
    return curves


# ---- the equations


def _equations(
    plane: ParameterPlane, kind: int, z: Float[np.ndarray, "lanes N"]
) -> tuple[Float[np.ndarray, "lanes rows"], Float[np.ndarray, "lanes rows N"], Float[np.ndarray, "lanes n d d"]]:
    """Residuals of the orbit and the test function, their derivatives in the unknowns, and ∂P/∂u, all in units."""
    (points, values), lanes = split_unknowns(plane, z), len(z)
    n, d = points.shape[1:]
    width = plane.high - plane.low
    # One call for all: the orbits, and for differences each coordinate of all points and each parameter shifted.
    at = [points, *(points + _SHIFT * plane.size * unit for unit in np.eye(d)), points, points]
    by = [values] * (d + 1) + [values + _SHIFT * width * unit for unit in np.eye(2)]
    image, every, columns = _periods(plane, np.concatenate(at), np.concatenate(by))
    every = every.reshape(d + 3, *points.shape, d)
    image, blocks, columns = image[:lanes], every[0], columns[:lanes]
    missing = plane.wrap(image - np.roll(points, -1, 1)) / plane.size
    slopes = np.zeros((lanes, n * d + 1, n * d + 2))
    for i in range(n):
        rows, ahead = slice(i * d, (i + 1) * d), (i + 1) % n * d
        slopes[:, rows, i * d : (i + 1) * d] += np.sqrt(n) * blocks[:, i]
        slopes[:, rows, ahead : ahead + d] -= np.sqrt(n) * np.eye(d)
        slopes[:, rows, -2:] = columns[:, i]
    with np.errstate(invalid="ignore", over="ignore"):
        test = _finite_test(kind, blocks)
        for i, j in np.ndindex(n, d):  # each point by itself: its block is all that changes
            other = blocks.copy()
            other[:, i] = every[1 + j, :, i]
            slopes[:, -1, i * d + j] = np.sqrt(n) * (_finite_test(kind, other) - test) / _SHIFT
        for k in range(2):
            slopes[:, -1, n * d + k] = (_finite_test(kind, every[1 + d + k]) - test) / _SHIFT
        scale = np.linalg.norm(slopes[:, -1], axis=1)
        slopes[:, -1] /= scale[:, None]
        return np.concatenate([missing.reshape(lanes, -1), (test / scale)[:, None]], axis=1), slopes, blocks


def _finite_test(kind: int, blocks: np.ndarray) -> np.ndarray:
    finite = np.all(np.isfinite(blocks), axis=(1, 2, 3))
    return np.where(finite, test_function(kind, np.where(finite[:, None, None, None], blocks, 0.0)), np.nan)


def _periods(
    plane: ParameterPlane, points: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P(u), and in units of sizes and widths ∂P/∂u and ∂P/∂(both parameters), at all points of orbits."""
    lanes, n, d = points.shape
    image, matrix, column = plane.period(points.reshape(-1, d), np.repeat(values, n, axis=0))
    assert column is not None
    size, width = plane.size, plane.high - plane.low
    blocks = np.asarray(matrix).reshape(lanes, n, d, d) * (size / size[:, None])
    columns = np.asarray(column).reshape(lanes, n, d, 2) * (width / size[:, None])
    return np.asarray(image).reshape(points.shape), blocks, columns


def _solve(missing: np.ndarray, slopes: np.ndarray, across: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The step of Newton across ways, or the least one, and the direction of the curve."""
    way = np.linalg.svd(slopes)[2][:, -1]
    least = -(np.linalg.pinv(slopes) @ missing[..., None])[..., 0]
    if across is None:
        return least, way
    share = np.sum(way * across, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        back = np.sum(least * across, axis=1) / share
    return least - back[:, None] * way, np.where(share < 0.0, -1.0, 1.0)[:, None] * way


# ---- ends


def _outside(plane: ParameterPlane, z: np.ndarray) -> Bool[np.ndarray, " lanes"]:
    return np.any(_beyond(plane, z), axis=1)


def _beyond(plane: ParameterPlane, z: np.ndarray) -> Bool[np.ndarray, "lanes 2"]:
    """Return which of the two parameters are out of their ranges."""
    unit = plane.high - plane.low
    return (z[:, -2:] < plane.low / unit) | (z[:, -2:] > plane.high / unit)


def _cut_at_edge(plane: ParameterPlane, kind: int, now: CurvePoints, taken: CurvePoints) -> CurvePoints:
    """Points where curves leave the plane of parameters, between two points of theirs."""
    unit = plane.high - plane.low
    gone = taken.z - now.z
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = [(edge / unit - now.z[:, -2:]) / gone[:, -2:] for edge in (plane.low, plane.high)]
    share = np.where(gone[:, -2:] > 0.0, shares[1], shares[0])
    # A curve that begins on an edge, to rounding, leaves there at a share of zero.
    share = np.where(_beyond(plane, taken.z), np.clip(share, 0.0, 1.0), np.inf)
    first = np.argmin(share, axis=1)
    row = np.arange(len(gone))
    z = now.z + share[row, first][:, None] * gone
    edge = np.where(gone[row, first - 2] > 0.0, plane.high[first], plane.low[first]) / unit[first]
    z[row, first - 2] = edge
    across = np.zeros_like(z)
    across[row, first - 2] = np.sign(gone[row, first - 2])
    return correct(plane, kind, z, across)


def _endings(
    plane: ParameterPlane,
    kind: int,
    histories: list[list[CurvePoints]],
    now: CurvePoints,
    taken: CurvePoints,
    step: np.ndarray,
) -> dict[int, Bool[np.ndarray, " lanes"]]:
    """Return which curves have come back to where they began, to orbits of half the period, or to real multipliers."""
    begun = np.concatenate([history[0].z for history in histories])
    first = np.concatenate([history[0].way for history in histories])
    before, after = (np.sum((z - begun) * first, axis=1) for z in (now.z, taken.z))
    near = np.linalg.norm(taken.z - begun, axis=1) <= 2.0 * step
    long = np.array([len(history) > _LEAST_LOOP for history in histories])
    endings = {CLOSED: long & near & (before < 0.0) & (after >= 0.0)}
    one, other = split_unknowns(plane, now.z)[0], split_unknowns(plane, taken.z)[0]
    n = one.shape[1]
    if n % 2 == 0:
        gaps = [plane.wrap(u - np.roll(u, n // 2, 1)) / plane.size for u in (one, other)]
        endings[COLLAPSED] = np.sum(gaps[0] * gaps[1], axis=(1, 2)) <= 0.0
    if kind not in (FOLD, DOUBLING):
        finite = np.all(np.isfinite(taken.blocks), axis=(1, 2, 3))
        values = multipliers(np.where(finite[:, None, None, None], taken.blocks, 0.0))
        endings[RESONANCE] = np.abs(angle_cosine(values)) > 1.0
    return endings
