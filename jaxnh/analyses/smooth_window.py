"""Smooth averages over a run of a lane."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np


def window_weights(at: Any) -> Any:
    """Return the weight exp(−1/(x(1−x))) of a smooth average, x in (0, 1) (Das et al., Nonlinearity 30 (2017) 4111).

    On periodic and quasiperiodic motion such an average converges faster than any power of its length, where a plain
    one does so like its inverse: rotating tangents (complex multipliers) do no harm.
    """
    xp = np if isinstance(at, np.ndarray) else jnp
    return xp.exp(-1.0 / (at * (1.0 - at)))


def half_window_weights(at: Any) -> tuple[Any, Any]:
    """Return the weights of two smooth averages at x in (0, 1): of the whole, and of the half that x lies in."""
    return window_weights(at), window_weights((2.0 * at) % 1.0)


DEGREE = 5
"""Highest power of time whose smooth averages tell a drift from what only scatters."""


def moment_weights(at: Any) -> tuple[Any, ...]:
    """Return the weights at x in (0, 1) of the smooth averages of powers 0 to `DEGREE` of 2x − 1, and that of the half.

    A power times the window is as smooth as the window, so that these converge as the average does.
    """
    whole, half = half_window_weights(at)
    return *(whole * (2.0 * at - 1.0) ** power for power in range(DEGREE + 1)), half


def drift_basis(points: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix from moments to coefficients in orthonormal polynomials, and that of each power in its own.

    Polynomials are orthonormal under the window at these points in (0, 1): with L Lᵀ the matrix of the moments of
    2x − 1, coefficients are L⁻¹ times the moments, and the power j has the coefficient L_jj of the polynomial j.
    """
    powers = np.stack([(2.0 * points - 1.0) ** power for power in range(DEGREE + 1)])
    weights = window_weights(points)
    lower = np.linalg.cholesky((powers * (weights / weights.sum())) @ powers.T)
    return np.linalg.inv(lower) / weights.sum(), np.diagonal(lower)
