"""Averages over a chaotic set from its periodic orbits, by cycle expansion of the dynamical zeta function. Host code.

An orbit p of n_p returns, period T_p and expansion |Λ_p|, the modulus of the product of its unstable multipliers,
weighs t_p = z^(n_p) exp(−s T_p)/|Λ_p| in 1/ζ = ∏ (1 − t_p), which is expanded in z, truncated after z^N, and taken at
z = 1 (Artuso, Aurell and Cvitanović, Nonlinearity 3 (1990) 325). Its leading zero s is minus the escape rate, zero for
an attractor; there the mean of what adds up to a_p along each orbit is a ratio of derivatives of 1/ζ.

Terms of hyperbolic sets fall off exponentially, so that the range of the values at N/2, …, N covers the error at N
where that has halved since N/2. The exponent is the sum of the entropy of the natural measure and of the escape
rate (Kantz and Grassberger, Physica D 17 (1985) 75), and has the error of the latter beside its own range.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_ORDERS = 4  # truncations that convergence is judged by, at least
_STEPS = 64
_CONVERGED = 1e-12  # a mean time between returns, and of the other averages


class WeightedCycles(NamedTuple):
    """Primitive orbits of one lane.

    Attributes:
        returns: n_p, (cycles,).
        time: T_p, (cycles,).
        growth: ln|Λ_p|, (cycles,).
        number: of orbits that each stands for, (cycles,).
    """

    returns: Int[np.ndarray, " cycles"]
    time: Float[np.ndarray, " cycles"]
    growth: Float[np.ndarray, " cycles"]
    number: Float[np.ndarray, " cycles"]


class CycleAverages(NamedTuple):
    """Escape rate and exponent a unit of time, and time between returns, with their errors.

    Attributes:
        mean, error: (3,) in this order; not numbers where they are not known.
    """

    mean: Float[np.ndarray, " averages"]
    error: Float[np.ndarray, " averages"]


UNKNOWN = CycleAverages(np.full(3, np.nan), np.full(3, np.nan))
"""Averages of a lane that has none."""


def cycle_averages(cycles: WeightedCycles, limit: int, others: Sequence[WeightedCycles] = ()) -> CycleAverages:
    """Return averages from orbits of up to `limit` returns.

    Args:
        others: the orbits as they may be instead; what each changes counts as an error.
    """
    orders = range(max(limit - max(limit // 2, _ORDERS - 1), 1), limit + 1)
    if limit < _ORDERS or not len(cycles.returns):
        return UNKNOWN
    values = truncated_averages(cycles, orders)
    known = np.all(np.isfinite(values), axis=1)
    if not known[-1] or known.sum() < _ORDERS - 1:
        return UNKNOWN
    last, error = values[-1], np.ptp(values[known], axis=0)
    error += _CONVERGED * np.abs([1.0 / last[2], last[1], last[2]])
    for other in others:
        error += np.abs(truncated_averages(other, orders[-1:])[0] - last)
    error[1] += error[0]
    return CycleAverages(last, error) if np.isfinite(error).all() else UNKNOWN


def truncated_averages(cycles: WeightedCycles, orders: Sequence[int]) -> Float[np.ndarray, "orders 3"]:
    """Return escape rate, exponent, and time between returns for truncations; not numbers where 1/ζ has no zero."""
    values = np.full((len(orders), 3), np.nan)
    unit = float(cycles.time.sum() / cycles.returns.sum())
    s = 0.0
    for i, order in enumerate(orders):
        zero = _zero(cycles, order, s, unit)
        if zero is not None:
            s, (time, growth, returns) = zero
            values[i] = -s, growth / time, time / returns
    return values


def _zero(cycles: WeightedCycles, order: int, s: float, unit: float) -> tuple[float, Float[np.ndarray, " sums"]] | None:
    """Return the zero of a truncation that Newton finds from s, and the sums there; None where there is none near.

    Args:
        unit: mean time between returns.
    """
    for _ in range(_STEPS):
        zeta, sums = _zeta(cycles, order, s)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = float(np.clip(zeta / sums[0], -1.0 / unit, 1.0 / unit))
        s -= step
        if abs(step) <= _CONVERGED / unit:
            return s, sums
        if not np.isfinite(step):
            break
    return None


def _zeta(cycles: WeightedCycles, order: int, s: float) -> tuple[float, Float[np.ndarray, " sums"]]:
    """Return 1/ζ truncated after z^order, and what the sums of time, growth and returns come to in it.

    These are −∂/∂β of 1/ζ with weights t_p exp(β a_p). From the traces tr_k, sums of n_p t_p^r over n_p r = k, the
    coefficients follow by k c_k = −Σ tr_j c_(k − j).
    """
    amounts = np.stack([cycles.time, cycles.growth, cycles.returns])
    trace, sums = np.zeros(order + 1), np.zeros((3, order + 1))
    for r in range(1, order + 1):
        k = cycles.returns * r
        kept = k <= order
        weight = (cycles.number * cycles.returns * np.exp(-r * (s * cycles.time + cycles.growth)))[kept]
        trace += np.bincount(k[kept], weight, order + 1)
        sums += [np.bincount(k[kept], weight * r * amount[kept], order + 1) for amount in amounts]
    coefficients, derivatives = np.zeros(order + 1), np.zeros((3, order + 1))
    coefficients[0] = 1.0
    for k in range(1, order + 1):
        before = coefficients[k - 1 :: -1]
        coefficients[k] = -(trace[1 : k + 1] @ before) / k
        derivatives[:, k] = -(sums[:, 1 : k + 1] @ before + derivatives[:, k - 1 :: -1] @ trace[1 : k + 1]) / k
    return float(coefficients.sum()), -derivatives.sum(axis=1)
