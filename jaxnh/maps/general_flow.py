"""The strobe map of any flow by a Runge–Kutta method, each step projected on the constraints, on a grid of steps.

The loop does the arithmetic of `solvers.projected.Projected` under `diffrax.diffeqsolve`, and so many steps are data:
one program serves every accuracy. Solvers that are not the package's run under `diffeqsolve` itself. Derivatives go
through the constraints as well: in 2k coordinates and velocities the map has m multipliers zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.maps.protocol import Pushed, Strobe, Tangent
from jaxnh.solvers import WrittenOutRungeKutta
from jaxnh.systems.flow import Flow, Parameters, State

_SMALLEST_GRID = 1024
_FEW_LANES = 32  # a step carries all its stages: more lanes do not fit a core's first cache

Field = Callable[[Any, Any, Any], Any]


class GeneralStrobe(Strobe):
    """P of any flow by steps on a grid.

    Attributes:
        system: the flow.
        solver: a Runge–Kutta method of the package, or any diffrax solver that takes one term.
        grid: ends of the steps, (capacity + 1,); the last one repeats where not all are in use.
        steps: how many are in use.
        rolled: whether the stages of a step are a loop: large fields compile ten times as fast then, and run half as
            fast.
    """

    system: Flow
    solver: diffrax.AbstractSolver = eqx.field(static=True)
    grid: ArrayLike
    steps: ArrayLike
    rolled: bool = eqx.field(static=True, default=True)

    @property
    def most_lanes(self) -> int | None:
        """Few, where a loop carries all stages."""
        return _FEW_LANES if self._rolls else None

    @property
    def turns(self) -> tuple[float, ...]:
        """Of the loop over steps, and of the loop over stages where there is one."""
        steps = float(np.mean(self.steps))
        return (steps, float(self.solver.stages)) if self._rolls else (steps,)  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def _rolls(self) -> bool:
        return self.rolled and isinstance(self.solver, WrittenOutRungeKutta)

    def stretched(self, factor: ArrayLike) -> GeneralStrobe:
        """The map over so many times the time, of a flow without a clock."""
        return GeneralStrobe(self.system, self.solver, self.grid * factor, self.steps, self.rolled)

    def with_room_of(self, other: Strobe) -> GeneralStrobe:
        if not isinstance(self.solver, WrittenOutRungeKutta):  # diffrax takes no step of no length
            return self
        assert isinstance(other, GeneralStrobe)
        grid = np.asarray(self.grid)
        return replace(self, grid=np.pad(grid, (0, len(np.asarray(other.grid)) - len(grid)), mode="edge"))

    def __call__(self, state: State, p: Parameters) -> State:
        return self._solve(self.system.rhs, lambda t, y: self.system.project(t, y, p), state, p)

    def push(self, state: State, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushed:
        moved: tuple[Tangent, ...] = ()
        if tangents:
            still = jax.tree.map(jnp.zeros_like, dict(p))
            directions = [(t.state, {**still, **(t.p or {})}) for t in tangents]
            stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *directions)
            images = jax.vmap(lambda direction: jax.jvp(self, (state, dict(p)), direction)[1])(stacked)
            parts = [jax.tree.map(lambda leaf, i=i: leaf[i], images) for i in range(len(tangents))]
            moved = tuple(Tangent(dz, t.p) for dz, t in zip(parts, tangents, strict=True))
        return Pushed(self(state, p), moved, self._volume(state, p))

    def _volume(self, state: State, p: Parameters) -> Any:
        """exp ∫ divergence dt, integrated beside the state."""

        def field(t: Any, y: tuple[State, Any], p: Parameters) -> tuple[State, Any]:
            return self.system.rhs(t, y[0], p), self.system.divergence(t, y[0], p)

        def project(t: Any, y: tuple[State, Any]) -> tuple[State, Any]:
            return self.system.project(t, y[0], p), y[1]

        zero = jnp.zeros_like(jax.tree.leaves(state)[0])
        return jnp.exp(self._solve(field, project, (state, zero), p)[1])

    def _solve(self, field: Field, project: Callable[[Any, Any], Any], y: Any, p: Parameters) -> Any:
        grid, term = jnp.asarray(self.grid), diffrax.ODETerm(field)
        solver = self.solver
        if isinstance(solver, WrittenOutRungeKutta):

            def step(i: Any, y: Any) -> Any:
                t0, t1 = grid[i], grid[i + 1]
                after = (
                    solver.rolled_step(term, t0, t1, y, p)
                    if self.rolled
                    else solver.step(term, t0, t1, y, p, None, False)[0]
                )
                return project(t1, after)

            return lax.fori_loop(0, self.steps, step, y)
        solution = diffrax.diffeqsolve(
            term,
            solver,
            t0=grid[0],
            t1=grid[-1],
            dt0=None,
            y0=y,
            args=p,
            stepsize_controller=diffrax.StepTo(grid),
            adjoint=diffrax.ForwardMode(),
            max_steps=len(grid),
            throw=False,
        )
        return jax.tree.map(lambda leaf: leaf[-1], solution.ys)


def general_strobe(
    system: Flow, solver: diffrax.AbstractSolver, grid: np.ndarray, *, rolled: bool = True
) -> GeneralStrobe:
    """The map over a grid (..., steps + 1), or stacked maps."""
    count = grid.shape[-1] - 1
    if isinstance(solver, WrittenOutRungeKutta):
        capacity = max(_SMALLEST_GRID, 1 << (count - 1).bit_length())
        grid = np.concatenate([grid, np.repeat(grid[..., -1:], capacity - count, axis=-1)], axis=-1)
    return GeneralStrobe(system, solver, grid, np.full(grid.shape[:-1], count, np.int32), rolled)
