"""Isokinetic splittings: drift the position along n, kick n by the exact turn under a frozen force.

With the clock advanced by the drift, the flow of `systems.IsokineticParticle` is A + B:
    A (drift):  q' = s(t) n, t' = 1     solved exactly, q += n ∫ s dt;
    B (kick):   n' = (F − (n·F) n)/s    at frozen q and t, solved exactly by a hyperbolic turn (Zhang 1997).
Any composition of both keeps |n| = 1 by construction. Compositions of high order are tables of coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.systems import IsokineticParticle, State, Vector


class DriftTerm(diffrax.AbstractTerm):
    """q' = s(t) n as a diffrax term: the vector field is n, the control ∫ s dt."""

    system: IsokineticParticle

    def vf(self, t: Any, y: Vector, args: Any) -> Vector:
        return y

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Array:
        return self.system.path_length(jnp.asarray(t0), jnp.asarray(t1))

    def prod(self, vf: Vector, control: Any) -> Vector:
        return tuple(control * v for v in vf)


class KickTerm(diffrax.AbstractTerm):
    """F/s at a frozen time as a diffrax term; the solver turns n by it. `args` is the lane's b."""

    system: IsokineticParticle

    def vf(self, t: Any, y: Vector, args: ArrayLike) -> Vector:
        weight = 1.0 / self.system.speed(t)
        return self.system.force(y, self.system.forcing(t) * weight, weight, args)

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        return t1 - t0

    def prod(self, vf: Vector, control: Any) -> Vector:
        return tuple(control * v for v in vf)


def isokinetic_terms(system: IsokineticParticle) -> tuple[DriftTerm, KickTerm]:
    """The two terms that an `IsokineticSplitting` integrates."""
    return DriftTerm(system), KickTerm(system)


class Schedule(NamedTuple):
    """What a step asks of every lane alike, a row a kick.

    Attributes:
        drift: (..., stages + 1) path lengths ∫ s dt before each kick, and after the last.
        weight: (..., stages) h b_i / s, the kick's length over the speed.
        forcing: (..., stages) g h b_i / s.
    """

    drift: Any
    weight: Any
    forcing: Any


def half_turn(z: Any) -> tuple[Any, Any]:
    """N and D with N/D = τ(z) = tanh(√z/2)/√z to a relative 1e-10 z⁵: the Padé approximant [5/4] of tanh.

    With z of the order of h² its error is of order eleven in the step, below that of every splitting here.
    """
    return 15120.0 + z * (420.0 + z), 30240.0 + z * (3360.0 + z * 30.0)


def exact_half_turn(z: Any) -> tuple[Any, Any]:
    """N and D with N/D = tanh(√z/2)/√z to rounding, for any z ≥ 0 that is a number: nothing overflows or cancels."""
    root = jnp.sqrt(jnp.maximum(z, 1.0))
    small = 135135.0 + z * (17325.0 / 4 + z * (378.0 / 16 + z * (1.0 / 64)))
    over = 270270.0 + z * (31185.0 + z * (393.75 + z * 0.875))
    near = z < 1.0
    return jnp.where(near, small / over, jnp.tanh(0.5 * root) / root), jnp.ones_like(root)


def kick(n: Vector, f: Vector, tau: Callable[[Any], tuple[Any, Any]] = exact_half_turn) -> Vector:
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


class IsokineticSplitting(diffrax.AbstractSolver):
    """A symmetric composition of drifts and kicks as a diffrax solver, for constant steps.

    Attributes:
        drifts: stages + 1 fractions of the step, summing to one.
        kicks: stages fractions of the step, summing to one.
        convergence_order: order of the composition.
        name: name in configs and result files.
        source: where the coefficients come from.
    """

    drifts: tuple[float, ...] = eqx.field(static=True)
    kicks: tuple[float, ...] = eqx.field(static=True)
    convergence_order: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    source: str = eqx.field(static=True)

    term_structure: ClassVar = (diffrax.AbstractTerm, diffrax.AbstractTerm)
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    @property
    def stages(self) -> int:
        """Kicks, that is forces, a step."""
        return len(self.kicks)

    def order(self, terms: Any) -> int:
        return self.convergence_order

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> None:
        return None

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> State:
        drift, kick = terms
        return drift.vf(t0, y0[1], args), kick.vf(t0, y0[0], args)

    def nodes(self, t0: Any, t1: Any) -> Any:
        """Ends of the drifts of a step from t0 to t1; (...,) in, (..., stages + 2) out. Kicks are at the inner ones."""
        fractions = np.concatenate([[0.0], np.cumsum(self.drifts)[:-1], [1.0]])
        return t0[..., None] + (t1 - t0)[..., None] * fractions

    def schedule(self, system: IsokineticParticle, t0: Any, t1: Any) -> Schedule:
        """The shared table of the steps from t0 to t1; arrays (...,) in, (..., stages) out, NumPy or JAX alike."""
        nodes = self.nodes(t0, t1)
        weight = (t1 - t0)[..., None] * np.asarray(self.kicks) / system.speed(nodes[..., 1:-1])
        forcing = system.forcing(nodes[..., 1:-1]) * weight
        return Schedule(system.path_length(nodes[..., :-1], nodes[..., 1:]), weight, forcing)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: State, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[State, None, dict[str, State], None, diffrax.RESULTS]:
        """One step of every lane."""
        del solver_state, made_jump
        drift_term, kick_term = terms
        nodes = self.nodes(jnp.asarray(t0), jnp.asarray(t1))
        q, n = y0
        for i, fraction in enumerate((*self.kicks, None)):
            path = drift_term.vf_prod(nodes[i], n, args, drift_term.contr(nodes[i], nodes[i + 1]))
            q = tuple(qi + pi for qi, pi in zip(q, path, strict=True))
            if fraction is not None:
                control = kick_term.contr(nodes[i + 1], nodes[i + 1] + fraction * (t1 - t0))
                n = kick(n, kick_term.vf_prod(nodes[i + 1], q, args, control))
        y1 = (q, n)
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful


def _palindrome(half: tuple[float, ...]) -> tuple[float, ...]:
    """half, then what is missing to one, then half backwards: an odd number of coefficients."""
    return (*half, 1.0 - 2.0 * sum(half), *half[::-1])


def _mirror(half: tuple[float, ...]) -> tuple[float, ...]:
    """half, what is missing to one half, and the same backwards: an even number of coefficients."""
    whole = (*half, 0.5 - sum(half))
    return (*whole, *whole[::-1])


def _of_steps(name: str, order: int, source: str, half: tuple[float, ...]) -> IsokineticSplitting:
    """A symmetric composition of Strang steps: drift γ/2, kick γ, drift γ/2, for each γ; neighbouring drifts join."""
    gammas = np.array(_palindrome(half))
    drifts = 0.5 * (np.append(gammas, 0.0) + np.append(0.0, gammas))
    return IsokineticSplitting(tuple(drifts.tolist()), tuple(gammas.tolist()), order, name, source)


_STRANG_2 = _of_steps("strang2", 2, "Strang, SIAM J. Numer. Anal. 5 (1968) 506", ())

_BLANES_MOAN_4 = IsokineticSplitting(
    drifts=_palindrome((0.0792036964311957, 0.353172906049774, -0.0420650803577195)),
    kicks=_mirror((0.209515106613362, -0.143851773179818)),
    convergence_order=4,
    name="blanes_moan4",
    source="Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313, S6 of order four",
)

_BLANES_MOAN_6 = IsokineticSplitting(
    drifts=_palindrome(
        (0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569, 0.541960678450780)
    ),
    kicks=_mirror((0.148816447901042, -0.132385865767784, 0.067307604692185, 0.432666402578175)),
    convergence_order=6,
    name="blanes_moan6",
    source="Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313, S10 of order six",
)

_KAHAN_LI_8 = _of_steps(
    "kahan_li8",
    8,
    "Kahan and Li, Math. Comp. 66 (1997) 1089, s17odr8a",
    (
        0.13020248308889008087881763,
        0.56116298177510838456196441,
        -0.38947496264484728640807860,
        0.15884190655515560089621075,
        -0.39590389413323757733623154,
        0.18453964097831570709183254,
        0.25837438768632204729397911,
        0.29501172360931029887096624,
    ),
)

_SOFRONIOU_SPALETTA_10 = _of_steps(
    "sofroniou_spaletta10",
    10,
    "Sofroniou and Spaletta, Optim. Methods Softw. 20 (2005) 597, 35 stages",
    (
        0.07879572252168641926390768,
        0.31309610341510852776481247,
        0.02791838323507806610952027,
        -0.22959284159390709415121340,
        0.13096206107716486317465686,
        -0.26973340565451071434460973,
        0.07497334315589143566613711,
        0.11199342399981020488957508,
        0.36613344954622675119314812,
        -0.39910563013603589787862981,
        0.10308739852747107731580277,
        0.41143087395589023782070412,
        -0.00486636058313526176219566,
        -0.39203335370863990644808194,
        0.05194250296244964703718290,
        0.05066509075992449633587434,
        0.04967437063972987905456880,
    ),
)

SPLITTINGS: dict[str, IsokineticSplitting] = {
    s.name: s for s in (_STRANG_2, _BLANES_MOAN_4, _BLANES_MOAN_6, _KAHAN_LI_8, _SOFRONIOU_SPALETTA_10)
}
"""Splittings by their name in configs, in rising order."""
