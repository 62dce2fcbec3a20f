"""The logistic map: its derivatives, and orbits that attract."""

from __future__ import annotations

import numpy as np

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.continuation.arclength import Family


def logistic(u, p):
    """x → p x (1 − x) and its derivatives."""
    slope = (p[:, None] * (1 - 2 * u))[..., None]
    return Derivatives(p[:, None] * u * (1 - u), slope, u * (1 - u))


LOGISTIC = Family(logistic, lambda difference: difference, np.ones(1), 2.0, 3.9)


def logistic_orbit(n, p):
    """The n points that attract 0.5, in turn, (n, 1)."""
    x = 0.5
    for _ in range(4000):
        x = p * x * (1 - x)
    points = []
    for _ in range(n):
        points.append([x])
        x = p * x * (1 - x)
    return points
