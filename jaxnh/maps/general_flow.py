"""The strobe map of any flow by a Runge–Kutta method, each step projected on the constraints, on a grid of steps.

The loop does the arithmetic of steps and projections under `diffrax.diffeqsolve`, and so many steps
are data: one program serves every accuracy. What the field makes of time alone is in a table (`time_tables`). Tangents
and volume go along with the state, stage by stage, by the field's linearisation, which is the exact derivative of the
steps. Solvers of diffrax run under `diffeqsolve` itself. Derivatives go through the constraints as well: in 2k
coordinates and velocities the map has m multipliers zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.maps.batching import as_batched
from jaxnh.maps.jacobians import equations_with_tangents, field_jacobian, has_cheap_jacobian, tangent_rate
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import AdaptiveMethod, WrittenOutRungeKutta
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State
from jaxnh.systems.tracing import traced_once

_SMALLEST_GRID = 2048  # steps of all parts: most accuracies, and refined ones, run through one program
_LARGEST_STEP = 3000  # equations that are written out in a step; larger ones compile for minutes, and get a loop
_IN_TURN = 150  # equations of a field from which on tangents take turns: compiled in half the time, and run no slower
# In a loop a field of more equations has so few tangents each by itself: compiled in up to 1.15 times the time, and
# with one lane is 1.4 (dysts' BlinkingVortex) to 2.5 times as fast (InteriorSquirmer), with 8 and 32 lanes 1.0 and 1.3.
_APART, _FEW = 100, 4
_CACHE = 72 << 10  # bytes for the stages of a tile: measured, of most flows 128 lanes are faster than 64 and 256
_MOST_LANES, _FEWEST_LANES = 256, 32


class Moving(NamedTuple):
    """State carried from step to step.

    Attributes:
        state: of the flow.
        tangents: of it, one each; or all of them in one, a number of which is an array (tangents,).
        log_volume: ∫ divergence dt; None where it is not asked for.
    """

    state: State
    tangents: Any = ()
    log_volume: Any = None


class GeneralStrobe(ReturnMap):
    """P of any flow by steps on a grid.

    Attributes:
        system: the flow.
        solver: a Runge–Kutta method of the package, or `solvers.diffrax_solvers.DiffraxSteps`.
        grid: ends of the steps, (capacity + 1,); the last one repeats where not all are in use.
        steps: how many are in use; None of the only one, which is no loop.
        values: what time alone decides, at the stages of all steps, each (capacity, stages).
        carried: whether stages are a loop of sums and products alone, as extended precision knows them.
    """

    system: Flow
    solver: Any = eqx.field(static=True)
    grid: ArrayLike
    steps: ArrayLike | None
    values: tuple[Any, ...] = ()
    carried: bool = eqx.field(static=True, default=False)

    @property
    def most_lanes(self) -> int | None:
        """Number of lanes whose stages fit in a core's nearest caches."""
        if not isinstance(self.solver, WrittenOutRungeKutta):
            return None
        return lanes_per_tile(8 * (self.solver.stages + 2) * len(self.system.coordinates))

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the loop over steps and, where there is one, of the loop over stages."""
        steps = () if self.steps is None else (float(np.mean(self.steps)),)
        rolls = first_of_stack(self, np.ndim(self.grid) - 1)._rolls(0)
        return (*steps, float(self.solver.stages)) if rolls else steps

    def _rolls(self, tangents: int) -> bool:
        if not isinstance(self.solver, WrittenOutRungeKutta):
            return False
        return self.carried or stages_in_loop(self.solver, lambda: equations_with_tangents(self.system, tangents))

    def as_loop(self) -> GeneralStrobe:
        return replace(self, carried=True) if isinstance(self.solver, WrittenOutRungeKutta) else self

    def rescaled_time(self, factor: ArrayLike) -> GeneralStrobe:
        """The map over so many times the time, of a flow without a clock."""
        return replace(self, grid=self.grid * factor, values=())

    def padded_like(self, other: ReturnMap) -> GeneralStrobe:
        if not hasattr(self.solver, "written_stages"):  # diffrax takes no step of no length
            return self
        assert isinstance(other, GeneralStrobe)
        more = len(np.asarray(other.grid)) - len(np.asarray(self.grid))
        values = tuple(np.pad(value, [(0, more), *[(0, 0)] * (np.ndim(value) - 1)]) for value in self.values)
        return replace(self, grid=np.pad(self.grid, (0, more), mode="edge"), values=values)

    def __call__(self, state: State, p: Parameters) -> State:
        if not isinstance(self.solver, WrittenOutRungeKutta):
            return self.solver.flow_over(self.system, jnp.asarray(self.grid), state, p)
        own = own_parameters(self.system, p)

        system = self.system

        def field(values: Sequence[Any], y: Moving) -> Moving:
            return Moving(time_split(system).rest(values, system, (y.state, own)))

        def project(t: Any, y: Moving) -> Moving:
            return Moving(system.project(t, y.state, p))

        if system.reduction.leaves_constraints:
            return self._march(field, project, Moving(state), 0).state
        grid = jnp.asarray(self.grid)
        placed = system.project(grid[0], state, p)
        ended = self._march(field, None, Moving(system.reduction.reduce(placed)), 0)
        return restored(system, grid[-1], ended.state, placed, p)

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        if not isinstance(self.solver, WrittenOutRungeKutta):
            return self._pushforward_of_call(state, p, tangents)
        own = own_parameters(self.system, p)
        by_p: Any = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]
        moved: Any = tuple(t.state for t in tangents)
        rolls = self._rolls(len(tangents))
        in_stack = linearised_in_loop(self.system, len(tangents)) if rolls and not self.carried else None
        stacked, derivative = in_stack is not None, in_stack or linearise
        by_matrix = not (rolls or any(by_p)) and has_cheap_jacobian(self.system, len(tangents))
        if stacked:
            moved, by_p = stacked_tangents(moved, own, by_p)
        rates = traced_once(partial(rates_along, derivative=None if by_matrix else derivative, volume=volume))

        def field(values: Sequence[Any], y: Moving) -> Moving:
            return rates(list(values), self.system, own, y, by_p)

        def along_tangents(change: Callable[[Flow, Any, State, Any, Parameters], State]) -> Callable[..., Moving]:
            """Something done to states at a time, with what it does to tangents; it may read another state."""

            @traced_once
            def changed(system: Flow, t: Any, y: Moving, other: Any, p: Parameters, own: Any, by_p: Any) -> Moving:
                def of_state(z: State, own: Any) -> State:
                    return change(system, t, z, other, {**p, **own})

                return Moving(*derivative(of_state, y.state, own, y.tangents, by_p), y.log_volume)

            return lambda t, y, other=None: changed(self.system, t, y, other, p, own, by_p)

        first, grid, system = jax.tree.leaves(state)[0], jnp.asarray(self.grid), self.system
        zero = as_batched(jnp.zeros_like(first), first) if volume else None
        start = Moving(state, moved, zero)
        project = along_tangents(lambda system, t, z, _, p: system.project(t, z, p))
        if system.reduction.leaves_constraints:
            ended = self._march(field, project, start, len(tangents))
        else:
            placed, reduce = project(grid[0], start), system.reduction.reduce
            reduced = Moving(
                reduce(placed.state), reduce(placed.tangents) if stacked else tuple(map(reduce, placed.tangents)), zero
            )
            ended = self._march(field, None, reduced, len(tangents))
            ended = along_tangents(restored)(grid[-1], ended, placed.state)
        each = unstacked_tangents(ended.tangents, len(tangents)) if stacked else ended.tangents
        pushed = tuple(Tangent(dz, t.p) for dz, t in zip(each, tangents, strict=True))
        return Pushforward(ended.state, pushed, ended.log_volume if volume else jnp.zeros_like(first))

    def _march(
        self,
        field: Callable[[Sequence[Any], Moving], Moving],
        project: Callable[[Any, Moving], Moving] | None,
        y: Moving,
        tangents: int,
    ) -> Moving:
        """All steps, each projected where there is something to project on."""
        solver, grid = self.solver, jnp.asarray(self.grid)
        assert isinstance(solver, WrittenOutRungeKutta)
        rolled = solver.carried_stages if self.carried else solver.rolled_stages
        advance = rolled if self._rolls(tangents) else solver.written_stages
        kinds = [value.dtype for value in self.values]
        # What a loop over stages closes over has to be a floating-point number (`jax.closure_convert`).
        numbers = [kind if jnp.issubdtype(kind, jnp.inexact) else grid.dtype for kind in kinds]
        values = [jnp.asarray(value, kind) for value, kind in zip(self.values, numbers, strict=True)]

        def step(i: Any, y: Moving) -> Moving:
            rows = [value[i] for value in values]

            def stage(s: Any, y: Moving) -> Moving:
                return field([row[s].astype(kind) for row, kind in zip(rows, kinds, strict=True)], y)

            after = advance(stage, grid[i + 1] - grid[i], y)
            return after if project is None else project(grid[i + 1], after)

        return step(0, y) if self.steps is None else lax.fori_loop(0, self.steps, step, y)

    def _pushforward_of_call(self, state: State, p: Parameters, tangents: tuple[Tangent, ...]) -> Pushforward:
        still = jax.tree.map(jnp.zeros_like, dict(p))
        moved = []
        for t in tangents:
            image = jax.jvp(self.__call__, (state, dict(p)), (t.state, {**still, **(t.p or {})}))[1]
            moved.append(Tangent(image, t.p))
        return Pushforward(self(state, p), tuple(moved), jnp.full_like(jax.tree.leaves(state)[0], jnp.nan))


def restored(system: Flow, t: Any, carried: State, before: State, p: Parameters) -> State:
    """The state after steps that cannot leave its constraints, of what they carry and the state before them."""
    return system.project(t, system.reduction.restore(t, carried, before, p), p)


def linearise(
    function: Callable[[Any, Any], Any],
    y: Any,
    own: Mapping[str, Any],
    moved: Sequence[Any],
    by_p: Sequence[Mapping[str, Any] | None],
) -> tuple[Any, tuple[Any, ...]]:
    """A function's value at (y, own), and its derivative along every tangent of y and, where it has them, of own."""
    if not moved:
        return function(y, own), ()
    if not any(by_p):
        value, slope = jax.linearize(lambda y: function(y, own), y)
        return value, tuple(slope(dy) for dy in moved)
    still = jax.tree.map(jnp.zeros_like, dict(own))
    value, slope = jax.linearize(function, y, dict(own))
    return value, tuple(slope(dy, dp or still) for dy, dp in zip(moved, by_p, strict=True))


def linearise_stacked(
    function: Callable[[Any, Any], Any], y: Any, own: Mapping[str, Any], moved: Any, by_p: Any, *, in_turn: bool = False
) -> tuple[Any, Any]:
    """`linearise` along tangents stacked in arrays (tangents,), with their derivatives of `own` where there are some.

    Args:
        in_turn: whether tangents take turns in a loop, and do not lie side by side.
    """

    def each(slope: Callable[..., Any], *along: Any) -> Any:
        return lax.map(lambda tangent: slope(*tangent), along) if in_turn else jax.vmap(slope)(*along)

    if by_p is None:
        value, slope = jax.linearize(lambda y: function(y, own), y)
        return value, each(slope, moved)
    value, slope = jax.linearize(function, y, dict(own))
    return value, each(slope, moved, by_p)


def linearised_in_loop(system: Flow, tangents: int) -> Callable[..., tuple[Any, Any]] | None:
    """Return `linearise_stacked` for so many tangents of a field in a loop; None where each is by itself.

    There a field with all tangents is one that has one of them, of more numbers.
    """
    size = time_split(system).size
    apart = _APART < size <= _IN_TURN and tangents <= _FEW
    return None if tangents < 2 or apart else partial(linearise_stacked, in_turn=size > _IN_TURN)


def rates_along(
    values: Sequence[Any],
    system: Flow,
    own: Any,
    y: Moving,
    by_p: Any,
    *,
    derivative: Callable[..., tuple[Any, Any]] | None,
    volume: bool,
) -> Moving:
    """Rates of a state, of its tangents, and of the logarithm of a volume where that is asked for.

    Args:
        values: what time alone decides.
        by_p: of each tangent its derivative in the parameters, or None.
        derivative: `linearise`, or as of `linearised_in_loop`; None: tangents go by the field's matrix.
    """

    def rate(z: State, own: Any) -> State:
        return time_split(system).rest(values, system, (z, own))

    divergence = system.reduction.divergence_of(lambda z: rate(z, own), y.state) if volume else None
    if derivative is None:
        value, rows = field_jacobian(system)(values, system, y.state, own)
        return Moving(value, tuple(tangent_rate(rows, dz) for dz in y.tangents), divergence)
    return Moving(*derivative(rate, y.state, own, y.tangents, by_p), divergence)


def linearise_all(
    function: Callable[[Any, Any], Any],
    y: Any,
    own: Mapping[str, Any],
    moved: Sequence[Any],
    by_p: Sequence[Any],
    *,
    stacked: bool,
) -> tuple[Any, tuple[Any, ...]]:
    """`linearise`, where tangents may be a single one that has all of them stacked."""
    if not stacked:
        return linearise(function, y, own, moved, by_p)
    value, slopes = linearise_stacked(function, y, own, moved[0], by_p[0])
    return value, (slopes,)


def stacked_tangents(
    moved: Sequence[Any], own: Mapping[str, Any], by_p: Sequence[Mapping[str, Any] | None]
) -> tuple[Any, Any]:
    """Tangents, and their derivatives in the parameters or None, as one whose numbers are arrays (tangents,)."""
    if not any(by_p):
        return _stacked(moved), None
    return _stacked(moved), _stacked([dp or jax.tree.map(jnp.zeros_like, dict(own)) for dp in by_p])


def unstacked_tangents(moved: Any, count: int) -> tuple[Any, ...]:
    """Tangents one by one, of one whose numbers are arrays (tangents,)."""
    return tuple(jax.tree.map(lambda leaf, i=i: leaf[i], moved) for i in range(count))


def _stacked(trees: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def lanes_per_tile(each: int) -> int:
    """Lanes a tile whose stages have so many bytes each."""
    return int(np.clip(1 << (_CACHE // each).bit_length() >> 1, _FEWEST_LANES, _MOST_LANES))


def own_parameters(system: Flow, p: Parameters) -> dict[str, Any]:
    """The parameters that lanes may have of their own, from the flow where a lane has none."""
    if unknown := set(p) - set(system.roles.of_lanes):
        raise ValueError(f"lanes have {', '.join(sorted(unknown))} of their own, which the flow does not know of")
    return {name: p[name] if name in p else system.parameters[name] for name in system.roles.of_lanes}


def stages_in_loop(solver: WrittenOutRungeKutta | AdaptiveMethod, equations: Callable[[], int]) -> bool:
    """Return whether the stages of a step, each of so many equations, are a loop: written out they are too many."""
    return equations() * solver.stages > _LARGEST_STEP if solver.rolled is None else solver.rolled


def general_strobe(system: Flow, solver: Any, grid: np.ndarray) -> GeneralStrobe:
    """The map over a grid (steps + 1,), or stacked maps of one flow over grids (parts, steps + 1)."""
    count, parts = grid.shape[-1] - 1, grid.shape[:-1]
    values: tuple[Any, ...] = ()
    if isinstance(solver, WrittenOutRungeKutta):
        grid, times = stage_times(grid, solver.c[: solver.stages])
        values = tuple(np.asarray(value) for value in time_split(system).table(times, system))
    return GeneralStrobe(stack_leaves(system, parts), solver, grid, np.full(parts, count, np.int32), values)


def stage_times(grid: np.ndarray, c: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """A grid (..., steps + 1) with room for as many steps as most accuracies need, and times (..., steps, stages)."""
    grid = roomy_grid(grid)
    return grid, grid[..., :-1, None] + np.diff(grid)[..., None] * np.asarray(c)


def roomy_grid(grid: np.ndarray) -> np.ndarray:
    """A grid (..., steps + 1) with room for as many steps as most accuracies need, its last end repeated."""
    count, parts = grid.shape[-1] - 1, grid.shape[:-1]
    capacity = 1 << (max(_SMALLEST_GRID // math.prod(parts), count) - 1).bit_length()
    return np.concatenate([grid, np.repeat(grid[..., -1:], capacity - count, axis=-1)], axis=-1)


def stack_leaves(system: Any, parts: tuple[int, ...]) -> Any:
    """A flow as `lax.scan` takes it: every leaf with the parts as first axis, where there are some."""
    return jax.tree.map(lambda leaf: np.full(parts, leaf, float), system) if parts else system


def first_of_stack(stack: Any, axes: int) -> Any:
    """The first flow or map of a stack whose leaves have so many axes of parts before their own."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[(0,) * axes], stack) if axes else stack


def unit_step(system: Flow, solver: Any) -> GeneralStrobe:
    """One step as long as the unit of time, of a flow without a clock."""
    return GeneralStrobe(system, solver, np.array([0.0, 1.0]), None)
