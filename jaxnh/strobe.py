"""The stroboscopic map P(z; b): a system under a solver over one period, its iterates and its derivatives.

Every lane keeps the same clock, and the clock starts anew each period, so no phase is lost in a long run.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.solvers import IsokineticSplitting, WrittenOutRungeKutta, half_turn, kick
from jaxnh.systems import IsokineticParticle, State, Vector

_UNROLL = 8
_UNROLL_TANGENT = 1
_SMALLEST_TABLE = 512


class Tangent(NamedTuple):
    """A direction in phase and parameter space: δ(q, n) as a state, and δb, each component of shape ()."""

    state: State
    b: ArrayLike


class Strobe(eqx.Module):
    """P(z; b) for one lane: state (q, n) and b in, the state one period later out. Use under `jax.vmap`."""

    system: eqx.AbstractVar[IsokineticParticle]

    @abc.abstractmethod
    def __call__(self, state: State, b: ArrayLike) -> State:
        """The state one strobe period later."""

    @abc.abstractmethod
    def push(self, state: State, b: ArrayLike, tangents: tuple[Tangent, ...]) -> tuple[State, tuple[Tangent, ...]]:
        """The state and any number of tangents one strobe period later, exact derivatives of `__call__`."""


class KickStrobe(Strobe):
    """P by an isokinetic splitting: one loop over a table of kicks that all lanes share.

    The table is data: every splitting, any number of steps and any step grid run through the same compiled program
    (tables grow by powers of two). It does the arithmetic of `IsokineticSplitting.step` under `diffrax.diffeqsolve`.

    Attributes:
        system: the flow.
        table: (rows, 8, 3) drift before the kick, kick length over speed, and that times the forcing.
        rows: number of rows that are in use.
        rest: drift after the last kick.
    """

    system: IsokineticParticle
    table: ArrayLike
    rows: ArrayLike
    rest: ArrayLike

    def __call__(self, state: State, b: ArrayLike) -> State:
        state = self._run(lambda entry, z: self._kick(entry, z, b), state, unroll=_UNROLL)
        return _drift(state, self.rest)

    def push(self, state: State, b: ArrayLike, tangents: tuple[Tangent, ...]) -> tuple[State, tuple[Tangent, ...]]:
        # A kick turns θ alone, so four numbers carry every tangent through it: ∂θ'/∂(θ, x1, y1, b).
        def advance(entry: Array, carry: tuple[State, tuple[Vector, ...]]) -> tuple[State, tuple[Vector, ...]]:
            (q, n), moved = carry
            q = tuple(qi + ni * entry[0] for qi, ni in zip(q, n, strict=True))
            moved = tuple(_drift_tangent(n, v, entry[0]) for v in moved)
            n, slopes = self._turn(entry, q, n, b)
            moved = tuple(
                (dx, dy, slopes[0] * dtheta + slopes[1] * dx + slopes[2] * dy + slopes[3] * t.b)
                for (dx, dy, dtheta), t in zip(moved, tangents, strict=True)
            )
            return (q, n), moved

        moved = tuple((*t.state[0], _cross(state[1], t.state[1])) for t in tangents)
        (q, n), moved = self._run(advance, (state, moved), unroll=_UNROLL_TANGENT)
        moved = tuple(_drift_tangent(n, v, self.rest) for v in moved)
        pushed = tuple(
            Tangent(((dx, dy), (-n[1] * dtheta, n[0] * dtheta)), t.b)
            for (dx, dy, dtheta), t in zip(moved, tangents, strict=True)
        )
        return _drift((q, n), self.rest), pushed

    def _turn(self, entry: Array, q: Vector, n: Vector, b: ArrayLike) -> tuple[Vector, tuple[Array, ...]]:
        """n after the kick, and ∂θ'/∂(θ, x1, y1, b): with the bisector m = D n + N f, θ' = 2 arg m − θ."""

        def force(at: Vector) -> Vector:
            return self.system.force(at[:2], entry[2], entry[1], at[2])

        at = (*q, b)
        f = force(at)
        one = jnp.ones_like(q[0])
        (top, bottom), (top_rate, bottom_rate) = jax.jvp(half_turn, (f[0] * f[0] + f[1] * f[1],), (one,))
        m = tuple(bottom * ni + top * fi for ni, fi in zip(n, f, strict=True))
        scale = 2.0 / (m[0] * m[0] + m[1] * m[1])
        along = scale * (m[0] * n[0] + m[1] * n[1])
        stretch = 2.0 * (bottom_rate * _cross(m, n) + top_rate * _cross(m, f))

        def slope(index: int) -> Array:
            _, df = jax.jvp(lambda v: force((*at[:index], v, *at[index + 1 :])), (at[index],), (one,))
            return scale * ((f[0] * df[0] + f[1] * df[1]) * stretch + top * _cross(m, df))

        turned = tuple(along * mi - ni for ni, mi in zip(n, m, strict=True))
        return turned, (bottom * along - 1.0, slope(0), slope(1), slope(2))

    def _kick(self, entry: Array, state: State, b: ArrayLike) -> State:
        q, n = _drift(state, entry[0])
        return q, kick(n, self.system.force(q, entry[2], entry[1], b))

    def _run(self, advance: Callable[[Array, Any], Any], carry: Any, unroll: int) -> Any:
        table = jnp.reshape(self.table, (-1, unroll, 3))

        def body(i: Array, carry: Any) -> Any:
            row = table[i]
            for j in range(unroll):
                carry = advance(row[j], carry)
            return carry

        return lax.fori_loop(0, self.rows * (_UNROLL // unroll), body, carry)


class SolveStrobe(Strobe):
    """P by `diffrax.diffeqsolve` with constant steps, for the Runge–Kutta solvers.

    Attributes:
        system: the flow.
        solver: any diffrax solver that takes one term.
        steps: steps a period.
    """

    system: IsokineticParticle
    solver: diffrax.AbstractSolver = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def __call__(self, state: State, b: ArrayLike) -> State:
        period = self.system.period
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(self.system.vector_field),
            self.solver,
            t0=0.0,
            t1=period,
            dt0=None,
            y0=state,
            args=b,
            stepsize_controller=diffrax.StepTo(np.linspace(0.0, period, self.steps + 1)),
            adjoint=diffrax.ForwardMode(),
            max_steps=self.steps,
            throw=False,
        )
        return jax.tree.map(lambda leaf: leaf[-1], solution.ys)

    def push(self, state: State, b: ArrayLike, tangents: tuple[Tangent, ...]) -> tuple[State, tuple[Tangent, ...]]:
        pushed = [jax.jvp(self.__call__, (state, b), (t.state, t.b)) for t in tangents]
        return pushed[0][0], tuple(Tangent(dz, t.b) for (_, dz), t in zip(pushed, tangents, strict=True))


def _drift(state: State, length: ArrayLike) -> State:
    q, n = state
    return tuple(qi + ni * length for qi, ni in zip(q, n, strict=True)), n


def _drift_tangent(n: Vector, v: Vector, length: ArrayLike) -> Vector:
    """δ(x1, y1, θ) after a drift: δq += n^⊥ δθ · length."""
    dx, dy, dtheta = v
    turned = dtheta * length
    return dx - n[1] * turned, dy + n[0] * turned, dtheta


def _cross(u: Vector, v: Vector) -> Array:
    """u × v in the plane; of n and its change δn it is δθ."""
    return u[0] * v[1] - u[1] * v[0]


def make_strobe(system: IsokineticParticle, solver: IsokineticSplitting | WrittenOutRungeKutta, steps: int) -> Strobe:
    """The strobe map of a system under a solver with so many steps a period."""
    if isinstance(solver, IsokineticSplitting):
        return _tabulate(system, solver, steps)
    return SolveStrobe(system, solver, steps)


def _tabulate(system: IsokineticParticle, solver: IsokineticSplitting, steps: int) -> KickStrobe:
    """Kicks of all steps in a row; the last drift of each step joins the first of the next."""
    grid = np.linspace(0.0, system.period, steps + 1)
    rows = solver.schedule(system, grid[:-1], grid[1:])
    before = np.array(rows.drift[:, :-1])
    before[1:, 0] += rows.drift[:-1, -1]
    kicks = np.stack([before, rows.weight, rows.forcing], axis=-1).reshape(-1, 3)
    used = -(-len(kicks) // _UNROLL)
    capacity = max(_SMALLEST_TABLE, 1 << (used - 1).bit_length())
    table = np.zeros((capacity * _UNROLL, 3))
    table[: len(kicks)] = kicks
    return KickStrobe(system, table.reshape(capacity, _UNROLL, 3), np.int32(used), np.float64(rows.drift[-1, -1]))


def iterate(strobe: Strobe, n: ArrayLike, state: State, b: ArrayLike) -> State:
    """Pⁿ(z; b) for one lane; n may be traced."""
    return lax.fori_loop(0, n, lambda _, z: strobe(z, b), state)


def record(strobe: Strobe, state: State, b: ArrayLike, count: int) -> tuple[State, State]:
    """The state after `count` periods, and those after 1, 2, …, count stacked along a new first axis."""

    def step(z: State, _: Any) -> tuple[State, State]:
        z = strobe(z, b)
        return z, z

    return lax.scan(step, state, length=count)


def chart(state: State) -> Array:
    """(x1, y1, θ) of shape (3,), θ the direction of n in (−π, π]: coordinates of the section."""
    (x, y), (n1, n2) = state
    return jnp.stack([x, y, jnp.arctan2(n2, n1)])


def unchart(u: Array) -> State:
    """The state with section coordinates (x1, y1, θ)."""
    return (u[0], u[1]), (jnp.cos(u[2]), jnp.sin(u[2]))


def section_map(strobe: Strobe, n: ArrayLike, u: Array, b: ArrayLike) -> Array:
    """Pⁿ in section coordinates, (3,) to (3,)."""
    return chart(iterate(strobe, n, unchart(u), b))


def derivatives(strobe: Strobe, n: ArrayLike, u: Array, b: ArrayLike) -> tuple[Array, Array, Array]:
    """Pⁿ(u; b) of shape (3,), its monodromy matrix ∂Pⁿ/∂u (3, 3) and ∂Pⁿ/∂b (3,), in one forward pass.

    The same as `jax.jacfwd` of `section_map`, to rounding.
    """
    basis = jnp.eye(4)

    def lift(v: Array) -> tuple[State, Array]:
        return unchart(v[:3]), v[3]

    point = jnp.append(u, b)
    state, _ = lift(point)
    tangents = tuple(Tangent(*jax.jvp(lift, (point,), (e,))[1]) for e in basis)
    state, tangents = lax.fori_loop(0, n, lambda _, carry: strobe.push(carry[0], b, carry[1]), (state, tangents))
    columns = [jax.jvp(chart, (state,), (t.state,))[1] for t in tangents]
    return chart(state), jnp.stack(columns[:3], axis=-1), columns[3]


def wrap(difference: Any) -> Any:
    """A difference of section coordinates (..., 3) with its angle brought into [−π, π)."""
    xp = np if isinstance(difference, np.ndarray) else jnp
    angle = (difference[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return xp.stack([difference[..., 0], difference[..., 1], angle], axis=-1)
