"""Isokinetic splittings: drift the position along n, kick n by the exact turn under a frozen force.

With the clock advanced by the drift, the flow of `particle.IsokineticParticle` is A + B:
    A (drift):  q' = s(t) n, t' = 1     solved exactly, q += n ∫ s dt;
    B (kick):   n' = (F − (n·F) n)/s    at frozen q and t, solved exactly by a hyperbolic turn (Zhang 1997).
Any composition of both keeps |n| = 1 by construction. Compositions of high order are tables of coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.particle import IsokineticParticle
from jaxnh.systems.state import Number, Vector


class Schedule(NamedTuple):
    """Coefficients of a step that all lanes share, one row a kick.

    Attributes:
        drift: (..., stages + 1) path lengths ∫ s dt before each kick, and after the last.
        weight: (..., stages) h b_i / s, the kick's length over the speed.
        forcing: (..., stages) g h b_i / s.
    """

    drift: Number
    weight: Number
    forcing: Number


def half_turn(z: Number) -> tuple[Number, Number]:
    """N and D with N/D = τ(z) = tanh(√z/2)/√z to a relative 1e-10 z⁵: the Padé approximant [5/4] of tanh.

    With z of the order of h² its error is of order eleven in the step, below that of every splitting here.
    """
    return 15120.0 + z * (420.0 + z), 30240.0 + z * (3360.0 + z * 30.0)


def exact_half_turn(z: Number) -> tuple[Number, Number]:
    """N and D with N/D = tanh(√z/2)/√z to rounding, for any z ≥ 0 that is a number: nothing overflows or cancels."""
    root = jnp.sqrt(jnp.maximum(z, 1.0))
    small = 135135.0 + z * (17325.0 / 4 + z * (378.0 / 16 + z * (1.0 / 64)))
    over = 270270.0 + z * (31185.0 + z * (393.75 + z * 0.875))
    near = z < 1.0
    return jnp.where(near, small / over, jnp.tanh(0.5 * root) / root), jnp.ones_like(root)


def kick(n: Vector, f: Vector, tau: Callable[[Number], tuple[Number, Number]] = exact_half_turn) -> Vector:
    """Exact turn of n under a frozen force f = F h / s, in any dimension; components of shape (...,).

    n' = f − (f·n) n carries n to its mirror image 2 (n·m) m / (m·m) − n in the bisector m = n + τ f of the turn. This
    keeps |n| = 1 and is symmetric in time whatever m is, so that an error of τ costs accuracy alone, never the
    constraint; and the length of m does not matter, so that τ = N/D costs no division.
    """
    top, bottom = tau(sum(fi * fi for fi in f))
    m = tuple(ni * bottom + fi * top for ni, fi in zip(n, f, strict=True))
    along = sum(ni * mi for ni, mi in zip(n, m, strict=True))
    scale = 2.0 * along / sum(mi * mi for mi in m)
    return tuple(scale * mi - ni for ni, mi in zip(n, m, strict=True))


class IsokineticSplitting(eqx.Module):
    """A symmetric composition of drifts and kicks, for constant steps.

    Attributes:
        drifts: stages + 1 fractions of the step, summing to one.
        kicks: stages fractions of the step, summing to one.
        convergence_order: order of the composition.
        name: name in configs and result files.
        source: where the coefficients come from.
        processor: drifts (one more) and kicks, fractions of the step that sum to zero, of a processed method (Blanes,
            Casas and Murua, SIAM J. Sci. Comput. 27 (2006) 1817); without one, of no stages. Its order is that of
            processor, steps, inverse of the processor: `sequence`. Its steps alone have order two; `maps.build` puts
            the processor before the first step of a map and its inverse after the last.
    """

    drifts: tuple[float, ...] = eqx.field(static=True)
    kicks: tuple[float, ...] = eqx.field(static=True)
    convergence_order: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    source: str = eqx.field(static=True)
    processor: tuple[tuple[float, ...], tuple[float, ...]] = eqx.field(static=True, default=((0.0,), ()))

    @property
    def stages(self) -> int:
        """Kicks, that is forces, a step."""
        return len(self.kicks)

    @property
    def processed(self) -> bool:
        """Return whether a processor stands at the ends of a map."""
        return bool(self.processor[1])

    def most_steps(self, kicks: int) -> int:
        """Steps of a map with so many kicks at most, those of the processor at both ends included."""
        return (kicks - 2 * len(self.processor[1])) // self.stages

    def total_kicks(self, steps: int) -> int:
        """Kicks of a map of so many steps, those of the processor at both ends included."""
        return steps * self.stages + 2 * len(self.processor[1])

    def sequence(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions of the kicks of a map of so many steps, and their lengths, both in steps and of shape (kicks,).

        The processor comes first, its inverse last.
        """
        drifts, kicks = (np.asarray(row) for row in self.processor)
        before = np.cumsum(drifts)[:-1]
        at = np.arange(steps)[:, None] + np.cumsum(self.drifts)[:-1]
        places = [before, at.ravel(), steps + before[::-1]]
        return np.concatenate(places), np.concatenate([kicks, np.tile(self.kicks, steps), -kicks[::-1]])

    def nodes(self, t0: Number, t1: Number) -> Number:
        """Ends of the drifts of a step from t0 to t1; (...,) in, (..., stages + 2) out. Kicks are at the inner ones."""
        fractions = np.concatenate([[0.0], np.cumsum(self.drifts)[:-1], [1.0]])
        return t0[..., None] + (t1 - t0)[..., None] * fractions

    def schedule(self, system: IsokineticParticle, t0: Number, t1: Number) -> Schedule:
        """The shared table of the steps from t0 to t1; arrays (...,) in, (..., stages) out, NumPy or JAX alike."""
        nodes = self.nodes(t0, t1)
        weight = (t1 - t0)[..., None] * np.asarray(self.kicks) / system.speed(nodes[..., 1:-1])
        forcing = system.forcing(nodes[..., 1:-1]) * weight
        return Schedule(system.path_length(nodes[..., :-1], nodes[..., 1:]), weight, forcing)
