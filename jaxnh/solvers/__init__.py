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
from jaxnh.solvers.iterations import Iteration, iteration
from jaxnh.solvers.nystrom import NYSTROM, Nystrom, nystrom8
from jaxnh.solvers.projection import ProjectedSolver
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.solvers.tableaus import RUNGE_KUTTA, dopri5, dopri8, tsit5, tsitouras_papakostas8, verner9, write_out

Solver = IsokineticSplitting | WrittenOutRungeKutta | Nystrom | AdaptiveMethod | Iteration

SOLVERS: dict[str, Solver] = {**SPLITTINGS, **RUNGE_KUTTA, **NYSTROM, **ADAPTIVE}
"""All solvers by their name in configs."""

NAMED: dict[str, Solver] = {**SOLVERS, iteration.name: iteration}
"""All that a result may name as its solver."""

__all__ = [
    "ADAPTIVE",
    "NAMED",
    "NYSTROM",
    "RUNGE_KUTTA",
    "SOLVERS",
    "SPLITTINGS",
    "AdaptiveMethod",
    "IsokineticSplitting",
    "Iteration",
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
    "iteration",
    "kick",
    "nystrom8",
    "tsit5",
    "tsitouras_papakostas8",
    "verner9",
    "write_out",
]
