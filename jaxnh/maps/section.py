"""A flow without a clock seen on a section: the states at which one of its positions passes a value.

The section takes the part of the strobe: `event.EventStrobe` is its map. Without forcing and disturbance the flow at
constant speed keeps a volume: its divergence −n·F/s is a time derivative, d(V/c)/dt with F = −grad V. Exponents then
come in pairs ±λ about zero (Dettmann and Morriss, Phys. Rev. E 53 (1996) R5545), and no orbit is attracting.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.systems.lagrangian import FAULTS, NonholonomicSystem
from jaxnh.systems.particle import IsokineticParticle

NOT_FINITE, NO_RETURN = FAULTS.index("not_finite"), len(FAULTS)
"""Why a lane has failed here, continuing `mechanics.FAULTS`."""

Flow = IsokineticParticle | NonholonomicSystem


class Crossing(NamedTuple):
    """A state on the section, or the start state on its way there.

    Attributes:
        state: of the flow.
        t: time since the start.
        reason: why the lane has failed, else zero.
    """

    state: Any
    t: Any
    reason: Any


class SectionedFlow(eqx.Module):
    """A flow without a clock and a section of it.

    Attributes:
        flow: the flow.
        coordinate, number: name and number of the position that decides.
        value: where it does.
        direction: "up" or "down", in which it passes the value, or "both".
    """

    flow: Flow
    coordinate: str = eqx.field(static=True)
    number: int = eqx.field(static=True)
    value: float = eqx.field(static=True)
    direction: str = eqx.field(static=True)

    def height(self, state: Any) -> Any:
        """How far a state of the flow is from the section: above zero after a passage up, or down if that is wanted."""
        above = state[0][self.number] - self.value
        return -above if self.direction == "down" else above

    def rate(self, state: Any, lane: ArrayLike) -> Any:
        """Its time derivative."""
        rate = self.flow.vector_field(jnp.zeros_like(state[0][0]), state, lane)[0][self.number]
        return -rate if self.direction == "down" else rate

    @property
    def words(self) -> str:
        """The section in words."""
        return f"{self.coordinate} = {self.value:g}, {self.direction}"

    # ---- what every system has

    @property
    def dimension(self) -> int:
        """Coordinates of the section."""
        return self.flow.dimension - 1

    @property
    def exponents(self) -> int:
        """Lyapunov exponents of the flow, that along it included."""
        return self.flow.exponents

    @property
    def sweeps(self) -> str:
        """What differs from lane to lane, in words and with its symbol."""
        return self.flow.sweeps

    @property
    def period(self) -> float:
        """Unit that steps and lengths of time are counted in."""
        return self.flow.period

    def signal(self, crossing: Crossing) -> Any:
        """A position that stands for a motion where one is enough."""
        return crossing.state[0][1 if self.number == 0 else 0]

    def chart(self, crossing: Crossing) -> Array:
        """Coordinates of a point on the section, (dimension,)."""
        u = self.flow.chart(crossing.state)
        return jnp.concatenate([u[: self.number], u[self.number + 1 :]])

    def unchart(self, u: Array) -> Crossing:
        """The point with these coordinates, at t = 0."""
        zero = jnp.zeros_like(u[0])
        value = jnp.full_like(u[:1], self.value)
        return Crossing(self.flow.unchart(jnp.concatenate([u[: self.number], value, u[self.number :]])), zero, zero)

    def wrap(self, difference: Any) -> Any:
        """A difference of section coordinates (..., dimension), its angles in [−π, π)."""
        xp = np if isinstance(difference, np.ndarray) else jnp
        return xp.delete(self.flow.wrap(self._whole(difference)), self.number, axis=-1)

    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Largest difference of positions between section points (..., dimension): (...,)."""
        return self.flow.apart(self._whole(one), self._whole(other))

    def section_point(self, start: Crossing) -> np.ndarray:
        """(dimension,) coordinates of a point of floats."""
        return np.delete(self.flow.section_point(start.state), self.number)

    def random_states(self, draws: np.ndarray, box: float, b: np.ndarray) -> Crossing:
        """Start states of even draws (lanes, dimension + 1) from [−1, 1], none of them on the section."""
        return Crossing(self.flow.random_states(draws, box, b), np.zeros(len(b)), np.zeros(len(b)))

    def outputs(self, states: Crossing, t: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
        """Coordinates and velocities of states by name, and when they are met."""
        del t
        return {**self.flow.outputs(states.state, np.zeros(1)), "t": (states.t, "time since the start")}

    def reports(self, states: Crossing) -> dict[str, tuple[np.ndarray, str, dict[str, Any]]]:
        """What the flow reports, and why a trajectory has failed: the section may be one more reason."""
        found = self.flow.reports(states.state)
        reason = np.asarray(states.reason)[..., -1].astype(np.int8)
        if "failure" in found:
            reason = np.where(reason == NO_RETURN, reason, found["failure"][0])
        flags = {
            "flag_values": np.arange(NO_RETURN + 1, dtype=np.int8),
            "flag_meanings": " ".join((*FAULTS, "no_return")),
        }
        return {**found, "failure": (reason, "why the trajectory has failed", flags)}

    def _whole(self, u: Any) -> Any:
        """Section coordinates (..., dimension) as those of the flow."""
        xp = np if isinstance(u, np.ndarray) else jnp
        return xp.insert(u, self.number, 0.0, axis=-1)
