"""Any mechanical system of T, Q and f as a flow: its lanes, its section, and its projection on the constraints.

The exact flow of the equations of motion (`jourdain`) keeps f, on the constraint and off it. A computed step leaves
f = 0 by the error of the method, and `Lagrangian.project` goes back along M⁻¹ Aᵀ, which is orthogonal in the metric of
the mass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.systems.chart import wrap_angle
from jaxnh.systems.definition import DefinedFlow, DefinedReadout, Definition, marked
from jaxnh.systems.explicit import (
    Explicit,
    ExplicitReduction,
    all_velocities,
    dependent_velocities,
    explicit_velocities,
    maggi_accelerations,
)
from jaxnh.systems.flow import Parameters, Reduction
from jaxnh.systems.impulses import LARGEST_DRIFT, Projection, project_velocities
from jaxnh.systems.jourdain import Equations, accelerations, constraint_functions
from jaxnh.systems.motion import Motion, MotionChart
from jaxnh.systems.quasi_velocities import QuasiVelocities, equations_of, quasi_velocities_of
from jaxnh.systems.readout import UNSAID, Labels, Output, pairs, status
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import cached_by_structure, listed_once
from jaxnh.systems.user_text import states_of

_SINGULAR, _OFF, _NOT_FINITE = 1.0, 2.0, 3.0
_NEWTON_STEPS = 2  # to a level that a step has left by its error: the first squares that
_LARGEST_FACTOR = 1e-2  # less one: a step's error is smaller, but for a body that is all but at rest
_APPROACHES = 12  # projections from a random state to one on f = 0


class Lagrangian(DefinedFlow):
    """Any system of a definition's `T`, `Q` and, where it has constraints, `f`; made by `lagrangian`.

    Attributes:
        constraints: number m of constraints that a state can leave.
        ignorable: for each coordinate, whether nothing depends on it: such are left out of the section.
        quasi: quasi-velocities, where these are the velocities; None where they are q̇.
        level: integral on whose level states are kept, the value of which is a parameter by this name; None: on none.
    """

    constraints: int = eqx.field(static=True)
    ignorable: tuple[bool, ...] = eqx.field(static=True)
    quasi: QuasiVelocities | None = eqx.field(static=True, default=None)
    level: str | None = eqx.field(static=True, default=None)

    # ---- names

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of each coordinate and its velocity, x, x_dot, y, …, or of coordinates, then quasi-velocities."""
        return states_of(self.names, self.quasi.names if self.quasi else ())

    @property
    def velocities(self) -> tuple[str, ...]:
        """Names of the velocities of a state."""
        return self.quasi.names if self.quasi else tuple(f"{name}_dot" for name in self.names)

    # ---- motion

    def equations(self, p: Parameters) -> Equations:
        """T, Q and f of a lane, and where it has quasi-velocities their kinematics."""
        return equations_of(self.definition(p), self.quasi)

    def _state_constraints(self, equations: Equations) -> Callable[..., Vector]:
        """f of the components of a state; empty where it cannot leave f = 0."""
        return constraint_functions(equations, len(self.names)) if self.constraints else lambda *at: ()

    def all_velocities(self, t: ArrayLike, y: Motion, p: Parameters) -> Vector:
        """The velocities of a state, and those that constraints give and the state leaves out."""
        dependent = self._dependent
        return y.v if dependent is None else all_velocities(self.equations(p), dependent, y.q, y.v, t)

    def rhs(self, t: ArrayLike, y: Motion, p: Parameters) -> Motion:
        """Time derivative of a state; a singular matrix makes the rate of the reason not a number.

        Its equations are listed once: of a rolling body 380 in place of 3,300, which take a second to trace, and which
        a small job would trace ten times (`sweeps.timing.startup`, rattleback).
        """
        return _rates(self, t, y, dict(p))

    def derived_rates(self, t: ArrayLike, y: Motion, p: Parameters) -> Motion:
        """`rhs`, derived from T, Q and f where it is called."""
        equations, dependent, zero = self.equations(p), self._dependent, jnp.zeros_like(y.q[0])
        if dependent is None:
            solved = accelerations(equations, y.q, y.v, t)
        else:
            solved = maggi_accelerations(equations, dependent, y.q, y.v, t)
        rates = equations.rates(y.q, self.all_velocities(t, y, p), t)
        return Motion(rates, solved.a, (zero, jnp.where(solved.singular, jnp.nan, zero)))

    def motion_at(self, t: ArrayLike, y: Motion, p: Parameters) -> tuple[Equations, Vector, Vector, None]:
        """The equations of a lane, coordinates and all velocities of a state, and which constraints hold: all."""
        return self.equations(p), y.q, self.all_velocities(t, y, p), None

    def multipliers(self, t: ArrayLike, y: Motion, p: Parameters) -> Vector:
        """The multipliers λ of (6), one a constraint, of velocities that are left out as well."""
        return accelerations(self.equations(p), y.q, self.all_velocities(t, y, p), t).multipliers

    def integral(self, name: str, t: ArrayLike, y: Motion, p: Parameters) -> Number:
        """Value at a state of one of the definition's `integrals`."""
        return self.definition(p)["integrals"][name](y.q, self.all_velocities(t, y, p), t)

    def residuals(self, t: ArrayLike, y: Motion, p: Parameters) -> Vector:
        """The m values of f, zero on the constraints, then the sums of squares that are one, less one."""
        return (*self._state_constraints(self.equations(p))(*y.q, *y.v, t), *self._norm_residuals(y.q))

    @property
    def constrained(self) -> bool:
        """Return whether a state can be off its constraints, its norms or its level."""
        return bool(self.constraints or self.norms or self.level)

    @property
    def norms(self) -> tuple[tuple[int, ...], ...]:
        """Coordinates, by number, the sum of whose squares is one, for each such sum."""
        return self.quasi.norms if self.quasi else ()

    def _norm_residuals(self, q: Vector) -> Vector:
        return tuple(sum(q[i] * q[i] for i in group) - 1.0 for group in self.norms)

    def _normalised(self, q: Vector) -> Vector:
        """Coordinates with their norms brought back to one."""
        moved = list(q)
        for group in self.norms:
            inverse = 1.0 / jnp.sqrt(sum(q[i] * q[i] for i in group))
            for i in group:
                moved[i] = q[i] * inverse
        return tuple(moved)

    def _on_level(self, t: ArrayLike, q: Vector, v: Vector, p: Parameters, most: float) -> Vector:
        """Velocities by as many times theirs as brings them to the level: Newton on the factor, from one.

        It changes by no more than `most` a step; where it would, as all but at rest, by nothing.
        """
        name = self.level
        if name is None:
            return v
        level, factor = p.get(name, self.values[name]), jnp.ones_like(q[0])

        def excess(factor: Number) -> Number:
            return self.integral(name, t, Motion(q, tuple(factor * x for x in v), ()), p) - level

        for _ in range(_NEWTON_STEPS):
            left, slope = jax.jvp(excess, (factor,), (jnp.ones_like(factor),))
            known = (slope != 0.0) & (jnp.abs(left) <= most * jnp.abs(slope))
            factor = factor - jnp.where(known, left / jnp.where(known, slope, 1.0), 0.0)
        return tuple(factor * x for x in v)

    def project(self, t: ArrayLike, y: Motion, p: Parameters, *, trust: bool = True) -> Motion:
        """The state brought back to f = 0 along M⁻¹ Aᵀ, or marked as failed: not a number from there on.

        The largest |f| met here is kept in `watch`.
        Without trust a state that is still off f = 0 is no failure. Norms are brought back to one before.
        """
        q, v, (drift, reason) = y
        for residual in self._norm_residuals(q):
            drift = jnp.maximum(drift, jnp.abs(residual))
        q = self._normalised(q)
        v = self._on_level(t, q, v, p, _LARGEST_FACTOR if trust else jnp.inf)
        finite = jnp.isfinite(sum(x * x for x in (*q, *v)))
        singular = jnp.isnan(reason)
        off = ~finite
        if self.constraints:
            projection = _projection(self, t, q, v, dict(p))
            v, singular = projection.v, singular | projection.singular
            drift = jnp.where(projection.drift > drift, projection.drift, drift)
            if trust:
                off = ~(projection.left < LARGEST_DRIFT)
        code = jnp.where(off, jnp.where(finite, _OFF, _NOT_FINITE), jnp.zeros_like(drift))
        code = jnp.where(singular, _SINGULAR, code)
        reason = jnp.where(reason > 0.0, reason, code)
        q, v = (tuple(jnp.where(reason > 0.0, jnp.nan, x) for x in side) for side in (q, v))
        return Motion(q, v, lax.stop_gradient((drift, reason)))

    # ---- what maps act on, and what steps carry: no velocity that the constraints give

    @property
    def exponents(self) -> int:
        """Lyapunov exponents of motions that keep the constraints, and where there is one the level."""
        norms = [group for group in self.norms if not all(self.ignorable[i] for i in group)]
        return self.chart.dimension - self.constraints - len(norms) - (self.level is not None)

    @property
    def chart(self) -> MotionChart:
        """Coordinates but for those that are ignorable, and all velocities."""
        kept = tuple(i for i, left_out in enumerate(self.ignorable) if not left_out)
        angles = *(self.angles[i] for i in kept), *(False for _ in self.velocities)
        return MotionChart(angles, len(kept), dimensionless=False, kept=kept, count=len(self.names))

    @property
    def explicit(self) -> Explicit | None:
        """Return which velocities of a state the constraints give; None where there are none."""
        return self._given_velocities if self.constraints else None

    @property
    def _dependent(self) -> Explicit | None:
        """Velocities that the constraints give and that are no part of a state; None where there are none."""
        return self._given_velocities if self.quasi and self.quasi.dependent else None

    @property
    def _given_velocities(self) -> Explicit | None:
        return _explicit(self)

    @property
    def reduction(self) -> Reduction:
        """Coordinates and the free velocities, where the others are given at every state."""
        explicit, dependent = self.explicit, self._dependent
        if explicit is not None:
            return ExplicitReduction(self, self.equations, explicit, left_out=False)
        if dependent is not None and dependent.definite and dependent.inverse is not None:
            return ExplicitReduction(self, self.equations, dependent, left_out=True)
        return Reduction(self)

    def nearest(self, y: Motion, p: Parameters, t: ArrayLike = 0.0) -> Motion:
        """The state near one that is on the constraints at a time: of other velocities, by many projections.

        What it was off them is no drift of a step.
        """
        zero = jnp.zeros_like(y.q[0])
        at = zero + t

        def again(_: Number, state: Motion) -> Motion:
            q, v, (drift, _) = state
            moved = self.project(at, Motion(q, v, (drift, zero)), p, trust=False)
            return Motion(q, moved.v, (drift, zero))

        there = self.project(at, lax.fori_loop(0, _APPROACHES, again, y), p)
        return there._replace(watch=(y.watch[0], there.watch[1]))

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> Motion:
        """Coordinates and velocities at t = 0."""
        q = tuple(np.asarray(coordinates[name], float) for name in self.names)
        v = tuple(np.asarray(coordinates[name], float) for name in self.velocities)
        return Motion(q, v, (np.zeros_like(q[0]), np.zeros_like(q[0])))

    @property
    def readout(self) -> LagrangianReadout:
        """Coordinates and velocities as the definition calls them."""
        return LagrangianReadout(self)


@dataclass(frozen=True)
class LagrangianReadout(DefinedReadout):
    """States of a mechanical system, coordinates and velocities in the order of `Lagrangian.coordinates`."""

    flow: Lagrangian

    @property
    def labels(self) -> Labels:
        """Labels of the definition; each coordinate of the section is drawn with its velocity, then all others.

        With quasi-velocities all pairs are drawn.
        """
        flow, names, rates = self.flow, self.flow.names, self.flow.velocities
        kinds = {name: "angle" if angle else "coordinate" for name, angle in zip(names, flow.angles, strict=True)}
        kinds |= dict.fromkeys(flow.define(**flow.values).get("integrals", ()), "integral")
        kinds |= dict.fromkeys(rates, "quasi-velocity" if flow.quasi else "velocity")
        order = sorted(range(len(names)), key=flow.ignorable.__getitem__)
        if flow.quasi:
            return self.labelled(kinds, pairs((*(names[i] for i in order), *rates)))
        return self.labelled(kinds, tuple((names[i], rates[i]) for i in order))

    def coordinates(self, y: Motion, t: np.ndarray) -> dict[str, Output]:
        flow, words, units = self.flow, self.labels.long_names, self.labels.units
        outputs: dict[str, Output] = {}
        for name, q, is_angle in zip(flow.names, y.q, flow.angles, strict=True):
            outputs[name] = Output(wrap_angle(q) if is_angle else q, words[name], {"units": units[name]})
        for number, (rate, v) in enumerate(zip(flow.velocities, y.v, strict=True)):
            meaning = "" if flow.quasi else f" = d{flow.names[number]}/dt"
            outputs[rate] = Output(v, f"{words[rate]}{meaning}", {"units": units[rate]})
        return {name: outputs[name] for name in states_of(flow.names, flow.quasi.names if flow.quasi else ())}

    def reports(self, y: Motion) -> dict[str, Output]:
        """Return the largest |f| before a projection and the status of each trajectory, from states (..., points)."""
        drift, reason = (component[..., -1] for component in y.watch)
        return {
            "drift": Output(drift, "largest |f| that a step left before its projection", {"units": UNSAID}),
            "status": status(reason),
        }


@listed_once
def _rates(system: Lagrangian, t: ArrayLike, y: Motion, p: Parameters) -> Motion:
    return system.derived_rates(t, y, p)


@listed_once
def _projection(system: Lagrangian, t: ArrayLike, q: Vector, v: Vector, p: Parameters) -> Projection:
    return project_velocities(system.equations(p), q, v, t)


@cached_by_structure
def _explicit(system: Lagrangian) -> Explicit | None:
    """Compute the velocities once for a structure: parameters are no numbers then, and decide nothing."""
    velocities: list[Explicit | None] = []

    def look(system: Lagrangian, own: Parameters) -> float:
        equations, k = system.equations(own), len(system.names)
        if system.quasi and system.quasi.dependent:
            solved = dependent_velocities(equations, k, len(system.quasi.everything), system.quasi.dependent)
        else:
            solved = explicit_velocities(equations, k, len(system.velocities))
        velocities.append(solved)
        return 0.0

    jax.eval_shape(look, system, dict.fromkeys(system.roles.of_lanes, 0.0))
    return velocities[0]


def lagrangian(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> Lagrangian:
    """The system that a function of its parameters defines.

    Args:
        define: parameters by name to a mapping with `T`, `Q` and, unless the system is free, `f`: functions of
            (q, q̇, t), with q and q̇ tuples of k numbers; `coordinates`, their k names; with a clock its `period`,
            that of the strobe; where there are some, names of coordinates that are `angles` or `ignorable`; and where
            it has quasi-velocities, `rates` with their names and what goes with them (`quasi_velocities_of`).
        parameters: values of all parameters.
        of_lanes: names of those that lanes may have of their own, by default all.

    Raises:
        InputError: `rates` are no rates of quasi-velocities.
    """
    definition = define(**parameters)
    names = tuple(definition["coordinates"])
    quasi = quasi_velocities_of(define, parameters)
    m = 0
    if not quasi or not quasi.dependent:
        zeros, velocities = ((jnp.zeros(()),) * len(each) for each in (names, quasi.names if quasi else names))
        f = constraint_functions(equations_of(definition, quasi), len(names))
        m = len(jax.eval_shape(lambda q, v, t: f(*q, *v, t), zeros, velocities, zeros[0]))
    angles, ignorable = marked(definition, "angles"), marked(definition, "ignorable")
    return Lagrangian(define, dict(parameters), of_lanes, names, angles, "period" in definition, m, ignorable, quasi)
