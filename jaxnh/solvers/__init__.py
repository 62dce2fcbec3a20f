"""Steps: isokinetic splittings and Runge–Kutta methods, all diffrax solvers, methods of Nyström's, and embedded pairs
with steps of a lane's own, Rodas5P for stiff flows among them.
"""

from jaxnh.solvers.adaptive import ADAPTIVE, AdaptiveMethod
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

Solver = IsokineticSplitting | WrittenOutRungeKutta | Nystrom | AdaptiveMethod

SOLVERS: dict[str, Solver] = {**SPLITTINGS, **RUNGE_KUTTA, **NYSTROM, **ADAPTIVE}
"""All solvers by their name in configs."""

__all__ = [
    "ADAPTIVE",
    "NYSTROM",
    "RUNGE_KUTTA",
    "SOLVERS",
    "SPLITTINGS",
    "AdaptiveMethod",
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
