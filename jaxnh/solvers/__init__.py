"""Steps: isokinetic splittings and Runge–Kutta methods, diffrax solvers by `diffrax_solvers`, methods of Nyström's, and
embedded pairs with steps of a lane's own, Rodas5P for stiff flows among them.
"""

from jaxnh.solvers.adaptive import ADAPTIVE, AdaptiveMethod
from jaxnh.solvers.compositions import SPLITTINGS
from jaxnh.solvers.dormand_prince import dopri5, dopri8
from jaxnh.solvers.isokinetic import IsokineticSplitting, Schedule, exact_half_turn, half_turn, kick
from jaxnh.solvers.iterations import Iteration, iteration
from jaxnh.solvers.nystrom import NYSTROM, Nystrom, nystrom8
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.solvers.tableaus import RUNGE_KUTTA, tsit5, tsitouras_papakostas8, verner9

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
    "Schedule",
    "Solver",
    "WrittenOutRungeKutta",
    "dopri5",
    "dopri8",
    "exact_half_turn",
    "half_turn",
    "iteration",
    "kick",
    "nystrom8",
    "tsit5",
    "tsitouras_papakostas8",
    "verner9",
]
