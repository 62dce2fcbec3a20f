"""Options of the analyses that follow orbits: periods, cascades, branches, curves, windows, all orbits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from jaxnh.analyses.options.base import (
    Box,
    Extra,
    Omission,
    Options,
    SensitivityOptions,
    check_random_starts,
    check_sides,
    rule,
)


class PeriodOptions(SensitivityOptions):
    """Options of `period`."""

    newton: ClassVar[bool] = True

    max_period: int = Field(default=64, ge=1, le=1024, description="Largest period looked for")
    transient: int = Field(default=512, ge=0, description="Periods before the last look at the strobe points")
    phase_response: int | None = Field(
        default=None,
        ge=2,
        le=4096,
        description="Phases at which the phase response of limit cycles is given; by default it is not",
    )


class DoublingOptions(SensitivityOptions):
    """Options of `doubling`."""

    newton: ClassVar[bool] = True
    extended: ClassVar[bool] = True

    levels: int = Field(default=6, ge=1, le=16, description="Number of period doublings to find: 12 at most in float64")
    search: bool = Field(
        default=True, description="Where the sweep has fewer, look as far as it is wide beyond either end of it as well"
    )


class Continuation(Options):
    """Steps along curves, in widths of the sweep's axes and in sizes of the motion; names are AUTO's."""

    ds: float | None = Field(default=None, gt=0, le=0.25, description="First step; by default a tenth of ds_max")
    ds_min: float = Field(default=1e-7, gt=0, le=0.25, description="Smallest step, where Newton does not converge")
    ds_max: float = Field(
        default=0.02, gt=0, le=0.25, description="Largest step along a curve, in widths of the sweep and in sizes"
    )
    max_steps: int = Field(default=2000, ge=2, description="Points of a curve to either side of its first, at most")

    @model_validator(mode="after")
    def _check_steps(self) -> Continuation:
        if not self.ds_min <= (self.ds or 0.1 * self.ds_max) <= self.ds_max:
            raise rule("must be between ds_min and ds_max", "ds" if self.ds else "ds_min")
        return self


class BranchesOptions(Continuation, SensitivityOptions):
    """Options of `branches`."""

    newton: ClassVar[bool] = True
    untimed: ClassVar[bool] = True

    max_period: int = Field(default=8, ge=1, le=64, description="Largest period of the orbits that are followed")
    transient: int = Field(default=512, ge=0, description="Periods before lanes are looked at")
    ds_max: float = Field(
        default=0.05, gt=0, le=0.25, description="Largest step along a branch, in widths of the sweep and in sizes"
    )
    method: Literal["auto", "shooting", "collocation"] | None = Field(
        default=None,
        description="Orbits of the return map by shooting, the default, or cycles of the flow by collocation, however "
        "unstable; auto: by shooting, and by collocation where that loses a branch of a flow without a clock",
    )
    n_starts: int = Field(
        default=0, ge=0, description="Random starts of Newton for orbits at each of the values searched; needs a box"
    )
    equilibria: int = Field(
        default=0, ge=0, description="The same for equilibria of a flow without a clock, which are followed as well"
    )
    n_values: int = Field(default=5, ge=1, description="Number of values searched, evenly over the lanes of the sweep")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> BranchesOptions:
        asked = "n_starts" if self.n_starts or self.box else "equilibria"
        check_random_starts(self.box, self.n_starts + self.equilibria, False, asked)
        for name in ("seed", "n_values"):
            if name in self.model_fields_set and not self.box:
                raise rule("goes with n_starts or equilibria, and there are none", name)
        return self


class CurvesOptions(Continuation):
    """Options of `curves`."""

    newton: ClassVar[bool] = True
    untimed: ClassVar[bool] = True

    max_period: int = Field(
        default=2, ge=0, le=64, description="Largest period of the orbits whose bifurcations are followed; 0: of none"
    )
    transient: int = Field(default=512, ge=1, description="Periods before lanes are looked at")
    n_values: int = Field(
        default=3, ge=1, description="Number of values of the second axis at which bifurcations are looked for"
    )
    equilibria: int = Field(
        default=0,
        ge=0,
        description="Random starts of Newton for equilibria of a flow without a clock, whose folds and Hopf points are "
        "followed as well; needs a box",
    )
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)
    max_steps: int = Field(default=500, ge=2, description="Points of a curve to either side of its first, at most")
    bifurcations: Omission = Field(default=None, description="Whether bifurcations of periodic orbits are followed")
    duration: float | None = Field(
        default=None, gt=0, description="Time of a flow without a clock that cycles take along a curve of their own"
    )
    maximum: dict[str, float] | None = Field(
        default=None, description="Observables whose largest value along a cycle is one given, each with a curve"
    )
    minimum: dict[str, float] | None = Field(
        default=None, description="Observables whose least value along a cycle is one given, each with a curve"
    )
    amplitude: dict[str, float] | None = Field(
        default=None,
        description="Observables whose largest less least value along a cycle is one given, each with a curve",
    )
    mean: dict[str, float] | None = Field(
        default=None, description="Observables whose mean in time along a cycle is one given, each with a curve"
    )
    exponent_sum: float | None = Field(
        default=None, description="Sum of the Floquet exponents of cycles along a curve of their own: 0 keeps volumes"
    )
    grazing: Extra = Field(
        default=None, description="Whether cycles that touch a wall of a jump or the surface of a switch are followed"
    )

    @property
    def in_time(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Tell whether no orbits are followed, which need a section."""
        return not self.max_period

    @property
    def conditional(self) -> bool:
        """Tell whether cycles that keep a condition are followed."""
        asked = any((self.duration, self.maximum, self.minimum, self.amplitude, self.mean, self.grazing))
        return asked or self.exponent_sum is not None

    @model_validator(mode="after")
    def _check(self) -> CurvesOptions:
        check_random_starts(self.box, self.equilibria, "seed" in self.model_fields_set, "equilibria")
        if self.conditional and not self.max_period:
            raise rule("cycles that keep a condition are periodic orbits: give a max_period of 1 or more", "max_period")
        if not (self.max_period or self.equilibria):
            raise rule("without periodic orbits there are curves of equilibria alone: give equilibria", "max_period")
        if self.bifurcations is False and not (self.conditional or self.equilibria):
            raise rule(
                "then nothing is left to follow: give duration, maximum, minimum, amplitude, mean, exponent_sum or "
                "grazing",
                "bifurcations",
            )
        return self


class AtlasOptions(Continuation):
    """Options of `atlas`."""

    newton: ClassVar[bool] = True
    untimed: ClassVar[bool] = True

    max_period: int = Field(
        default=4, ge=1, le=64, description="Largest period of orbits whose branches, curves and windows are followed"
    )
    transient: int = Field(default=512, ge=1, description="Periods before lanes are looked at")
    n_values: int = Field(
        default=3, ge=1, description="Number of values of the second axis at which branches and windows are looked for"
    )
    n_starts: int = Field(
        default=0, ge=0, description="Random starts of Newton for orbits at some values of the first axis; needs a box"
    )
    equilibria: int = Field(
        default=0, ge=0, description="The same for equilibria of a flow without a clock, which are followed as well"
    )
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)
    levels: int = Field(default=4, ge=0, le=8, description="Doublings of a window to locate")
    crisis: int = Field(default=0, ge=0, description="Periods of a path that looks for the crisis of a window; 0: none")
    max_steps: int = Field(default=500, ge=2, description="Points of a curve to either side of its first, at most")

    @model_validator(mode="after")
    def _check(self) -> AtlasOptions:
        asked = "n_starts" if self.n_starts else "equilibria"
        check_random_starts(self.box, self.n_starts + self.equilibria, "seed" in self.model_fields_set, asked)
        return self


class HomoclinicOptions(Continuation):
    """Options of `homoclinic`."""

    newton: ClassVar[bool] = True

    @property
    def in_time(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Return whether manifolds alone are followed: cycles are looked for on a section."""
        return not self.cycles

    n_starts: int = Field(default=64, ge=1, description="Random starts of Newton for saddles at each value searched")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)
    n_values: int = Field(
        default=3, ge=1, description="Number of values of the second axis at which orbits are looked for"
    )
    duration: float = Field(default=100.0, gt=0, description="Time for which manifolds of saddles are followed there")
    pulses: int = Field(
        default=1, ge=1, le=8, description="Passages of a saddle that are looked at: orbits return at the last one"
    )
    cycles: int | None = Field(
        default=None,
        ge=1,
        le=64,
        description="Largest number of returns to the section of cycles that are followed over the first axis to where "
        "their time has no end; by default none are",
    )
    bogdanov_takens: Extra = Field(
        default=None,
        description="Whether the curves that begin at Bogdanov–Takens points of equilibria are followed as well",
    )
    max_steps: int = Field(default=200, ge=2, description="Points of a curve to either side of its first, at most")

    @model_validator(mode="after")
    def _check_box(self) -> HomoclinicOptions:
        check_sides(self.box)
        return self


class WindowsOptions(SensitivityOptions):
    """Options of `windows`."""

    newton: ClassVar[bool] = True
    untimed: ClassVar[bool] = True

    max_period: int = Field(default=12, ge=1, le=64, description="Largest period of the orbits that windows begin with")
    transient: int = Field(default=512, ge=0, description="Periods before lanes are looked at")
    levels: int = Field(
        default=4, ge=0, le=8, description="Doublings of a window to locate; four or more say where they accumulate"
    )
    crisis: int = Field(
        default=4096,
        ge=0,
        description="Periods of a path, at most, that looks for the crisis beyond where doublings accumulate; 0: none",
    )


class OrbitsOptions(Options):
    """Options of `orbits`."""

    newton: ClassVar[bool] = True

    max_period: int = Field(default=8, ge=1, le=32, description="Largest number of returns of the orbits")
    transient: int = Field(default=512, ge=1, description="Periods, or crossings, before motions are looked at")
    rounds: int = Field(
        default=32, ge=4, le=1024, description="Rounds of the search, at most; it ends where none leaves doubts"
    )
    n_starts: int = Field(default=0, ge=0, description="Random starts of Newton in each round; needs a box")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)
    attractor: int | None = Field(
        default=None,
        ge=256,
        description="Points of a motion, by which orbits are told to lie in its attractor; by default not asked",
    )
    symmetry: Annotated[tuple[str, ...], Field(strict=False)] | None = Field(
        default=None,
        description="Coordinates whose signs a symmetry of the system changes, which takes orbits to orbits",
    )
    averages: Extra = Field(
        default=None,
        description="Whether to give exponent and escape rate by cycle expansion, with attractor beside time averages",
    )

    @model_validator(mode="after")
    def _check(self) -> OrbitsOptions:
        check_random_starts(self.box, self.n_starts, "seed" in self.model_fields_set)
        return self


_SURFACES = {"length": 4.0, "spacing": 0.1, "max_points": 16384, "crossings": 0}
"""Defaults of surfaces, where those of curves are others."""


class ManifoldsOptions(Options):
    """Options of `manifolds`."""

    newton: ClassVar[bool] = True

    dimension: Literal[1, 2] = Field(
        default=1,
        description="Dimension: curves of saddle orbits of the return map, or surfaces of equilibria of a flow",
    )
    of: Literal["equilibria", "cycles"] = Field(
        default="equilibria",
        description="Saddles that surfaces are of; cycles are those of the map of a section",
    )
    period: int = Field(default=1, ge=1, le=64, description="Returns of the saddle orbits")
    n_starts: int = Field(default=64, ge=1, description="Random starts of Newton for saddles in each lane")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts")
    box: Box = Field(default_factory=dict)
    saddles: int = Field(
        default=1,
        ge=1,
        le=64,
        description="Saddle orbits of a lane that are kept: those nearest to the middle of the box",
    )
    kind: Literal["both", "unstable", "stable"] = Field(default="both", description="Manifolds that are grown")
    length: float = Field(default=10.0, gt=0, description="Arc length of a branch, in halves of the box")
    spacing: float = Field(
        default=0.02, gt=0, le=1, description="Largest distance of neighbouring points, in halves of the box"
    )
    max_points: int = Field(default=2048, ge=16, description="Points of a branch, at most")
    crossings: int = Field(
        default=16, ge=0, description="Homoclinic and heteroclinic orbits of a lane that are kept, shortest first"
    )
    tangency: str | None = Field(
        default=None, description="Parameter along which tangencies of the manifolds are located; nothing: none are"
    )

    @property
    def in_time(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Return whether there is no return map: equilibria are those of the flow."""
        return self.dimension == 2 and self.of == "equilibria"

    @model_validator(mode="before")
    @classmethod
    def _of_surfaces(cls, given: Any) -> Any:
        """Return what is given with other defaults of surfaces, which have many points."""
        return {**_SURFACES, **given} if isinstance(given, Mapping) and given.get("dimension") == 2 else given

    @model_validator(mode="after")
    def _check(self) -> ManifoldsOptions:
        check_sides(self.box)
        if self.dimension == 1 and self.of == "cycles":
            raise rule("curves are of orbits of the return map anyway: leave it out, or take dimension: 2", "of")
        if self.dimension == 2:
            if self.crossings or self.tangency is not None:
                message = "crossings and tangencies are of curves: leave it out, or take dimension: 1"
                raise rule(message, "tangency" if self.tangency is not None else "crossings", "dimension")
            if self.of == "equilibria" and self.period != 1:
                raise rule("equilibria have no period: leave it out, or take of: cycles", "period", "of")
        if self.kind != "both" and self.tangency is not None:
            raise rule("tangencies are of stable and unstable manifolds: take kind: both", "tangency", "kind")
        return self
