"""Intervals at 95 %: of shares from numbers of draws, and quantiles of Student's t and of a normal variable."""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Float, Int


@functools.cache
def normal_quantile() -> float:
    """Return how many standard deviations a normal variable lies from its mean at most in 95 of 100 cases."""
    from scipy.special import ndtri  # here, as it takes a tenth of a second to import

    return float(ndtri(0.975))


def student(count: int) -> float:
    """Return Student's two-sided quantile of 95 % for the mean of so many numbers, by one less degrees of freedom."""
    from scipy.special import stdtrit  # here, as it takes a tenth of a second to import

    return float(stdtrit(count - 1, 0.975))


def binomial_interval(
    count: Int[np.ndarray, " lanes"] | Float[np.ndarray, " lanes"],
    total: int | Int[np.ndarray, " lanes"] | Float[np.ndarray, " lanes"],
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the ends of the 95 % interval of a share, for numbers of independent draws (Clopper, Pearson 1934).

    Numbers need not be whole, as of draws that count as fewer independent ones.
    """
    from scipy.special import betaincinv  # here, as it takes a tenth of a second to import

    low = np.where(count > 0, betaincinv(np.where(count > 0, count, 1), total - count + 1, 0.025), 0.0)
    high = np.where(count < total, betaincinv(count + 1, np.where(count < total, total - count, 1), 0.975), 1.0)
    return low, high
