"""Doubling points and long orbits by multiple shooting: no product of monodromy matrices is formed.

Lane functions are pure; the solution of the one large system is host code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnh.maps.protocol import Strobe, Tangent
from jaxnh.systems.flow import Parameters
from jaxnh.systems.particle import wrap as planar_wrap

_NEWTON_STEPS = 12
_NEWTON_TOLERANCE = 1e-9
_LARGEST_STEP = 0.25
_MOST_TURNS = 200


class Segment(NamedTuple):
    """One period of an orbit with a vector carried along, and all that Newton on both needs.

    Attributes:
        image: P(u; p), (d,).
        carried: M w with M = ∂P/∂u, (d,).
        image_slope: ∂P/∂u and in one parameter, (d, d + 1).
        carried_slope: ∂(M w)/∂u and in it, (d, d + 1).
    """

    image: Any
    carried: Any
    image_slope: Any
    carried_slope: Any


def segment(strobe: Strobe, u: Float[Array, " d"], w: Float[Array, " d"], p: Parameters, name: str) -> Segment:
    """P, M w and their derivatives in u and the parameter of that name, for one lane."""

    system, d = strobe.system, strobe.system.dimension

    def carry(v: Array) -> tuple[Array, Array]:
        state, tangent = jax.jvp(system.unchart, (v[:d],), (w,))
        pushed = strobe.push(state, {**p, name: v[d]}, (Tangent(tangent),))
        image, carried = jax.jvp(system.chart, (pushed.state,), (pushed.tangents[0].state,))
        return image, carried

    point = jnp.append(u, p[name])
    image_slope, carried_slope = jax.jacfwd(carry)(point)
    return Segment(*carry(point), image_slope, carried_slope)


class DoublingPoint(NamedTuple):
    """Where a period-n orbit has a multiplier −1.

    Attributes:
        value: of the parameter.
        orbit: the n points of the orbit in section coordinates, (n, d).
        vector: the eigenvector of −1 at each of them, (n, d), of length one at the first.
        last_step: size of the last Newton step in the parameter, which is rounding once it has converged.
        converged: whether it has.
    """

    value: float
    orbit: np.ndarray
    vector: np.ndarray
    last_step: float
    converged: bool


def refine_doubling(
    segments: Callable[[np.ndarray, np.ndarray, np.ndarray], Segment],
    orbit: np.ndarray,
    vector: np.ndarray,
    value: float,
    wrap: Callable[[np.ndarray], np.ndarray] = planar_wrap,
) -> DoublingPoint:
    """Newton on orbit, eigenvector and one parameter together, so that the orbit of n points has the multiplier −1.

    Multiple shooting: P(u_i) = u_{i+1}, M_i w_i = w_{i+1} around the orbit with w_n = −w_0 and |w_0|² = 1. No product
    of monodromy matrices is formed, so that rounding does not grow with n; and since the orbit, stable or not, is a
    solution of an equation, critical slowing plays no part.

    Args:
        segments: `segment` over lanes (n, d), (n, d), (n,).
        orbit: starting points (n, d).
        vector: starting vectors (n, d).
        value: starting value of the parameter.
        wrap: brings angles of a difference of section coordinates into their range.
    """
    n, d = orbit.shape
    turn = np.ones((n, 1))
    turn[-1] = -1.0
    vector = vector / np.linalg.norm(vector[0])
    step = np.inf
    for _ in range(_NEWTON_STEPS):
        s = Segment(*(np.asarray(leaf) for leaf in segments(orbit, vector, np.full(n, value))))
        residual = np.concatenate(
            [wrap(np.roll(orbit, -1, 0) - s.image), turn * np.roll(vector, -1, 0) - s.carried], axis=1
        )
        here = np.zeros((n, 2 * d, 2 * d))
        here[:, :d, :d] = here[:, d:, d:] = s.image_slope[:, :, :d]
        here[:, d:, :d] = s.carried_slope[:, :, :d]
        there = np.zeros((n, 2 * d, 2 * d))
        there[:, :d, :d] = -np.eye(d)
        there[:, d:, d:] = -np.eye(d) * turn[:, :, None]
        slope = np.concatenate([s.image_slope[:, :, d], s.carried_slope[:, :, d]], axis=1)
        normal = np.concatenate([np.zeros(d), 2.0 * vector[0]])
        moved, shift = solve_cyclic(here, there, slope, residual, normal, 1.0 - vector[0] @ vector[0])
        orbit, vector, value = orbit + moved[:, :d], vector + moved[:, d:], value + shift
        previous, step = step, abs(shift)
        if not np.isfinite(step):
            break
        if (step < 1e-10 and step >= 0.25 * previous) or step == 0.0:
            return DoublingPoint(value, orbit, vector, step, True)
    return DoublingPoint(value, orbit, vector, step, bool(step < 1e-10))


class LongOrbit(NamedTuple):
    """A periodic orbit of n points by multiple shooting.

    Attributes:
        points: section coordinates, (n, 3).
        blocks: ∂P/∂u at each of them, (n, 3, 3).
        residual: largest component of P(u_i) − u_{i+1}.
    """

    points: np.ndarray
    blocks: np.ndarray
    residual: float


def close_orbit(
    segments: Callable[[np.ndarray, np.ndarray, np.ndarray], Segment], points: np.ndarray, value: float
) -> LongOrbit:
    """Newton on P(u_i; p) = u_{i+1} around an orbit, all points (n, 3) at once: no error grows over more than a period.

    Args:
        segments: `segment` over lanes (n, 3), (n, 3), (n,).
        points: starting points (n, 3).
        value: of the parameter.
    """
    n = len(points)
    there = np.tile(-np.eye(3), (n, 1, 1))
    size = np.inf
    for _ in range(_NEWTON_STEPS):
        orbit, slope, right = _around(segments, points, value)
        if not size > _NEWTON_TOLERANCE or not np.isfinite(orbit.residual):
            return orbit
        # Of the line of solutions with the parameter free, the one that leaves it where it is.
        (y0, shift0), (y1, shift1) = (
            solve_cyclic(orbit.blocks, there, slope, right, np.ones(3), level) for level in (0.0, 1.0)
        )
        step = y0 - shift0 / (shift1 - shift0) * (y1 - y0)
        size = float(np.abs(step).max())
        points = points + step * min(1.0, _LARGEST_STEP / size)
    return _around(segments, points, value)[0]


def _around(
    segments: Callable[[np.ndarray, np.ndarray, np.ndarray], Segment], points: np.ndarray, value: float
) -> tuple[LongOrbit, np.ndarray, np.ndarray]:
    """An orbit as it is, ∂P/∂p at its points (n, 3), and what its images miss the next points by (n, 3)."""
    s = segments(points, np.zeros_like(points), np.full(len(points), value))
    slope = np.asarray(s.image_slope)
    missing = planar_wrap(np.roll(points, -1, 0) - np.asarray(s.image))
    return LongOrbit(points, slope[:, :, :3], float(np.abs(missing).max())), slope[:, :, 3], missing


def log_volume(strobe: Strobe, u: Float[Array, " d"], p: Parameters) -> Array:
    """ln det ∂P/∂u for one lane, exact where the determinant itself is lost to rounding."""
    return jnp.log(strobe.push(strobe.system.unchart(u), p, ()).volume)


def multiplier_logs(blocks: np.ndarray, volume: float) -> np.ndarray:
    """ln|μ| of the three multipliers of an orbit with these ∂P/∂u (n, 3, 3), largest first; no product is formed.

    Simultaneous iteration: two orthonormal vectors are carried around until their growth in a turn changes no more.
    Rounding loses the third in a single period already; `volume`, the sum of `log_volume` around the orbit, has it.
    Multipliers of one modulus, as complex ones, have it as the mean of their logarithms.
    """
    basis, logs = np.eye(3)[:, :2], np.full(2, np.inf)
    for _ in range(_MOST_TURNS):
        before, logs = logs, np.zeros(2)
        for block in blocks:
            basis, upper = np.linalg.qr(block @ basis)
            logs += np.log(np.abs(np.diag(upper)))
        if np.abs(logs - before).max() < 1e-13 * np.abs(logs).max():
            break
    return np.sort(np.append(logs, volume - logs.sum()))[::-1]


def solve_cyclic(
    here: np.ndarray, there: np.ndarray, slope: np.ndarray, right: np.ndarray, normal: np.ndarray, level: float
) -> tuple[np.ndarray, float]:
    """A_i y_i + B_i y_{i+1} + c_i β = r_i around a cycle (y_n = y_0), with ℓ·y_0 = ν.

    Structured orthogonal elimination (Wright, SIAM J. Sci. Stat. Comput. 13 (1992) 742): points are eliminated one
    after the other by a QR step of the two equations they stand in, which is stable where multiplying the blocks out is
    not. Small LAPACK calls only: the result does not depend on the number of threads.

    Args:
        here, there: A and B, (n, m, m).
        slope, right: c and r, (n, m).
        normal, level: ℓ (m,) and ν.

    Returns:
        y (n, m) and β.
    """
    n, m = right.shape
    first, last, c, r = here[0], there[0], slope[0], right[0]  # first y_0 + last y_i + c β = r
    eliminated = []
    for i in range(1, n):
        q, upper = np.linalg.qr(np.concatenate([last, here[i]]), mode="complete")
        rows = np.zeros((2 * m, 2 * m + 2))
        rows[:m, :m], rows[:m, 2 * m], rows[:m, 2 * m + 1] = first, c, r
        rows[m:, m : 2 * m], rows[m:, 2 * m], rows[m:, 2 * m + 1] = there[i], slope[i], right[i]
        rows = q.T @ rows
        eliminated.append((upper[:m], rows[:m]))
        first, last, c, r = rows[m:, :m], rows[m:, m : 2 * m], rows[m:, 2 * m], rows[m:, 2 * m + 1]
    closed = np.zeros((m + 1, m + 1))
    closed[:m, :m], closed[:m, m], closed[m, :m] = first + last, c, normal
    solution = np.linalg.solve(closed, np.append(r, level))
    y = np.empty((n, m))
    y[0], beta = solution[:m], float(solution[m])
    following = y[0]
    for i in range(n - 1, 0, -1):
        upper, rows = eliminated[i - 1]
        known = rows[:, 2 * m + 1] - rows[:, :m] @ y[0] - rows[:, m : 2 * m] @ following - rows[:, 2 * m] * beta
        following = y[i] = np.linalg.solve(upper, known)
    return y, beta
