"""Options of the analyses of basins of attraction: `basins` and `edges`."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from jaxnh.analyses.options.base import BLOCKS, Box, Options, SensitivityOptions, check_random_starts, check_sides, rule


class BasinsOptions(SensitivityOptions):
    """Options of `basins`."""

    in_time: ClassVar[bool] = True
    newton: ClassVar[bool] = True

    transient: int = Field(
        default=64,
        ge=2 * BLOCKS,
        multiple_of=2 * BLOCKS,
        description="Periods, or units of time, before the first look, which is as long; the next take twice as long",
    )
    max_periods: int = Field(
        default=8192, ge=4 * BLOCKS, description="Periods after which a lane that has not settled is undecided"
    )
    max_period: int = Field(default=64, ge=1, le=1024, description="Largest period looked for")
    n_starts: int = Field(default=0, ge=0, description="Random start states at each value of parameters; needs a box")
    seed: int = Field(default=0, ge=0, description="Seed of the random start states")
    box: Box = Field(default_factory=dict)

    boundary: bool = Field(
        default=False,
        description="Whether entropies and the uncertainty exponent of planes of start states are measured",
    )

    @model_validator(mode="after")
    def _check(self) -> BasinsOptions:
        check_random_starts(self.box, self.n_starts, "seed" in self.model_fields_set)
        if self.max_periods < 2 * self.transient:
            raise rule(f"must be at least twice the transient, {2 * self.transient}", "max_periods", "transient")
        return self


class EdgesOptions(Options):
    """Options of `edges`."""

    in_time: ClassVar[bool] = True
    newton: ClassVar[bool] = True

    n_starts: int = Field(default=64, ge=4, description="Random starts of each lane, of which pairs are drawn")
    seed: int = Field(default=0, ge=0, description="Seed of the random starts and of directions")
    box: Box = Field(default_factory=dict)
    transient: int = Field(
        default=64,
        ge=2 * BLOCKS,
        multiple_of=2 * BLOCKS,
        description="Periods before the first look at starts, and returns before that at a boundary; "
        "the next take twice as long",
    )
    max_periods: int = Field(
        default=8192, ge=4 * BLOCKS, description="Periods after which a state that is near no attractor is undecided"
    )
    max_returns: int = Field(default=512, ge=1, description="Returns that a boundary is followed for, at most")
    max_period: int = Field(default=16, ge=1, le=64, description="Largest period of attractors and of edge states")
    pairs: int = Field(default=4, ge=1, le=64, description="Pairs of starts of each lane whose boundary is followed")
    directions: int = Field(
        default=32, ge=0, description="Directions in which each point of an attractor is displaced; 0: no shocks"
    )
    shock_points: int = Field(default=8, ge=1, le=512, description="Points of each attractor that are displaced")
    reach: float = Field(default=2.0, gt=0, description="Longest shock looked for, in halves of the box")

    @model_validator(mode="after")
    def _check(self) -> EdgesOptions:
        check_sides(self.box)
        if self.max_periods < 2 * self.transient:
            raise rule(f"must be at least twice the transient, {2 * self.transient}", "max_periods", "transient")
        if self.max_returns < self.transient:
            raise rule(f"must be at least the transient, {self.transient}", "max_returns", "transient")
        return self
