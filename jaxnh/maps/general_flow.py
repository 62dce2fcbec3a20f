"""The strobe map of a system of T, Q and f: Runge–Kutta steps, each projected on the constraints, on a grid of steps.

The loop does the arithmetic of `solvers.projected.Projected` under `diffrax.diffeqsolve`. Derivatives go through the
constraints as well: in the 2k coordinates and velocities the map has m multipliers zero, and Newton needs no others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.protocol import Pushed, Strobe, Tangent
from jaxnh.solvers import Projected, Solver, WrittenOutRungeKutta
from jaxnh.systems.lagrangian import Motion, NonholonomicSystem
from jaxnh.systems.particle import IsokineticParticle, State

_SMALLEST_GRID = 1024


class MarchedStrobe(Strobe):
    """P by projected steps; the number of steps is data, so that one program serves every accuracy.

    Attributes:
        system: T, Q and f.
        solver: the Runge–Kutta method.
        grid: ends of the steps, (capacity + 1,).
        steps: how many are in use.
    """

    system: NonholonomicSystem
    solver: WrittenOutRungeKutta = eqx.field(static=True)
    grid: ArrayLike
    steps: ArrayLike

    @property
    def most_lanes(self) -> int | None:
        """A step carries all its stages: more lanes do not fit a core's first cache."""
        return 32

    def stretched(self, factor: ArrayLike) -> MarchedStrobe:
        """The map over so many times the time, of a system without a clock."""
        return MarchedStrobe(self.system, self.solver, self.grid * factor, self.steps)

    def __call__(self, state: Motion, b: ArrayLike) -> Motion:
        solver, terms = Projected(self.solver, self.system), diffrax.ODETerm(self.system.vector_field)
        return self._run(lambda t0, t1, state: solver.rolled_step(terms, t0, t1, state, b), state)

    def push(self, state: Motion, b: ArrayLike, tangents: tuple[Tangent, ...]) -> Pushed:
        zero = jnp.zeros_like(state.q[0])
        directions = [(t.state, zero if t.b is None else t.b) for t in tangents]
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *directions)
        moved = jax.vmap(lambda direction: jax.jvp(self, (state, b), direction)[1])(stacked)
        parts = [jax.tree.map(lambda leaf, i=i: leaf[i], moved) for i in range(len(tangents))]
        pushed = tuple(Tangent(dz, t.b) for dz, t in zip(parts, tangents, strict=True))
        return Pushed(self(state, b), pushed, self._volume(state, b))

    def _volume(self, state: Motion, b: ArrayLike) -> Any:
        terms = diffrax.ODETerm(self._field_and_divergence)

        def step(t0: Any, t1: Any, carry: tuple[Motion, Any]) -> tuple[Motion, Any]:
            state, logarithm = self.solver.rolled_step(terms, t0, t1, carry, b)
            return self.system.project(t1, state, b), logarithm

        return jnp.exp(self._run(step, (state, jnp.zeros_like(state.q[0])))[1])

    def _field_and_divergence(self, t: ArrayLike, carry: tuple[Motion, Any], b: ArrayLike) -> tuple[Motion, Any]:
        return self.system.vector_field(t, carry[0], b), self.system.divergence(t, carry[0], b)

    def _run(self, step: Callable[[Any, Any, Any], Any], carry: Any) -> Any:
        grid = jnp.asarray(self.grid)
        return lax.fori_loop(0, self.steps, lambda i, carry: step(grid[i], grid[i + 1], carry), carry)


def marched(system: NonholonomicSystem, solver: Solver, grid: np.ndarray) -> MarchedStrobe:
    """The map over a grid (..., steps + 1), or stacked maps.

    Raises:
        TypeError: the solver is none for equations of this kind.
    """
    if not isinstance(solver, WrittenOutRungeKutta):
        raise TypeError(f"{solver.name} is a splitting for a particle at a prescribed speed")
    count = grid.shape[-1] - 1
    capacity = max(_SMALLEST_GRID, 1 << (count - 1).bit_length())
    padded = np.concatenate([grid, np.repeat(grid[..., -1:], capacity - count, axis=-1)], axis=-1)
    return MarchedStrobe(system, solver, padded, np.full(grid.shape[:-1], count, np.int32))


class SolveStrobe(Strobe):
    """P by `diffrax.diffeqsolve` with constant steps, for the Runge–Kutta solvers.

    Attributes:
        system: the flow.
        solver: any diffrax solver that takes one term.
        grid: ends of the steps, (steps + 1,).
    """

    system: IsokineticParticle
    solver: diffrax.AbstractSolver = eqx.field(static=True)
    grid: ArrayLike

    def __call__(self, state: State, b: ArrayLike) -> State:
        return self._solve(self.system.vector_field, state, b)

    def _solve(self, field: Callable[[Any, Any, Any], Any], y: Any, b: ArrayLike) -> Any:
        grid = jnp.asarray(self.grid)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            self.solver,
            t0=grid[0],
            t1=grid[-1],
            dt0=None,
            y0=y,
            args=b,
            stepsize_controller=diffrax.StepTo(grid),
            adjoint=diffrax.ForwardMode(),
            max_steps=len(grid),
            throw=False,
        )
        return jax.tree.map(lambda leaf: leaf[-1], solution.ys)

    def push(self, state: State, b: ArrayLike, tangents: tuple[Tangent, ...]) -> Pushed:
        zero = jnp.zeros_like(state[0][0])
        moved = [jax.jvp(self, (state, b), (t.state, zero if t.b is None else t.b))[1] for t in tangents]
        pushed = tuple(Tangent(dz, t.b) for dz, t in zip(moved, tangents, strict=True))
        state, logarithm = self._solve(self._field_and_divergence, (state, zero), b)
        return Pushed(state, pushed, jnp.exp(logarithm))

    def _field_and_divergence(self, t: ArrayLike, y: tuple[State, Array], b: ArrayLike) -> tuple[State, Array]:
        state, _ = y
        return self.system.vector_field(t, state, b), self.system.divergence(t, state, b)
