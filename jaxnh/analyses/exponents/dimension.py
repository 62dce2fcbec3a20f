"""Dimension of an attractor from its exponents (Kaplan and Yorke 1979)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def kaplan_yorke(exponents: Float[np.ndarray, "lanes k"]) -> Float[np.ndarray, " lanes"]:
    """Return the Kaplan–Yorke dimension of descending exponents; k where their sum is not negative."""
    total = np.cumsum(exponents, axis=1)
    lanes, k = exponents.shape
    whole = np.sum(total >= 0.0, axis=1)
    before = np.where(whole > 0, total[np.arange(lanes), np.maximum(whole, 1) - 1], 0.0)
    following = np.where(whole < k, np.abs(exponents[np.arange(lanes), np.minimum(whole, k - 1)]), 1.0)
    return np.where(whole == k, float(k), whole + before / following)


def kaplan_yorke_error(
    exponents: Float[np.ndarray, "lanes k"], errors: Float[np.ndarray, "lanes k"]
) -> Float[np.ndarray, " lanes"]:
    """Return the error of the Kaplan–Yorke dimension by those of descending exponents, none helping another.

    It grows with every exponent, so that its ends are those with all errors added and all taken away. Where an exponent
    may be zero it may jump: a torus and a cycle that attracts weakly are one dimension apart.
    """
    ends = [kaplan_yorke(-np.sort(-(exponents + sign * errors), axis=1)) for sign in (1.0, -1.0)]
    return np.max(np.abs(ends - kaplan_yorke(exponents)), axis=0)
