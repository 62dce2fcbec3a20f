"""Options of the analyses that keep states: portraits, Poincaré maps, diagrams, transport."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from jaxnh.analyses.options.base import Box, Options, check_random_starts, rule

LEAST_FOR_DIMENSION = 256
"""Points that a region of scaling may be seen in."""

_FOR_RANDOM = ("n_starts", "seed", "box")


Outputs = Annotated[
    tuple[str, ...] | None,
    Field(
        strict=False,
        description="Outputs of mechanics beside the states, as energies, multipliers, powers; each is computed where "
        "it is named alone",
    ),
]
"""Names of outputs on request (`systems.mechanical_outputs`)."""


class PortraitOptions(Options):
    """Options of `portrait`."""

    in_time: ClassVar[bool] = True

    transient: int = Field(default=512, ge=0, description="Periods before the first sample; 0: it is the start state")
    periods: int = Field(default=16, ge=1, description="Length of the trajectory, in periods")
    samples: int = Field(default=256, ge=1, le=65536, description="Samples a period, evenly spaced in time")
    outputs: Outputs = None


class PoincareOptions(Options):
    """Options of `poincare`."""

    transient: int = Field(default=512, ge=0, description="Periods before the first strobe; 0: it is the start state")
    strobes: int = Field(default=1024, ge=1, description="Number of strobes kept, one period apart")
    correlation_dimension: bool | None = Field(
        default=None, description="Whether to give the correlation dimension of the strobes of each lane; takes 256"
    )
    outputs: Outputs = None

    @model_validator(mode="after")
    def _check(self) -> PoincareOptions:
        if self.correlation_dimension and self.strobes < LEAST_FOR_DIMENSION:
            message = f"must be {LEAST_FOR_DIMENSION} or more for a correlation dimension"
            raise rule(message, "strobes", "correlation_dimension")
        return self


class DiagramOptions(Options):
    """Options of `diagram`."""

    transient: int = Field(default=512, ge=0, description="Periods before the first strobe; 0: it is the start state")
    strobes: int = Field(default=128, ge=1, description="Number of strobes kept, one period apart")
    start: Literal["fixed", "up", "down", "random"] = Field(
        default="fixed",
        description="Start state: the same in every lane, carried along rising or falling values of the first axis, or "
        "random ones in every lane",
    )
    snap_to_period: int | None = Field(
        default=None,
        ge=1,
        le=64,
        description="Strobes of lanes that settle on a periodic orbit up to this period are those of the orbit itself, "
        "by Newton; nothing: of none",
    )
    statistics: bool | None = Field(
        default=None,
        description="Of the strobes of each trajectory keep the largest, smallest, mean and standard deviation alone",
    )
    outputs: Outputs = None
    phase: float = Field(default=0.0, ge=0.0, lt=1.0, description="When in a period to strobe, as a fraction of it")
    n_starts: int = Field(default=16, ge=1, description="Number of random start states a lane")
    seed: int = Field(default=0, ge=0, description="Seed of the random start states")
    box: float = Field(
        default=4.0, gt=0, description="Random starts have x1 and y1 in [-box, box] and any direction, evenly"
    )

    @model_validator(mode="after")
    def _check(self) -> DiagramOptions:
        for name in _FOR_RANDOM:
            if self.start != "random" and name in self.model_fields_set:
                raise rule(f"{name} goes with start: random, and start is {self.start}", name, "start")
        if self.snap_to_period and (self.carried or self.phase):
            other = "start" if self.carried else "phase"
            raise rule("orbits are located for starts side by side and strobes at phase 0", "snap_to_period", other)
        return self

    @property
    def carried(self) -> bool:
        """Return whether the state at one value of the first axis is the start state at the next."""
        return self.start in ("up", "down")


class TransportOptions(Options):
    """Options of `transport`."""

    in_time: ClassVar[bool] = True

    transient: int = Field(default=0, ge=0, description="Periods before the record begins, which time is counted from")
    periods: int = Field(default=4096, ge=256, description="Periods of the record, of which whole sixteenths are used")
    growth: Annotated[tuple[str, ...], Field(strict=False)] | None = Field(
        default=None, description="Coordinates, velocities or outputs whose growth is asked for"
    )
    path: Annotated[tuple[str, ...], Field(strict=False, min_length=1, max_length=3)] | None = Field(
        default=None, description="Coordinates of the place whose drift and diffusion are asked for"
    )
    n_starts: int = Field(default=0, ge=0, description="Random starts of each lane; 0: the start state alone")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> TransportOptions:
        check_random_starts(self.box, self.n_starts, "seed" in self.model_fields_set)
        return self
