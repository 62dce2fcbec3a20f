"""Blocks of a config for the paper's particle: its constraint and parameters, start, sweep, and what is left out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from pydantic import ConfigDict, Field, field_validator

from jaxnh.analyses.options.base import rule
from jaxnh.config.blocks import (
    EvenGrid,
    Grid,
    InitialBlock,
    OrderedBlock,
    SectionBlock,
    SweepBlock,
    SystemBlock,
    ValueGrid,
)
from jaxnh.config.messages import close_match, join_words, show_value
from jaxnh.systems.particle_parameters import EFFECTS, strobe_period

_START_Y2 = math.sqrt(0.99)  # of the paper's start, at its speed of one
_COORDINATES = ("x1", "x2", "y1", "y2")


# ---- start, sweep, section


class Initial(InitialBlock, frozen=True):
    """The start state at t = 0; with a constraint y2 follows from it, as the positive root."""

    x1: float = Field(default=0.1, description="Position x1")
    x2: float = Field(default=0.1, description="Velocity of x1; its square is at most the squared speed at t = 0")
    y1: float = Field(default=0.1, description="Position y1")
    y2: float | None = Field(
        default=None, description="Velocity of y1 where there is no constraint; with one it is its positive root"
    )

    def coordinates(self) -> Mapping[str, float | None]:
        """Coordinates by name; y2 is None where it is not given."""
        return {"x1": self.x1, "x2": self.x2, "y1": self.y1, "y2": self.y2}


def _axis(words: str) -> Any:
    return Field(default=None, description=f"{words}: start, stop and count, or values")


class Sweep(OrderedBlock, SweepBlock, frozen=True):
    """The axes of the sweep, whose product is what is run: parameters, and coordinates of the start state."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    b: Grid | None = _axis("Coupling b")
    a: Grid | None = _axis("Stiffness a")
    c: Grid | None = _axis("Squared speed c, or its mean, where there is a constraint")
    omega: Grid | None = _axis("Angular frequency omega of the forcing")
    d: Grid | None = _axis("Amplitude d of the disturbance, at disturbed speed")
    x1: Grid | None = _axis("Position x1 of the start")
    x2: Grid | None = _axis("Velocity x2 of the start")
    y1: Grid | None = _axis("Position y1 of the start")
    y2: Grid | None = _axis("Velocity y2 of the start, where there is no constraint")

    @property
    def grids(self) -> Mapping[str, EvenGrid | ValueGrid]:
        """Name to grid, in the order of the config."""
        return {name: grid for name in self._order if (grid := getattr(self, name)) is not None}

    @property
    def known(self) -> tuple[str, ...]:
        """Names that there are."""
        return tuple(type(self).model_fields)


class PoincareSection(SectionBlock, frozen=True):
    """Section of a flow without a clock: one of its positions passes a value."""

    coordinate: Literal["x1", "y1"] = Field(default="x1", description="Position that decides")
    value: float = Field(default=0.0, description="Its value on the section")


# ---- system


class Particle(SystemBlock, frozen=True):
    """A particle in the plane under the paper's forces."""

    constraint: str = Field(description="Constraint on the speed")
    a: float = Field(default=0.5, description="Linear stiffness of x1 and cubic stiffness of y1")
    b: float | None = Field(default=None, description="Coupling, where it is not swept")
    omega: float = Field(default=1.0, gt=0, description="Angular frequency of the forcing 1 + sin(omega t)")
    without: tuple[str, ...] | None = Field(
        default=None,
        strict=False,
        description=f"Effects that are left out, of {', '.join(EFFECTS)}; without forcing 2 pi/omega is a unit of time",
        json_schema_extra={"items": {"enum": list(EFFECTS)}},
    )

    axes: ClassVar[tuple[str, ...]] = ("b", "a", "omega", "x1", "x2", "y1")
    """Names of the axes that a sweep may have."""

    @field_validator("without")
    @classmethod
    def _known(cls, without: tuple[str, ...] | None) -> tuple[str, ...] | None:
        """Effects in one order, each once; none is nothing."""
        for name in without or ():
            if name not in EFFECTS:
                message = (
                    f"there are the effects {', '.join(EFFECTS)}, and no {show_value(name)}{close_match(name, EFFECTS)}"
                )
                if name in ("disturbance", "constraint"):
                    other = "d: 0 leaves the disturbance" if name == "disturbance" else "constraint: free leaves it"
                    message = f"of {name} another key decides: {other} out"
                raise rule(message)
        return tuple(sorted(set(without or ()))) or None

    @property
    def effects_left_out(self) -> frozenset[str]:
        """The effects that are named, of `systems.particle_parameters.EFFECTS`."""
        return frozenset(self.without or ())

    def has_clock(self, sweep: SweepBlock) -> bool:
        """Return whether there is a forcing or a disturbance."""
        return "forcing" not in self.effects_left_out

    def start(self, initial: Initial) -> Mapping[str, float]:
        """Coordinates of the start state; what the constraint decides is left out."""
        return {"x1": initial.x1, "x2": initial.x2, "y1": initial.y1}

    def check(self, initial: Initial, sweep: SweepBlock) -> None:
        """Check that parameters, start state and sweep go together."""
        for name in sweep.grids:
            self._check_axis(name, initial)
        self._check_coupling(sweep)
        for name in {"c", "omega"} & set(sweep.grids):
            if (least := sweep.grids[name].grid().min()) <= 0:
                raise rule(f"must be above 0, not {least:g}", f"sweep.{name}")
        self._check_values(_Values(self, initial, sweep))

    def _check_axis(self, name: str, initial: Initial) -> None:
        """Check that what is swept is there, and has no second value elsewhere."""
        if name not in self.axes:
            message = f"{name} does not go with {self.constraint}; what can be swept is {', '.join(self.axes)}"
            if name == "y2":
                message = "y2 follows from the constraint, and cannot be swept"
            raise rule(message, f"sweep.{name}", "system.constraint")
        for effect, parameter, other in (("coupling", "b", "; sweep a"), ("forcing", "omega", "")):
            if name == parameter and effect in self.effects_left_out:
                message = f"the {effect} is left out, and there is no {name} to sweep{other}"
                raise rule(message, f"sweep.{name}", "system.without")
        block, given = ("initial", initial.given) if name in _COORDINATES else ("system", self.model_fields_set)
        if name in given and getattr(initial if block == "initial" else self, name) is not None:
            raise rule(f"{name} is swept; leave it out of {block}", f"{block}.{name}", f"sweep.{name}")

    def _check_coupling(self, sweep: SweepBlock) -> None:
        uncoupled = "coupling" in self.effects_left_out
        if uncoupled and self.b is not None:
            raise rule("the coupling is left out; leave b out as well", "system.b", "system.without")
        if not uncoupled and self.b is None and "b" not in sweep.grids:
            names = tuple(sweep.grids)
            verb = "is" if len(names) == 1 else "are"
            message = f"{join_words(names)} {verb} swept, and b must be given (Coupling b)"
            raise rule(message, "system.b", *(f"sweep.{name}" for name in names), "system")

    def _check_values(self, values: _Values) -> None:
        """Check that the values of parameters and start go together in all lanes."""


class _Values:
    """Values of parameters and coordinates over a sweep, and the keys of the config that say them."""

    def __init__(self, system: Particle, initial: Initial, sweep: SweepBlock) -> None:
        self._single: dict[str, Any] = {**initial.coordinates(), **dict(system)}
        self._grids = sweep.grids

    def __getitem__(self, name: str) -> Float[np.ndarray, " n"]:
        return self._grids[name].grid() if self.swept(name) else np.array([self._single[name]], dtype=np.float64)

    def swept(self, name: str) -> bool:
        """Return whether there is an axis of this name."""
        return name in self._grids

    def keys(self, *names: str) -> Iterator[str]:
        """Keys that may be to blame, the most likely culprit first."""
        for name in names:
            yield f"{'initial' if name in _COORDINATES else 'system'}.{name}"
            yield f"sweep.{name}"


class PrescribedSpeed(Particle, frozen=True):
    """A particle at a prescribed speed: its multiplier absorbs the damping, so that leaving it out changes nothing."""

    c: float = Field(default=1.0, gt=0, description="Squared speed, or its mean")

    axes: ClassVar[tuple[str, ...]] = ("b", "a", "c", "omega", "x1", "x2", "y1")
    prescribed: ClassVar[bool] = True

    def check(self, initial: Initial, sweep: SweepBlock) -> None:
        """Check that parameters, start state and sweep go together, and the speed at t = 0 is enough for x2."""
        super().check(initial, sweep)
        if initial.y2 is not None:
            raise rule("y2 follows from the constraint; leave it out", "initial.y2", "system.constraint")

    def _check_values(self, values: _Values) -> None:
        c, x2 = values["c"].min(), values["x2"]
        x2 = float(x2[np.argmax(np.abs(x2))])  # whose square may be infinite
        if x2 * x2 > c:
            message = f"the speed at t = 0 is {math.sqrt(c):g}, and |x2| cannot be above it; x2 is {x2:g}"
            raise rule(message, *values.keys("x2", "c"))


class ConstantSpeed(PrescribedSpeed, frozen=True):
    """x2² + y2² = c, equation (12) of the paper."""

    constraint: Literal["constant_speed"] = Field(description="The squared speed is held at c")


class DisturbedSpeed(PrescribedSpeed, frozen=True):
    """x2² + y2² = c + d sin t, equation (22) of the paper."""

    constraint: Literal["disturbed_speed"] = Field(description="The squared speed is held at c + d sin(t)")
    d: float = Field(
        default=0.1, description="Amplitude of the disturbance of the squared speed, |d| < c; 0 leaves it out"
    )

    axes: ClassVar[tuple[str, ...]] = ("b", "a", "c", "omega", "d", "x1", "x2", "y1")

    def _check_values(self, values: _Values) -> None:
        c, d = values["c"].min(), values["d"]
        worst, forced = d[np.argmax(np.abs(d))], "forcing" not in self.effects_left_out
        if abs(worst) >= c:
            message = f"the speed vanishes: |d| must be below c, and d is {worst:g}, c is {c:g}"
            raise rule(message, *values.keys("d", "c"))
        if not forced and values.swept("d") and not np.all(d):
            message = "the forcing is left out, and there is no clock where d is 0; leave 0 out of the axis"
            raise rule(message, "sweep.d", "system.without")
        for omega in values["omega"] if forced and np.any(d) else ():
            try:
                strobe_period(float(omega), disturbed=True)
            except ValueError as error:
                raise rule(str(error), *values.keys("omega", "d"), "system.constraint") from None
        super()._check_values(values)

    def has_clock(self, sweep: SweepBlock) -> bool:
        """Return whether there is a forcing or a disturbance."""
        return super().has_clock(sweep) or self.d != 0 or "d" in sweep.grids


class Free(Particle, frozen=True):
    """No constraint, equation (1) of the paper: the one system in which the damping counts."""

    constraint: Literal["free"] = Field(description="The speed is free")

    axes: ClassVar[tuple[str, ...]] = ("b", "a", "omega", *_COORDINATES)

    def start(self, initial: Initial) -> Mapping[str, float]:
        """Coordinates of the start state."""
        return {**super().start(initial), "y2": _START_Y2 if initial.y2 is None else initial.y2}
