"""Embedded pairs with steps of a lane's own: how fine they are is one number, as a number of equal steps is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeGuard

import equinox as eqx

from jaxnh.solvers.rosenbrock import Rosenbrock, rodas5p
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.solvers.tableaus import RUNGE_KUTTA

_COARSE = 2.0  # steps a period with which a step may err by as much as the motion is large
_FINEST = 1e-13  # of the size of the motion: estimates below it are of rounding


class AdaptiveMethod(eqx.Module):
    """A pair whose steps follow each lane's own motion.

    Attributes:
        pair: the method of a step.
        name: name in configs and result files.
        least: steps a period, or unit of time, that every motion has, however calm: tangents along it may need them.
        rolled: as of `WrittenOutRungeKutta`; None of a Rosenbrock method, whose stages are written out.
    """

    pair: Rosenbrock | WrittenOutRungeKutta = eqx.field(static=True)
    name: str = eqx.field(static=True)
    least: int = eqx.field(static=True, default=1)
    rolled: bool | None = eqx.field(static=True, default=None)

    @property
    def source(self) -> str:
        """Source of the coefficients."""
        return self.pair.source

    @property
    def convergence_order(self) -> int:
        """Power of the steps with which errors fall: the order of the solution."""
        return self.pair.convergence_order

    @property
    def stages(self) -> int:
        """Evaluations of the field a step, those of the error estimate among them."""
        return len(self.pair.b)

    @property
    def processor(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """None: steps alone have the order of the method."""
        return (0.0,), ()

    def with_least(self, steps: int) -> AdaptiveMethod:
        """The same method with so many steps a period at least."""
        return replace(self, least=steps)

    def most_steps(self, fields: int) -> int:
        """Steps of a map with so many evaluations of the field at most; with more, estimates are of rounding."""
        return min(fields // self.stages, int(_COARSE * _FINEST ** (-1.0 / self.convergence_order)))

    def total_kicks(self, steps: int) -> int:
        """Evaluations of the field of a map of so many steps."""
        return steps * self.stages

    def tolerance(self, steps: int) -> float:
        """Error of a step, relative to the size of the motion, that makes about so many steps of a calm period.

        The estimate of an error falls with the order-th power of a step, so that the errors of a motion fall with the
        order-th power of the number of steps as those of equal steps do. A stiff period has as many as it needs.
        """
        return max(_FINEST, min(1.0, _COARSE / steps) ** self.convergence_order)


ADAPTIVE = {
    "rodas5p": AdaptiveMethod(rodas5p, "rodas5p"),
    **{f"adaptive_{name}": AdaptiveMethod(pair, f"adaptive_{name}") for name, pair in RUNGE_KUTTA.items()},
}
"""Pairs with steps of a lane's own by their name in configs: one for stiff flows, and the explicit ones."""


def has_loop(solver: Any) -> TypeGuard[AdaptiveMethod | WrittenOutRungeKutta]:
    """Return whether a solver can have its stages in a loop."""
    return isinstance(solver.pair if isinstance(solver, AdaptiveMethod) else solver, WrittenOutRungeKutta)


def in_loop(solver: Any) -> Any:
    """A solver with its stages in a loop, where it can have them so, which needs the least compiling."""
    return replace(solver, rolled=True) if has_loop(solver) else solver
