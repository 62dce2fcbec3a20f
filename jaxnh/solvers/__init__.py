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
from jaxnh.solvers.iterations import Iteration, iteration
from jaxnh.solvers.nystrom import NYSTROM, Nystrom, nystrom8
from jaxnh.solvers.projection import ProjectedSolver
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.solvers.tableaus import RUNGE_KUTTA, dopri5, dopri8, tsit5, tsitouras_papakostas8, verner9, write_out

Solver = IsokineticSplitting | WrittenOutRungeKutta | Nystrom | Iteration

SOLVERS: dict[str, Solver] = {**SPLITTINGS, **RUNGE_KUTTA, **NYSTROM}
"""All solvers by their name in configs."""

NAMED: dict[str, Solver] = {**SOLVERS, iteration.name: iteration}
"""All that a result may name as its solver."""

__all__ = [
    "NAMED",
    "NYSTROM",
    "RUNGE_KUTTA",
    "SOLVERS",
    "SPLITTINGS",
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
