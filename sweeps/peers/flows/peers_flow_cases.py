"""The flows that contestants of `sweeps.peers.flows.peers_flows` are measured on, each written once for all of them. No
integrator.

Equations are functions of a namespace with `sin` and `cos`, so that heyoka and JAX read the same lines. Systems that
jaxnh takes as T, Q and f stand here with their accelerations solved by hand, as heyoka and diffrax need them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sweeps.peers.particle.peers_scene import TangentTruth

LANES = 256
"""Values of the parameter of a flow."""

Field = Callable[[Any, Any, Any, Any], tuple[Any, ...]]
"""(namespace, state, forcing, parameter) to the rates of the state."""


class FlowCase(NamedTuple):
    """A flow, and the lanes that it is integrated from.

    Attributes:
        name: of the flow.
        words: its equations, for the page.
        field: they, of components as `start` has them.
        forcing: "sin" or "cos" of t; empty of a flow without a clock.
        parameter, low, high: what lanes differ in, and its range.
        start: start state.
    """

    name: str
    words: str
    field: Field
    forcing: str
    parameter: str
    low: float
    high: float
    start: tuple[float, ...]

    @property
    def period(self) -> float:
        """Of the forcing; without a clock a unit of time."""
        return 2.0 * math.pi if self.forcing else 1.0

    @property
    def values(self) -> np.ndarray:
        """(LANES,) values of the parameter."""
        return np.linspace(self.low, self.high, LANES)


@dataclass(frozen=True)
class FlowScene(TangentTruth):
    """Lanes of a flow and what is true of them, as `peers_scene.TangentTruth` says.

    Attributes:
        name: of the flow, by which processes find it.
    """

    name: str
    b: np.ndarray
    states: np.ndarray
    ends: np.ndarray
    derivatives: np.ndarray

    @property
    def case(self) -> FlowCase:
        """The flow."""
        return CASES[self.name]

    @property
    def period(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of its clock, or a unit of time."""
        return self.case.period


def _duffing(m: Any, y: Any, g: Any, drive: Any) -> tuple[Any, ...]:
    x, v = y
    return v, drive * g + x - x * x * x - 0.2 * v


def _pendulum(m: Any, y: Any, g: Any, drive: Any) -> tuple[Any, ...]:
    angle, rate = y
    return rate, drive * g - m.sin(angle) - 0.2 * rate


def _governor(m: Any, y: Any, g: Any, drive: Any) -> tuple[Any, ...]:
    x, v, slide = y
    rise = 0.5 * (v * v - 0.5)
    force = drive * g + x - x * x * x - 0.2 * v
    return v, (force - v * (slide + 0.2 * rise)) / (1.0 + v * v), rise


def _lorenz(m: Any, y: Any, g: Any, rho: Any) -> tuple[Any, ...]:
    x, y_, z = y
    return 10.0 * (y_ - x), x * (rho - z) - y_, x * y_ - (8.0 / 3.0) * z


def _roessler(m: Any, y: Any, g: Any, c: Any) -> tuple[Any, ...]:
    x, y_, z = y
    return -y_ - z, x + 0.2 * y_, 0.2 + z * (x - c)


def _double_pendulum(m: Any, y: Any, g: Any, ratio: Any) -> tuple[Any, ...]:
    upper, lower, v, w = y
    sine, cosine = m.sin(upper - lower), m.cos(upper - lower)
    first = -(1.0 + ratio) * m.sin(upper) - ratio * (sine * (w * w))
    second = sine * (v * v) - m.sin(lower)
    turn = (first - ratio * (cosine * second)) / (1.0 + ratio * (sine * sine))
    return v, w, turn, second - cosine * turn


CASES: dict[str, FlowCase] = {
    case.name: case
    for case in (
        FlowCase("duffing", "x'' = γ cos t + x − x³ − 0.2 x'", _duffing, "cos", "gamma", 0.2, 0.5, (0.5, 0.0)),
        FlowCase("pendulum", "φ'' = γ cos t − sin φ − 0.2 φ'", _pendulum, "cos", "gamma", 0.5, 2.0, (0.1, 0.1)),
        FlowCase(
            "governor",
            "`configs/governor.yaml`, by T, Q and f; for the others a velocity is eliminated by hand",
            _governor,
            "sin",
            "drive",
            0.77,
            0.87,
            (0.5, 0.0, 0.0),
        ),
        FlowCase("lorenz", "σ = 10, β = 8/3; a unit of time", _lorenz, "", "rho", 28.0, 100.0, (1.0, 1.0, 20.0)),
        FlowCase("roessler", "a = b = 0.2; a unit of time", _roessler, "", "c", 2.5, 6.0, (1.0, 1.0, 0.0)),
        FlowCase(
            "double_pendulum",
            "equal arms, g = 1, by T and Q; for the others solved by hand; a unit of time",
            _double_pendulum,
            "",
            "ratio",
            0.5,
            1.5,
            (2.0, 2.5, 0.0, 0.0),
        ),
    )
}
"""By name."""
