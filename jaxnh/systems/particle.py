"""The systems: forces, prescribed speed, parameters and sources. No integrator lives here.

A particle of unit mass in the plane is held at a prescribed speed s(t) by a nonlinear nonholonomic constraint
x2² + y2² = s(t)². Its velocity is written as s(t) n with a unit vector n, so that the constraint holds by
construction; n then turns with the part of the force that is normal to it (the isokinetic flow: Evans, Hoover and
co-workers 1983; splitting by Zhang 1997). The multiplier takes up the tangential part, and with it the whole of the
damping −a dx/dt, which therefore appears nowhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

jax.config.update("jax_enable_x64", True)  # every module that computes imports this one first

Vector = tuple[Any, ...]
"""Cartesian components, each of shape (...,): JAX arrays in lanes, NumPy arrays or floats on the host."""
State = tuple[Vector, Vector]
"""(q, n): position (x1, y1) and unit vector of the velocity (n1, n2)."""

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(12)
_LARGEST_DENOMINATOR = 64


def chart(state: State) -> Array:
    """(x1, y1, θ) of shape (3,), θ the direction of n in (−π, π]: coordinates of the section."""
    (x, y), (n1, n2) = state
    return jnp.stack([x, y, jnp.arctan2(n2, n1)])


def unchart(u: Array) -> State:
    """The state with section coordinates (x1, y1, θ)."""
    return (u[0], u[1]), (jnp.cos(u[2]), jnp.sin(u[2]))


def wrap(difference: Any) -> Any:
    """A difference of section coordinates (..., 3) with its angle brought into [−π, π)."""
    xp = np if isinstance(difference, np.ndarray) else jnp
    angle = (difference[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return xp.stack([difference[..., 0], difference[..., 1], angle], axis=-1)


class IsokineticParticle(eqx.Module):
    """Forced coupled oscillator (1) whose squared speed is held at c + d sin t: equations (12) and (22).

    Phase space is (x1, y1, n) and time: three dimensions and a clock, or none without forcing and disturbance. Lanes
    differ in b or in a; all else is shared. An effect that is left out is no part of any program.

    Attributes (all real, no units: the paper's equations are dimensionless):
        a: linear stiffness of x1 and cubic stiffness of y1 (and damping, which the constraint absorbs).
        c: mean squared speed, c > |d|.
        d: amplitude of the disturbance of the squared speed; 0 gives (12).
        omega: angular frequency of the forcing g(t) = 1 + sin ωt, ω > 0.
        b: coupling where all lanes have the same, else None.
        swept: the parameter that differs from lane to lane, "b" or "a".
        without: effects that are left out, of `EFFECTS`.
    """

    a: ArrayLike
    c: float = eqx.field(static=True)
    d: float = eqx.field(static=True)
    omega: float = eqx.field(static=True)
    b: ArrayLike | None = None
    swept: str = eqx.field(static=True, default="b")
    without: frozenset[str] = eqx.field(static=True, default=frozenset())

    dimension: ClassVar[int] = 3
    """Coordinates of the section: (x1, y1, θ)."""
    exponents: ClassVar[int] = 3
    """Lyapunov exponents of motions that keep the constraint."""

    @property
    def sweeps(self) -> str:
        """What differs from lane to lane, in words and with its symbol."""
        return SWEEPS[self.swept]

    @property
    def forced(self) -> bool:
        """Whether there is a forcing."""
        return "forcing" not in self.without

    @property
    def autonomous(self) -> bool:
        """Whether there is no clock: neither forcing nor disturbance."""
        return not self.forced and not self.d

    @property
    def period(self) -> float:
        """Strobe period T: of the forcing, of the disturbance sin t, or the least common one of both.

        Without a clock it is the unit that lengths of time are counted in, 2π/ω.
        """
        return strobe_period(self.omega if self.forced or not self.d else 1.0, disturbed=self.d != 0)

    def forcing(self, t: Any) -> Any:
        """g(t) = 1 + sin ωt, any shape; 1 without forcing."""
        return 1.0 + _namespace(t).sin(self.omega * t) if self.forced else _namespace(t).ones_like(t)

    def speed(self, t: Any) -> Any:
        """s(t) = √(c + d sin t), any shape."""
        xp = _namespace(t)
        return xp.sqrt(self.c + self.d * xp.sin(t)) if self.d else xp.full_like(t, math.sqrt(self.c))

    def path_length(self, t0: Any, t1: Any) -> Any:
        """∫ s dt from t0 to t1, any shape: exact at constant speed, else by twelve Gauss–Legendre nodes."""
        if not self.d:
            return math.sqrt(self.c) * (t1 - t0)
        half = 0.5 * (t1 - t0)
        nodes = 0.5 * (t0 + t1)[..., None] + half[..., None] * _GAUSS_NODES
        return half * (self.speed(nodes) * _GAUSS_WEIGHTS).sum(axis=-1)

    def force(self, q: Vector, g: ArrayLike, weight: ArrayLike, lane: ArrayLike) -> Vector:
        """Applied force without damping, times a weight: −weight (g a x + g x³ − b y, g y + g a y³ − b x).

        `g` is the forcing times the weight and `weight` the weight alone, as both come ready-made from tables; without
        forcing `g` is not looked at. `lane` is the lane's own parameter.
        """
        a, b = self._stiffness_and_coupling(lane)

        def along(z: Any, other: Any, stiffness: Callable[[], Any]) -> Any:
            pull = None if b is None else weight * (b * other) if self.forced else b * other
            spring = g * z if self.forced else z
            if (k := stiffness()) is not None:
                spring = spring * k
            total = -spring if pull is None else pull - spring
            return total if self.forced else weight * total

        x, y = q
        if "cubic_stiffness" in self.without:
            return along(x, y, lambda: a), along(y, x, lambda: None)
        return along(x, y, lambda: a + x * x), along(y, x, lambda: 1.0 + a * (y * y))

    def force_pullback(self, q: Vector, g: ArrayLike, weight: ArrayLike, lane: ArrayLike, p: Vector) -> Vector:
        """Derivatives of p·F, with F as in `force` and p held, in (x1, y1) and the lane's parameter: a row of three."""
        x, y = q
        a, b = self._stiffness_and_coupling(lane)
        scale, cubic = g if self.forced else weight, "cubic_stiffness" not in self.without
        xx, ayy = (x * x, a * (y * y)) if cubic else (0.0, 0.0)

        def along(i: int, k: Any, square: Any) -> Any:
            pull = None if b is None else weight * (b * p[1 - i])
            slope = k + square + (square + square) if cubic else k
            spring = p[i] * (scale if slope is None else scale * slope)
            return -spring if pull is None else pull - spring

        by_x, by_y = along(0, a, xx), along(1, 1.0 if cubic else None, ayy)
        if self.swept == "b":
            return by_x, by_y, weight * (p[0] * y + p[1] * x)
        by_a = p[0] * x + p[1] * (y * (y * y)) if cubic else p[0] * x
        return by_x, by_y, -(scale * by_a)

    def _stiffness_and_coupling(self, lane: ArrayLike) -> tuple[Any, Any]:
        """a and b of a lane; b is None without coupling."""
        a, b = (self.a, lane) if self.swept == "b" else (lane, self.b)
        return a, None if "coupling" in self.without else b

    def vector_field(self, t: ArrayLike, state: State, b: ArrayLike) -> State:
        """Time derivative (q', n'); shapes (...,) in and out."""
        q, n = state
        s = self.speed(t)
        f = self.force(q, self.forcing(t), 1.0, b)
        turn = (n[0] * f[1] - n[1] * f[0]) / s
        return (s * n[0], s * n[1]), (-n[1] * turn, n[0] * turn)

    def divergence(self, t: ArrayLike, state: State, b: ArrayLike) -> Array:
        """Divergence −n·F/s of the flow of (x1, y1, θ); its mean is the sum of the three Lyapunov exponents.

        Twice this is the growth rate of a speed error in the paper's four equations, off the constraint.
        """
        q, n = state
        f = self.force(q, self.forcing(t), 1.0, b)
        return -(n[0] * f[0] + n[1] * f[1]) / self.speed(t)

    def velocity(self, t: ArrayLike, state: State) -> Vector:
        """(x2, y2) = s(t) n."""
        s = self.speed(t)
        return s * state[1][0], s * state[1][1]

    def chart(self, state: State) -> Array:
        """Section coordinates (x1, y1, θ) of a state, (3,)."""
        return chart(state)

    def unchart(self, u: Array) -> State:
        """The state with section coordinates (3,)."""
        return unchart(u)

    def wrap(self, difference: Any) -> Any:
        """A difference of section coordinates (..., 3), its angle in [−π, π)."""
        return wrap(difference)

    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Largest difference of positions between section points (..., 3): (...,)."""
        return np.max(np.abs(one[..., :2] - other[..., :2]), axis=-1)

    def section_point(self, start: State) -> np.ndarray:
        """(3,) section coordinates of a start state of floats."""
        (x, y), (n1, n2) = start
        return np.array([x, y, math.atan2(n2, n1)])

    def directions(self, k: int) -> tuple[Vector, ...]:
        """k tangents of three components to begin with: coordinate directions."""
        return tuple(tuple(float(i == j) for j in range(3)) for i in range(k))

    def lift(self, state: State, tangent: Vector) -> State:
        """δ(q, n) of a tangent δ(x1, y1, θ) at a state."""
        (dx, dy, dtheta), n = tangent, state[1]
        return (dx, dy), (-n[1] * dtheta, n[0] * dtheta)

    def lower(self, state: State, tangent: State) -> Vector:
        """δ(x1, y1, θ) of a tangent δ(q, n) at a state."""
        n, dn = state[1], tangent[1]
        return *tangent[0], n[0] * dn[1] - n[1] * dn[0]

    def signal(self, state: State) -> Any:
        """The position that stands for a motion where one is enough."""
        return state[0][0]

    def random_states(self, draws: np.ndarray, box: float, b: np.ndarray) -> State:
        """Start states of even draws (lanes, 3) from [−1, 1]: x1 and y1 in [−box, box] and any direction."""
        angle = np.pi * draws[:, 2]
        return (box * draws[:, 0], box * draws[:, 1]), (np.cos(angle), np.sin(angle))

    def outputs(self, states: State, t: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
        """The paper's coordinates of states by name, each with words for it; times t repeat along their last axis."""
        (x1, y1), (n1, n2) = states
        speed = np.tile(self.speed(t), n1.shape[-1] // len(t))
        return {
            "x1": (x1, "position x1"),
            "x2": (speed * n1, "velocity x2 = dx1/dt"),
            "y1": (y1, "position y1"),
            "y2": (speed * n2, "velocity y2 = dy1/dt"),
        }

    def reports(self, states: State) -> dict[str, tuple[np.ndarray, str, dict[str, Any]]]:
        """Nothing: the constraint holds by construction."""
        return {}


def _namespace(t: Any) -> Any:
    """NumPy for NumPy arrays, whose tables are made once on the host; jax.numpy for everything else."""
    return np if isinstance(t, np.ndarray) else jnp


EFFECTS = ("forcing", "coupling", "cubic_stiffness", "damping")
"""What can be left out of a system; the disturbance is left out by d = 0, the constraint by another system."""
SWEEPS = {"b": "coupling b", "a": "stiffness a"}
"""What can differ from lane to lane, in words and with its symbol."""


def strobe_period(omega: float, *, disturbed: bool) -> float:
    """2π/ω, or with the disturbance sin t the least T that is a multiple of both 2π/ω and 2π.

    Raises:
        ValueError: ω is not a ratio of whole numbers with a denominator up to 64, so that sin ωt and sin t have no
            common period to strobe at.
    """
    if not disturbed:
        return 2 * math.pi / omega
    ratio = Fraction(omega).limit_denominator(_LARGEST_DENOMINATOR)
    if ratio <= 0 or abs(float(ratio) - omega) > 1e-12 * omega:
        raise ValueError(
            f"sin({omega:g} t) and the disturbance sin t have no common period to strobe at; "
            f"omega must be a ratio p/q of whole numbers with q up to {_LARGEST_DENOMINATOR}"
        )
    return 2 * math.pi * ratio.denominator


def constant_speed(a: float = 0.5, c: float = 1.0, omega: float = 1.0, **others: Any) -> IsokineticParticle:
    """x2² + y2² = c: equation (12) of the paper (figures 1–5, table 1); others are its fields."""
    return IsokineticParticle(a=a, c=c, d=0.0, omega=omega, **others)


def disturbed_speed(
    a: float = 0.5, c: float = 1.0, d: float = 0.1, omega: float = 1.0, **others: Any
) -> IsokineticParticle:
    """x2² + y2² = c + d sin t: equation (22) of the paper (figures 6–10, table 2); others are its fields."""
    return IsokineticParticle(a=a, c=c, d=d, omega=omega, **others)


def constrained_field(system: IsokineticParticle, t: ArrayLike, y: Vector, b: ArrayLike) -> Vector:
    """The paper's own four equations (12)/(22), with (13)/(23), in y = (x1, x2, y1, y2).

    For comparison only: off the constraint they are ill-posed, a speed error grows as exp(−2 ∫ n·F/s dt).
    """
    x1, x2, y1, y2 = y
    g = system.forcing(t)
    f1 = g * x1 * (system.a + x1 * x1) - b * y1
    f2 = g * y1 * (1.0 + system.a * (y1 * y1)) - b * x1
    squared_speed = system.c + system.d * jnp.sin(t)
    power = f1 * x2 + f2 * y2 + 0.5 * system.d * jnp.cos(t)
    return x2, -f1 + power * x2 / squared_speed, y2, -f2 + power * y2 / squared_speed
