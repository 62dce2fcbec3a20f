"""A doubling in double-double precision: Newton on the orbit and its vector of −1 from where float64 has found them.

Unknowns are the points u_i of the orbit, a vector w_i at each, and the parameter, with P(u_i) = u_{i+1} around the
orbit and ∂P/∂u w_i = w_{i+1}, reversed once around. Only what these equations miss by has to be precise: slopes are
those of float64 at the start, second derivatives differences of first ones, and steps are small corrections. Host code.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jaxnh.maps.double_double import two_sum
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits import cyclic
from jaxnh.orbits.doubling_points import DoublingPoint
from jaxnh.orbits.shooting import Wrap

Sum = tuple[np.ndarray, np.ndarray]
"""Arrays that are summed without error: hi and lo."""

_STEPS = 12
_DIFFERENCE = 1e-5  # in sizes of the motion, of differences of slopes: what they miss is 1e-8 of them
_FALLING = 0.25  # of the step before, at most, or rounding rules
_SPACING = 2.0**-104
_TURN = (2.0 * np.pi, 2.4492935982947064e-16)  # 2 π as a sum


class Slopes(Protocol):
    """P, ∂P/∂u and ∂P/∂p of lanes in float64."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"], /) -> Derivatives:
        """At points and values of the parameter, a lane each."""
        ...


class ExtendedPeriod(Protocol):
    """P and ∂P/∂u w of lanes in double-double precision: `maps.extended_precision.carried`."""

    def __call__(self, u: Sum, w: Sum, value: tuple[float, float], /) -> tuple[Sum, Sum]:
        """At points (lanes, d) and vectors (lanes, d), at one value of the parameter."""
        ...


class ExtendedPoint(NamedTuple):
    """A doubling beyond float64.

    Attributes:
        value: of the parameter, as a sum of two.
        error: by rounding: the last step of Newton, which made it no smaller.
    """

    value: tuple[float, float]
    error: float


def extended_doubling(
    period: ExtendedPeriod, slopes: Slopes, point: DoublingPoint, size: Float[np.ndarray, " d"], wrap: Wrap
) -> ExtendedPoint | None:
    """The doubling of the same map near one in float64; None where Newton does not settle.

    Args:
        period: the map in double-double precision.
        slopes: the map in float64.
        point: the doubling in float64.
        size: of the motion in each section coordinate.
        wrap: of differences of section coordinates.
    """
    linear = _linearised(slopes, point, size)
    u, w = (point.orbit, np.zeros_like(point.orbit)), (point.vector, np.zeros_like(point.vector))
    value, last = (point.value, 0.0), np.inf
    for _ in range(_STEPS):
        image, vector = period(u, w, value)
        of_orbit = _difference(_next(u), image, wrap)
        of_vector = _difference(_next(w, -1.0), vector)
        du, dw, step = _step(linear, of_orbit, of_vector)
        if not np.isfinite(step) or not np.isfinite(du).all():
            return None
        u, w, value = _moved(u, du), _moved(w, dw), _shifted(value, step)
        if abs(step) <= _SPACING * abs(value[0]) or (abs(step) >= _FALLING * last and last < np.spacing(point.value)):
            return ExtendedPoint(value, max(abs(step), _SPACING * abs(value[0])))
        last = abs(step)
    return None


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


def _linearised(slopes: Slopes, point: DoublingPoint, size: Float[np.ndarray, " d"]) -> _Linear:
    n, d = point.orbit.shape
    values = np.full(n, point.value)
    away = _DIFFERENCE / np.linalg.norm(point.vector / size, axis=1)[:, None]
    here, ahead, behind = (slopes(point.orbit + sign * away * point.vector, values) for sign in (0.0, 1.0, -1.0))
    assert here.by_parameter is not None
    assert ahead.by_parameter is not None
    assert behind.by_parameter is not None
    blocks = np.asarray(here.monodromy)
    second = (np.asarray(ahead.monodromy) - np.asarray(behind.monodromy)) / (2.0 * away[:, :, None])
    mixed = (np.asarray(ahead.by_parameter) - np.asarray(behind.by_parameter)) / (2.0 * away)
    there = np.tile(-np.eye(d), (n, 1, 1))
    orbit = cyclic.eliminate(blocks, there)
    there[-1] *= -1.0
    by_value = cyclic.solve(orbit, -np.asarray(here.by_parameter))
    column = np.einsum("nij,nj->ni", second, by_value) + mixed
    return _Linear(orbit, cyclic.eliminate(blocks, there), by_value, second, column)


def _step(linear: _Linear, of_orbit: np.ndarray, of_vector: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Steps of u, w and the parameter for what u_{i+1} − P(u_i) and w_{i+1} − ∂P/∂u w_i are."""
    left = cyclic.solve(linear.orbit, of_orbit)
    right = of_vector - np.einsum("nij,nj->ni", linear.second, left)
    solutions = cyclic.underdetermined(linear.vector, right, linear.column)
    step = float(solutions.x)
    return left + step * linear.by_value, solutions.y, step


def _next(points: Sum, sign: float = 1.0) -> Sum:
    """The points that follow; before the first stands the last, times a sign."""
    hi, lo = (np.roll(half, -1, axis=0) for half in points)
    hi[-1] *= sign
    lo[-1] *= sign
    return hi, lo


def _difference(a: Sum, b: Sum, wrap: Wrap | None = None) -> np.ndarray:
    """a − b in float64, of which the upper halves, and whole turns of angles, are subtracted without error."""
    (high, low), rest = two_sum(a[0], -b[0]), a[1] - b[1]
    if wrap is not None:
        turns = np.round((high - wrap(high)) / _TURN[0])
        high, less = two_sum(high, -turns * _TURN[0])
        rest = rest + (less - turns * _TURN[1])
    return high + (low + rest)


def _moved(points: Sum, step: np.ndarray) -> Sum:
    high, low = two_sum(points[0], step)
    return two_sum(high, low + points[1])


def _shifted(value: tuple[float, float], step: float) -> tuple[float, float]:
    hi, lo = _moved((np.array(value[0]), np.array(value[1])), np.array(step))
    return float(hi), float(lo)
