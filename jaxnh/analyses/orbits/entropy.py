"""Topological entropy from the numbers of periodic orbits."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_ORDERS = 4  # the highest, by which convergence is judged


def topological_entropy(number: Float[np.ndarray, " n"], missing: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the entropy per return, and its error, from the numbers of primitive orbits of 1, 2, …, n returns.

    The numbers N_n of points of period n, primitive or not, grow by it: h = lim ln N_n / n on hyperbolic sets (Bowen,
    Trans. Am. Math. Soc. 154 (1971) 377), where N_n = e^(hn) up to a factor that tends to one. The error is the largest
    difference of the value at n from those at the three numbers of returns before, and what missing orbits would add.

    Args:
        number: of orbits known.
        missing: how many may be missing at most.

    Returns:
        Not numbers where there are fewer than four numbers of returns, or no orbit.
    """
    known, most = _growth(number), _growth(number + missing)
    if len(known) < _ORDERS or not number.any():
        return np.nan, np.nan
    lower = known[-_ORDERS:-1]
    return float(known[-1]), float(np.max(np.abs(lower - known[-1])) + most[-1] - known[-1])


def _growth(number: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return ln N_n / n for each n, zero where there is no point of that period."""
    n = np.arange(1, len(number) + 1)
    points = np.array([np.sum(n * number * (k % n == 0)) for k in n])
    return np.log(np.maximum(points, 1.0)) / n
