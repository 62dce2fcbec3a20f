"""Parts of a config that every system shares: what a section is, and the values of a sweep."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from jaxnh.config.messages import rule

_MOST_LANES = 10_000_000


class Section(BaseModel):
    """A mapping in a config: frozen, strict about types, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Evenly(Section):
    """Evenly spaced values of a parameter, both ends included."""

    start: float = Field(description="First value")
    stop: float = Field(description="Last value, above or below the first")
    count: int = Field(ge=2, le=_MOST_LANES, description="Number of values, both ends included")

    @model_validator(mode="after")
    def _check(self) -> Evenly:
        if self.start == self.stop:
            raise rule(f"must differ from start, and both are {self.start:g}", "stop", "start")
        if not math.isfinite(self.stop - self.start):
            raise rule("start and stop are further apart than a double can say", "stop", "start")
        return self

    def grid(self) -> np.ndarray:
        """The values from start to stop, shape (count,)."""
        return np.linspace(self.start, self.stop, self.count)


class Named(Section):
    """Values of a parameter, named one by one."""

    values: tuple[float, ...] = Field(
        min_length=1, max_length=_MOST_LANES, strict=False, description="The values, in the order they are wanted"
    )

    def grid(self) -> np.ndarray:
        """The values as given, shape (count,)."""
        return np.array(self.values, dtype=np.float64)


def _grid_kind(content: Any) -> str:
    named = "values" in content if isinstance(content, dict) else isinstance(content, Named)
    return "values" if named else "start, stop, count"


Grid = Annotated[
    Annotated[Evenly, Tag("start, stop, count")] | Annotated[Named, Tag("values")], Discriminator(_grid_kind)
]
"""Values of the parameter that is swept."""
