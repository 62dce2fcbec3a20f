"""Growth of lengths normal to invariant curves, from the derivatives of the map along them. Host code."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.rotation.averages import birkhoff_average
from jaxnh.analyses.tori.invariant_curves import CurveQuality, InvariantCurve, trigonometric_polynomial

_TINY = np.finfo(float).tiny


def normal_growth(
    curve: InvariantCurve, quality: CurveQuality, k: int, length: int, error: float
) -> tuple[Float[np.ndarray, " k-1"], Float[np.ndarray, " k-1"]]:
    """Return the growth of the logarithm of lengths normal to the curve, an iterate, largest first, and its errors.

    Along the curve it is zero. Of two directions the other one has the mean of log |det ∂P/∂u|. Of more, frames go
    along the orbit θ + nρ, with derivatives between the nodes by their trigonometric polynomial, and the growth
    nearest to zero is that along the curve; what it differs by is part of the errors. So is what the growth changes by
    as far as the curve may be off, which beside a fold of tori is much further than its equations are.

    Args:
        quality: of the curve, with ∂P/∂u at the nodes.
        k: directions, as many as the flow has exponents on its section.
        length: points of the orbit that are averaged over; a quarter more come before.
        error: of the derivatives, relative to their size.
    """
    (count, d, _), size = quality.matrices.shape, curve.size
    scaled = quality.matrices * size / size[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    by_map = (error + 8.0 * np.finfo(float).eps) * np.mean(values[:, 0] / np.maximum(values[:, k - 1], _TINY))
    if d == k == 2:
        logs = np.log(np.abs(np.linalg.det(scaled)))
        spectrum = np.abs(np.fft.rfft(logs)) / count
        missed = np.max(spectrum[-(count // 8) :]) + by_map + quality.volume_error
        return np.array([np.mean(logs)]), np.array([missed])
    growth, missed = _growths(curve, scaled, k, length)
    displaced, _ = _growths(curve, quality.displaced * size / size[:, None], k, length)
    return growth, missed + by_map + np.abs(displaced - growth)


def _growths(
    curve: InvariantCurve, scaled: Float[np.ndarray, "N d d"], k: int, length: int
) -> tuple[Float[np.ndarray, " k-1"], Float[np.ndarray, " k-1"]]:
    """Return the growths by frames along an orbit, and their errors by its length and by the one along the curve."""
    count, d, _ = scaled.shape
    coefficients = np.fft.rfft(scaled.reshape(count, d * d), axis=0) / count
    theta = curve.rotation * np.arange(-(length // 4), length)
    along = trigonometric_polynomial(coefficients, theta).reshape(-1, d, d)
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(d, k)))[0]
    logs = np.empty((k, len(along)))
    for n, matrix in enumerate(along):
        frame, triangle = np.linalg.qr(matrix @ frame)
        with np.errstate(divide="ignore"):
            logs[:, n] = np.log(np.abs(np.diagonal(triangle)))
    average = birkhoff_average(logs[:, length // 4 :])
    tangent = np.argmin(np.abs(average.value))
    missed = np.abs(average.value[tangent])
    return np.delete(average.value, tangent), np.delete(average.error, tangent) + missed
