"""Solvers of diffrax as steps of a return map.

Maps of the package write their steps out and need none of this. It is imported by whoever integrates by diffrax, which
costs a start half a second.
"""

from __future__ import annotations

from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax

from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State


class DiffraxSteps(eqx.Module):
    """Any diffrax solver of one term as the steps of a return map (`maps.general_flow.GeneralStrobe`).

    Attributes:
        solver: of diffrax.
    """

    solver: diffrax.AbstractSolver = eqx.field(static=True)

    def flow_over(self, system: Flow, grid: Any, state: State, p: Parameters) -> State:
        """The state at the end of a grid of steps (steps + 1,); of a lane whose solver fails, what it has by then."""
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(system.rhs),
            self.solver,
            t0=grid[0],
            t1=grid[-1],
            dt0=None,
            y0=state,
            args=p,
            stepsize_controller=diffrax.StepTo(grid),
            adjoint=diffrax.ForwardMode(),
            max_steps=len(grid),
            throw=False,
        )
        return jax.tree.map(lambda leaf: leaf[-1], solution.ys)


class OneTermSolver(diffrax.AbstractSolver):
    """A solver of one term with nothing to begin with; a subclass adds its step."""

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    def order(self, terms: Any) -> int | None:
        """The order of convergence; None where a controller decides."""
        return None

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Nothing is carried from step to step."""
        return

    def func(self, terms: diffrax.AbstractTerm, t0: Any, y0: Any, args: Any) -> Any:
        """Vector field of the term."""
        return terms.vf(t0, y0, args)
