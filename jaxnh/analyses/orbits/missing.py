"""Number of orbits that a search has not met, from how often it has met the others.

Rounds of a search are samples, in each of which an orbit is met or not. From Q1, the number of those met in one round
of T alone, and Q2, of those met in two, Chao's estimator is (T − 1)/T · Q1²/(2 Q2), or where Q2 is zero (T − 1)/T ·
Q1 (Q1 − 1)/2 (Chao, Scand. J. Statist. 11 (1984) 265; of samples by incidence, with the interval on a logarithmic
scale, Chao, Biometrics 43 (1987) 783).

That interval is the point zero where Q1 is zero, or one without a Q2, though a few orbits may still be missing. Its
upper end is therefore at least the 97.5 % quantile of the Poisson distribution of as many orbits as the known ones
would lead to: one of k meetings is missed by T rounds with the probability (1 − k/T)^T (Horvitz and Thompson, J. Am.
Stat. Assoc. 47 (1952) 663).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

_NORMAL = 1.959963984540054
_HIGHEST = 0.975


class Missing(NamedTuple):
    """Estimated number of orbits that are not known, and the ends of its 95 % interval, whole numbers."""

    estimate: float
    low: float
    high: float


def missing_orbits(rounds: Int[np.ndarray, " orbits"], total: int) -> Missing:
    """Return how many orbits are missing.

    Args:
        rounds: in how many rounds each known orbit was met, zero where it is known from elsewhere, (orbits,).
        total: number of rounds.
    """
    met = rounds[rounds > 0]
    elsewhere = len(rounds) - len(met)  # of those that the rounds have missed these are known
    once, twice, share = float(np.sum(met == 1)), float(np.sum(met == 2)), (total - 1) / total
    if twice:
        ratio = once / twice
        estimate = share * once**2 / (2.0 * twice)
        variance = twice * (share * ratio**2 / 2.0 + share**2 * ratio**3 + share**2 * ratio**4 / 4.0)
    else:
        estimate = share * once * (once - 1.0) / 2.0
        variance = estimate + share**2 * once * (2.0 * once - 1.0) ** 2 / 4.0
        variance -= share**2 * once**4 / (4.0 * (len(met) + estimate)) if estimate else 0.0
    factor = np.exp(_NORMAL * np.sqrt(np.log1p(variance / estimate**2))) if estimate else 1.0
    low, high = np.floor(estimate / factor), np.ceil(estimate * factor)
    missed = (1.0 - met / total) ** total
    high = max(high, _poisson_quantile(float(np.sum(missed / (1.0 - missed)))))
    return Missing(*(abs(max(float(value) - elsewhere, 0.0)) for value in (estimate, low, high)))  # no negative zero


def _poisson_quantile(mean: float) -> float:
    """Return the least number that a Poisson variable exceeds in 2.5 of 100 cases at most."""
    from scipy.special import pdtr, pdtrik  # here, as it takes a tenth of a second to import

    number = float(np.ceil(pdtrik(_HIGHEST, mean))) if mean > 0.0 and pdtr(0.0, mean) < _HIGHEST else 0.0
    return number
