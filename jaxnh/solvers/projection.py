"""A solver whose every step ends on the constraints of the system."""

from __future__ import annotations

from typing import Any, ClassVar

import diffrax
import equinox as eqx

from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State


class ProjectedSolver(diffrax.AbstractSolver):
    """Steps of another solver, each followed by `Flow.project`.

    The order stays: a projection moves a step by no more than a multiple of its own error.

    Attributes:
        solver: the solver that steps, of one term.
        system: the system whose `rhs` that term has.
    """

    solver: WrittenOutRungeKutta = eqx.field(static=True)
    system: Flow

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    def order(self, terms: Any) -> int | None:
        return self.solver.order(terms)

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> Any:
        return self.solver.init(terms, t0, t1, y0, args)

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> Any:
        return self.solver.func(terms, t0, y0, args)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: State, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[State, Any, dict[str, State], Any, diffrax.RESULTS]:
        """One step and its projection; `args` are the lane's parameters."""
        y1, _, _, solver_state, result = self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump)
        y1 = self.system.project(t1, y1, args)
        return y1, None, {"y0": y0, "y1": y1}, solver_state, result
