"""Power law of the lifetime at a crisis: the value of the parameter where it is endless, and the exponent. Host code.

Beyond a crisis at p_c motions leave at a rate κ ~ |p − p_c|^γ (Grebogi, Ott, Romeiras and Yorke, Phys. Rev. A 36 (1987)
5365). What leaves changes the measure of what stays by a share of the order of κ, so that ln κ = ln κ₀ − c κ₀ with
κ₀ = A |p − p_c|^γ and c of order one: zero but for a normal deviation of two, as far as is known before. Given p_c the
other three are fitted by least squares, with the weights of the numbers of escapes; p_c is where χ² is least. Intervals
are those of its profile, with the scatter of the rates where that is larger than chance. To them is added what the
fit to the half of the values nearer to the crisis changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

FEWEST_VALUES = 8
"""Values of the parameter with escapes, at least."""

_FEWEST_FITTED = 5
_FEWEST_ESCAPES = 16  # fewer are far from normal in their logarithm
_LARGEST = 0.5  # rate: beyond it c κ₀ is not small
_SPREAD = 2.0  # of c
_DISTANCES = np.geomspace(1e-4, 1e2, 400)  # of the crisis from the value nearest to it, in widths of the range
_STEPS = 12  # of Gauss and Newton
_FARTHEST = 2.0  # ln κ₀ on the way
_RIDGE = 1e-9  # of the trace: far from the crisis ln κ₀ is a line in p whatever γ


class CrisisScaling(NamedTuple):
    """Value of the parameter at the crisis, and the exponent γ, with errors at 95 %; not numbers where unknown."""

    value: float
    value_error: float
    exponent: float
    exponent_error: float


def fit_crisis(
    values: Float[np.ndarray, " values"], rate: Float[np.ndarray, " values"], escapes: Int[np.ndarray, " values"]
) -> CrisisScaling:
    """Fit the power law to escape rates over a parameter, in any order; the crisis lies on the side of low rates."""
    known = (escapes >= _FEWEST_ESCAPES) & (rate < _LARGEST)
    values, logs, weights = values[known], np.log(rate[known]), escapes[known].astype(float)
    if len(np.unique(values)) < FEWEST_VALUES:
        return CrisisScaling(np.nan, np.nan, np.nan, np.nan)
    away = 1.0 if np.cov(values, logs)[0, 1] > 0.0 else -1.0
    order = np.argsort(away * values, kind="stable")
    nearest, x = float(values[order[0]]), away * (values - values[order[0]])
    half = order[: max(len(order) // 2, _FEWEST_FITTED)]
    near, every = (_profile(x[part], logs[part], weights[part]) for part in (half, order))
    return CrisisScaling(
        nearest - away * every.value,
        every.value_error + abs(near.value - every.value),
        every.exponent,
        every.exponent_error + abs(near.exponent - every.exponent),
    )


def _profile(
    x: Float[np.ndarray, " values"], logs: Float[np.ndarray, " values"], weights: Float[np.ndarray, " values"]
) -> CrisisScaling:
    """Return the fit, its value as the distance of the crisis before x = 0."""
    from scipy.special import stdtrit  # here, as it takes a tenth of a second to import

    before = _DISTANCES * np.ptp(x)
    exponent, variance, residual = _fits(np.log(x + before[:, None]), logs, weights)
    best, freedom = int(np.argmin(residual)), len(x) - 3  # c has a residual of its own
    scatter, limit = max(1.0, residual[best] / freedom), float(stdtrit(freedom, 0.975)) ** 2
    left = limit - (residual - residual[best]) / scatter
    inside = left >= 0.0
    width = np.sqrt(np.maximum(left, 0.0) * scatter * variance)
    apart = np.abs(exponent - exponent[best]) + width
    return CrisisScaling(
        float(before[best]),
        float(np.max(np.abs(before[inside] - before[best]))),
        float(exponent[best]),
        float(np.max(apart[inside])),
    )


def _fits(
    distance: Float[np.ndarray, "crises values"],
    logs: Float[np.ndarray, " values"],
    weights: Float[np.ndarray, " values"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return γ, its variance and χ² of the fit at each distance of the crisis, of which the logarithms are given."""
    root, prior = np.sqrt(weights), np.diag([0.0, 0.0, _SPREAD**-2])
    mean = distance @ weights / weights.sum()
    across = distance - mean[:, None]
    slope = (across * logs) @ weights / (across**2 @ weights)
    fitted = np.stack([weights @ logs / weights.sum() - slope * mean, slope, np.zeros(len(slope))], axis=1)

    def equations() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The residuals, the normal matrix with the prior of c, and the gradient."""
        leading = fitted[:, :1] + fitted[:, 1:2] * distance
        rate = np.exp(np.minimum(leading, _FARTHEST))
        residual = (leading - fitted[:, 2:] * rate - logs) * root
        by_leading = 1.0 - fitted[:, 2:] * rate
        jacobian = np.stack([by_leading, by_leading * distance, -rate], axis=2) * root[:, None]
        normal = np.swapaxes(jacobian, 1, 2) @ jacobian + prior
        ridge = _RIDGE * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        return residual, normal + ridge, np.einsum("cvk,cv->ck", jacobian, residual) + fitted @ prior

    for _ in range(_STEPS):
        _, normal, gradient = equations()
        fitted = fitted - np.clip(np.linalg.solve(normal, gradient[:, :, None])[:, :, 0], -1.0, 1.0)
    residual, normal, _ = equations()
    return fitted[:, 1], np.linalg.inv(normal)[:, 1, 1], np.sum(residual**2, axis=1) + (fitted[:, 2] / _SPREAD) ** 2
