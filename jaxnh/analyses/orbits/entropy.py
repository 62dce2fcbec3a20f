"""Topological entropy from the numbers of periodic orbits."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_LAST = 3  # orders beside the highest by which convergence is judged


def topological_entropy(number: Float[np.ndarray, " n"], missing: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the entropy per return, and its error, from the numbers of primitive orbits of 1, 2, …, n returns.

    The zeta function of Artin and Mazur (Ann. Math. 81 (1965) 82), 1/ζ(z) = ∏ (1 − z^m)^(number of orbits of m returns),
    has its least zero at e^(−h) where the numbers of orbits grow by the entropy h, as of hyperbolic sets (Bowen, Trans.
    Am. Math. Soc. 154 (1971) 377). Its Taylor polynomials converge faster than the growth itself: the error is the
    largest difference from the last lower orders, and what missing orbits would add.

    Args:
        number: of orbits known.
        missing: how many may be missing at most.
    """
    orders = range(max(1, len(number) - _LAST), len(number) + 1)
    values = np.array([_from_zero(number[:order]) for order in orders])
    if not np.any(number > 0):
        return np.nan, np.nan
    return float(values[-1]), float(np.max(np.abs(values - values[-1])) + _from_zero(number + missing) - values[-1])


def _from_zero(number: Float[np.ndarray, " n"]) -> float:
    """Return −ln z of the least zero in (0, 1] of the polynomial of order n; zero where it has none."""
    n = len(number)
    fixed = [sum(m * number[m - 1] for m in range(1, k + 1) if k % m == 0) for k in range(1, n + 1)]
    terms = [1.0]
    for k in range(1, n + 1):
        terms.append(-sum(fixed[j - 1] * terms[k - j] for j in range(1, k + 1)) / k)
    roots = np.roots(np.trim_zeros(terms[::-1], "f"))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= 1.0)]
    return float(-np.log(real.min())) if len(real) else 0.0
