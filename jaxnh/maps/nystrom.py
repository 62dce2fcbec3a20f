"""The strobe map of a flow of second order by a method of Nyström's, on a grid of steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.exceptions import AccuracyError
from jaxnh.maps.general_flow import (
    GeneralStrobe,
    Moving,
    lanes_per_tile,
    linearise,
    own_parameters,
    stack_leaves,
    stage_times,
)
from jaxnh.maps.protocol import Pushforward, Tangent
from jaxnh.maps.second_order import SecondOrder, second_order
from jaxnh.solvers import Nystrom
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State
from jaxnh.systems.tracing import traced_once

Carried = list[list[Any]]
"""Positions, or velocities: of the state, then of every tangent."""


class NystromStrobe(GeneralStrobe):
    """P of a flow x″ = F(x, t) − γ x′ by steps on a grid, its tangents by the linearisation of F.

    Attributes:
        solver: a method of Nyström's.
        gamma: of each position, (positions,); the last of `values` are then exp(γ t/2) and exp(−γ t/2), t from the
            beginning of the step, at its stages and its end: (capacity, stages + 1, positions).
        damped: whether there is a γ that is not zero; without, nothing of it is computed.
    """

    solver: Nystrom = eqx.field(static=True)  # pyright: ignore[reportIncompatibleVariableOverride]
    gamma: ArrayLike = 0.0
    damped: bool = eqx.field(static=True, default=False)

    @property
    def most_lanes(self) -> int:
        """Number of lanes whose stages, of positions alone, fit in a core's nearest caches."""
        return lanes_per_tile(8 * (self.solver.stages + 4) * np.shape(self.gamma)[-1])

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip count of the loop over steps."""
        return () if self.steps is None else (float(np.mean(self.steps)),)

    def __call__(self, state: State, p: Parameters) -> State:
        form, own = self._form, own_parameters(self.system, p)

        def force(values: Sequence[Any], x: Carried) -> Carried:
            return [form.split.rest(values, self.system, (x[0], own))]

        def project(t: Any, y: Moving) -> Moving:
            return Moving(self.system.project(t, y.state, p))

        return self._march_on(force, project, Moving(state)).state

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        del volume  # the damping's, which costs nothing
        form, own = self._form, own_parameters(self.system, p)
        by_p = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]

        @traced_once
        def forces(values: Sequence[Any], system: Flow, x: Carried, own: Any, by_p: Any) -> Carried:
            value, moved = linearise(lambda x, own: form.split.rest(values, system, (x, own)), x[0], own, x[1:], by_p)
            return [value, *moved]

        @traced_once
        def projected(t: Any, system: Flow, y: Moving, p: Parameters, own: Any, by_p: Any) -> Moving:
            return Moving(*linearise(lambda z, own: system.project(t, z, {**p, **own}), y.state, own, y.tangents, by_p))

        def force(values: Sequence[Any], x: Carried) -> Carried:
            return forces(list(values), self.system, x, own, by_p)

        def project(t: Any, y: Moving) -> Moving:
            return projected(t, self.system, y, p, own, by_p)

        ended = self._march_on(force, project, Moving(state, tuple(t.state for t in tangents)))
        moved = tuple(Tangent(dz, t.p) for dz, t in zip(ended.tangents, tangents, strict=True))
        grid, shrunk = jnp.asarray(self.grid), jnp.zeros_like(jax.tree.leaves(state)[0])
        if self.damped:
            shrunk = shrunk - (grid[-1] - grid[0]) * jnp.sum(jnp.asarray(self.gamma))
        return Pushforward(ended.state, moved, shrunk)

    @property
    def _form(self) -> SecondOrder:
        form = second_order(self.system)
        assert form is not None
        return form

    def _march_on(
        self, force: Callable[[Sequence[Any], Carried], Carried], project: Callable[[Any, Moving], Moving], y: Moving
    ) -> Moving:
        """All steps, each projected."""
        halves, grid, values = self._form.halves, jnp.asarray(self.grid), [jnp.asarray(v) for v in self.values]
        gamma = [jnp.asarray(self.gamma)[k] for k in range(len(halves.positions))] if self.damped else []

        def step(i: Any, y: Moving) -> Moving:
            h = grid[i + 1] - grid[i]
            carried = [halves.parts(state) for state in (y.state, *y.tangents)]
            x, v = ([half[part] for half in carried] for part in (0, 1))
            rows = [value[i] for value in values]
            if self.damped:
                *rows, growth, decay = rows

                def grown(s: int, x: Carried) -> Carried:
                    x = _times(decay[s], x)
                    pushed = force([row[s] for row in rows], x)
                    return _times(growth[s], _plus(pushed, [0.25 * g * g for g in gamma], x))

                half = [0.5 * g for g in gamma]
                x, v = self.solver.written_stages(grown, h, x, _plus(v, half, x))
                x, v = _times(decay[-1], x), _times(decay[-1], v)
                v = _plus(v, [-g for g in half], x)
            else:
                x, v = self.solver.written_stages(lambda s, x: force([row[s] for row in rows], x), h, x, v)
            state, *moved = (
                halves.joined(state, *part) for state, *part in zip((y.state, *y.tangents), x, v, strict=True)
            )
            return project(grid[i + 1], Moving(state, tuple(moved)))

        return step(0, y) if self.steps is None else lax.fori_loop(0, self.steps, step, y)


def nystrom_strobe(system: Flow, solver: Nystrom, grid: np.ndarray) -> NystromStrobe:
    """The map over a grid (steps + 1,), or stacked maps of one flow over grids (parts, steps + 1).

    Raises:
        AccuracyError: the flow is not of second order.
    """
    form = second_order(system)
    if form is None:
        raise AccuracyError(f"{solver.name} is for flows x'' = F(x, t) - gamma x', and this one is not seen to be one")
    count, parts = grid.shape[-1] - 1, grid.shape[:-1]
    grid, times = stage_times(grid, solver.c)
    values, gamma = list(form.split.table(times, system)), form.damping(system)
    if form.damped:
        since = np.diff(grid)[..., None] * np.asarray([*solver.c, 1.0])
        half = 0.5 * since[..., None] * gamma
        values += [np.exp(half), np.exp(-half)]
    return NystromStrobe(
        stack_leaves(system, parts),
        solver,
        grid,
        np.full(parts, count, np.int32),
        tuple(np.asarray(value) for value in values),
        gamma=np.broadcast_to(gamma, (*parts, len(gamma))),
        damped=form.damped,
    )


def nystrom_unit_step(system: Flow, solver: Nystrom) -> NystromStrobe:
    """One step as long as the unit of time, of a flow without a clock.

    Raises:
        AccuracyError: the flow is not of second order, or damped.
    """
    form = second_order(system)
    if form is None or form.damped:
        raise AccuracyError(f"{solver.name} is for flows x'' = F(x) where there is no clock, and this is none of them")
    return NystromStrobe(system, solver, np.array([0.0, 1.0]), None, gamma=np.zeros(len(form.halves.positions)))


def _times(factors: Any, carried: Carried) -> Carried:
    """Multiply every component by its factor."""
    return [[factors[k] * leaf for k, leaf in enumerate(part)] for part in carried]


def _plus(carried: Carried, factors: Sequence[Any], other: Carried) -> Carried:
    """carried + factor · other, each component with its factor."""
    return [
        [first + f * two for first, f, two in zip(part, factors, others, strict=True)]
        for part, others in zip(carried, other, strict=True)
    ]
