"""Points where the orbit of period n has a multiplier −1, from first derivatives of single periods alone. Host code.

The test function is det(M + 1), M the product of the ∂P/∂u around the orbit: about 2 where the orbit is born from one
of half its period, 0 where it doubles. It is the determinant of the linear equations around the orbit for a vector that
comes back reversed, so that no product is formed and rounding does not grow with n; and since the orbit, stable or
not, solves an equation, critical slowing plays no part. It is computed at a few nodes of the parameter about the
doubling, with warm starts, and a polynomial through them has the root.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial import polynomial

from jaxnh.orbits import cyclic
from jaxnh.orbits.shooting import Period, ShootingOrbits, close_orbits
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

FEIGENBAUM = 4.669201609102990
"""Ratio δ of successive distances between doublings, far down a cascade; here it only says where to look."""

_NODES = np.cos(np.pi * (np.arange(6) + 0.5) / 6)  # Chebyshev nodes of [−1, 1]
_DEGREE = 3  # two less than what would go through all nodes: the rest shows truncation and rounding
_NARROWER = 64  # from round to round
_ROUNDS = 12
_AHEAD = 4  # nodes of a step along the branch
_BEHIND = 3  # nodes that a step is predicted from
_SMALLEST_STEP = 1e-6  # share of the range
_MOST_STEPS = 64
_COLLAPSED = 0.25  # of the distance to an orbit of a shorter period, from one value to the next
_ROUNDING = 1e-6  # of the test function, which is of order one: what falls no more below it is rounding


class DoublingPoint(NamedTuple):
    """Point where a period-n orbit has a multiplier −1.

    Attributes:
        value: of the parameter.
        orbit: the n points of the orbit in section coordinates, (n, d).
        vector: the eigenvector of −1 at each of them, (n, d), of length one at the first.
        error: of the value, by rounding and interpolation: what the polynomial misses the test function by at its nodes
            and at its root, over its slope.
        slope: of the test function in the parameter.
    """

    value: float
    orbit: Float[np.ndarray, "n d"]
    vector: Float[np.ndarray, "n d"]
    error: float
    slope: float


class DoublingBranch(NamedTuple):
    """Orbits at neighbouring values of the parameter, with a doubling among them or near.

    Attributes:
        values: of the parameter, (k,).
        points: (k, n, d), with angles that go on from one value to the next.
        centre, half: where the doubling is looked for: centre ± half.
    """

    values: Float[np.ndarray, " k"]
    points: Float[np.ndarray, "k n d"]
    centre: float
    half: float


def follow_branch(
    period: Period, points: Float[np.ndarray, "n d"], start: float, stop: float, wrap: Wrap
) -> DoublingBranch | None:
    """The branch of a stable orbit from one value of the parameter on to where it has doubled; None: not before `stop`.

    Args:
        period: P and ∂P/∂u over lanes.
        points: of the orbit at `start`, nearly.
        start, stop: values of the parameter, in either order.
        wrap: of differences of section coordinates.
    """
    orbit = close_orbits(period, points[None], np.array([start]), wrap)
    if not orbit.converged[0]:
        return None
    values, known, reach = np.array([start]), orbit.points, stop - start
    if doubling_function(orbit)[0] <= 0.0:  # at the doubling, as far as the survey could tell
        return DoublingBranch(values, known, start, abs(reach) / _NARROWER)
    for _ in range(_MOST_STEPS):
        if abs(reach) <= _SMALLEST_STEP * abs(stop - start) or values[-1] == stop:
            break
        share = np.linspace(0.0, 1.0, _AHEAD + 1)[1:]
        end = stop if abs(reach) >= abs(stop - values[-1]) else values[-1] + reach
        ahead = values[-1] + share * (end - values[-1])
        ahead[-1] = end
        guess = _interpolate(values[-_BEHIND:], known[-_BEHIND:], ahead)
        orbits = close_orbits(period, guess, ahead, wrap)
        apart = np.array([_separation(p, wrap) for p in [known[-1], *orbits.points]])
        kept = orbits.converged & (apart[1:] >= _COLLAPSED * apart[:-1])
        count = int(np.argmin(np.append(kept, False)))
        if not count:
            reach /= _AHEAD
            continue
        values, known = np.append(values, ahead[:count]), np.concatenate([known, orbits.points[:count]])
        beyond = np.flatnonzero(doubling_function(select(orbits, slice(count))) <= 0.0)
        if len(beyond):
            last = len(values) - count + int(beyond[0])
            low, high = values[last - 1], values[last]
            return DoublingBranch(values, known, float(0.5 * (low + high)), float(0.5 * abs(high - low)))
        reach *= 2.0 if count == _AHEAD else 0.5
    return None


def doubling_point(period: Period, branch: DoublingBranch, wrap: Wrap) -> DoublingPoint | None:
    """The doubling on a branch; None where it is not there.

    Rounds of nodes narrow about the root of the round before, until the error falls no more: rounding is reached.

    Args:
        period: P and ∂P/∂u over lanes.
        branch: with orbits near the doubling.
        wrap: of differences of section coordinates.
    """
    best: DoublingPoint | None = None
    for _ in range(_ROUNDS):
        nearest = np.argsort(np.abs(branch.values - branch.centre), kind="stable")[: len(_NODES)]
        nodes = branch.centre + branch.half * _NODES
        guess = _interpolate(branch.values[nearest], branch.points[nearest], nodes)
        orbits = close_orbits(period, guess, nodes, wrap)
        if not orbits.converged.all():
            branch = branch._replace(half=branch.half / _NARROWER)
            continue
        tested = doubling_function(orbits)
        fit = polynomial.polyfit(_NODES, tested, _DEGREE)
        misfit = np.abs(tested - polynomial.polyval(_NODES, fit)).max()
        root = _root_nearest_zero(fit)
        if root is None:
            return best
        value = float(branch.centre + branch.half * root)
        there = close_orbits(period, _interpolate(nodes, orbits.points, np.array([value])), np.array([value]), wrap)
        slope = float(polynomial.polyval(root, polynomial.polyder(fit)) / branch.half)
        missed = misfit + np.abs(doubling_function(there)[0])
        error = float(missed / abs(slope) + np.spacing(abs(value)))
        if not there.converged[0] or (best is not None and not error < 0.25 * best.error):
            return best
        narrower = branch.half / (_NARROWER if abs(root) <= 1.0 else 1.0)
        branch = DoublingBranch(nodes, orbits.points, value, narrower)
        best = DoublingPoint(value, there.points[0], cyclic.null_vector(_reversed_equations(there))[0], error, slope)
    return best


def refine_doubling(period: Period, point: DoublingPoint, wrap: Wrap) -> DoublingPoint | None:
    """The doubling of nearly the same map, as of more steps a period, by Newton with the slope of the one known.

    None where it is not there. Its error has that of the known one in it.
    """
    value, size = point.value, np.inf
    orbit = point.orbit[None]
    for _ in range(_ROUNDS):
        there = close_orbits(period, orbit, np.array([value]), wrap)
        left = float(doubling_function(there)[0])
        shift = -left / point.slope
        if not there.converged[0]:
            return None
        if abs(shift) <= point.error or (abs(left) < _ROUNDING and abs(shift) >= 0.25 * size):
            vector = cyclic.null_vector(_reversed_equations(there))[0]
            return DoublingPoint(value, there.points[0], vector, point.error + abs(shift), point.slope)
        value, size, orbit = value + shift, abs(shift), there.points
    return None


def doubling_function(orbits: ShootingOrbits) -> Float[np.ndarray, " nodes"]:
    """det(M + 1) of every orbit, M = M_{n−1}…M_0: positive where it is stable, negative once it has doubled."""
    return cyclic.determinant(_reversed_equations(orbits))


def halves(points: Float[np.ndarray, "... n d"], wrap: Wrap) -> Float[np.ndarray, "... n d"]:
    """Differences of points of an orbit from those half its period later."""
    return wrap(points - np.roll(points, points.shape[-2] // 2, axis=-2))


def _reversed_equations(orbits: ShootingOrbits) -> cyclic.Cyclic:
    """The equations M_i w_i = w_{i+1} around each orbit with w_n = −w_0."""
    there = np.zeros_like(orbits.blocks)
    there[:] = -np.eye(orbits.blocks.shape[-1])
    there[:, -1] *= -1.0
    return cyclic.eliminate(orbits.blocks, there)


def _root_nearest_zero(coefficients: np.ndarray) -> float | None:
    """The real root nearest zero of a polynomial, of those not far beyond its nodes in [−1, 1]."""
    roots = polynomial.polyroots(coefficients)
    real = roots.real[(np.abs(roots.imag) < 1e-6) & (np.abs(roots.real) < 2.0)]
    if not len(real):
        return None
    root, slope = float(real[np.argmin(np.abs(real))]), polynomial.polyder(coefficients)
    for _ in range(2):  # roundings of the largest root are in all of them
        root -= float(polynomial.polyval(root, coefficients) / polynomial.polyval(root, slope))
    return root


def _interpolate(values: np.ndarray, leaves: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The polynomial through leaves (k, ...) at so many values (k,), at others (m,): (m, ...)."""
    k = len(values)
    apart = values[:, None] - values
    shares = [
        np.prod([(at - values[i]) / apart[j, i] for i in range(k) if i != j], axis=0) * np.ones_like(at)
        for j in range(k)
    ]
    return np.tensordot(np.array(shares), leaves, (0, 0))


def _separation(points: Float[np.ndarray, "n d"], wrap: Wrap) -> float:
    """Distance of an orbit of n points from one of a shorter period, over all divisors of n."""
    n = len(points)
    shorter = [n // q for q in range(2, n + 1) if n % q == 0]
    return min((float(np.abs(wrap(points - np.roll(points, m, 0))).max()) for m in shorter), default=np.inf)
