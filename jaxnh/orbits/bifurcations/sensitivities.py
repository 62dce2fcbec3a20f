"""Derivatives of multipliers and bifurcation points in all parameters, by the implicit function theorem. Host code.

An orbit u_{i+1} = P(u_i; q) moves with a parameter by M_i u'_i + ∂P/∂q = u'_{i+1}, and a multiplier μ with right and
left vectors φ, ψ around the orbit by ψᵀ M' φ, M' the derivative of the blocks along the motion of the orbit (Kuznetsov,
Elements of Applied Bifurcation Theory, 2004, 10.2). A bifurcation in p is then where a condition g(p, q) holds:
dp/dq = −(∂g/∂q)/(∂g/∂p). No orbit is solved for anew.

Derivatives of one period alone are differences: of first order in u they are exact, and in parameters that decide a
table, or a period, there are no others. Sixth order at five widths, the best of which is taken number by number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits import cyclic
from jaxnh.systems.chart import Wrap

_WIDTHS = 2.0 ** -np.array([6.0, 9.0, 12.0, 15.0, 18.0])  # of the parameter, half of the widest nodes of a difference
_PLACES = np.array([1.0, 2.0, 3.0]) / 3.0
_SIXTH = np.array([45.0, -9.0, 1.0]) / 20.0  # weights of f(x h) − f(−x h), times h
_FOURTH = np.array([8.0, -1.0, 0.0]) / 4.0
_ROUNDINGS = 8.0  # of a period of the map, whose operations are many
_DRAWS, _WORSE = 8, 2.0  # draws of errors of one period, so many times as large
_NEAR = 1e-4  # sizes: points beside an orbit, by which its matrices are seen to change
_LEAST = 1e-6  # of the largest size: a coordinate that is zero has this one
_ROUNDING = 8.0  # of a sixth-order difference, in that of its distance to the one of fourth order: 7.1


class ShiftedMap(Protocol):
    """P and ∂P/∂u at points of orbits side by side, each at its own values of the parameters but for one of them."""

    def __call__(self, name: str, shift: float, u: Float[np.ndarray, "points d"], /) -> Derivatives:
        """Evaluate at points near those of the orbits, in their order, the named parameter shifted for all."""
        ...


class ShiftedTime(Protocol):
    """Time of return at the same points."""

    def __call__(self, name: str, shift: float, u: Float[np.ndarray, "points d"], /) -> Float[np.ndarray, " points"]:
        """Times of return from the points of `ShiftedMap`, with the same parameter shifted."""
        ...


class OrbitMotion(NamedTuple):
    """The motion of one orbit with a parameter, and how its maps change along it.

    Attributes:
        column: ∂P/∂q at each point, (n, d).
        column_error: error of `column`.
        points: du/dq, (n, d); not a number where the orbit has a multiplier one, zero where it is held.
        points_error: error of `points`.
        blocks: dM/dq along the motion, (n, d, d).
        blocks_error: error of `blocks`.
        time: derivative of the time of return of each point, (n,); empty where it is not asked for.
        time_error: error of `time`.
    """

    column: Float[np.ndarray, "n d"]
    column_error: Float[np.ndarray, "n d"]
    points: Float[np.ndarray, "n d"]
    points_error: Float[np.ndarray, "n d"]
    blocks: Float[np.ndarray, "n d d"]
    blocks_error: Float[np.ndarray, "n d d"]
    time: Float[np.ndarray, " n"] = np.zeros(0)
    time_error: Float[np.ndarray, " n"] = np.zeros(0)


def orbit_motions(
    shifted: ShiftedMap,
    orbits: Sequence[Float[np.ndarray, "n d"]],
    blocks: Sequence[Float[np.ndarray, "n d d"]],
    name: str,
    scale: float,
    wrap: Wrap,
    time: ShiftedTime | None = None,
    isolated: Sequence[bool] | None = None,
) -> list[OrbitMotion]:
    """Return how each orbit moves with a parameter.

    Args:
        shifted: the map.
        orbits: their points, in the order that the map knows.
        blocks: ∂P/∂u at them.
        name: of the parameter.
        scale: of the parameter, in which shifts are small.
        wrap: of differences of section coordinates.
        time: the time of return, where its derivative is asked for.
        isolated: of each orbit, whether it has no multiplier one; others, as at folds, are held where they are.
    """
    isolated = [True] * len(orbits) if isolated is None else isolated
    at, cuts = np.concatenate(orbits), np.cumsum([len(orbit) for orbit in orbits])[:-1]
    column = difference(lambda s: np.asarray(shifted(name, s, at).image), scale, wrap)
    each = zip(blocks, *(np.split(leaf, cuts) for leaf in column), isolated, strict=True)
    held = [np.zeros((1 + _DRAWS, *orbit.shape)) for orbit in orbits]
    draws = [_motions(block, *part) if moves else zero for (block, *part, moves), zero in zip(each, held, strict=True)]
    moved, *errors = np.concatenate(draws, axis=1)
    matrices, error = difference(lambda s: np.asarray(shifted(name, s, at + s * moved).monodromy), scale)
    errors = np.array(errors)
    error += error_along(lambda u: np.asarray(shifted(name, 0.0, u).monodromy), orbits, errors)
    times = ()
    if time:
        rate, time_error = difference(lambda s: np.asarray(time(name, s, at + s * moved)), scale)
        times = rate, time_error + error_along(lambda u: np.asarray(time(name, 0.0, u)), orbits, errors)
    whole = (*column, moved, np.max(np.abs(errors), axis=0), matrices, error, *times)
    return [OrbitMotion(*leaves) for leaves in zip(*(np.split(leaf, cuts) for leaf in whole), strict=True)]


def multiplier_rate(
    blocks: Float[np.ndarray, "n d d"], motion: OrbitMotion, multiplier: complex
) -> tuple[complex, float]:
    """Return dμ/dq of the multiplier nearest to one given, and its error."""
    right, left = _multiplier_vectors(blocks, multiplier)
    return _contraction(left, motion.blocks, right), _largest(left, motion.blocks_error, right)


def doubling_rates(
    blocks: Float[np.ndarray, "n d d"], motions: Sequence[OrbitMotion]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return the derivative of the test for a multiplier −1 in each of k parameters, up to one factor, and errors."""
    there = np.broadcast_to(-np.eye(blocks.shape[-1]), blocks.shape).copy()
    there[-1] *= -1.0
    right, left = _null_vectors(blocks, there)
    rates = [_contraction(left, motion.blocks, right).real for motion in motions]
    return np.array(rates), np.array([_largest(left, motion.blocks_error, right) for motion in motions])


def fold_rates(
    blocks: Float[np.ndarray, "n d d"], motions: Sequence[OrbitMotion]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return what each of k parameters moves a fold by, up to one factor: ψᵀ ∂P/∂q, ψ the left vector of μ = 1."""
    _, left = _null_vectors(blocks, np.broadcast_to(-np.eye(blocks.shape[-1]), blocks.shape))
    rates = [float(np.sum(left * motion.column)) for motion in motions]
    return np.array(rates), np.array([float(np.sum(np.abs(left) * motion.column_error)) for motion in motions])


def time_rates(motions: Sequence[OrbitMotion]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return the derivative of the time that an orbit takes in each of k parameters, and errors."""
    return np.array([np.sum(motion.time) for motion in motions]), np.array([np.sum(m.time_error) for m in motions])


def point_rates(
    motions: Sequence[OrbitMotion],
) -> list[tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]]:
    """Return the derivative of each coordinate of an orbit's first point in each of k parameters, and errors."""
    rates, errors = (np.array([getattr(each, name)[0] for each in motions]).T for name in ("points", "points_error"))
    return list(zip(rates, errors, strict=True))


def modulus_rates(
    blocks: Float[np.ndarray, "n d d"], motions: Sequence[OrbitMotion], multiplier: complex
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return the derivative of |μ| in each of k parameters, and errors; NaN where μ is zero, a corner of |μ|."""
    rates = [multiplier_rate(blocks, motion, multiplier) for motion in motions]
    unit = np.conj(multiplier) / abs(multiplier) if multiplier else np.nan
    return np.array([(unit * rate).real for rate, _ in rates]), np.array([error for _, error in rates])


def implicit_rates(
    rates: Float[np.ndarray, " k"], errors: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " others"], Float[np.ndarray, " others"]]:
    """Return dp/dq = −g_q/g_p with its error, of the derivatives of a condition in p, the first, and all others q."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = -rates[1:] / rates[0]
        return ratio, (errors[1:] + np.abs(ratio) * errors[0]) / np.abs(rates[0])


def _motions(
    blocks: Float[np.ndarray, "n d d"], column: Float[np.ndarray, "n d"], error: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "draws n d"]:
    """Return du/dq around an orbit, and below it draws of its error: ∂P/∂q off by either sign, as if by chance."""
    signs = np.random.default_rng(0).choice([-_WORSE, _WORSE], (_DRAWS, *error.shape))
    cycle = cyclic.eliminate(blocks, np.broadcast_to(-np.eye(blocks.shape[-1]), blocks.shape))
    try:
        return np.array([cyclic.solve(cycle, -right) for right in (column, *(signs * error))])
    except np.linalg.LinAlgError:
        return np.full((1 + _DRAWS, *column.shape), np.nan)


def error_along(
    function: Callable[[Float[np.ndarray, "points d"]], np.ndarray],
    orbits: Sequence[Float[np.ndarray, "n d"]],
    errors: Float[np.ndarray, "draws points d"],
) -> Float[np.ndarray, "points ..."]:
    """Return the largest change of numbers at points by errors of these, of first order; one digit is enough.

    Args:
        function: of all points side by side.
        orbits: their points, each in the sizes of its own.
        errors: of the points.
    """
    at, sizes = np.concatenate(orbits), np.concatenate([np.tile(_size(orbit), (len(orbit), 1)) for orbit in orbits])
    slopes = []
    for step in sizes.T[:, :, None] * np.eye(at.shape[1])[:, None]:
        change = function(at + step) - function(at - step)
        slopes.append(change / (2.0 * np.max(step, axis=1)).reshape(-1, *(1,) * (change.ndim - 1)))
    return np.max(np.abs(np.einsum("jpk,kp...->jp...", errors, np.array(slopes))), axis=0)


def _size(orbit: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " d"]:
    """Return how far from an orbit points are near it, in each coordinate."""
    largest = np.max(np.abs(orbit), axis=0)
    return _NEAR * (np.fmax(largest, _LEAST * largest.max()) if largest.any() else np.ones_like(largest))


def _null_vectors(
    blocks: Float[np.ndarray, "n d d"], next_blocks: Float[np.ndarray, "n d d"]
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d"]]:
    """Return y and z with A_i y_i + B_i y_{i+1} = 0 and A_iᵀ z_i + B_{i−1}ᵀ z_{i−1} = 0, nearly."""
    right = cyclic.null_vector(cyclic.eliminate(blocks, next_blocks))
    transposed = np.swapaxes(blocks, -1, -2)[::-1], np.swapaxes(np.roll(next_blocks, 1, axis=0), -1, -2)[::-1]
    return right, cyclic.null_vector(cyclic.eliminate(*transposed))[::-1]


def _multiplier_vectors(
    blocks: Float[np.ndarray, "n d d"], multiplier: complex
) -> tuple[Complex[np.ndarray, "n d"], Complex[np.ndarray, "n d"]]:
    """Return φ and ψ of the multiplier nearest to one given, before and after each M_i: its derivative is Σ ψᵀ M' φ."""
    product = np.eye(blocks.shape[-1])
    for block in blocks:
        product = block @ product
    values, vectors = np.linalg.eig(product)
    k = int(np.argmin(np.abs(values - multiplier)))
    right, left = [vectors[:, k]], [np.linalg.inv(vectors)[k]]
    for before, after in zip(blocks[:-1], blocks[:0:-1], strict=True):
        right.append(before @ right[-1])
        left.append(left[-1] @ after)
    return np.array(right), np.array(left[::-1])


def _contraction(left: np.ndarray, matrices: np.ndarray, right: np.ndarray) -> complex:
    return complex(np.einsum("ni,nij,nj->", left, matrices, right))


def _largest(left: np.ndarray, errors: np.ndarray, right: np.ndarray) -> float:
    return float(np.einsum("ni,nij,nj->", np.abs(left), errors, np.abs(right)))


def _weighted(weights: Float[np.ndarray, " k"], rows: Float[np.ndarray, "k ..."]) -> Float[np.ndarray, ...]:
    """Return the sum of weighted rows, each number by itself: those of BLAS may depend on how many there are."""
    return weights[0] * rows[0] + weights[1] * rows[1] + weights[2] * rows[2]


def difference(
    function: Callable[[float], np.ndarray], scale: float, wrap: Wrap | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative at zero of an array of numbers, and its error.

    The error is the distance to the difference of fourth order, which bounds truncation, times what rounding needs, and
    the rounding of the result; no less than the distance to the second best width.
    """
    slopes, errors = [], []
    for width in _WIDTHS * scale:
        sides = [(function(x * width), function(-x * width)) for x in _PLACES]
        pairs = [ahead - behind for ahead, behind in sides]
        rows = np.array([wrap(pair) for pair in pairs] if wrap else pairs)
        sixth, fourth = (_weighted(weights, rows) / width for weights in (_SIXTH, _FOURTH))
        slopes.append(sixth)
        errors.append(
            _ROUNDING * np.abs(sixth - fourth) + _ROUNDINGS * np.spacing(np.max(np.abs(sides), axis=(0, 1))) / width
        )
    rates, bounds = np.array(slopes), np.where(np.isfinite(errors), errors, np.inf)
    order = np.argsort(bounds, axis=0, kind="stable")[:2]
    best, second = np.take_along_axis(rates, order, axis=0)
    with np.errstate(invalid="ignore"):
        error = np.fmax(np.take_along_axis(bounds, order[:1], axis=0)[0], np.abs(best - second))
    return best, error
