"""Steps: isokinetic splittings and Runge–Kutta methods, all diffrax solvers, and methods of Nyström's."""

from jaxnh.solvers.compositions import SPLITTINGS
from jaxnh.solvers.isokinetic import (
    IsokineticSplitting,
    Schedule,
    exact_half_turn,
    half_turn,
    isokinetic_terms,
    kick,
)
from jaxnh.solvers.nystrom import NYSTROM, Nystrom, nystrom8
from jaxnh.solvers.projection import ProjectedSolver
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.solvers.tableaus import RUNGE_KUTTA, dopri5, dopri8, tsit5, tsitouras_papakostas8, verner9, write_out

Solver = IsokineticSplitting | WrittenOutRungeKutta | Nystrom

SOLVERS: dict[str, Solver] = {**SPLITTINGS, **RUNGE_KUTTA, **NYSTROM}
"""All solvers by their name in configs."""

__all__ = [
    "NYSTROM",
    "RUNGE_KUTTA",
    "SOLVERS",
    "SPLITTINGS",
    "IsokineticSplitting",
    "Nystrom",
    "ProjectedSolver",
    "Schedule",
    "Solver",
    "WrittenOutRungeKutta",
    "dopri5",
    "dopri8",
    "exact_half_turn",
    "half_turn",
    "isokinetic_terms",
    "kick",
    "nystrom8",
    "tsit5",
    "tsitouras_papakostas8",
    "verner9",
    "write_out",
]
