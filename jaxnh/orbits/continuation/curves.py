"""Curves of bifurcations of periodic orbits over two parameters, followed by arclength, many side by side. Host code.

The unknowns are all n points of an orbit and both parameters; the equations are those of the orbit and that the test
function of the bifurcation is zero: det(M − 1), det(M + 1) or det(M ∧ M − 1) (`kinds`), whose derivatives are
differences of ∂P/∂u. Folds of the curve in either parameter are points like others, and so are cusps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Complex, Float

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.continuation import core, paths
from jaxnh.orbits.continuation.arclength import collapses
from jaxnh.orbits.continuation.core import FINE, Evaluation, Solution
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, closed_determinant, second_compound
from jaxnh.orbits.continuation.paths import StepControl, Track
from jaxnh.orbits.continuation.tracks import joined
from jaxnh.orbits.multipliers import angle_cosine, multipliers
from jaxnh.systems.chart import Wrap

CURVE_STEPS = StepControl(max_steps=500)
"""Default steps."""

_SHIFT = 1e-6  # of central differences, in lengths: their error is its square, and rounding over it
_NEUTRAL = 0.01  # beyond ±1 of the cosine: so far into neutral saddles, tori may begin again at a second resonance
_ROUNDINGS = 8.0  # of a period of the map and of ∂P/∂u, whose operations are many
_ENTRY = 2.0**-10  # of entries of ∂P/∂u, in which determinants are of first order, and of minors of second
_CURVED = 1e-2  # second differences of a test function, of first ones: beyond, derivatives are not known


class PeriodAndParameters(Protocol):
    """P, ∂P/∂u and ∂P/∂(both parameters) of lanes."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, "lanes 2"], /) -> Derivatives:
        """Evaluate at points and values of the parameters, a lane each; `by_parameter` is (lanes, d, 2)."""
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


@dataclass(frozen=True)
class Curve:
    """A curve, point by point.

    Attributes:
        kind: of bifurcation, a number in `kinds.KINDS`.
        points: of the orbits, section coordinates, (k, n, d).
        values: of both parameters, (k, 2).
        track: solutions of `BifurcationEquations` there, unknowns in their units.
        multipliers: (k, d).
        ends: why it ends where it begins, and at its end, numbers in `paths.ENDS`.
        equilibria: whether it is of equilibria; multipliers are then eigenvalues, and the period is 0.
    """

    kind: int
    points: Float[np.ndarray, "k n d"]
    values: Float[np.ndarray, "k 2"]
    track: Solution
    multipliers: Complex[np.ndarray, "k d"]
    ends: tuple[int, int]
    equilibria: bool = False

    @property
    def period(self) -> int:
        """Points of an orbit."""
        return 0 if self.equilibria else self.points.shape[1]

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
) -> Solution:
    """The points of curves nearest to guesses in the hyperplanes across ways; directions have a share along these.

    Args:
        plane: the map.
        kind: of bifurcation.
        z: guesses, in units (`join_unknowns`).
        across: ways, to which steps of Newton are orthogonal; without, they are orthogonal to the curve.
    """
    return core.correct(BifurcationEquations(plane, kind, z.shape[1]), z, across, FINE)


def follow_both_ways(
    plane: ParameterPlane,
    kind: int,
    points: Float[np.ndarray, "lanes n d"],
    values: Float[np.ndarray, "lanes 2"],
    steps: StepControl = CURVE_STEPS,
) -> list[Curve | None]:
    """The curves through bifurcations of a kind, each from end to end; None where Newton does not confirm one."""
    z = join_unknowns(plane, points, values)
    equations = BifurcationEquations(plane, kind, z.shape[1])
    start = core.correct(equations, z, tolerance=FINE)
    confirmed = np.flatnonzero(start.converged)
    curves = list[Curve | None]([None] * len(z))
    for k, track in paths.follow_both_ways(equations, start.take(confirmed), steps).items():
        curves[confirmed[k]] = _curve(plane, kind, track)
    return curves


def join_curves(plane: ParameterPlane, first: Curve, second: Curve, near: float) -> Curve | None:
    """The curve that two are parts of, the first of them cut on the second (`tracks.joined`); None where it is not."""
    if (first.kind, first.period) != (second.kind, second.period):
        return None
    equations = BifurcationEquations(plane, first.kind, first.track.z.shape[1])
    track = joined(equations, Track(first.track, first.ends), Track(second.track, second.ends), near)
    return None if track is None else _curve(plane, first.kind, track)


def _curve(plane: ParameterPlane, kind: int, track: Track) -> Curve:
    points, values = split_unknowns(plane, track.points.z)
    curve = Curve(kind, points, values, track.points, multipliers(track.points.blocks), track.ends)
    return curve if kind in (FOLD, DOUBLING) else _to_resonances(curve)


def _to_resonances(curve: Curve) -> Curve:
    """The curve to the first neutral saddle at each end: between two resonances it goes through such orbits."""
    with np.errstate(invalid="ignore"):
        born = np.flatnonzero(np.abs(angle_cosine(curve.multipliers)) <= 1.0)
    if not len(born):
        return curve
    last = len(curve.values) - 1
    first, end = max(born[0] - 1, 0), min(born[-1] + 1, last)
    begins = paths.RESONANCE if born[0] > 0 else curve.ends[0]
    ends = paths.RESONANCE if born[-1] < last else curve.ends[1]
    return replace(curve.part(slice(first, end + 1)), ends=(begins, ends))


class BifurcationEquations(core.DenseEquations):
    """Orbits with a bifurcation of a kind as `core.CurveEquations`, unknowns in their units."""

    def __init__(self, plane: ParameterPlane, kind: int, unknowns: int) -> None:
        self._plane, self._kind, self._d = plane, kind, len(plane.size)
        self.unit = np.ones(unknowns)
        width = plane.high - plane.low
        self.low, self.high = plane.low / width, plane.high / width

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """Residuals of the orbit and the test function, ∂P/∂u, and the derivatives of all in the unknowns."""
        missing, slopes, blocks, _ = _equations(self._plane, self._kind, z)
        return Evaluation(missing, blocks, slopes)

    def rounding(self, z: Float[np.ndarray, "lanes N"], /) -> Float[np.ndarray, "lanes N"]:
        """Return how far rounding of the equations moves solutions across the curve: bounds of each unknown.

        Rounding of P and of ∂P/∂u goes through the test function and the equations' least solution.
        """
        _, slopes, blocks, scale = _equations(self._plane, self._kind, z)
        unit = _ROUNDINGS * np.finfo(float).eps
        missed = np.ones((len(z), slopes.shape[1]))
        missed[:, :-1] += np.abs(z[:, :-2]) * np.sqrt(blocks.shape[1])  # coordinates in sizes of the motion
        missed[:, -1] = _response(self._kind, blocks) / scale
        moved = np.full_like(z, np.nan)
        known = np.flatnonzero(np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(missed[:, -1]))
        moved[known] = np.einsum("lij,lj->li", np.abs(np.linalg.pinv(slopes[known])), unit * missed[known])
        return moved + np.spacing(np.abs(z))

    def difference(self, gap: Float[np.ndarray, "lanes N"], /) -> Float[np.ndarray, "lanes N"]:
        """Angles wrapped."""
        return join_unknowns(self._plane, *_wrapped(self._plane, gap))

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterator[Float[np.ndarray, "lanes N"]]:
        """The same orbit from each of its points on."""
        points, values = split_unknowns(self._plane, z)
        return (join_unknowns(self._plane, np.roll(points, m, 1), values) for m in range(points.shape[1]))

    def endings(
        self, now: Solution, taken: Solution, /
    ) -> tuple[dict[int, Bool[np.ndarray, " lanes"]], Bool[np.ndarray, " lanes"]]:
        """Curves that have come to orbits of a shorter period, or far beyond where multipliers become real."""
        first, second = split_unknowns(self._plane, now.z)[0], split_unknowns(self._plane, taken.z)[0]
        collapsed, merged = collapses(first, second, self._plane.wrap, self._plane.size)
        endings = {paths.COLLAPSED: collapsed}
        if self._kind not in (FOLD, DOUBLING):
            with np.errstate(invalid="ignore"):
                endings[paths.RESONANCE] = np.abs(angle_cosine(multipliers(taken.blocks))) > 1.0 + _NEUTRAL
        return endings, merged


def _wrapped(plane: ParameterPlane, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points, values = split_unknowns(plane, gap)
    return plane.wrap(points), values


# ---- the equations


def _equations(
    plane: ParameterPlane, kind: int, z: Float[np.ndarray, "lanes N"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Float[np.ndarray, " lanes"]]:
    """Residuals of the orbit and the test function, their derivatives in the unknowns, and ∂P/∂u, all in units.

    And what the test function is divided by, the length of its derivatives.
    """
    (points, values), lanes = split_unknowns(plane, z), len(z)
    n, d = points.shape[1:]
    width = plane.high - plane.low
    # One call for all: the orbits, and for differences each coordinate of all points and each parameter shifted there
    # and back. One-sided ones turn a curve round near generalised Hopf points, where a fold's direction is left to what
    # two nearly equal cycles differ by: by their error, 1e-4 where cycles pass the section at a small angle.
    shifts = [sign * _SHIFT * unit for sign in (1.0, -1.0) for unit in np.eye(d + 2)]
    at = [points, *(points + plane.size * shift[:d] for shift in shifts)]
    by = [values, *(values + width * shift[d:] for shift in shifts)]
    image, every, columns = _periods(plane, np.concatenate(at), np.concatenate(by))
    every = every.reshape(2 * d + 5, *points.shape, d)
    image, blocks, columns = image[:lanes], every[0], columns[:lanes]
    missing = plane.wrap(image - np.roll(points, -1, 1)) / plane.size
    slopes = np.zeros((lanes, n * d + 1, n * d + 2))
    for i in range(n):
        rows, ahead = slice(i * d, (i + 1) * d), (i + 1) % n * d
        slopes[:, rows, i * d : (i + 1) * d] += np.sqrt(n) * blocks[:, i]
        slopes[:, rows, ahead : ahead + d] -= np.sqrt(n) * np.eye(d)
        slopes[:, rows, -2:] = columns[:, i]
    # Two determinants a derivative, all in one call: the orbit's own, those with each point shifted, whose block is all
    # that changes, and those with each parameter.
    sides = every[1:].reshape(2, d + 2, *blocks.shape)
    shifted = np.broadcast_to(blocks, (2, n, d, *blocks.shape)).copy()
    for i in range(n):
        shifted[:, i, :, :, i] = sides[:, :d, :, i]
    both = np.concatenate([shifted.reshape(2, n * d, *blocks.shape), sides[:, d:]], axis=1)
    stacked = np.concatenate([blocks[None], both.reshape(-1, *blocks.shape)])
    with np.errstate(invalid="ignore", over="ignore"):
        test, *others = _finite_test(kind, stacked.reshape(-1, *blocks.shape[1:])).reshape(len(stacked), lanes)
        ahead, back = np.array(others).reshape(2, -1, lanes)
        change, bend = 0.5 * (ahead - back), 0.5 * (ahead + back) - test
        # As towards orbits that touch their section, beyond which the map has no value.
        test = np.where(np.linalg.norm(bend, axis=0) <= _CURVED * np.linalg.norm(change, axis=0), test, np.nan)
        slopes[:, -1] = (change / _SHIFT).T * np.append(np.full(n * d, np.sqrt(n)), [1.0, 1.0])
        scale = np.linalg.norm(slopes[:, -1], axis=1)
        slopes[:, -1] /= scale[:, None]
        residual = np.concatenate([missing.reshape(lanes, -1), (test / scale)[:, None]], axis=1)
    return residual, slopes, blocks, scale


def _response(kind: int, blocks: Float[np.ndarray, "lanes n d d"]) -> Float[np.ndarray, " lanes"]:
    """Return Σ |∂test/∂M_ij| max(1, |M|): what relative changes of all entries of ∂P/∂u make of the test function."""
    largest = np.maximum(1.0, np.abs(blocks).max(axis=(2, 3)))
    entries = np.array(list(np.ndindex(blocks.shape[1:])))
    sides = np.broadcast_to(blocks, (2, len(entries), *blocks.shape)).copy()
    for number, (k, i, j) in enumerate(entries.tolist()):
        for side, sign in enumerate((1.0, -1.0)):
            sides[side, number, :, k, i, j] += sign * _ENTRY * largest[:, k]
    tests = _finite_test(kind, sides.reshape(-1, *blocks.shape[1:])).reshape(2, len(entries), len(blocks))
    return np.sum(np.abs(tests[0] - tests[1]), axis=0) / (2.0 * _ENTRY)


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
