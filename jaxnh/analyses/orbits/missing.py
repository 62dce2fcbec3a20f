"""Number of orbits that a search has not met, from how often it has met the others.

Rounds of a search are samples, in each of which an orbit is met or not. From Q1, the number of those met in one round
of T alone, and Q2, of those met in two, Chao's estimator is (T − 1)/T · Q1²/(2 Q2), or where Q2 is zero (T − 1)/T ·
Q1 (Q1 − 1)/2 (Chao, Scand. J. Statist. 11 (1984) 265; of samples by incidence, with the interval on a logarithmic
scale, Chao, Biometrics 43 (1987) 783).

Where chances differ much that is too few. From Q3 and Q4 comes a better bound, which is higher by (T − 3)/(4T) ·
Q3/Q4 · (Q1 − (T − 3)/(2 (T − 1)) · Q2 Q3/Q4) (Chiu, Wang, Walther and Chao, Biometrics 70 (2014) 671); the higher end
is of this.

That interval is the point zero where Q1 is zero, or one without a Q2, though a few orbits may still be missing. Its
upper end is therefore at least the 97.5 % quantile of the Poisson distribution of as many orbits as the known ones
would lead to: one of k meetings is missed by T rounds with the probability (1 − k/T)^T (Horvitz and Thompson, J. Am.
Stat. Assoc. 47 (1952) 663).

Of few meetings Q1 and Q2 scatter more than that interval knows. Where all orbits had one chance to be met, the number
of orbits and that of all meetings tell how many there are (Otis, Burnham, White and Anderson, Wildlife Monogr. 62
(1978)), and the profile of their likelihood gives an interval (Cormack, Biometrics 48 (1992) 567). Its lower end holds
for other chances too, as these hide more orbits. The interval reaches from the lower of the lower ends to the higher
of the higher ones; of orbits of which none was met twice there is no higher end of this kind.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxnh.analyses.intervals import normal_quantile

_HIGHEST = 0.975
_MISSING = np.unique(np.concatenate([np.arange(256), np.geomspace(256, 1e6, 256).round()]))  # that are tried


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
    factor = np.exp(normal_quantile() * np.sqrt(np.log1p(variance / estimate**2))) if estimate else 1.0
    low, high = np.floor(estimate / factor), np.ceil((estimate + _rarer(met, total)) * factor)
    missed = (1.0 - met / total) ** total
    high = max(high, _poisson_quantile(float(np.sum(missed / (1.0 - missed)))))
    least, most = _of_one_chance(met, total)
    low, high = min(low, least), max(high, most)
    return Missing(*(abs(max(float(value) - elsewhere, 0.0)) for value in (estimate, low, high)))  # no negative zero


def _rarer(met: Int[np.ndarray, " orbits"], total: int) -> float:
    """Return by how much the bound from orbits that were met up to four times is higher."""
    once, twice, thrice, often = (float(np.sum(met == k)) for k in (1, 2, 3, 4))
    ratio, rounds = thrice / max(often, 1.0), max(total - 3.0, 0.0)
    return rounds / (4.0 * total) * ratio * max(once - rounds / (2.0 * max(total - 1.0, 1.0)) * twice * ratio, 0.0)


def _of_one_chance(met: Int[np.ndarray, " orbits"], total: int) -> tuple[float, float]:
    """Return the ends of the interval where all orbits have one chance; the higher one 0 where none was met twice."""
    from scipy.special import gammaln, xlogy  # here, as it takes a tenth of a second to import

    known, meetings = len(met), float(met.sum())
    if not known:
        return 0.0, 0.0
    all_orbits = known + _MISSING
    chance = meetings / (total * all_orbits)
    likelihood = gammaln(all_orbits + 1.0) - gammaln(_MISSING + 1.0) + xlogy(meetings, chance)
    likelihood += xlogy(total * all_orbits - meetings, 1.0 - chance)
    drop = 0.5 * normal_quantile() ** 2  # at the ends of an interval of 95 %
    inside = _MISSING[likelihood >= likelihood.max() - drop]
    return float(inside[0]), float(inside[-1]) if meetings > known else 0.0


def _poisson_quantile(mean: float) -> float:
    """Return the least number that a Poisson variable exceeds in 2.5 of 100 cases at most."""
    from scipy.special import pdtr, pdtrik  # here, as it takes a tenth of a second to import

    number = float(np.ceil(pdtrik(_HIGHEST, mean))) if mean > 0.0 and pdtr(0.0, mean) < _HIGHEST else 0.0
    return number
