"""diffrax solvers of the package: isokinetic splittings, and Runge–Kutta methods with their stages written out."""

from jaxnh.solvers.isokinetic import (
    SPLITTINGS,
    IsokineticSplitting,
    Schedule,
    half_turn,
    isokinetic_terms,
    kick,
)
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta, dopri8

__all__ = [
    "SPLITTINGS",
    "IsokineticSplitting",
    "Schedule",
    "WrittenOutRungeKutta",
    "dopri8",
    "half_turn",
    "isokinetic_terms",
    "kick",
]
