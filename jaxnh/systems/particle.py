"""The particle at a prescribed speed: forces, speed, parameters and sources. No integrator lives here.

A particle of unit mass in the plane is held at a prescribed speed s(t) by a nonlinear nonholonomic constraint
x2² + y2² = s(t)². Its velocity is written as s(t) n with a unit vector n, so that the constraint holds by
construction; n then turns with the part of the force that is normal to it (the isokinetic flow: Evans, Hoover and
co-workers 1983; splitting by Zhang 1997). The multiplier takes up the tangential part, and with it the whole of the
damping −a dx/dt, which therefore appears nowhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Flow, ParameterRoles, Parameters, Reduction
from jaxnh.systems.particle_parameters import strobe_period
from jaxnh.systems.readout import Labels, Output, Readout
from jaxnh.systems.state import Number, Vector

State = tuple[Vector, Vector]
"""(q, n): position (x1, y1) and unit vector of the velocity (n1, n2)."""

_LONG_NAMES = {
    "a": "stiffness a",
    "b": "coupling b",
    "c": "squared speed c",
    "d": "disturbance d",
    "omega": "frequency omega",
    "x1": "position x1",
    "x2": "velocity x2",
    "y1": "position y1",
    "y2": "velocity y2",
}
LABELS = Labels(
    long_names=_LONG_NAMES,
    units=dict.fromkeys((*_LONG_NAMES, "t"), "1"),
    planes=(("x1", "x2"), ("y1", "y2")),
    iterates="units of time 2 pi/omega",
)
"""Names of the paper's parameters and coordinates."""

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(12)


class ParticleChart(Chart):
    """(x1, y1, θ) of states (q, n), θ the direction of n in (−π, π]."""

    def components(self, y: State) -> Vector:
        (x1, y1), (n1, n2) = y
        if isinstance(n1, jax.Array):
            return x1, y1, jnp.arctan2(n2, n1)
        # The arctangent of the C library, which is the same on all processors; NumPy's own is not.
        return x1, y1, np.vectorize(math.atan2, otypes=[float])(n2, n1)

    def point(self, y: State) -> Float[Array, " 3"]:
        return jnp.stack(self.components(y))

    def state(self, u: Number) -> State:
        xp = _namespace(u)
        return (u[0], u[1]), (xp.cos(u[2]), xp.sin(u[2]))

    def lift(self, y: State, tangent: Vector) -> State:
        (dx, dy, dtheta), n = tangent, y[1]
        return (dx, dy), (-n[1] * dtheta, n[0] * dtheta)

    def lower(self, y: State, tangent: State) -> Vector:
        """δ(x1, y1, θ) of a tangent δ(q, n) at a state.

        Of n × δn the compiler may fuse either product with the difference: which one, it decides by the shape of a
        tile. One quotient has one rounding.
        """
        n, dn = y[1], tangent[1]
        return *tangent[0], jnp.where(jnp.abs(n[0]) > jnp.abs(n[1]), dn[1] / n[0], -dn[0] / n[1])


CHART = ParticleChart((False, False, True), positions=2, dimensionless=True)


class IsokineticParticle(Flow):
    """Forced coupled oscillator (1) whose squared speed is held at c + d sin t: equations (12) and (22).

    Phase space is (x1, y1, n) and time: three dimensions and a clock, or none without forcing and disturbance. Lanes
    may have their own a and b; c, d and ω are the same for all lanes of a program. An effect that is left out is no
    part of any program.

    Attributes (all real, no units: the paper's equations are dimensionless):
        a: linear stiffness of x1 and cubic stiffness of y1 (and damping, which the constraint absorbs).
        c: mean squared speed, above the size of d.
        d: amplitude of the disturbance of the squared speed.
        omega: angular frequency of the forcing g(t) = 1 + sin ωt, ω > 0.
        b: coupling; None where it is left out or every lane has its own.
        without: effects that are left out, of `particle_parameters.EFFECTS` and "disturbance", which gives (12).
    """

    a: ArrayLike
    c: Number
    d: Number
    omega: Number
    b: ArrayLike | None = None
    without: frozenset[str] = eqx.field(static=True, default=frozenset())

    # ---- names

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The paper's x1, x2, y1, y2."""
        return "x1", "x2", "y1", "y2"

    @property
    def parameters(self) -> Parameters:
        """a, b, c, d and ω."""
        own = {"a": self.a, "b": self.b, "c": self.c, "d": self.d, "omega": self.omega}
        return {name: value for name, value in own.items() if value is not None}

    @property
    def roles(self) -> ParameterRoles:
        """a and b are of lanes; c, ω and, with a disturbance, d are in the table of kicks, which all lanes share."""
        of_equations = tuple(name for name in self.parameters if name != "d" or self.disturbed)
        return ParameterRoles(("a", "b"), of_equations, ("c", "d", "omega").__contains__)

    def with_parameters(self, values: Parameters) -> IsokineticParticle:
        """Return the particle with other values of some of its parameters."""
        return replace(self, **values)

    # ---- time

    @property
    def forced(self) -> bool:
        """Return whether there is a forcing."""
        return "forcing" not in self.without

    @property
    def disturbed(self) -> bool:
        """Return whether there is a disturbance of the speed."""
        return "disturbance" not in self.without

    @property
    def autonomous(self) -> bool:
        """Return whether there is no clock: neither forcing nor disturbance."""
        return not self.forced and not self.disturbed

    @property
    def period(self) -> float:
        """Strobe period T: of the forcing, of the disturbance sin t, or the least common one of both.

        Without a clock it is the unit that lengths of time are counted in, 2π/ω.
        """
        disturbed = self.disturbed and bool(self.d)
        return strobe_period(self.omega if self.forced or not disturbed else 1.0, disturbed=disturbed)

    def density(self, t: np.ndarray) -> np.ndarray:
        """Steps a unit of time, up to a factor; t of any shape.

        The density (g + 1/10)^0.3 / s follows the forcing weakly and the inverse speed fully: at constant speed it
        lowers the largest error of a period about 1.5 times at equal cost (stronger grading raises it again), and where
        the speed nearly vanishes it refines geometrically towards that moment.
        """
        return (self.forcing(t) + 0.1) ** 0.3 / self.speed(t)

    def forcing(self, t: Number) -> Number:
        """g(t) = 1 + sin ωt, any shape; 1 without forcing."""
        return 1.0 + _namespace(t).sin(self.omega * t) if self.forced else _namespace(t).ones_like(t)

    def speed(self, t: Number) -> Number:
        """s(t) = √(c + d sin t), any shape."""
        xp = _namespace(t)
        if self.disturbed and not _vanishes(self.d):
            return xp.sqrt(self.c + self.d * xp.sin(t))
        return xp.full_like(t, _root(self.c))

    def path_length(self, t0: Number, t1: Number) -> Number:
        """∫ s dt from t0 to t1, any shape: exact at constant speed, else by twelve Gauss–Legendre nodes."""
        if not self.disturbed or _vanishes(self.d):
            return _root(self.c) * (t1 - t0)
        half = 0.5 * (t1 - t0)
        nodes = 0.5 * (t0 + t1)[..., None] + half[..., None] * _GAUSS_NODES
        return half * (self.speed(nodes) * _GAUSS_WEIGHTS).sum(axis=-1)

    def tabulated(self) -> IsokineticParticle:
        """The flow as kicks see it: what a table of kicks has of it, its speed and its clock, is no part of it."""
        return IsokineticParticle(self.a, None, None, None, self.b, self.without)

    # ---- forces
    def force(self, q: Vector, g: ArrayLike, weight: ArrayLike, p: Parameters) -> Vector:
        """Applied force without damping, times a weight: −weight (g a x + g x³ − b y, g y + g a y³ − b x).

        `g` is the forcing times the weight and `weight` the weight alone, as both come ready-made from tables; without
        forcing `g` is not looked at.
        """
        a, b = self._stiffness_and_coupling(p)

        def along(z: Number, other: Number, stiffness: Callable[[], Number]) -> Number:
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

    def force_pullback(
        self, q: Vector, g: ArrayLike, weight: ArrayLike, p: Parameters, m: Vector, names: Sequence[str] = ()
    ) -> Vector:
        """Derivatives of m·F, with F as in `force` and m held, in x1, y1 and the parameters named, of a and b."""
        x, y = q
        a, b = self._stiffness_and_coupling(p)
        scale, cubic = g if self.forced else weight, "cubic_stiffness" not in self.without
        xx, ayy = (x * x, a * (y * y)) if cubic else (0.0, 0.0)

        def along(i: int, k: Number, square: Number) -> Number:
            pull = None if b is None else weight * (b * m[1 - i])
            slope = k + square + (square + square) if cubic else k
            spring = m[i] * (scale if slope is None else scale * slope)
            return -spring if pull is None else pull - spring

        by_x, by_y = along(0, a, xx), along(1, 1.0 if cubic else None, ayy)
        rows = {
            "b": lambda: weight * (m[0] * y + m[1] * x),
            "a": lambda: -(scale * (m[0] * x + m[1] * (y * (y * y)) if cubic else m[0] * x)),
        }
        return by_x, by_y, *(rows[name]() for name in names)

    def _stiffness_and_coupling(self, p: Parameters) -> tuple[Number, Number]:
        """a and b of a lane; b is None without coupling."""
        return p.get("a", self.a), None if "coupling" in self.without else p.get("b", self.b)

    def rhs(self, t: ArrayLike, y: State, p: Parameters) -> State:
        """Time derivative (q', n'); shapes (...,) in and out."""
        q, n = y
        s = self.speed(t)
        f = self.force(q, self.forcing(t), 1.0, p)
        turn = (n[0] * f[1] - n[1] * f[0]) / s
        return (s * n[0], s * n[1]), (-n[1] * turn, n[0] * turn)

    def reversal(self, p: Parameters) -> dict[str, float]:
        """(q, n, t) → (q, −n, T/2 − t), which undoes a motion as no damping is left; T/2 is π/ω at constant speed."""
        return {"time": 0.5 * self.period}

    def divergence(self, t: ArrayLike, y: State, p: Parameters) -> Array:
        """Divergence −n·F/s of the flow of (x1, y1, θ); its mean is the sum of the three Lyapunov exponents.

        Twice this is the growth rate of a speed error in the paper's four equations, off the constraint.
        """
        q, n = y
        f = self.force(q, self.forcing(t), 1.0, p)
        return -(n[0] * f[0] + n[1] * f[1]) / self.speed(t)

    @property
    def reduction(self) -> ParticleReduction:
        """All of a state."""
        return ParticleReduction(self)

    def velocity(self, t: ArrayLike, y: State) -> Vector:
        """(x2, y2) = s(t) n."""
        s = self.speed(t)
        return s * y[1][0], s * y[1][1]

    @property
    def exponents(self) -> int:
        """Lyapunov exponents of motions that keep the constraint."""
        return 3

    @property
    def chart(self) -> ParticleChart:
        """(x1, y1, θ); lengths are those of the cubic terms."""
        return CHART

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> State:
        """(q, n) at t = 0 with x1, x2 and y1; y2 is the positive root of the constraint, NaN where there is none."""
        x1, x2, y1 = (np.asarray(coordinates[name], float) for name in ("x1", "x2", "y1"))
        speed = np.sqrt(self.c)  # c + d sin t at t = 0
        with np.errstate(invalid="ignore"):
            return (x1, y1), (x2 / speed, np.sqrt(self.c - x2 * x2) / speed)

    @property
    def readout(self) -> ParticleReadout:
        """The paper's words."""
        return ParticleReadout(self)


class ParticleReduction(Reduction):
    """States (q, n) as they are; n has one direction, in which it turns."""

    def divergence_of(self, rate: Callable[[State], State], z: State) -> Array:
        """Divergence of a rate over (x1, y1, θ)."""
        (x1, y1), (n1, n2) = z
        unit = jnp.ones_like(x1)

        def turning(angle: Array) -> Array:
            n = n1 - angle * n2, n2 + angle * n1
            turn = rate(((x1, y1), n))[1]
            return n[0] * turn[1] - n[1] * turn[0]

        along = jax.jvp(lambda x: rate(((x, y1), (n1, n2)))[0][0], (x1,), (unit,))[1]
        across = jax.jvp(lambda x: rate(((x1, x), (n1, n2)))[0][1], (y1,), (unit,))[1]
        return along + across + jax.jvp(turning, (jnp.zeros_like(x1),), (unit,))[1]


@dataclass(frozen=True)
class ParticleReadout(Readout):
    """The paper's coordinates of states (q, n); every kick gives the mean contraction."""

    flow: IsokineticParticle
    contraction = "⟨n·F⟩/s"

    @property
    def labels(self) -> Labels:
        return LABELS

    def coordinates(self, y: State, t: np.ndarray) -> dict[str, Output]:
        (x1, y1), (n1, n2) = y
        speed = np.tile(self.flow.speed(t), n1.shape[-1] // len(t))
        return paper_coordinates(x1, speed * n1, y1, speed * n2)


def paper_coordinates(x1: Number, x2: Number, y1: Number, y2: Number) -> dict[str, Output]:
    """The paper's coordinates by name, velocities as the rates that they are."""
    rates = {"x2": " = dx1/dt", "y2": " = dy1/dt"}
    numbers = {"x1": x1, "x2": x2, "y1": y1, "y2": y2}
    return {name: Output(x, f"{LABELS.long_names[name]}{rates.get(name, '')}") for name, x in numbers.items()}


def _namespace(t: Number) -> Number:
    """NumPy for NumPy arrays, whose tables are made once on the host; jax.numpy for everything else."""
    return np if isinstance(t, np.ndarray) else jnp


def _vanishes(x: Number) -> bool:
    """Return whether a number is known, and zero."""
    return isinstance(x, float | int) and x == 0


def _root(c: Number) -> Number:
    """√c, of a number or a traced one."""
    return math.sqrt(c) if isinstance(c, float | int) else jnp.sqrt(c)


def constant_speed(
    a: float = 0.5, c: float = 1.0, omega: float = 1.0, b: float | None = None, without: Collection[str] = ()
) -> IsokineticParticle:
    """x2² + y2² = c: equation (12) of the paper (figures 1–5, table 1).

    `without` names effects of `particle_parameters.EFFECTS`.
    """
    return IsokineticParticle(a, c, 0.0, omega, b, frozenset(without) - {"damping"} | {"disturbance"})


def disturbed_speed(
    a: float = 0.5,
    c: float = 1.0,
    d: float = 0.1,
    omega: float = 1.0,
    b: float | None = None,
    without: Collection[str] = (),
) -> IsokineticParticle:
    """x2² + y2² = c + d sin t: equation (22) of the paper (figures 6–10, table 2); `without` names effects.

    With d = 0 the speed is constant at this d; `constant_speed` has no disturbance in any program.
    """
    return IsokineticParticle(a, c, d, omega, b, frozenset(without) - {"damping"})
