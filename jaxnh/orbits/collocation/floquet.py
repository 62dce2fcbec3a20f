"""Floquet multipliers of cycles by collocation, and errors by what shares nothing with their products. Host code.

Gauss collocation takes e^z of a rate z = λh over an interval as its diagonal Padé approximant, which for large |z|
neither grows nor decays (Hairer and Wanner, Solving Ordinary Differential Equations II, IV.3). Two checks tell where:
Liouville's formula, by which the logarithms' sum is the integral of the divergence, and the approximants of what grows.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.collocation.equations import BoundarySolution, Problem
from jaxnh.orbits.collocation.paths import gauss_rule
from jaxnh.orbits.multipliers import merged, multipliers

_TINY = np.finfo(float).tiny  # multipliers below are zero
_NOTHING = 1e-12  # size of a multiplier beside one
_KNOWN = 0.5  # of a multiplier: a larger error leaves it unknown
_CANCELLED = 2.0  # errors of several logarithms, in those of their sum, where some have opposite signs
_SHORT = 1.0  # norm of λh, below which the approximant is right to 10⁻⁷


def cycle_multipliers(
    problem: Problem,
    solution: BoundarySolution,
    blocks: Float[np.ndarray, "lanes n d d"],
    divergence: Float[np.ndarray, "lanes n m"],
) -> tuple[Complex[np.ndarray, "lanes e"], Float[np.ndarray, "lanes e"]]:
    """Multipliers, not numbers where they are not known, and their errors.

    One that is alone, as of a plane flow without a clock, is the exponential of the integral of the divergence,
    whatever the mesh does to it. Several are those of the product of blocks, with errors as large as what Liouville's
    formula misses. Of a multiplier that is nothing beside one, and may be below the smallest number, the logarithm says
    nothing of the others: where too little decay is missing, the error is that multiplier's own, and the others' is
    what the intervals miss of growth.

    Args:
        problem: the field.
        solution: cycles.
        blocks: derivatives over intervals, in sizes.
        divergence: of the field at the Gauss points, times the duration.
    """
    rate, jacobian = _field_at_ends(problem, solution)
    total = np.sum(solution.path.measure * divergence, axis=(1, 2))
    values = multipliers(merged(blocks if problem.clock else _across_flow(rate, blocks)))
    sizes = np.abs(values)
    with np.errstate(over="ignore", invalid="ignore"):
        missing = total - np.sum(np.log(np.maximum(sizes, _TINY)), axis=1)
        if values.shape[1] == 1:
            values = np.exp(total).astype(complex)[:, None]
            sizes = np.abs(values)
            # The formula's two sides have errors of one order where the mesh resolves both.
            missing = np.fmin(np.abs(missing), _quadrature_error(solution, divergence, jacobian))
            errors = sizes * np.expm1(missing)[:, None]
        else:
            growth = sizes * np.expm1(_missing_growth(solution, jacobian))[:, None]
            own = (sizes <= _NOTHING) & (missing < 0.0)[:, None]
            shared = np.where(
                own.any(axis=1, keepdims=True), 0.0, sizes * np.abs(np.expm1(_CANCELLED * missing))[:, None]
            )
            errors = np.where(own, sizes, shared + growth)
        known = np.isfinite(values) & ((errors <= _KNOWN * sizes) | (sizes <= _NOTHING))
    return np.where(known, values, np.nan), np.where(known, errors, np.inf)


def _field_at_ends(problem: Problem, solution: BoundarySolution) -> tuple[np.ndarray, np.ndarray]:
    """Rate (lanes, n, d, 1) and derivative (lanes, n, d, d) at the beginnings of intervals, in sizes and durations."""
    path, size, duration = solution.path, problem.size, solution.duration[:, None]
    lanes, n, _, d = path.stages.shape
    times, values = (duration * path.mesh[:, :-1]).ravel(), np.repeat(solution.values, n, axis=0)
    at, scale = problem.field(path.ends[:, :-1].reshape(-1, d), times, values), duration[..., None, None]
    rate = np.asarray(at.rate).reshape(lanes, n, d, 1) / size[:, None]
    return scale * rate, scale * np.asarray(at.jacobian).reshape(lanes, n, d, d) * (size / size[:, None])


def _across_flow(
    rate: Float[np.ndarray, "lanes n d 1"], blocks: Float[np.ndarray, "lanes n d d"]
) -> Float[np.ndarray, "lanes n e e"]:
    """Derivatives from the end of each interval to the next, of the directions across the flow."""
    across = np.linalg.qr(rate, mode="complete")[0][..., 1:]
    return np.swapaxes(np.roll(across, -1, 1), -1, -2) @ blocks @ across


def _quadrature_error(
    solution: BoundarySolution, divergence: Float[np.ndarray, "lanes n m"], jacobian: Float[np.ndarray, "lanes n d d"]
) -> Float[np.ndarray, " lanes"]:
    """A bound of the error of the divergence's integral: of its polynomials at the ends of intervals."""
    begins, rule = np.trace(jacobian, axis1=2, axis2=3), gauss_rule(divergence.shape[2])
    ahead = np.concatenate([begins[..., None], divergence], axis=2) @ rule.last
    return np.sum(solution.path.steps * np.abs(np.roll(begins, -1, 1) - ahead), axis=1)


def _missing_growth(
    solution: BoundarySolution, jacobian: Float[np.ndarray, "lanes n d d"]
) -> Float[np.ndarray, " lanes"]:
    """Errors of the logarithms of what grows: of the approximants of e^z, z the eigenvalues of intervals right of 0."""
    scaled = solution.path.steps[..., None, None] * 0.5 * (jacobian + np.roll(jacobian, -1, 1))
    finite = np.all(np.isfinite(scaled), axis=(2, 3))
    sizes = np.linalg.norm(np.where(np.isfinite(scaled), scaled, 0.0), axis=(2, 3))
    long = finite & (sizes > _SHORT)
    errors = np.where(finite, 0.0, np.inf)
    z = np.linalg.eigvals(scaled[long]).astype(complex)
    above = _pade(solution.path.stages.shape[2])
    with np.errstate(all="ignore"):
        gone = np.abs(np.log(np.polyval(above, z) / np.polyval(above, -z) * np.exp(-z)))
    errors[long] = np.sum(np.where(np.real(z) > 0.0, np.where(np.isnan(gone), np.inf, gone), 0.0), axis=1)
    return errors.sum(axis=1)


@functools.cache
def _pade(m: int) -> tuple[float, ...]:
    """Coefficients of the numerator of the diagonal Padé approximant of e^z of degree m, the highest power first."""
    share = [math.comb(m, k) * math.factorial(2 * m - k) / math.factorial(2 * m) for k in range(m + 1)]
    return tuple(share[::-1])
