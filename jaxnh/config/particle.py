"""Sections of a config for the paper's particle: its constraint and parameters, start, sweep, and what is left out."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, field_validator, model_validator

from jaxnh.config.blocks import Grid, Section
from jaxnh.config.messages import close_match, rule, shown
from jaxnh.maps.section import Flow, SectionedFlow
from jaxnh.systems.free_particle import FreeParticle, free_particle
from jaxnh.systems.lagrangian import Motion
from jaxnh.systems.particle import EFFECTS, IsokineticParticle, constant_speed, disturbed_speed, strobe_period

_START_Y2 = math.sqrt(0.99)  # of the paper's start, at its speed of one
_SHARED = {"c": "the squared speed", "d": "the disturbance", "omega": "the frequency of the forcing"}


# ---- system


class PlanarSystem(Section):
    """A particle in the plane under the paper's forces."""

    constraint: str = Field(description="Constraint on the speed")
    a: float = Field(default=0.5, description="Linear stiffness of x1 and cubic stiffness of y1")
    b: float | None = Field(default=None, description="Coupling, where a is swept")
    omega: float = Field(default=1.0, gt=0, description="Angular frequency of the forcing 1 + sin(omega t)")
    without: tuple[str, ...] | None = Field(
        default=None,
        strict=False,
        description=f"Effects that are left out, of {', '.join(EFFECTS)}; without forcing 2 pi/omega is a unit of time",
        json_schema_extra={"items": {"enum": list(EFFECTS)}},
    )

    _swept: str = PrivateAttr(default="b")

    @field_validator("without")
    @classmethod
    def _known(cls, without: tuple[str, ...] | None) -> tuple[str, ...] | None:
        """Effects in one order, each once; none is nothing."""
        for name in without or ():
            if name not in EFFECTS:
                message = (
                    f"there are the effects {', '.join(EFFECTS)}, and no {shown(name)}{close_match(name, EFFECTS)}"
                )
                if name in ("disturbance", "constraint"):
                    other = "d: 0 leaves the disturbance" if name == "disturbance" else "constraint: free leaves it"
                    message = f"of {name} another key decides: {other} out"
                raise rule(message)
        return tuple(sorted(set(without or ()))) or None

    @property
    def effects_left_out(self) -> frozenset[str]:
        """Those named, of `systems.EFFECTS`."""
        return frozenset(self.without or ())

    def prepare(self, swept: str) -> None:
        """Take note of the parameter that is swept, and see that the others fit."""
        uncoupled = "coupling" in self.effects_left_out
        if swept == "b" and uncoupled:
            raise rule("the coupling is left out, and there is no b to sweep; sweep a", "sweep.b", "system.without")
        if swept in self.model_fields_set and getattr(self, swept) is not None:
            raise rule(f"{swept} is swept; leave it out of system", f"system.{swept}", f"sweep.{swept}")
        if uncoupled and self.b is not None:
            raise rule("the coupling is left out; leave b out as well", "system.b", "system.without")
        if swept == "a" and not uncoupled and self.b is None:
            raise rule("a is swept, and b must be given (Coupling b)", "system.b", "sweep.a", "system")
        self._swept = swept

    def build(self) -> Flow:
        """The system with these parameters."""
        raise NotImplementedError

    def exponents(self, sweep: Any) -> int:
        """How many Lyapunov exponents there are."""
        return self.build().exponents

    def _others(self) -> dict[str, Any]:
        """What every particle at a prescribed speed has besides the paper's parameters."""
        return {"b": self.b, "swept": self._swept, "without": self.effects_left_out - {"damping"}}


class PrescribedSpeed(PlanarSystem):
    """A particle at a prescribed speed: its multiplier absorbs the damping, so that leaving it out changes nothing."""

    c: float = Field(default=1.0, gt=0, description="Squared speed, or its mean")


class ConstantSpeed(PrescribedSpeed):
    """x2² + y2² = c, equation (12) of the paper."""

    constraint: Literal["constant_speed"] = Field(description="The squared speed is held at c")  # pyright: ignore[reportIncompatibleVariableOverride]

    def build(self) -> IsokineticParticle:
        """The system with these parameters."""
        return constant_speed(self.a, self.c, self.omega, **self._others())


class DisturbedSpeed(PrescribedSpeed):
    """x2² + y2² = c + d sin t, equation (22) of the paper."""

    constraint: Literal["disturbed_speed"] = Field(description="The squared speed is held at c + d sin(t)")  # pyright: ignore[reportIncompatibleVariableOverride]
    d: float = Field(
        default=0.1, description="Amplitude of the disturbance of the squared speed, |d| < c; 0 leaves it out"
    )

    @model_validator(mode="after")
    def _check(self) -> DisturbedSpeed:
        if abs(self.d) >= self.c:
            raise rule(f"the speed vanishes: |d| must be below c, and d is {self.d:g}, c is {self.c:g}", "d", "c")
        try:
            strobe_period(self.omega, disturbed=self.d != 0 and "forcing" not in self.effects_left_out)
        except ValueError as error:
            raise rule(str(error), "omega", "d", "constraint") from None
        return self

    def build(self) -> IsokineticParticle:
        """The system with these parameters."""
        return disturbed_speed(self.a, self.c, self.d, self.omega, **self._others())


class Free(PlanarSystem):
    """No constraint, equation (1) of the paper: the one system in which the damping counts."""

    constraint: Literal["free"] = Field(description="The speed is free")  # pyright: ignore[reportIncompatibleVariableOverride]

    def build(self) -> FreeParticle:
        """The system with these parameters."""
        return free_particle(self.a, self.b, self.omega, self._swept, self.effects_left_out)


# ---- start, sweep, section


class Initial(Section):
    """The start state at t = 0; with a constraint y2 follows from it, as the positive root."""

    x1: float = Field(default=0.1, description="Position x1")
    x2: float = Field(default=0.1, description="Velocity of x1; its square is at most the squared speed at t = 0")
    y1: float = Field(default=0.1, description="Position y1")
    y2: float | None = Field(
        default=None, description="Velocity of y1 where there is no constraint; with one it is its positive root"
    )

    def state(self, system: Flow) -> Any:
        """At t = 0 position (x1, y1) with unit vector (n1, n2) of the velocity, or with the velocity itself.

        Raises:
            ValueError: |x2| is above the speed.
        """
        if not isinstance(system, IsokineticParticle):
            y2 = _START_Y2 if self.y2 is None else self.y2
            return Motion((self.x1, self.y1), (self.x2, y2), (0.0, 0.0))
        speed = math.sqrt(system.c)  # c + d sin t at t = 0
        return (self.x1, self.y1), (self.x2 / speed, math.sqrt(system.c - self.x2 * self.x2) / speed)

    def check(self, system: PlanarSystem, sweep: Sweep) -> None:
        """See that the sweep fits the system, and the speed at t = 0 is enough for x2."""
        system.prepare(sweep.swept)
        if not isinstance(system, PrescribedSpeed):
            return
        if self.y2 is not None:
            raise rule("y2 follows from the constraint; leave it out", "initial.y2", "system.constraint")
        if self.x2 * self.x2 > system.c:
            speed = math.sqrt(system.c)
            message = f"the speed at t = 0 is {speed:g}, and |x2| cannot be above it; x2 is {self.x2:g}"
            raise rule(message, "initial.x2", "system.c")


class Sweep(Section):
    """The parameter that differs from lane to lane: b, or a."""

    b: Grid | None = Field(default=None, description="Coupling b: start, stop and count, or values")  # pyright: ignore[reportOperatorIssue]
    a: Grid | None = Field(default=None, description="Stiffness a: start, stop and count, or values")  # pyright: ignore[reportOperatorIssue]

    @model_validator(mode="before")
    @classmethod
    def _shared(cls, content: Any) -> Any:
        for name, words in _SHARED.items() if isinstance(content, dict) else ():
            if name in content:
                raise rule(f"{name}, {words}, is the same in all lanes; what can be swept is b or a", name)
        return content

    @model_validator(mode="after")
    def _one(self) -> Sweep:
        if self.b is None and self.a is None:
            raise rule("name the parameter and its values: b or a")
        if self.b is not None and self.a is not None:
            raise rule("one parameter is swept, and both b and a are here", "a", "b")
        return self

    @property
    def swept(self) -> str:
        """Name of the parameter."""
        return "b" if self.a is None else "a"

    def grid(self) -> np.ndarray:
        """Its values in the order of the config, float64 of shape (lanes,)."""
        return getattr(self, self.swept).grid()


class EventSection(Section):
    """Where a flow without a clock is looked at: where one of its positions passes a value."""

    coordinate: Literal["x1", "y1"] = Field(default="x1", description="Position that decides")
    value: float = Field(default=0.0, description="Its value on the section")
    direction: Literal["up", "down", "both"] = Field(default="up", description="In which it passes the value")

    def of(self, flow: Flow) -> SectionedFlow:
        """A flow on this section."""
        return SectionedFlow(flow, self.coordinate, ("x1", "y1").index(self.coordinate), self.value, self.direction)
