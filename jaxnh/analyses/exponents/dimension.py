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
    exponents: Float[np.ndarray, "lanes k"],
    errors: Float[np.ndarray, "lanes k"],
    sum_errors: Float[np.ndarray, " lanes"] | None = None,
) -> Float[np.ndarray, " lanes"]:
    """Return the error of the Kaplan–Yorke dimension by those of descending exponents.

    It grows with every exponent, so that its ends are those with all errors added and all taken away. Where an exponent
    may be zero it may jump: a torus and a cycle that attracts weakly are one dimension apart. Where the sum is known
    better than the exponents, they do not err all to one side: what the last one misses the others have too much.

    Args:
        sum_errors: of the sum of all exponents, by default those of the exponents together.
    """
    ends = [kaplan_yorke(-np.sort(-(exponents + sign * errors), axis=1)) for sign in (1.0, -1.0)]
    if sum_errors is not None:
        ends = _ends_by_the_sum(exponents, errors, sum_errors, *ends)
    return np.max(np.abs(ends - kaplan_yorke(exponents)), axis=0)


def _ends_by_the_sum(
    exponents: Float[np.ndarray, "lanes k"],
    errors: Float[np.ndarray, "lanes k"],
    sum_errors: Float[np.ndarray, " lanes"],
    high: Float[np.ndarray, " lanes"],
    low: Float[np.ndarray, " lanes"],
) -> list[Float[np.ndarray, " lanes"]]:
    """Return the ends of the dimension where the sum S of all exponents is known, at most these.

    With the sum Λ of all but the last it is k − 1 + Λ/(Λ − S) where Λ ≥ 0 > S, and grows with both. Λ errs by no more
    than its exponents, and by no more than the last one and the sum.
    """
    k = exponents.shape[1]
    total, others = exponents.sum(axis=1), exponents[:, :-1].sum(axis=1)
    moved = np.minimum(errors[:, :-1].sum(axis=1), errors[:, -1] + sum_errors)
    ends = list[Float[np.ndarray, " lanes"]]()
    for sign, other, nearer in ((1.0, high, np.minimum), (-1.0, low, np.maximum)):
        with np.errstate(divide="ignore", invalid="ignore"):
            first, every = others + sign * moved, total + sign * sum_errors
            end = k - 1 + first / (first - every)
            beyond = (others - moved >= 0.0) & (total + sum_errors < 0.0) & np.isfinite(end)
        ends.append(np.where(beyond, nearer(other, end), other))
    return ends
