"""The stroboscopic map P(z; b): a system under a solver over one period, its iterates and its derivatives.

Every lane keeps the same clock, and the clock starts anew each period, so no phase is lost in a long run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.event import EventStrobe, SteppedStrobe
from jaxnh.grids import GRID_POINTS, share_of_steps, step_grid
from jaxnh.maps import Pushed, Strobe, System, Tangent
from jaxnh.marched import MarchedStrobe, marched
from jaxnh.mechanics import NonholonomicSystem
from jaxnh.sectioned import Flow, SectionedFlow
from jaxnh.solvers import IsokineticSplitting, Solver, WrittenOutRungeKutta, half_turn, kick
from jaxnh.systems import IsokineticParticle, State, Vector
from jaxnh.tables import cut_table, kick_table, processed_table

_SMALLEST_TABLE = 1024
_SMALLEST_STEP = 64  # kicks of a step: as many as any splitting has, so that all run through one program
_LONGEST_RETURN = 1000.0  # time without a crossing after which a lane has failed


class _Carry(NamedTuple):
    """State of the loop over kicks, and with compensated sums what rounding has cut off it so far (else None)."""

    q: Vector
    n: Vector
    lost: tuple[Vector, Vector] | None


class KickStrobe(Strobe):
    """P by an isokinetic splitting: one loop over a table of kicks that all lanes share.

    The table is data: every splitting, any number of steps and any step grid run through the same compiled program
    (tables grow by powers of two). It does the arithmetic of `IsokineticSplitting.step` under `diffrax.diffeqsolve`.

    Attributes:
        system: the flow.
        table: (capacity, 3), a row a kick: drift before it, its length over the speed, and that times the forcing; two
            numbers a row without forcing.
        kicks: number of rows that are in use.
        rest: drift after the last kick.
        compensated: whether q and n are summed with compensation (Kahan, Comm. ACM 8 (1965) 40), which lowers the
            rounding floor of one period thirtyfold at nearly twice the time.
    """

    system: IsokineticParticle
    table: ArrayLike
    kicks: ArrayLike
    rest: ArrayLike
    compensated: bool = eqx.field(static=True, default=False)

    def __call__(self, state: State, b: ArrayLike) -> State:
        def advance(entry: Array, carry: _Carry) -> _Carry:
            return _one_loop(lambda carry: self._kick(entry, carry, b), carry)

        return self._end(self._run(advance, jnp.asarray(self.table), self._begin(state)))

    def push(self, state: State, b: ArrayLike, tangents: tuple[Tangent, ...]) -> Pushed:
        # A kick turns θ alone, so few numbers carry every tangent through it: ∂θ'/∂(θ, x1, y1, b). Differentiating
        # where the kick is keeps every component an array of lanes; jacfwd of the whole period would not. Tangents are
        # carried from before one kick to before the next, so that they need the n after a kick alone.
        in_b = any(t.b is not None for t in tangents)

        def kick(entry: Array, before: _Carry) -> tuple[_Carry, Vector]:
            after = self._kick(entry, before, b)
            return after, self._slopes(entry, after.q, before.n, b, in_b)

        def move(
            length: Array, n: Vector, slopes: Vector, moved: tuple[Vector, ...], volume: Array
        ) -> tuple[tuple[Vector, ...], Array]:
            kicked = [_kick_tangent(slopes, v, t.b) for v, t in zip(moved, tangents, strict=True)]
            return tuple(_drift_tangent(n, v, length) for v in kicked), volume * slopes[0]

        def advance(entry: Array, carry: tuple[_Carry, tuple[Vector, ...], Array]) -> Any:
            after, slopes = _one_loop(partial(kick, entry), carry[0])
            return after, *_one_loop(partial(move, entry[table.shape[1]]), after.n, slopes, *carry[1:])

        table = jnp.asarray(self.table)
        drift_after = jnp.roll(table[:, 0], -1).at[self.kicks - 1].set(self.rest)
        moved = [(*t.state[0], _cross(state[1], t.state[1])) for t in tangents]
        moved = tuple(_drift_tangent(state[1], v, table[0, 0]) for v in moved)
        carry, moved, volume = self._run(
            advance, jnp.column_stack([table, drift_after]), (self._begin(state), moved, jnp.ones_like(state[0][0]))
        )
        q, n = self._end(carry)
        pushed = tuple(
            Tangent(((dx, dy), (-n[1] * dtheta, n[0] * dtheta)), t.b)
            for (dx, dy, dtheta), t in zip(moved, tangents, strict=True)
        )
        return Pushed((q, n), pushed, volume)

    def _kick(self, entry: Array, carry: _Carry, b: ArrayLike) -> _Carry:
        if self.compensated:
            return self._kick_compensated(entry, carry, b)
        q = _along(carry.q, carry.n, entry[0])
        return _Carry(q, kick(carry.n, self.system.force(q, self._forcing(entry), entry[1], b), half_turn), None)

    def _kick_compensated(self, entry: Array, carry: _Carry, b: ArrayLike) -> _Carry:
        # In the plane n' − n = 2 N (n × f) J m / (m·m) with J the quarter turn: small, and free of cancellation.
        assert carry.lost is not None
        q, q_lost = _add_compensated(carry.q, carry.lost[0], tuple(ni * entry[0] for ni in carry.n))
        n, f = carry.n, self.system.force(q, self._forcing(entry), entry[1], b)
        top, bottom = half_turn(f[0] * f[0] + f[1] * f[1])
        m = tuple(ni * bottom + fi * top for ni, fi in zip(n, f, strict=True))
        turn = 2.0 * top * _cross(n, f) / (m[0] * m[0] + m[1] * m[1])
        n, n_lost = _add_compensated(n, carry.lost[1], (-turn * m[1], turn * m[0]))
        return _Carry(q, n, (q_lost, n_lost))

    def _slopes(self, entry: Array, q: Vector, n: Vector, b: ArrayLike, in_b: bool) -> Vector:
        """∂θ'/∂(θ, x1, y1) of a kick at q, and if asked for ∂b.

        With the bisector m = D n + N f, θ' = 2 arg m − θ. So ∂θ'/∂θ = 2 D (m·n)/(m·m) − 1, and of the force
        ∂θ'/∂f = (2 N J m + 4 (N' D − N D') (n × f) f)/(m·m), J the quarter turn and ' the derivative in z = f·f.
        """
        f = self.system.force(q, self._forcing(entry), entry[1], b)
        z = f[0] * f[0] + f[1] * f[1]
        (top, bottom), (top_rate, bottom_rate) = jax.jvp(half_turn, (z,), (jnp.ones_like(z),))
        m = tuple(ni * bottom + fi * top for ni, fi in zip(n, f, strict=True))
        length = m[0] * m[0] + m[1] * m[1]
        half = bottom * (m[0] * n[0] + m[1] * n[1])
        scale = 1.0 / length
        twice = scale + scale
        across = twice * top
        along = (twice + twice) * _cross(n, f) * (top_rate * bottom - top * bottom_rate)
        by_force = along * f[0] - across * m[1], along * f[1] + across * m[0]
        rows = self.system.force_pullback(q, self._forcing(entry), entry[1], b, by_force)
        return (half + half - length) * scale, *(rows if in_b else rows[:2])

    def _forcing(self, entry: Array) -> Array:
        return entry[2] if self.system.forced else entry[1]

    def _begin(self, state: State) -> _Carry:
        return _Carry(*state, jax.tree.map(jnp.zeros_like, state) if self.compensated else None)

    def _end(self, carry: _Carry) -> State:
        q = _along(carry.q, carry.n, self.rest)
        q, n = (q, carry.n) if carry.lost is None else jax.tree.map(jnp.add, (q, carry.n), carry.lost)
        # A kick mirrors n and so keeps whatever rounding has made of |n|: one step of Newton for 1/|n| a period.
        scale = 1.5 - 0.5 * sum(ni * ni for ni in n)
        return q, tuple(scale * ni for ni in n)

    def stretched(self, factor: ArrayLike) -> KickStrobe:
        """The map over so many times the time, of a system without a clock."""
        return KickStrobe(self.system, self.table * factor, self.kicks, self.rest * factor, self.compensated)

    def _run(self, advance: Callable[[Array, Any], Any], table: Array, carry: Any) -> Any:
        return lax.fori_loop(0, self.kicks, lambda i, carry: advance(table[i], carry), carry)


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


def _one_loop(function: Callable[..., Any], *carried: Any) -> Any:
    """function(*carried), each component of the result from copies of its own of what a loop carries.

    XLA then puts all components into one loop over the lanes, where it would store what they share between several.
    The copies are identities that its common-subexpression pass cannot merge; LLVM does.
    """
    structure = jax.tree.structure(jax.eval_shape(function, *carried))
    components = []
    for i in range(structure.num_leaves):
        copies = jax.tree.map(lambda v, i=i: lax.reduce_precision(v, 11, 53 + i), carried)
        components.append(jax.tree.leaves(function(*copies))[i])
    return jax.tree.unflatten(structure, components)


def _along(q: Vector, n: Vector, length: ArrayLike) -> Vector:
    """q after a drift of so much path along n."""
    return tuple(qi + ni * length for qi, ni in zip(q, n, strict=True))


def _add_compensated(total: Vector, lost: Vector, change: Vector) -> tuple[Vector, Vector]:
    """total + change, and what rounding cut off it, to be added next time (Kahan 1965)."""
    wanted = tuple(c + e for c, e in zip(change, lost, strict=True))
    moved = tuple(t + w for t, w in zip(total, wanted, strict=True))
    return moved, tuple(w - (m - t) for w, m, t in zip(wanted, moved, total, strict=True))


def _drift_tangent(n: Vector, v: Vector, length: ArrayLike) -> Vector:
    """δ(x1, y1, θ) after a drift: δq += n^⊥ δθ · length."""
    dx, dy, dtheta = v
    turned = dtheta * length
    return dx - n[1] * turned, dy + n[0] * turned, dtheta


def _kick_tangent(slopes: tuple[Array, ...], v: Vector, db: ArrayLike | None) -> Vector:
    """δ(x1, y1, θ) after a kick with these ∂θ'/∂(θ, x1, y1, b)."""
    dx, dy, dtheta = v
    turned = slopes[0] * dtheta + slopes[1] * dx + slopes[2] * dy
    return dx, dy, turned if db is None else turned + slopes[3] * db


def _cross(u: Vector, v: Vector) -> Array:
    """u × v in the plane; of n and its change δn it is δθ."""
    return u[0] * v[1] - u[1] * v[0]


def make_strobe(
    system: System,
    solver: Solver,
    steps: int,
    *,
    compensated: bool = False,
    span: tuple[float, float] | None = None,
) -> Strobe:
    """The strobe map of a system under a solver with so many steps a period; of a flow on a section, its return map.

    Args:
        compensated: lower the rounding floor of a splitting; Runge–Kutta methods and maps without a clock ignore it.
        span: times (t0, t1) of another stretch than the period from 0, for a map over part of a period or a strobe at
            another phase; it gets its share of the steps, at least one.
    """
    if isinstance(system, SectionedFlow):
        most = math.ceil(_LONGEST_RETURN * steps / system.period)
        return EventStrobe(system, _unit_step(system.flow, solver), system.period / steps, np.int32(most))
    t0, t1 = span or (0.0, system.period)
    if system.autonomous:
        steps = max(1, math.ceil(steps * (t1 - t0) / system.period - 1e-6))
        return _equal_steps(system, solver, steps, t1 - t0)
    steps = max(1, math.ceil(steps * share_of_steps(system, (t0, t1)) - 1e-6))
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle) and solver.processor[1]:
        table = processed_table(system, solver, steps, (t0, t1), smallest=_SMALLEST_TABLE)
        return KickStrobe(system, *table, compensated)
    grid = step_grid(system, steps, (t0, t1))
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle):
        return KickStrobe(system, *kick_table(system, solver, grid, smallest=_SMALLEST_TABLE), compensated)
    return _solved(system, solver, grid)


def _solved(system: Flow, solver: Solver, grid: np.ndarray) -> Strobe:
    """The map, or stacked maps, of a Runge–Kutta method over a grid (..., steps + 1)."""
    if isinstance(system, NonholonomicSystem):
        return marched(system, solver, grid)
    return SolveStrobe(system, solver, grid)


def _unit_step(flow: Flow, solver: Solver) -> Strobe:
    """One step as long as the unit of time, of a system without a clock."""
    grid = np.array([0.0, 1.0])
    if isinstance(solver, IsokineticSplitting) and isinstance(flow, IsokineticParticle):
        return KickStrobe(flow, *kick_table(flow, solver, grid, smallest=_SMALLEST_STEP))
    if isinstance(flow, NonholonomicSystem) and isinstance(solver, WrittenOutRungeKutta):
        return MarchedStrobe(flow, solver, grid, np.int32(1))
    raise TypeError(f"{solver.name} has no steps of its own for a system without a clock")


def _equal_steps(flow: Flow, solver: Solver, steps: int, length: float, parts: int = 0) -> SteppedStrobe:
    """So many equal steps over a length of time, or the same in every one of so many parts."""
    strobe = SteppedStrobe(flow, _unit_step(flow, solver).stretched(length / steps), np.int32(steps))
    if not parts:
        return strobe
    return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], parts, axis=0), strobe)


def make_parts(system: Flow, solver: Solver, steps: int, parts: int, *, compensated: bool = False) -> Strobe:
    """The maps over so many equal parts of a period, one after the other, as one pytree for `lax.scan`.

    Every leaf has the parts as first axis. No step is longer than those of the whole period's map with `steps` steps.
    """
    if system.autonomous:
        return _equal_steps(system, solver, max(1, math.ceil(steps / parts - 1e-6)), system.period / parts, parts)
    fine = step_grid(system, GRID_POINTS, (0.0, system.period))
    share = np.linspace(0.0, 1.0, GRID_POINTS + 1)
    ends = np.linspace(0.0, system.period, parts + 1)
    shares = np.interp(ends, fine, share)
    each = max(1, math.ceil(steps * np.diff(shares).max() - 1e-6))
    grid = np.interp(np.linspace(shares[:-1], shares[1:], each + 1, axis=-1), share, fine)
    grid[:, 0], grid[:, -1] = ends[:-1], ends[1:]
    many = jax.tree.map(lambda leaf: np.full(parts, leaf, float), system)
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle) and solver.processor[1]:
        return KickStrobe(many, *processed_table(system, solver, each, (ends[:-1], ends[1:])), compensated)
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle):
        return KickStrobe(many, *kick_table(system, solver, grid), compensated)
    return _solved(many, solver, grid)


def cut_strobe(system: Flow, solver: Solver, steps: int, parts: int, *, compensated: bool = False) -> Strobe:
    """The strobe map cut into so many maps of equally many steps, stacked as by `make_parts`.

    The parts differ in length, and together have the least multiple of `parts` from `steps` on as steps. A processed
    solver's processor stands at the ends of the first and of the last alone.
    """
    each = -(-steps // parts)
    if system.autonomous:
        return _equal_steps(system, solver, each, system.period / parts, parts)
    many = jax.tree.map(lambda leaf: np.full(parts, leaf, float), system)
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle) and solver.processor[1]:
        table = processed_table(system, solver, each * parts, (0.0, system.period))
        return KickStrobe(many, *cut_table(table, parts, each * solver.stages), compensated)
    ends = step_grid(system, each * parts, (0.0, system.period))
    grid = ends[np.arange(parts)[:, None] * each + np.arange(each + 1)]
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle):
        return KickStrobe(many, *kick_table(system, solver, grid), compensated)
    return _solved(many, solver, grid)


def iterate(strobe: Strobe, n: ArrayLike, state: State, b: ArrayLike) -> State:
    """Pⁿ(z; b) for one lane; n may be traced."""
    return lax.fori_loop(0, n, lambda _, z: strobe(z, b), state)


def record(strobe: Strobe, state: State, b: ArrayLike, count: int) -> tuple[State, State]:
    """The state after `count` periods, and those after 1, 2, …, count stacked along a new first axis."""

    def step(z: State, _: Any) -> tuple[State, State]:
        z = strobe(z, b)
        return z, z

    return lax.scan(step, state, length=count)


def section_map(strobe: Strobe, n: ArrayLike, u: Array, b: ArrayLike) -> Array:
    """Pⁿ in section coordinates, (d,) to (d,)."""
    return strobe.system.chart(iterate(strobe, n, strobe.system.unchart(u), b))


def derivatives(strobe: Strobe, n: ArrayLike, u: Array, b: ArrayLike) -> tuple[Array, Array, Array]:
    """Pⁿ(u; b) of shape (d,), its monodromy matrix ∂Pⁿ/∂u (d, d) and ∂Pⁿ/∂b (d,), in one forward pass.

    The same as `jax.jacfwd` of `section_map`, to rounding.
    """
    system, d = strobe.system, strobe.system.dimension
    basis = jnp.eye(d + 1)

    def lift(v: Array) -> tuple[State, Array]:
        return system.unchart(v[:d]), v[d]

    point = jnp.append(u, b)
    state, _ = lift(point)
    tangents = tuple(Tangent(*jax.jvp(lift, (point,), (e,))[1]) for e in basis)
    state, tangents = lax.fori_loop(0, n, lambda _, carry: strobe.push(carry[0], b, carry[1])[:2], (state, tangents))
    columns = [jax.jvp(system.chart, (state,), (t.state,))[1] for t in tangents]
    return system.chart(state), jnp.stack(columns[:d], axis=-1), columns[d]
