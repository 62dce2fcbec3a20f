"""Sections of a flow without a clock: the states at which a position, or a sum of several, passes a value.

A section is a plane of a flow's phase space, with a chart of its own; it takes the part of the strobe, and
`crossings.EventStrobe` is its map. Without forcing and disturbance the flow at constant speed keeps a volume: its
divergence −n·F/s is a time derivative, d(V/c)/dt with F = −grad V. Exponents then come in pairs ±λ about zero (Dettmann
and Morriss, Phys. Rev. E 53 (1996) R5545), and no orbit is attracting.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxnh.maps.limits import LONGEST_RETURN
from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.readout import Output, status
from jaxnh.systems.state import Number, State, Vector, error_components
from jaxnh.systems.status import NO_RETURN


class Crossing(NamedTuple):
    """A state on the section, or the start state on its way there.

    Attributes:
        state: of the flow.
        t: time since the start, that of the motion: less than zero back in time, whatever steps it is followed by.
        reason: why the lane has failed, else zero.
    """

    state: State
    t: Any
    reason: Any


@error_components.register
def _(y: Crossing) -> tuple[State, Any]:
    return error_components(y.state), y.t


class Section(eqx.Module):
    """A section of a flow without a clock.

    Attributes:
        flow: the flow.
        coordinate, number: name and number of the position that decides.
        value: where it does.
        direction: "up" or "down", in which it passes the value, or "both".
        normal: where not one position but a plane decides, its normal over the positions; `number` is that of its
            largest component, which the other coordinates then give.
        title: the plane in words.
        longest: time without a crossing after which a lane has failed, in units of the flow's own.
    """

    flow: Flow
    coordinate: str = eqx.field(static=True)
    number: int = eqx.field(static=True)
    value: float = eqx.field(static=True)
    direction: str = eqx.field(static=True)
    normal: tuple[float, ...] | None = eqx.field(static=True, default=None)
    longest: float = eqx.field(static=True, default=LONGEST_RETURN)
    title: str = eqx.field(static=True, default="")

    def across(self, y: State) -> Number:
        """The component across the section of a state of the flow, of its rate or of a tangent of it."""
        if self.normal is None:
            return y[0][self.number]
        return sum(weight * x for weight, x in zip(self.normal, y[0], strict=True) if weight)

    @property
    def turn(self) -> float:
        """Period of values across the section: 2π of an angle, a multiple of it of angles of whole weights; else 0."""
        normal = self.normal or tuple(float(k == self.number) for k in range(self.number + 1))
        weights = [(weight, angle) for weight, angle in zip(normal, self.flow.chart.angles, strict=False) if weight]
        if not all(angle and float(weight).is_integer() for weight, angle in weights):
            return 0.0
        return 2.0 * math.pi * math.gcd(*(int(weight) for weight, _ in weights))

    def height(self, y: State) -> Number:
        """Signed distance of a state from the section: above zero after a passage up (down if that is wanted)."""
        return self.heights(y, y)[0]

    def heights(self, before: State, after: State) -> tuple[Number, Number]:
        """Heights at the ends of a step of less than a whole turn; of an angle above the turn that is nearest to it."""
        ends = self.across(before) - self.value, self.across(after) - self.value
        if self.turn:
            whole = self.turn * jnp.round(0.5 * (ends[0] + ends[1]) / self.turn)
            ends = ends[0] - whole, ends[1] - whole
        return (-ends[0], -ends[1]) if self.direction == "down" else ends

    def smooth_height(self, y: State) -> Number:
        """A smooth function with the zeros of the height; of an angle it rises on one turn and falls on the next."""
        if not self.turn:
            return self.height(y)
        above = self.turn / np.pi * jnp.sin(np.pi / self.turn * (self.across(y) - self.value))
        return -above if self.direction == "down" else above

    def slope(self, y: State) -> Number:
        """Slope of the smooth height over the height, on the section 1 or −1."""
        if not self.turn:
            return jnp.ones_like(self.across(y))
        return jnp.cos(np.pi / self.turn * (self.across(y) - self.value))

    def rate(self, y: State, p: Parameters) -> Number:
        """Time derivative of the height of a state of the flow."""
        rate = self.across(self.flow.rhs(jnp.zeros_like(y[0][0]), y, p))
        return -rate if self.direction == "down" else rate

    @property
    def description(self) -> str:
        """The section in words."""
        return f"{self.title or self.coordinate} = {self.value:g}, {self.direction}"

    @property
    def chart(self) -> SectionChart:
        """Section coordinates of crossings: those of the flow but for the one that the section gives."""
        whole = self.flow.chart
        angles = whole.angles[: self.number] + whole.angles[self.number + 1 :]
        section = self.number, self.value, self.normal
        return SectionChart(angles, whole.positions - 1, whole.dimensionless, whole, *section)


System = Flow | Section
"""The system of a return map: its chart is `system.chart`, the flow in continuous time `flow_of(system)`."""


def flow_of(system: System) -> Flow:
    """The flow of a system in continuous time: itself, or that of its section."""
    return system.flow if isinstance(system, Section) else system


class SectionChart(Chart):
    """Section coordinates of crossings.

    Attributes:
        whole: the chart of the flow.
        number: of its coordinate that the section gives.
        value, normal: of the section.
    """

    whole: Chart
    number: int = eqx.field(static=True)
    value: float = eqx.field(static=True)
    normal: tuple[float, ...] | None = eqx.field(static=True)

    def components(self, y: Crossing) -> Vector:
        return self._without(self.whole.components(y.state))

    def point(self, y: Crossing) -> Any:
        u = self.whole.point(y.state)
        return jnp.concatenate([u[: self.number], u[self.number + 1 :]])

    def state(self, u: Number) -> Crossing:
        """The point with these coordinates, at t = 0."""
        zero = jnp.zeros_like(u[0])
        value = jnp.full_like(u[:1], self.value)
        if self.normal is not None:
            others = self._without(self.normal)
            value = (value - sum(w * u[i] for i, w in enumerate(others) if w)) / self.normal[self.number]
        return Crossing(self.whole.state(jnp.concatenate([u[: self.number], value, u[self.number :]])), zero, zero)

    def lift(self, y: Crossing, tangent: Vector) -> Crossing:
        """The tangent of a crossing with these section coordinates, which keeps to the section and to its time."""
        across = jnp.zeros_like(tangent[0])
        if self.normal is not None:
            others = self._without(self.normal)
            across -= sum(w * v for w, v in zip(others, tangent, strict=False) if w) / self.normal[self.number]
        state = self.whole.lift(y.state, (*tangent[: self.number], across, *tangent[self.number :]))
        return Crossing(state, jnp.zeros_like(across), jnp.zeros_like(across))

    def lower(self, y: Crossing, tangent: Crossing) -> Vector:
        return self._without(self.whole.lower(y.state, tangent.state))

    def _without(self, components: tuple[Any, ...]) -> tuple[Any, ...]:
        """Components of the flow's, that which the section gives left out."""
        return *components[: self.number], *components[self.number + 1 :]


def with_parameters(system: System, values: Parameters) -> System:
    """Return a system with other values of some parameters of its flow, of the same structure."""
    flow = flow_of(system).with_parameters(values)
    return replace(system, flow=flow) if isinstance(system, Section) else flow


# ---- states of a flow, or crossings of a section of it


def begin(system: System, state: State) -> State:
    """Start states of a flow, on the host; of a section on their way there."""
    if not isinstance(system, Section):
        return state
    zero = np.zeros_like(state[0][0])
    return Crossing(state, zero, zero)


def rates(system: System, y: State, p: Parameters) -> Vector:
    """Rates of the section coordinates at a state along the flow, which has no clock or is at t = 0."""
    if not isinstance(system, Section):
        return system.chart.lower(y, system.rhs(jnp.zeros_like(y[0][0]), y, p))
    zero = jnp.zeros_like(y.t)
    return system.chart.lower(y, Crossing(system.flow.rhs(zero, y.state, p), zero + 1.0, zero))


def outputs(flow: Flow, y: State, t: np.ndarray) -> dict[str, Output]:
    """Coordinates and velocities of states by name; of crossings also when they are met.

    Args:
        y: states of the flow, at times t that repeat along their last axis; or crossings.
    """
    if not isinstance(y, Crossing):
        return flow.readout.coordinates(y, t)
    met = Output(y.t, "time since the start", {"units": flow.readout.labels.units["t"]})
    return {**flow.readout.coordinates(y.state, np.zeros(1)), "t": met}


def reports(flow: Flow, y: State) -> dict[str, Output]:
    """Return the status of each trajectory, which may have failed to return to the section."""
    if not isinstance(y, Crossing):
        return flow.readout.reports(y)
    of_flow = flow.readout.reports(y.state)
    reason = np.asarray(y.reason)[..., -1].astype(np.int8)
    inner = np.asarray(of_flow["status"].data)
    return {**of_flow, "status": status(np.where((reason == NO_RETURN) | (inner == 0), reason, inner))}


def plot_plane(system: System) -> tuple[str, str]:
    """The two coordinates that motions are drawn over: of a section the first pair without the one that it gives."""
    planes = flow_of(system).readout.labels.planes
    if not isinstance(system, Section):
        return planes[0]
    first, second = planes[0]
    fallback = (second, first) if system.coordinate == first else (first, second)
    return next((pair for pair in planes if system.coordinate not in pair), fallback)
