"""diffrax solvers of the package: isokinetic splittings, and Runge–Kutta methods with their stages written out."""

from jaxnh.solvers.compositions import SPLITTINGS
from jaxnh.solvers.isokinetic import (
    IsokineticSplitting,
    Schedule,
    exact_half_turn,
    half_turn,
    isokinetic_terms,
    kick,
)
from jaxnh.solvers.projected import Projected
from jaxnh.solvers.runge_kutta import RUNGE_KUTTA, WrittenOutRungeKutta, dopri5, dopri8, tsit5, written_out

Solver = IsokineticSplitting | WrittenOutRungeKutta

SOLVERS: dict[str, Solver] = {**SPLITTINGS, **RUNGE_KUTTA}
"""All solvers by their name in configs."""

__all__ = [
    "RUNGE_KUTTA",
    "SOLVERS",
    "SPLITTINGS",
    "IsokineticSplitting",
    "Projected",
    "Schedule",
    "Solver",
    "WrittenOutRungeKutta",
    "dopri5",
    "dopri8",
    "exact_half_turn",
    "half_turn",
    "isokinetic_terms",
    "kick",
    "tsit5",
    "written_out",
]
