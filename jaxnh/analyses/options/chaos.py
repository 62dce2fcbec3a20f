"""Options of the analyses that tell chaos from order: exponents, the 0-1 test, verdicts, transient chaos."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from jaxnh.analyses.options.base import BLOCKS, Box, Extra, Options, Side, check_sides, rule
from jaxnh.analyses.options.orbits import Continuation

Plane = Annotated[
    tuple[str, str] | None,
    Field(
        strict=False,
        description="Coordinates of the plane in which the angle is taken; by default an angle of the system",
    ),
]
Centre = Annotated[
    Side | None,
    Field(description="Values of the two coordinates about which the angle is taken; by default their means"),
]


class LyapunovOptions(Options):
    """Options of `lyapunov`."""

    in_time: ClassVar[bool] = True

    transient: int = Field(default=256, ge=0, description="Periods before the average begins")
    periods: int = Field(default=1024, ge=BLOCKS, description="Periods averaged over, at most")
    error: float = Field(default=0.0, ge=0.0, description="Stop a lane whose error bars, 1/time, are below this")
    exponents: int = Field(default=3, ge=1, description="How many of the largest exponents are wanted")
    method: Literal["orbits", "averages"] = Field(
        default="orbits",
        description="orbits: of lanes on a stable orbit its exponents; averages: time averages (faster, less exact)",
    )


class Chaos01Options(Options):
    """Options of `chaos01`."""

    transient: int = Field(default=512, ge=0, description="Periods before the strobe points are used")
    periods: int = Field(default=1024, ge=100, description="Strobe points used")


class VerdictOptions(Options):
    """Options of `verdict`, beside those of the analyses that it needs."""

    needs: ClassVar[tuple[str, ...]] = ("period", "lyapunov", "chaos01")

    confirmation_factor: int = Field(
        default=10,
        ge=0,
        description="Lanes that look chaotic or quasiperiodic are followed for so many times as long; 0: chaotic ones"
        " are not, others once",
    )


class RotationOptions(Options):
    """Options of `rotation`."""

    transient: int = Field(default=256, ge=1, description="Periods, or crossings, before the average begins")
    periods: int = Field(default=2048, ge=128, description="Periods averaged over")
    max_denominator: int = Field(default=64, ge=1, le=1024, description="Largest denominator that is looked for")
    plane: Plane = None
    centre: Centre = None


class InvariantCurveOptions(Options):
    """Options of analyses that make invariant curves of motions that turn."""

    transient: int = Field(default=256, ge=1, description="Periods, or crossings, before points of the motion are kept")
    periods: int = Field(default=2048, ge=128, description="Points that the first curve of a lane is made of")
    harmonics: int = Field(default=128, ge=8, le=512, description="Largest number of harmonics of a curve")
    points: int = Field(default=128, ge=16, le=4096, description="Points of each curve that are kept")
    max_denominator: int = Field(
        default=64, ge=1, le=1024, description="Largest denominator of fractions that a motion may be locked to"
    )
    plane: Plane = None
    centre: Centre = None


class ToriOptions(InvariantCurveOptions):
    """Options of `tori`."""


class TorusBranchesOptions(Continuation, InvariantCurveOptions):
    """Options of `torus_branches`."""

    newton: ClassVar[bool] = True
    untimed: ClassVar[bool] = True

    max_period: int = Field(
        default=1, ge=1, le=16, description="Largest period of orbits whose Neimark–Sacker bifurcations begin tori"
    )
    ds_max: float = Field(
        default=0.05, gt=0, le=0.25, description="Largest step along a branch, in widths of the sweep and in sizes"
    )
    max_steps: int = Field(default=200, ge=2, description="Tori of a branch to either side of its first, at most")


class ReversalOptions(Options):
    """Options of `reversal`."""

    transient: int = Field(
        default=512, ge=1, description="Periods, or crossings, before points of the attractor are kept"
    )
    strobes: int = Field(default=512, ge=64, description="Points that the attractor and its image are compared by")
    periods: int = Field(default=1024, ge=BLOCKS, description="Periods that exponents of either are averaged over")
    max_period: int | None = Field(
        default=None,
        ge=1,
        le=16,
        description="Largest number of returns of symmetric periodic orbits that are looked for; nothing: of none",
    )


class TransientsOptions(Options):
    """Options of `transients`."""

    n_starts: int = Field(default=4096, ge=16, description="Random start states at each value of parameters")
    box: Box = Field(default_factory=dict)
    region: dict[str, Side] = Field(
        default_factory=dict,
        description="Coordinates that motions leave, each with its lowest and highest value; by default the box",
    )
    max_periods: int = Field(default=1024, ge=16, description="Periods after which a motion is followed no longer")
    transient: int = Field(default=8, ge=0, description="Periods before escapes are counted for the rate")
    seed: int = Field(default=0, ge=0, description="Seed of the random start states and of what moves points")
    saddle_points: int = Field(
        default=0,
        ge=0,
        le=1 << 16,
        description="Points of the chaotic saddle by stagger and step; 0: those of motions that stay long",
    )
    crisis: Extra = Field(
        default=None, description="Whether to fit the power law of the lifetime at a crisis along the first axis"
    )

    @model_validator(mode="after")
    def _check(self) -> TransientsOptions:
        check_sides(self.box)
        check_sides(self.region, "region")
        if self.transient >= self.max_periods:
            raise rule(f"must be less than max_periods, {self.max_periods}", "transient", "max_periods")
        return self


class CovariantOptions(Options):
    """Options of `covariant`."""

    transient: int = Field(default=512, ge=0, description="Periods, or crossings, before vectors are looked for")
    strobes: int = Field(default=2048, ge=256, description="Points that angles and exponents are taken from")
    search: int = Field(
        default=0, ge=0, description="Rounds of a search for smaller angles beside the motions; 0: none"
    )
