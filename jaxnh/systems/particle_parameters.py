"""Effects of the paper's particle and its strobe period, which a config and a flow both need. Nothing imports JAX."""

from __future__ import annotations

import math
from fractions import Fraction

EFFECTS = ("forcing", "coupling", "cubic_stiffness", "damping")
"""Parts that a system may omit; the disturbance is left out by d = 0, the constraint by another system."""

_LARGEST_DENOMINATOR = 64


def strobe_period(omega: float, *, disturbed: bool) -> float:
    """2π/ω, or with the disturbance sin t the least T that is a multiple of both 2π/ω and 2π.

    Raises:
        ValueError: ω is not a ratio of whole numbers with a denominator up to 64, so that sin ωt and sin t have no
            common period to strobe at.
    """
    if not disturbed:
        return 2 * math.pi / omega
    ratio = Fraction(omega).limit_denominator(_LARGEST_DENOMINATOR)
    if ratio <= 0 or abs(float(ratio) - omega) > 1e-12 * omega:
        raise ValueError(
            f"sin({omega:g} t) and the disturbance sin t have no common period to strobe at; "
            f"omega must be a ratio p/q of whole numbers with q up to {_LARGEST_DENOMINATOR}"
        )
    return 2 * math.pi * ratio.denominator
