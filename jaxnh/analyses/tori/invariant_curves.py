"""Invariant curves of return maps by Fourier collocation: tori of the flow, attracting or not. Host code.

A curve K over the circle is carried to itself as a rotation, P(K(θ)) = K(θ + ρ), θ and ρ in turns (Schilder, Osinga and
Vogt, SIAM J. Appl. Dyn. Syst. 4 (2005) 459). Unknown are its values at N = 2m + 1 even nodes, between which it is a
trigonometric polynomial, and ρ; the phase of θ is fixed against the curve before. Where curves come in a family, as on
tori of a conservative flow, Newton takes the nearest one. Coordinates that are angles may wind: K_j(θ) = 2π w_j θ +
what is periodic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.linalg import lstsq

from jaxnh.analyses.smooth_window import window_weights
from jaxnh.orbits.newton import Images
from jaxnh.systems.chart import Wrap

_TURN = 2 * np.pi
_NEWTON_STEPS = 12
_AT_REST = 1e-9  # step, in sizes of the curve, after which one more reaches rounding
_CONTRACTION = 0.5  # of successive steps, at least
_RESOLVED = 1e-10  # of the size of the curve: largest coefficient in the last quarter of the harmonics
_FEWEST = 8  # harmonics
_APART = 4.0  # turns, in all points of a motion, that two harmonics differ by which averages over it tell apart
_FLOOR = 1e-12  # of the largest coefficient: what is less is rounding, and tells no rate of decay
_TINY = np.finfo(float).tiny
_SHIFT = 1e-6  # sizes: of all nodes, for the derivatives of ∂P/∂u in them
_DROPPED = 1e-13  # singular values of Newton's matrix, of the largest: along the family of curves


@dataclass(frozen=True)
class InvariantCurve:
    """A closed curve.

    Attributes:
        points: K at the nodes i/N, coordinates that go on along the curve, (N, d).
        winding: whole turns of each coordinate along the curve, (d,).
        rotation: ρ, in turns.
    """

    points: Float[np.ndarray, "N d"]
    winding: Int[np.ndarray, " d"]
    rotation: float

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.points) // 2

    @property
    def coefficients(self) -> Complex[np.ndarray, "m d"]:
        """Fourier coefficients of the periodic part, of harmonics 0 to m."""
        return np.fft.rfft(self.periodic, axis=0) / len(self.points)

    @property
    def size(self) -> Float[np.ndarray, " d"]:
        """Size in each coordinate: 1 where the curve winds, else half its width; of one that rests, the largest."""
        width = 0.5 * np.ptp(self.periodic, axis=0)
        largest = max(np.max(width), _TINY)
        return np.where(self.winding != 0, 1.0, np.where(width > 1e-9 * largest, width, largest))

    @classmethod
    def of_periodic(
        cls, periodic: Float[np.ndarray, "N d"], winding: Int[np.ndarray, " d"], rotation: float
    ) -> InvariantCurve:
        """Return the curve of what is left of its points without the winding."""
        return cls(periodic + _TURN * _nodes(len(periodic))[:, None] * winding, winding, rotation)

    @property
    def periodic(self) -> Float[np.ndarray, "N d"]:
        """The points without the winding, (N, d)."""
        return self.points - _TURN * _nodes(len(self.points))[:, None] * self.winding

    def at(self, theta: Float[np.ndarray, " points"]) -> Float[np.ndarray, "points d"]:
        """Return the points at these θ, in turns."""
        return trigonometric_polynomial(self.coefficients, theta) + _TURN * theta[:, None] * self.winding

    def tangents(self, theta: Float[np.ndarray, " points"]) -> Float[np.ndarray, "points d"]:
        """Return dK/dθ, a turn."""
        wave = 2j * np.pi * np.arange(self.harmonics + 1)[:, None]
        return trigonometric_polynomial(wave * self.coefficients, theta) + _TURN * self.winding

    def with_harmonics(self, m: int) -> InvariantCurve:
        """Return the curve with so many harmonics, those beyond its own zero."""
        return replace(self, points=self.at(_nodes(2 * m + 1)))


class CurveQuality(NamedTuple):
    """The numbers of a solution.

    Attributes:
        converged: whether Newton has come to rest and all that matters is resolved.
        rotation_error: of ρ, by what the nodes miss and by errors of the map.
        residual: largest |P(K(θ)) − K(θ + ρ)| between the nodes, in sizes of the curve.
        decay: rate at which coefficients fall with the harmonic, the width in rad of the strip about the real axis in
            which the curve is analytic; NaN where too few are above rounding.
        matrices: ∂P/∂u at the nodes, (N, d, d).
        volume_error: of the mean of log |det ∂P/∂u| along the curve, by what the curve may be off.
        displaced: ∂P/∂u at the nodes, off by what the equations may miss in the direction that they tell least, (N, d,
            d); those of a plane, where the error of the volume says all, are as they are.
    """

    converged: bool
    rotation_error: float
    residual: float
    decay: float
    matrices: Float[np.ndarray, "N d d"]
    volume_error: float
    displaced: Float[np.ndarray, "N d d"]


def _nodes(count: int) -> Float[np.ndarray, " N"]:
    return np.arange(count) / count


def trigonometric_polynomial(
    coefficients: Complex[np.ndarray, "m d"], theta: Float[np.ndarray, " points"]
) -> Float[np.ndarray, "points d"]:
    """Return real polynomials with Fourier coefficients of harmonics from 0 on at these θ, in turns."""
    k = np.arange(len(coefficients))
    waves = np.where(k > 0, 2.0, 1.0) * np.exp(2j * np.pi * np.outer(theta % 1.0, k))
    return np.real(waves @ coefficients)


def curve_through(
    u: Float[np.ndarray, "points d"], rotation: float, m: int, angles: Bool[np.ndarray, " d"]
) -> InvariantCurve:
    """Return the curve of quasiperiodic motion: its coefficients are weighted Birkhoff averages of u_n exp(−2πi k n ρ).

    Args:
        u: successive points, angles up to whole turns.
        rotation: ρ.
        m: harmonics; fewer where so many points do not tell them apart, as beside a rational ρ.
        angles: which coordinates are angles.
    """
    count = len(u)
    turns = np.arange(1, 2 * m + 1) * rotation
    close = np.flatnonzero(np.abs(turns - np.rint(turns)) * count < _APART)
    m = max(1, int(close[0]) // 2) if len(close) else m
    theta = (np.arange(count) * rotation) % 1.0
    order = np.argsort(theta)
    u = np.array(u)
    unwrapped = np.unwrap(np.concatenate([u[order], u[order[:1]]])[:, angles], axis=0)
    winding = np.zeros(u.shape[1], np.int64)
    winding[angles] = np.rint((unwrapped[-1] - unwrapped[0]) / _TURN)
    u[np.ix_(order, angles)] = unwrapped[:-1]
    periodic = u - _TURN * theta[:, None] * winding
    weights = window_weights((np.arange(count) + 0.5) / count)
    waves = np.exp(-2j * np.pi * np.outer(np.arange(m + 1), theta))
    coefficients = (waves * weights) @ periodic / np.sum(weights)
    nodes = _nodes(2 * m + 1)
    return InvariantCurve(
        trigonometric_polynomial(coefficients, nodes) + _TURN * nodes[:, None] * winding, winding, rotation
    )


def solve_curves(
    images: Images, curves: dict[int, InvariantCurve], most: int, error: Float[np.ndarray, " d"] | float, wrap: Wrap
) -> dict[int, tuple[InvariantCurve, CurveQuality]]:
    """Newton on the curves of many lanes at once, each with as many harmonics as it needs; lanes wait for no others.

    Args:
        images: P and ∂P/∂u at points of lanes.
        curves: where to begin, by the number of the lane.
        most: harmonics at most.
        error: of the map, that of ρ grows from, in the units of each coordinate.
        wrap: of differences of section coordinates.

    Returns:
        Of every lane the last curve, and whether it is a solution.
    """
    solved: dict[int, tuple[InvariantCurve, CurveQuality]] = {}
    current = {lane: curve.with_harmonics(max(_FEWEST, curve.harmonics)) for lane, curve in curves.items()}
    while current:
        rested = _come_to_rest(images, current, wrap)
        checked = qualities(images, {k: curve for k, (curve, at_rest) in rested.items() if at_rest}, error, wrap)
        checked |= {lane: (curve, _unknown(curve)) for lane, (curve, at_rest) in rested.items() if not at_rest}
        current = {}
        for lane, (curve, quality) in checked.items():
            m = curve.harmonics
            if quality.converged and not is_resolved(curve) and 2 * m <= most:
                current[lane] = curve.with_harmonics(2 * m)
            else:
                solved[lane] = curve, quality._replace(converged=quality.converged and is_resolved(curve))
    return solved


def is_resolved(curve: InvariantCurve) -> bool:
    """Return whether the last harmonics of a curve are rounding."""
    last = np.abs(curve.coefficients[-max(2, curve.harmonics // 4) :])
    return bool(np.max(last / curve.size) <= _RESOLVED)


def _asked(
    images: Images, curves: dict[int, InvariantCurve], shift: float, coordinate: int | None = None
) -> dict[int, tuple[Float[np.ndarray, "N d"], Float[np.ndarray, "N d d"]]]:
    """Return images and derivatives at the nodes of all curves, moved by so many of their distances.

    Args:
        coordinate: number of that by which all points are shifted as well, by `_SHIFT`.
    """
    places = {lane: _nodes(len(curve.points)) + shift / len(curve.points) for lane, curve in curves.items()}
    u = [curve.at(places[lane]) for lane, curve in curves.items()]
    if coordinate is not None:
        ways = _SHIFT * np.eye(u[0].shape[1])[coordinate]
        u = [points + ways * curve.size for points, curve in zip(u, curves.values(), strict=True)]
    u = np.concatenate(u)
    lane = np.repeat(np.array(list(curves), np.int64), [len(theta) for theta in places.values()])
    at = images(u, lane)
    image, matrices = np.asarray(at.image), np.asarray(at.monodromy)
    return {number: (image[lane == number], matrices[lane == number]) for number in curves}


def _come_to_rest(
    images: Images, curves: dict[int, InvariantCurve], wrap: Wrap
) -> dict[int, tuple[InvariantCurve, bool]]:
    """Return the curves after steps of Newton, and whether these came to nothing."""
    ended: dict[int, tuple[InvariantCurve, bool]] = {}
    length = dict.fromkeys(curves, np.inf)
    for _ in range(_NEWTON_STEPS):
        if not curves:
            break
        going: dict[int, InvariantCurve] = {}
        for lane, (image, matrices) in _asked(images, curves, 0.0).items():
            curve, last = curves[lane], length[lane]
            missing, matrix = invariance_system(curve, image, matrices, wrap)
            if not (np.isfinite(missing).all() and np.isfinite(matrix).all()):
                ended[lane] = curve, False
                continue
            step = _least_squares(matrix, missing)
            moved = replace(
                curve,
                points=curve.points + step[:-1].reshape(curve.points.shape) * curve.size,
                rotation=curve.rotation + step[-1],
            )
            length[lane] = float(np.max(np.abs(step)))
            if last <= _AT_REST or length[lane] <= 1e-3 * _AT_REST:
                ended[lane] = moved, True
            elif length[lane] > _CONTRACTION * last:
                ended[lane] = curve, False
            else:
                going[lane] = moved
        curves = going
    return ended | {lane: (curve, False) for lane, curve in curves.items()}


def invariance_system(
    curve: InvariantCurve, image: Float[np.ndarray, "N d"], matrices: Float[np.ndarray, "N d d"], wrap: Wrap
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
    """Return minus the residual and Newton's matrix, of points in sizes of the curve and ρ; the phase is last.

    Args:
        curve: the iterate.
        image, matrices: of the map and its derivative at the nodes.
        wrap: of differences of section coordinates.
    """
    count, d = curve.points.shape
    size, nodes = curve.size, _nodes(count)
    there = nodes + curve.rotation
    missing = wrap(curve.at(there) - image) / size
    matrix = np.zeros((count * d + 1, count * d + 1))
    blocks = matrix[:-1, :-1].reshape(count, d, count, d)
    every = np.arange(count)
    blocks[every, :, every, :] = matrices * size / size[:, None]
    shift = _dirichlet(nodes[:, None] - nodes + curve.rotation, count)
    for j in range(d):
        blocks[:, j, :, j] -= shift
    matrix[:-1, -1] = -(curve.tangents(there) / size).ravel()
    matrix[-1, :-1] = (curve.tangents(nodes) / size).ravel() / count
    return np.append(missing.ravel(), 0.0), matrix


def _least_squares(matrix: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the shortest solution, which goes along no family of curves."""
    solution, *_ = lstsq(matrix, right, cond=_DROPPED, lapack_driver="gelsy") or (right,)
    return np.asarray(solution)


def _dirichlet(x: Float[np.ndarray, ...], count: int) -> Float[np.ndarray, ...]:
    """Return the trigonometric polynomial of an odd number of nodes that is 1 at 0 and 0 at the others."""
    sine = np.sin(np.pi * x)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.sin(np.pi * count * x) / (count * sine)
    return np.where(np.abs(sine) < 1e-14, 1.0, value)


def qualities(
    images: Images, curves: dict[int, InvariantCurve], error: Float[np.ndarray, " d"] | float, wrap: Wrap
) -> dict[int, tuple[InvariantCurve, CurveQuality]]:
    """Return curves that are solutions with their quality, from the residual half-way between the nodes.

    Args:
        images, error, wrap: as of `solve_curves`.
        curves: the curves, by the number of the lane.
    """
    if not curves:
        return {}
    nodes, between = _asked(images, curves, 0.0), _asked(images, curves, 0.5)
    beside = [_asked(images, curves, 0.0, j) for j in range(next(iter(curves.values())).points.shape[1])]
    of_lane = {lane: np.stack([shifted[lane][1] for shifted in beside]) for lane in curves}
    return {
        lane: (curve, _quality(curve, *nodes[lane], of_lane[lane], between[lane][0], error, wrap))
        for lane, curve in curves.items()
    }


def _unknown(curve: InvariantCurve) -> CurveQuality:
    count, d = curve.points.shape
    none = np.full((count, d, d), np.nan)
    return CurveQuality(False, np.nan, np.nan, np.nan, none, np.nan, none)


def _quality(
    curve: InvariantCurve,
    image: Float[np.ndarray, "N d"],
    matrices: Float[np.ndarray, "N d d"],
    beside: Float[np.ndarray, "d N d d"],
    image_between: Float[np.ndarray, "N d"],
    error: Float[np.ndarray, " d"] | float,
    wrap: Wrap,
) -> CurveQuality:
    missing, matrix = invariance_system(curve, image, matrices, wrap)
    count, size = len(curve.points), curve.size
    halfway = _nodes(count) + 0.5 / count
    between = wrap(curve.at(halfway + curve.rotation) - image_between) / size
    if not (np.isfinite(between).all() and np.isfinite(matrix).all()):
        return _unknown(curve)
    rounding = 8.0 * np.finfo(float).eps * (1.0 + np.max(np.abs(curve.points), axis=0) / size)
    missed = np.maximum(np.abs(between), np.abs(missing[:-1].reshape(between.shape)))
    bounds = missed + (error / size + rounding)
    unit = np.zeros(len(missing))
    unit[-1] = 1.0
    rotation_error = _response(matrix, unit, bounds)
    slopes = (beside - matrices) / _SHIFT
    with np.errstate(invalid="ignore"):
        volume = np.trace(np.linalg.pinv(matrices) @ slopes, axis1=2, axis2=3).T / count
    volume_error = _response(matrix, np.append(volume.ravel(), 0.0), bounds) if np.isfinite(volume).all() else np.inf
    displaced = matrices
    if curve.points.shape[1] > 2 and np.isfinite(slopes).all():
        displaced = matrices + np.einsum("nj,jnab->nab", _displacement(matrix, bounds), slopes)
    residual = float(np.max(np.abs(between)))
    return CurveQuality(True, rotation_error, residual, _decay(curve), matrices, volume_error, displaced)


def _response(
    matrix: Float[np.ndarray, "n n"], gradient: Float[np.ndarray, " n"], bounds: Float[np.ndarray, "N d"]
) -> float:
    """Return the largest change of a quantity with a gradient in the unknowns, by errors of the equations in bounds."""
    return float(np.abs(_least_squares(matrix.T, gradient)[:-1]) @ bounds.ravel())


def _displacement(matrix: Float[np.ndarray, "n n"], bounds: Float[np.ndarray, "N d"]) -> Float[np.ndarray, "N d"]:
    """Return about how far errors of the equations in bounds displace the curve at most, in sizes.

    By a step of inverse iteration: beside a fold of tori one direction is told far less than all others.
    """
    weakest = _least_squares(matrix.T, _least_squares(matrix, np.append(bounds.ravel(), 0.0)))[:-1]
    worst = np.where(weakest < 0.0, -1.0, 1.0) * bounds.ravel()
    return _least_squares(matrix, np.append(worst, 0.0))[:-1].reshape(bounds.shape)


def _decay(curve: InvariantCurve) -> float:
    """Return the rate at which the largest of a coefficient and all beyond it falls, by a straight line."""
    largest = np.max(np.abs(curve.coefficients[1:]) / curve.size, axis=1)
    tail = np.maximum.accumulate(largest[::-1])[::-1]  # no coefficient beyond is larger
    k = np.flatnonzero(tail > _FLOOR * tail[0]) + 1.0
    if len(k) < 4:
        return np.nan
    return float(-np.polyfit(k, np.log(tail[: len(k)]), 1)[0])
