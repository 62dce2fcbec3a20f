"""A flow without a clock seen on a section: the states at which one of its positions passes a value.

The section takes the part of the strobe: `crossings.EventStrobe` is its map. Without forcing and disturbance the flow
at constant speed keeps a volume: its divergence −n·F/s is a time derivative, d(V/c)/dt with F = −grad V. Exponents then
come in pairs ±λ about zero (Dettmann and Morriss, Phys. Rev. E 53 (1996) R5545), and no orbit is attracting.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.systems.flow import FAULTS, Flow, Output, Parameters, State, Vector

NOT_FINITE, NO_RETURN = FAULTS.index("not_finite"), len(FAULTS)
"""Why a lane has failed here, continuing `flow.FAULTS`."""


LONGEST = 200.0
"""Time without a crossing after which a lane has failed, in units of the flow's own, where nothing is said."""


class Crossing(NamedTuple):
    """A state on the section, or the start state on its way there.

    Attributes:
        state: of the flow.
        t: time since the start.
        reason: why the lane has failed, else zero.
    """

    state: State
    t: Any
    reason: Any


class SectionedFlow(Flow):
    """A flow without a clock and a section of it.

    Attributes:
        inner: the flow.
        coordinate, number: name and number of the position that decides.
        value: where it does.
        direction: "up" or "down", in which it passes the value, or "both".
        normal: where not one position but a plane decides, its normal over the positions; `number` is that of its
            largest component, which the other coordinates then give.
        title: the plane in words.
        longest: time without a crossing after which a lane has failed, in units of the flow's own.
    """

    inner: Flow
    coordinate: str = eqx.field(static=True)
    number: int = eqx.field(static=True)
    value: float = eqx.field(static=True)
    direction: str = eqx.field(static=True)
    normal: tuple[float, ...] | None = eqx.field(static=True, default=None)
    longest: float = eqx.field(static=True, default=LONGEST)
    title: str = eqx.field(static=True, default="")

    def across(self, y: State) -> Any:
        """The component across the section of a state of the flow, of its rate or of a tangent of it."""
        if self.normal is None:
            return y[0][self.number]
        return sum(weight * x for weight, x in zip(self.normal, y[0], strict=True) if weight)

    def height(self, y: State) -> Any:
        """How far a state of the flow is from the section: above zero after a passage up, or down if that is wanted."""
        above = self.across(y) - self.value
        return -above if self.direction == "down" else above

    def rate(self, y: State, p: Parameters) -> Any:
        """Its time derivative."""
        rate = self.across(self.inner.rhs(jnp.zeros_like(y[0][0]), y, p))
        return -rate if self.direction == "down" else rate

    @property
    def section(self) -> str:
        """The section in words."""
        return f"{self.title or self.coordinate} = {self.value:g}, {self.direction}"

    @property
    def flow(self) -> Flow:
        """The flow that it is a section of."""
        return self.inner

    # ---- as every flow

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Those of the flow."""
        return self.inner.coordinates

    @property
    def parameters(self) -> Parameters:
        """Those of the flow."""
        return self.inner.parameters

    def words(self, name: str) -> str:
        """As the flow says."""
        return self.inner.words(name)

    def units(self, name: str) -> str:
        """As the flow says."""
        return self.inner.units(name)

    @property
    def plane(self) -> tuple[str, str]:
        """The first plane of the flow that does not have the coordinate that the section gives, or has it second."""
        first, second = self.inner.plane
        fallback = (second, first) if self.coordinate == first else (first, second)
        return next((pair for pair in self.inner.planes if self.coordinate not in pair), fallback)

    @property
    def period(self) -> float:
        """Unit that steps and lengths of time are counted in."""
        return self.inner.period

    @property
    def autonomous(self) -> bool:
        """As the flow."""
        return self.inner.autonomous

    def shares(self, name: str) -> bool:
        """As the flow."""
        return self.inner.shares(name)

    def rhs(self, t: ArrayLike, y: Crossing, p: Parameters) -> Crossing:
        """Time derivative of a crossing's state, of its time and of its reason."""
        rate = self.inner.rhs(t, y.state, p)
        return Crossing(rate, jnp.ones_like(rate[0][0]), jnp.zeros_like(rate[0][0]))

    @property
    def own(self) -> tuple[str, ...]:
        """As the flow."""
        return self.inner.own

    def divergence(self, t: ArrayLike, y: Crossing, p: Parameters) -> Any:
        """That of the flow at the crossing's state."""
        return self.inner.divergence(t, y.state, p)

    def project(self, t: ArrayLike, y: Crossing, p: Parameters) -> Crossing:
        """The crossing with its state brought back to the constraints of the flow."""
        return y._replace(state=self.inner.project(t, y.state, p))

    def compared(self, y: Crossing) -> tuple[State, Any]:
        """What is compared of a state of the flow, and the time of the crossing."""
        return self.inner.compared(y.state), y.t

    @property
    def dimension(self) -> int:
        """Coordinates of the section."""
        return self.inner.dimension - 1

    @property
    def exponents(self) -> int:
        """Lyapunov exponents of the flow, that along it included."""
        return self.inner.exponents

    def signal(self, y: Crossing) -> Vector:
        """The first position that the section does not fix."""
        return (y.state[0][1 if self.number == 0 else 0],)

    def chart(self, y: Crossing) -> Float[Array, " dimension"]:
        """Coordinates of a point on the section."""
        u = self.inner.chart(y.state)
        return jnp.concatenate([u[: self.number], u[self.number + 1 :]])

    def unchart(self, u: Float[Array, " dimension"]) -> Crossing:
        """The point with these coordinates, at t = 0."""
        zero = jnp.zeros_like(u[0])
        value = jnp.full_like(u[:1], self.value)
        if self.normal is not None:
            others = [weight for i, weight in enumerate(self.normal) if i != self.number]
            value = (value - sum(w * u[i] for i, w in enumerate(others) if w)) / self.normal[self.number]
        return Crossing(self.inner.unchart(jnp.concatenate([u[: self.number], value, u[self.number :]])), zero, zero)

    def wrap(self, difference: Any) -> Any:
        """A difference of section coordinates (..., dimension), its angles in [−π, π)."""
        xp = np if isinstance(difference, np.ndarray) else jnp
        return xp.delete(self.inner.wrap(self._whole(difference)), self.number, axis=-1)

    @property
    def dimensionless(self) -> bool:
        """As the flow says."""
        return self.inner.dimensionless

    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Largest difference of positions between section points (..., dimension): (...,)."""
        return self.inner.apart(self._whole(one), self._whole(other))

    def directions(self, k: int) -> tuple[Vector, ...]:
        """The first k coordinate directions of the section."""
        return tuple(tuple(row.tolist()) for row in np.eye(self.dimension)[:k])

    def lift(self, y: Crossing, tangent: Vector) -> Crossing:
        """The tangent of a crossing with these section coordinates, which keeps to the section and to its time."""
        across = jnp.zeros_like(tangent[0])
        if self.normal is not None:
            others = [weight for i, weight in enumerate(self.normal) if i != self.number]
            across -= sum(w * v for w, v in zip(others, tangent, strict=False) if w) / self.normal[self.number]
        state = self.inner.lift(y.state, (*tangent[: self.number], across, *tangent[self.number :]))
        return Crossing(state, jnp.zeros_like(across), jnp.zeros_like(across))

    def lower(self, y: Crossing, tangent: Crossing) -> Vector:
        """Section coordinates of a tangent of a crossing."""
        lowered = self.inner.lower(y.state, tangent.state)
        return (*lowered[: self.number], *lowered[self.number + 1 :])

    def start(self, coordinates: Mapping[str, ArrayLike]) -> Crossing:
        """The state at t = 0, on its way to the section."""
        state = self.inner.start(coordinates)
        zero = np.zeros_like(state[0][0])
        return Crossing(state, zero, zero)

    def section_point(self, y: Crossing) -> Float[np.ndarray, "... dimension"]:
        """Section coordinates of points (...,) on the host."""
        return np.delete(self.inner.section_point(y.state), self.number, axis=-1)

    def random_states(self, draws: np.ndarray, box: float, p: Parameters) -> Crossing:
        """Start states of even draws (lanes, dimension + 1) from [−1, 1], none of them on the section."""
        return Crossing(self.inner.random_states(draws, box, p), np.zeros(len(draws)), np.zeros(len(draws)))

    def outputs(self, y: Crossing, t: np.ndarray) -> dict[str, Output]:
        """Coordinates and velocities of states by name, and when they are met."""
        del t
        t_found = Output(y.t, "time since the start", {"units": self.inner.units("t")})
        return {**self.inner.outputs(y.state, np.zeros(1)), "t": t_found}

    def reports(self, y: Crossing) -> dict[str, Output]:
        """What the flow reports, and why a trajectory has failed: the section may be one more reason."""
        found = self.inner.reports(y.state)
        reason = np.asarray(y.reason)[..., -1].astype(np.int8)
        if "failure" in found:
            inner = np.asarray(found["failure"].data)
            reason = np.where((reason == NO_RETURN) | (inner == 0), reason, inner)
        flags = {
            "flag_values": np.arange(NO_RETURN + 1, dtype=np.int8),
            "flag_meanings": " ".join((*FAULTS, "no_return")),
        }
        return {**found, "failure": Output(reason, "why the trajectory has failed", flags)}

    def _whole(self, u: Any) -> Any:
        """Section coordinates (..., dimension) as those of the flow."""
        xp = np if isinstance(u, np.ndarray) else jnp
        return xp.insert(u, self.number, 0.0, axis=-1)
