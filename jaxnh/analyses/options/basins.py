"""Options of `basins`."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from jaxnh.analyses.options.base import BLOCKS, Options, Side, check_random_starts, rule


class BasinsOptions(Options):
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
    box: dict[str, Side] = Field(
        default_factory=dict, description="Coordinates of random start states, each with its lowest and highest value"
    )

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
