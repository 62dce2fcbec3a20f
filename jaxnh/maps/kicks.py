"""The strobe map of the particle by an isokinetic splitting: one loop over a table of kicks that all lanes share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.batching import as_batched
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.solvers import half_turn, kick
from jaxnh.systems.flow import Parameters
from jaxnh.systems.particle import IsokineticParticle, State
from jaxnh.systems.state import Vector


class _Carry(NamedTuple):
    """State of the loop over kicks, and with compensated sums what rounding has cut off it so far (else None)."""

    q: Vector
    n: Vector
    lost: tuple[Vector, Vector] | None


class KickStrobe(ReturnMap):
    """P by an isokinetic splitting: one loop over a table of kicks that all lanes share.

    The table is data: every splitting, any number of steps and any step grid run through the same compiled program
    (tables grow by powers of two). It does the arithmetic of diffrax's own loop over such steps.

    Attributes:
        system: the flow as kicks see it (`IsokineticParticle.tabulated`): speed and clock are in the table.
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

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Trip count of the loop over kicks."""
        return (float(np.mean(self.kicks)),)

    def __call__(self, state: State, p: Parameters) -> State:
        def advance(i: Array, carry: _Carry) -> _Carry:
            return _one_loop(lambda carry: self._kick(table[i], carry, p), carry)

        table = jnp.asarray(self.table)
        return self._end(lax.fori_loop(0, self.kicks, advance, self._begin(state)))

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        # A kick turns θ alone, so few numbers carry every tangent through it: ∂θ'/∂(θ, x1, y1, p). Differentiating
        # where the kick is keeps every component an array of lanes; jacfwd of the whole period would not. Tangents are
        # carried from before one kick to before the next, so that they need the n after a kick alone.
        del volume  # a product more a kick
        names = tuple(dict.fromkeys(name for t in tangents for name in t.p or ()))

        def kick(entry: Array, before: _Carry) -> tuple[_Carry, Vector]:
            after = self._kick(entry, before, p)
            return after, self._slopes(entry, after.q, before.n, p, names)

        def move(
            length: Array, n: Vector, slopes: Vector, moved: tuple[Vector, ...], shrunk: Array
        ) -> tuple[tuple[Vector, ...], Array]:
            kicked = [_kick_tangent(slopes, v, t.p, names) for v, t in zip(moved, tangents, strict=True)]
            return tuple(_drift_tangent(n, v, length) for v in kicked), shrunk * slopes[0]

        def advance(i: Array, carry: tuple[_Carry, tuple[Vector, ...], Array]) -> Any:
            after, slopes = _one_loop(partial(kick, table[i]), carry[0])
            drift_after = jnp.where(i + 1 < self.kicks, table[jnp.minimum(i + 1, len(table) - 1), 0], self.rest)
            return after, *_one_loop(partial(move, drift_after), after.n, slopes, *carry[1:])

        table = jnp.asarray(self.table)
        moved = [(*t.state[0], _cross(state[1], t.state[1])) for t in tangents]
        moved = tuple(_drift_tangent(state[1], v, table[0, 0]) for v in moved)
        start = self._begin(state), moved, as_batched(jnp.ones_like(state[0][0]), state[0][0])
        carry, moved, shrunk = lax.fori_loop(0, self.kicks, advance, start)
        q, n = self._end(carry)
        pushed = tuple(
            Tangent(((dx, dy), (-n[1] * dtheta, n[0] * dtheta)), t.p)
            for (dx, dy, dtheta), t in zip(moved, tangents, strict=True)
        )
        return Pushforward((q, n), pushed, jnp.log(shrunk))

    def _kick(self, entry: Array, carry: _Carry, p: Parameters) -> _Carry:
        if self.compensated:
            return self._kick_compensated(entry, carry, p)
        q = _drift(carry.q, carry.n, entry[0])
        return _Carry(q, kick(carry.n, self.system.force(q, self._forcing(entry), entry[1], p), half_turn), None)

    def _kick_compensated(self, entry: Array, carry: _Carry, p: Parameters) -> _Carry:
        # In the plane n' − n = 2 N (n × f) J m / (m·m) with J the quarter turn: small, and free of cancellation.
        assert carry.lost is not None
        q, q_lost = _add_compensated(carry.q, carry.lost[0], tuple(ni * entry[0] for ni in carry.n))
        n, f = carry.n, self.system.force(q, self._forcing(entry), entry[1], p)
        top, bottom = half_turn(f[0] * f[0] + f[1] * f[1])
        m = tuple(ni * bottom + fi * top for ni, fi in zip(n, f, strict=True))
        turn = 2.0 * top * _cross(n, f) / (m[0] * m[0] + m[1] * m[1])
        n, n_lost = _add_compensated(n, carry.lost[1], (-turn * m[1], turn * m[0]))
        return _Carry(q, n, (q_lost, n_lost))

    def _slopes(self, entry: Array, q: Vector, n: Vector, p: Parameters, names: Sequence[str]) -> Vector:
        """∂θ'/∂(θ, x1, y1) of a kick at q, and in the parameters named.

        With the bisector m = D n + N f, θ' = 2 arg m − θ. So ∂θ'/∂θ = 2 D (m·n)/(m·m) − 1, and of the force
        ∂θ'/∂f = (2 N J m + 4 (N' D − N D') (n × f) f)/(m·m), J the quarter turn and ' the derivative in z = f·f.
        """
        f = self.system.force(q, self._forcing(entry), entry[1], p)
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
        rows = self.system.force_pullback(q, self._forcing(entry), entry[1], p, by_force, names)
        return (half + half - length) * scale, *rows

    def _forcing(self, entry: Array) -> Array:
        return entry[2] if self.system.forced else entry[1]

    def _begin(self, state: State) -> _Carry:
        return _Carry(
            *state, as_batched(jax.tree.map(jnp.zeros_like, state), state[0][0]) if self.compensated else None
        )

    def _end(self, carry: _Carry) -> State:
        q = _drift(carry.q, carry.n, self.rest)
        q, n = (q, carry.n) if carry.lost is None else jax.tree.map(jnp.add, (q, carry.n), carry.lost)
        # A kick mirrors n and so keeps whatever rounding has made of |n|: one step of Newton for 1/|n| a period.
        scale = 1.5 - 0.5 * sum(ni * ni for ni in n)
        return q, tuple(scale * ni for ni in n)

    def rescaled_time(self, factor: ArrayLike) -> KickStrobe:
        """The map over so many times the time, of a system without a clock."""
        return KickStrobe(self.system, self.table * factor, self.kicks, self.rest * factor, self.compensated)

    def compact(self) -> KickStrobe:
        table, most = np.asarray(self.table), int(np.max(self.kicks))
        return replace(self, table=table[..., : 1 << (most - 1).bit_length(), :])

    def padded_like(self, other: ReturnMap) -> KickStrobe:
        assert isinstance(other, KickStrobe)
        table = np.asarray(self.table)
        return replace(self, table=np.pad(table, [(0, len(np.asarray(other.table)) - len(table)), (0, 0)]))


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


def _drift(q: Vector, n: Vector, length: ArrayLike) -> Vector:
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


def _kick_tangent(slopes: Vector, v: Vector, dp: Parameters | None, names: Sequence[str]) -> Vector:
    """δ(x1, y1, θ) after a kick with these ∂θ'/∂(θ, x1, y1) and ∂θ'/∂p of the parameters named."""
    dx, dy, dtheta = v
    turned = slopes[0] * dtheta + slopes[1] * dx + slopes[2] * dy
    for name, slope in zip(names, slopes[3:], strict=True):
        if dp is not None and name in dp:
            turned = turned + slope * dp[name]
    return dx, dy, turned


def _cross(u: Vector, v: Vector) -> Array:
    """u × v in the plane; of n and its change δn it is δθ."""
    return u[0] * v[1] - u[1] * v[0]
