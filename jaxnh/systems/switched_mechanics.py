"""Mechanical systems of T, Q and f that hit walls, whose forces are switched, or whose constraints come and go.

Their states are points of all coordinates and velocities, and their events those of `piecewise_smooth`. A constraint
that holds while a height is positive has that height for a surface: where it is passed upwards the velocity is brought
to the constraint by an impulse (`impulses`), where it is passed downwards the motion goes on freely.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.systems.definition import Definition
from jaxnh.systems.flow import Parameters
from jaxnh.systems.impulses import LARGEST_DRIFT, constrained_velocities, project_velocities, reflected_velocities
from jaxnh.systems.jourdain import Equations, accelerations, constraint_slopes
from jaxnh.systems.lagrangian import Lagrangian, lagrangian
from jaxnh.systems.motion import Motion
from jaxnh.systems.piecewise_smooth import PiecewiseChart, PiecewisePoint, PiecewiseReadout, PiecewiseSmooth
from jaxnh.systems.quasi_velocities import QuasiVelocities, equations_of
from jaxnh.systems.readout import UNSAID, Labels, Output
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.status import STATUS
from jaxnh.systems.tracing import Program

_SINGULAR, _OFF = float(STATUS.index("singular")), float(STATUS.index("off_constraint"))


class SwitchedChart(PiecewiseChart):
    """Coordinates and velocities, those left out that nothing depends on.

    Attributes:
        kept: numbers of those that are not left out.
        count: number of all of them.
    """

    kept: tuple[int, ...] = eqx.field(static=True)
    count: int = eqx.field(static=True)

    def components(self, y: PiecewisePoint) -> Vector:
        return tuple(y.y[i] for i in self.kept)

    def state(self, u: Number) -> PiecewisePoint:
        """The state with section coordinates; those left out are zero."""
        zero = np.zeros_like(u[0]) if isinstance(u, np.ndarray) else jnp.zeros_like(u[0])
        y = [zero] * self.count
        for j, i in enumerate(self.kept):
            y[i] = u[j]
        return PiecewisePoint(tuple(y), zero, (zero, zero))


class SwitchedMechanics(PiecewiseSmooth):
    """Any system of `T`, `Q`, `f` with jumps, switches, or constraints that come and go; made by `switched_mechanics`.

    The switches are those of the definition, then one for each constraint that comes and goes.

    Attributes:
        positions: number of the coordinates, which come before the velocities.
        ignorable: for each coordinate, whether nothing depends on it.
        constraints: number of the constraints that hold at all times and that a state can leave.
        permanent: number of all that hold at all times.
        switched: for each constraint that comes and goes the number of its equations.
        linear: whether these are linear in the velocities.
        quasi: quasi-velocities, where these are the velocities; None where they are q̇.
    """

    positions: int = eqx.field(static=True)
    ignorable: tuple[bool, ...] = eqx.field(static=True)
    constraints: int = eqx.field(static=True)
    permanent: int = eqx.field(static=True)
    switched: tuple[int, ...] = eqx.field(static=True)
    linear: bool = eqx.field(static=True)
    quasi: QuasiVelocities | None = eqx.field(static=True)

    @property
    def mechanics(self) -> Lagrangian:
        """The same system without its jumps, its switches and the constraints that come and go."""
        k = self.positions
        return Lagrangian(
            self.define, self.values, self.of_lanes, self.names[:k], self.angles[:k], self.clock,
            self.constraints, self.ignorable, self.quasi,
        )  # fmt: skip

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of coordinates and velocities, in the order of results."""
        return self.mechanics.coordinates

    @property
    def loses_rank(self) -> bool:
        """Return whether motions may be held, constraints begin, or jumps forget, where different ones become one."""
        return super().loses_rank or bool(self.switched)

    @property
    def needs_events(self) -> bool:
        """Return whether no steps follow motions but those that end at events, and are projected there."""
        return True

    @property
    def constrained(self) -> bool:
        """Return whether states are brought back to constraints, or to norms, after each step."""
        return bool(self.constraints or self.switched or self._norms)

    @property
    def begins(self) -> tuple[bool, ...]:
        """Return for each wall and surface whether a constraint begins there."""
        others = len(self.jumps) + self.switches - len(self.switched)
        return *(False,) * others, *(True,) * len(self.switched)

    @property
    def exponents(self) -> int:
        """Lyapunov exponents of motions that keep the constraints which hold at all times."""
        norms = [group for group in self._norms if not all(self.ignorable[i] for i in group)]
        return self.chart.dimension - self.constraints - len(norms)

    @property
    def chart(self) -> SwitchedChart:
        """Coordinates but for those that are ignorable, and all velocities."""
        left_out = (*self.ignorable, *(False,) * (len(self.names) - self.positions))
        kept = tuple(i for i, out in enumerate(left_out) if not out)
        positions = self.positions - sum(self.ignorable)
        return SwitchedChart(tuple(self.angles[i] for i in kept), positions, False, kept, len(self.names))

    # ---- motion

    def heights(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...] | None = None
    ) -> tuple[Number, ...]:
        """Heights of a state above the walls, the surfaces of switches, and those of constraints that come and go."""
        definition, (q, v) = self.definition(p), self._split(t, y.y, p)
        walls = [jump["when"](q, v, t) for jump in definition.get("jumps", ())]
        walls = [-wall if way == "down" else wall for wall, way in zip(walls, self.jumps, strict=True)]
        surfaces = [switch["on"](q, v, t) for switch in definition.get("switches", ())]
        holding = [each["when"](q, v, t) for each in definition.get("constraints", ())]
        return tuple(jnp.asarray(height, jnp.float64) for height in (*walls, *surfaces, *holding))

    def rates(self, y: Vector, t: ArrayLike, p: Parameters, sides: tuple[Number, ...]) -> Vector:
        """Rates of coordinates and velocities on these sides."""
        q, v = self._split(t, y, p)
        equations = self._equations(p, sides)
        solved = accelerations(equations, q, v, t, self._active(sides))
        zero = jnp.where(solved.singular, jnp.nan, jnp.zeros_like(q[0]))
        return tuple(zero + rate for rate in (*equations.rates(q, v, t), *self._free(solved.a)))

    def on_constraints(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state brought back to the constraints that hold, and to its norms, as `Lagrangian.project` does it."""
        drift, lost = y.watch
        q, v = self._split(t, y.y, p)
        for group in self._norms:
            square = sum(q[i] * q[i] for i in group)
            drift, inverse = jnp.maximum(drift, jnp.abs(square - 1.0)), 1.0 / jnp.sqrt(square)
            q = tuple(x * inverse if i in group else x for i, x in enumerate(q))
        reason = y.reason
        if self.constraints or self.switched:
            projection = project_velocities(self._equations(p, sides), q, v, t, self._active(sides))
            v, drift = projection.v, jnp.where(projection.drift > drift, projection.drift, drift)
            code = jnp.where(projection.left < LARGEST_DRIFT, 0.0, _OFF)
            code = jnp.where(projection.singular, _SINGULAR, code)
            reason = jnp.where(reason > 0.0, reason, code)
        moved = tuple(jnp.where(reason > 0.0, jnp.nan, x) for x in (*q, *self._free(v)))
        return PiecewisePoint(moved, *lax.stop_gradient((reason, (drift, lost))))

    def jumped(
        self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state after a jump, or where a constraint has begun."""
        if number >= len(self.jumps):
            return self.constrain(t, y, p, (*sides[:number], jnp.ones_like(sides[number]), *sides[number + 1 :]))
        jump, (q, v) = self.definition(p)["jumps"][number], self._split(t, y.y, p)
        if "then" in jump:
            return self._after_impulse(t, y, p, *jump["then"](q, v, t))
        return self._reflected(number, t, y, p, sides, lambda r: r)

    @property
    def has_linear_jumps(self) -> bool:
        """Return whether all jumps are impacts, which are linear in the velocities."""
        return all("restitution" in jump for jump in self.define(**self.values).get("jumps", ()))

    def jump_slopes(self, p: Parameters) -> list[Array]:
        """The restitution of each impact, by which it multiplies the speed away from its wall, as a matrix (1, 1)."""
        jumps = self.definition(p).get("jumps", ())
        return [jnp.reshape(jnp.asarray(jump["restitution"], jnp.float64), (1, 1)) for jump in jumps]

    def before_jump(
        self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state before an impact."""
        return self._reflected(number, t, y, p, sides, lambda r: 1.0 / r)

    def heights_before_jumps(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...] | None = None
    ) -> tuple[Number, ...]:
        """Heights, which an impact leaves as they are."""
        return self.heights(t, y, p, sides)

    def constrain(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """The state after the constraints that hold on these sides have begun."""
        if not self.switched:
            return self.on_constraints(t, y, p, sides)
        (q, v), equations, active = self._split(t, y.y, p), self._equations(p, sides), self._active(sides)
        return self._after_impulse(t, y, p, q, constrained_velocities(equations, q, v, t, active, linear=self.linear))

    def motion_at(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters
    ) -> tuple[Equations, Vector, Vector, tuple[Number, ...] | None]:
        """The equations of a lane, coordinates and all velocities of a state, and which constraints hold there."""
        sides = self.sides(t, y, p)
        return self._equations(p, sides), *self._split(t, y.y, p), self._active(sides)

    # ---- parts

    @property
    def _norms(self) -> tuple[tuple[int, ...], ...]:
        return self.quasi.norms if self.quasi else ()

    def _split(self, t: ArrayLike, y: Vector, p: Parameters) -> tuple[Vector, Vector]:
        """Coordinates and all velocities of a state."""
        q, v = tuple(y[: self.positions]), tuple(y[self.positions :])
        if self.quasi and self.quasi.dependent:
            v = self.mechanics.all_velocities(t, Motion(q, v, ()), p)
        return q, v

    def _reflected(
        self,
        number: int,
        t: ArrayLike,
        y: PiecewisePoint,
        p: Parameters,
        sides: tuple[Number, ...],
        of: Callable[[Number], Number],
    ) -> PiecewisePoint:
        """The state after an impact, with a function of the restitution in place of it."""
        jump, (q, v) = self.definition(p)["jumps"][number], self._split(t, y.y, p)
        wall, equations = jump["when"], self._equations(p, sides)
        reflected = reflected_velocities(equations, wall, of(jump["restitution"]), q, v, t, self._active(sides))
        return self._after_impulse(t, y, p, q, reflected)

    def _after_impulse(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, *after: Any) -> PiecewisePoint:
        """The state of other coordinates and velocities; the kinetic energy that it has lost is added up."""
        (q, v), zero = self._split(t, y.y, p), jnp.zeros_like(y.y[0])
        q_after, v_after = (tuple(jnp.asarray(x, jnp.float64) + zero for x in side) for side in after)
        moved = y._replace(y=(*q_after, *self._free(v_after)))
        if not y.watch:
            return moved
        T, (drift, lost) = self.definition(p)["T"], y.watch
        lost += T(q, v, t) - T(q_after, v_after, t)
        return moved._replace(watch=lax.stop_gradient((drift, lost)))

    def _free(self, v: Vector) -> Vector:
        """The velocities that are part of a state."""
        return tuple(x for j, x in enumerate(v) if not (self.quasi and j in self.quasi.dependent))

    def _equations(self, p: Parameters, sides: tuple[Number, ...]) -> Equations:
        """T, Q and all constraints of a lane on these sides."""
        definition = self.definition(p)
        first, count = len(self.jumps), len(definition.get("switches", ()))
        return _equations(definition, self.quasi, sides[first : first + count] if count else None)

    def _active(self, sides: tuple[Number, ...]) -> tuple[Number, ...] | None:
        """1 or 0 for each equation of the constraints."""
        if not self.switched:
            return None
        weights = [jnp.where(side > 0.0, 1.0, 0.0) for side in sides[len(sides) - len(self.switched) :]]
        repeated = [weight for weight, count in zip(weights, self.switched, strict=True) for _ in range(count)]
        return *(1.0,) * self.permanent, *repeated

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> PiecewisePoint:
        """The state with coordinates and velocities by name."""
        point = super().start(coordinates)
        return point._replace(watch=(np.zeros_like(point.reason),) * 2)

    def as_motion(self, y: PiecewisePoint) -> Motion:
        """A state as one of `mechanics`."""
        return Motion(y.y[: self.positions], y.y[self.positions :], (y.watch[0], y.reason))

    def from_motion(self, y: Motion) -> PiecewisePoint:
        """The state of one of `mechanics` that has lost no energy yet."""
        drift, reason = y.watch
        return PiecewisePoint((*y.q, *y.v), reason, (drift, np.zeros_like(drift)))

    @property
    def readout(self) -> PiecewiseReadout:
        """Coordinates and velocities as the definition calls them."""
        return SwitchedReadout(self)


@dataclass(frozen=True)
class SwitchedReadout(PiecewiseReadout):
    """States of a mechanical system with events, as those of the system without."""

    flow: SwitchedMechanics

    @property
    def labels(self) -> Labels:
        return self.flow.mechanics.readout.labels

    def coordinates(self, y: PiecewisePoint, t: np.ndarray) -> dict[str, Output]:
        return self.flow.mechanics.readout.coordinates(self.flow.as_motion(y), t)

    def reports(self, y: PiecewisePoint) -> dict[str, Output]:
        """Return drift, energy lost in impulses and status of each trajectory, from states (..., points)."""
        drift, lost = (np.asarray(number)[..., -1] for number in y.watch)
        words = "kinetic energy lost in impacts and where constraints begin, since the start"
        reports = {"energy_lost": Output(lost, words, {"units": UNSAID}), **super().reports(y)}
        if not self.flow.constrained:
            return reports
        words = "largest |f| that a step left before its projection"
        return {"drift": Output(drift, words, {"units": UNSAID}), **reports}


def _equations(definition: Definition, quasi: QuasiVelocities | None, side: Any = None) -> Equations:
    """The equations of a definition with all its constraints, those that come and go after the others."""
    permanent, switched = definition.get("f"), definition.get("constraints", ())
    every = [*([] if permanent is None else [permanent]), *(each["constraint"] for each in switched)]
    forces = definition["Q"]
    if side is not None:
        forces = lambda q, v, t: definition["Q"](q, v, t, side)  # noqa: E731
    f = (lambda q, v, t: tuple(x for each in every for x in each(q, v, t))) if every else None
    return equations_of({**definition, "Q": forces, "f": f}, quasi)


def switched_mechanics(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> SwitchedMechanics:
    """The system that a function of its parameters defines.

    Args:
        define: as of `lagrangian`, with `jumps`, each a mapping of `when`, the height (q, v, t) to a number, its
            `direction`, and `then`, (q, v, t) to the coordinates and the velocities after the jump, or `restitution`, a
            number; `switches`, each a mapping of `on`, the height of a surface, of which `Q` then reads the sides in a
            fourth argument; and `constraints` that come and go, each a mapping of `constraint`, (q, v, t) to the
            numbers that are zero, and `when`, the height that is positive while it holds.
        parameters, of_lanes: as of `lagrangian`.

    Raises:
        InputError: as of `lagrangian`.
    """
    definition, mechanics = define(**parameters), lagrangian(define, parameters, of_lanes)
    names, quasi, k = mechanics.names, mechanics.quasi, len(mechanics.names)
    jumps, switches = definition.get("jumps", ()), definition.get("switches", ())
    n = len(quasi.everything) if quasi else k
    zeros = ((jnp.zeros(()),) * k, (jnp.zeros(()),) * n, jnp.zeros(()))

    def count(f: Any) -> int:
        return len(jax.eval_shape(lambda *at: tuple(f(*at)), *zeros))

    switched = tuple(count(each["constraint"]) for each in definition.get("constraints", ()))
    return SwitchedMechanics(
        define,
        dict(parameters),
        of_lanes,
        (*names, *mechanics.velocities),
        (*mechanics.angles, *(False,) * len(mechanics.velocities)),
        mechanics.clock,
        tuple(jump["direction"] for jump in jumps),
        len(switches) + len(switched),
        (
            *(bool(jump.get("rest", False)) for jump in jumps),
            *(bool(switch.get("sliding", False)) for switch in switches),
            *(False,) * len(switched),
        ),
        any("then" in jump for jump in jumps),
        (),
        positions=k,
        ignorable=mechanics.ignorable,
        constraints=mechanics.constraints,
        permanent=count(definition["f"]) if definition.get("f") is not None else 0,
        switched=switched,
        linear=_is_linear(define, parameters, k, n),
        quasi=quasi,
    )


def _is_linear(define: Callable[..., Definition], parameters: Mapping[str, float], k: int, n: int) -> bool:
    """Return whether all constraints of a definition are linear in the velocities, which their slopes say."""

    def slopes(v: Any, q: Any, t: Any, p: Any) -> Any:
        equations = _equations(define(**p), None)
        return constraint_slopes(equations, (*q, *v, t), k) if equations.f else []

    program = Program(slopes, (0.0,) * n, (0.0,) * k, 0.0, dict(parameters))
    return not program.output_depends([1] * n + [0] * (len(program.inputs) - n))
