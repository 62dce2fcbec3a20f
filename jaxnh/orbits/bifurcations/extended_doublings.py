"""Doublings in double-double precision: Newton on the orbit and its vector of −1, from those of float64 or before.

Unknowns are the points u_i of the orbit, a vector w_i at each, and the parameter, with P(u_i) = u_{i+1} around the
orbit and ∂P/∂u w_i = w_{i+1}, reversed once around. Only what these equations miss by has to be precise: slopes are
those of float64, second derivatives differences of first ones, and steps are corrections. Slopes are computed again as
long as steps do not shrink as they do near the doubling.

The next doubling of a cascade is looked for where its law puts it (Feigenbaum, J. Stat. Phys. 19 (1978) 25): at the
last distance over δ, with an orbit that leaves the last one along ± w by the last width over α. Host code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jaxnh.maps.double_double import two_sum
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits import cyclic
from jaxnh.orbits.bifurcations.doubling_points import FEIGENBAUM, halves
from jaxnh.systems.chart import Wrap

Sum = tuple[np.ndarray, np.ndarray]
"""Arrays that are summed without error: hi and lo."""

_WIDTHS = 2.5  # ratio α of successive widths far down a cascade; here it only says where to look
_SHARES = (0.4, 0.6, 0.3)  # of half a width, tried one after the other: the orbit at its doubling is no longer straight
_BEYOND, _UP_TO = 0.5, 1.5  # shares of the expected distance within which a doubling is the next one
_STEPS = 16
_DIFFERENCE = 1e-5  # in sizes of the motion, of differences of slopes: what they miss is 1e-8 of them
_FALLING = 0.25  # of the step before, at most, or rounding rules
_STEADY = 1e-5  # of the step before, at most, or slopes are computed again
_SPACING = 2.0**-104
_TURN = (2.0 * np.pi, 2.4492935982947064e-16)  # 2 π as a sum


class Slopes(Protocol):
    """P, ∂P/∂u and ∂P/∂p of lanes in float64."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"], /) -> Derivatives:
        """Evaluate at points and values of the parameter, a lane each."""
        ...


class ExtendedPeriod(Protocol):
    """P and ∂P/∂u w of lanes in double-double precision: `maps.extended_precision.push_point`."""

    def __call__(self, u: Sum, w: Sum, value: tuple[float, float], /) -> tuple[Sum, Sum]:
        """Evaluate at points (lanes, d) and vectors (lanes, d), at one value of the parameter."""
        ...


class ExtendedPoint(NamedTuple):
    """A doubling beyond float64.

    Attributes:
        value: of the parameter, as a sum of two.
        error: by rounding: the last step of Newton, which made it no smaller.
        orbit: its n points, (n, d) each.
        vector: of −1 at each, of any length.
    """

    value: tuple[float, float]
    error: float
    orbit: Sum
    vector: Sum


def from_float64(value: float, orbit: Float[np.ndarray, "n d"], vector: Float[np.ndarray, "n d"]) -> ExtendedPoint:
    """A doubling of float64."""
    return ExtendedPoint((value, 0.0), np.inf, (orbit, np.zeros_like(orbit)), (vector, np.zeros_like(vector)))


def extended_doubling(
    period: ExtendedPeriod, slopes: Slopes, start: ExtendedPoint, size: Float[np.ndarray, " d"], wrap: Wrap
) -> ExtendedPoint | None:
    """The doubling near a point, one of float64 or of nearly the same map; None where Newton does not settle.

    Args:
        period: the map in double-double precision.
        slopes: the map in float64.
        start: the point; its error is how far the doubling may be where the slopes there are of no use, else infinite.
        size: of the motion in each section coordinate.
        wrap: of differences of section coordinates.
    """
    (value, last, u, w), linear = start, None
    for _ in range(_STEPS):
        linear = linear or _linearise(slopes, value[0], u[0], w[0], size)
        image, vector = period(u, w, value)
        of_orbit = difference(_following_points(u), image, wrap)
        of_vector = difference(_following_points(w, -1.0), vector)
        du, dw, step = _step(linear, of_orbit, of_vector)
        if not np.isfinite(step) or not np.isfinite(du).all():
            return None
        u, w, value = _move(u, du), _move(w, dw), _shift(value, step)
        size_of_step, least = abs(step), _SPACING * abs(value[0])
        if size_of_step <= least or (size_of_step >= _FALLING * last and last < np.spacing(abs(value[0]))):
            return ExtendedPoint(value, max(size_of_step, least), u, w)
        if size_of_step > _STEADY * last:
            linear = None
        last = size_of_step
    return None


def next_doubling(
    period: ExtendedPeriod, slopes: Slopes, known: Sequence[ExtendedPoint], size: Float[np.ndarray, " d"], wrap: Wrap
) -> ExtendedPoint | None:
    """The doubling that follows two or more; None where it is not located. The last orbit has more than one point.

    Args:
        period, slopes, size, wrap: as in `extended_doubling`.
        known: doublings of the cascade, each of twice the period of the one before.
    """
    before, last = known[-2:]
    gap = _distance(before, last) / FEIGENBAUM
    value, (points, _), (along, _) = last.value[0] + gap, last.orbit, last.vector
    along = along / np.linalg.norm(along / size, axis=1).max()
    width = np.linalg.norm(halves(points, wrap) / size, axis=1).max()
    for share in _SHARES:
        moved = 0.5 * share / _SHARES[0] / _WIDTHS * width * along
        orbit = np.concatenate([points + moved, points - moved])
        vector = _null_vector(slopes, value, orbit)
        guess = from_float64(value, orbit, vector)._replace(error=abs(gap))
        doubling = extended_doubling(period, slopes, guess, size, wrap)
        if doubling is not None and _BEYOND < _distance(last, doubling) / gap < _UP_TO:
            return doubling
    return None


def predict_on_finer_map(point: ExtendedPoint, coarse: ExtendedPoint, fine: ExtendedPoint, wrap: Wrap) -> ExtendedPoint:
    """About where a finer map has a doubling of a map, from the doubling before of both: points move together.

    Args:
        point: the doubling of the map.
        coarse, fine: the one before, of half the period, of this map and of the finer one.
        wrap: of differences of section coordinates.
    """
    shift = difference(fine.orbit, coarse.orbit, wrap)
    orbit = _move(point.orbit, np.concatenate([shift, shift]))
    return point._replace(value=_shift(point.value, _distance(coarse, fine)), error=np.inf, orbit=orbit)


def difference(a: Sum, b: Sum, wrap: Wrap | None = None) -> np.ndarray:
    """a − b in float64, of which the upper halves, and whole turns of angles, are subtracted without error."""
    (high, low), rest = two_sum(a[0], -b[0]), a[1] - b[1]
    if wrap is not None:
        turns = np.round((high - wrap(high)) / _TURN[0])
        high, less = two_sum(high, -turns * _TURN[0])
        rest = rest + (less - turns * _TURN[1])
    return high + (low + rest)


class _Linear(NamedTuple):
    """Newton's equations at a doubling.

    Attributes:
        orbit, vector: around the orbit, and with the last sign reversed.
        by_value: ∂u/∂p of the orbit, (n, d).
        second: ∂²P/∂u² w at each point, (n, d, d).
        column: what stands before the step of the parameter in the equations of w, (n, d).
    """

    orbit: cyclic.Cyclic
    vector: cyclic.Cyclic
    by_value: np.ndarray
    second: np.ndarray
    column: np.ndarray


def _linearise(
    slopes: Slopes,
    value: float,
    orbit: Float[np.ndarray, "n d"],
    vector: Float[np.ndarray, "n d"],
    size: Float[np.ndarray, " d"],
) -> _Linear:
    n, d = orbit.shape
    values = np.full(n, value)
    away = _DIFFERENCE / np.linalg.norm(vector / size, axis=1)[:, None]
    centre, ahead, behind = (slopes(orbit + sign * away * vector, values) for sign in (0.0, 1.0, -1.0))
    assert centre.by_parameter is not None
    assert ahead.by_parameter is not None
    assert behind.by_parameter is not None
    blocks = np.asarray(centre.monodromy)
    second = (np.asarray(ahead.monodromy) - np.asarray(behind.monodromy)) / (2.0 * away[:, :, None])
    mixed = (np.asarray(ahead.by_parameter) - np.asarray(behind.by_parameter)) / (2.0 * away)
    closed = cyclic.eliminate(blocks, np.tile(-np.eye(d), (n, 1, 1)))
    by_value = cyclic.solve(closed, -np.asarray(centre.by_parameter))
    column = np.einsum("nij,nj->ni", second, by_value) + mixed
    return _Linear(closed, _reversed_equations(blocks), by_value, second, column)


def _reversed_equations(blocks: Float[np.ndarray, "n d d"]) -> cyclic.Cyclic:
    """The equations of the vector of −1."""
    there = np.tile(-np.eye(blocks.shape[-1]), (len(blocks), 1, 1))
    there[-1] *= -1.0
    return cyclic.eliminate(blocks, there)


def _null_vector(slopes: Slopes, value: float, orbit: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """The vector of −1 nearly, around an orbit that nearly has one, of length one where it is longest."""
    blocks = np.asarray(slopes(orbit, np.full(len(orbit), value)).monodromy)
    vector = cyclic.null_vector(_reversed_equations(blocks))
    return vector / np.abs(vector).max()


def _step(linear: _Linear, of_orbit: np.ndarray, of_vector: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Steps of u, w and the parameter for what u_{i+1} − P(u_i) and w_{i+1} − ∂P/∂u w_i are."""
    left = cyclic.solve(linear.orbit, of_orbit)
    right = of_vector - np.einsum("nij,nj->ni", linear.second, left)
    solutions = cyclic.underdetermined(linear.vector, right, linear.column)
    step = float(solutions.x)
    return left + step * linear.by_value, solutions.y, step


def _following_points(points: Sum, sign: float = 1.0) -> Sum:
    """The points that follow; before the first stands the last, times a sign."""
    hi, lo = (np.roll(half, -1, axis=0) for half in points)
    hi[-1] *= sign
    lo[-1] *= sign
    return hi, lo


def _move(points: Sum, step: np.ndarray) -> Sum:
    high, low = two_sum(points[0], step)
    return two_sum(high, low + points[1])


def _distance(a: ExtendedPoint, b: ExtendedPoint) -> float:
    """Difference of the values, b minus a."""
    return (b.value[0] - a.value[0]) + (b.value[1] - a.value[1])


def _shift(value: tuple[float, float], step: float) -> tuple[float, float]:
    hi, lo = _move((np.array(value[0]), np.array(value[1])), np.array(step))
    return float(hi), float(lo)
