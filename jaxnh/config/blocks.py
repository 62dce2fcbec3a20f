"""What blocks of a config are, and those that every system has: its axes, its parameters and its start state."""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from typing import Annotated, Any, Self, TypeAlias

import numpy as np
from jaxtyping import Float
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    Tag,
    model_validator,
)

from jaxnh.analyses.base import rule
from jaxnh.systems.flow import Flow

MOST_LANES = 10_000_000
"""Lanes that a sweep may have, the product of its axes."""


class Block(BaseModel):
    """A mapping in a config: frozen, strict about types, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class OrderedBlock(Block):
    """A block whose keys have an order that counts."""

    _order: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="wrap")
    @classmethod
    def _keep_order(cls, content: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        block = handler(content)
        if isinstance(content, dict):
            block._order = tuple(content)
        return block


# ---- a sweep


class Evenly(Block):
    """Evenly spaced values, both ends included."""

    start: float = Field(description="First value")
    stop: float = Field(description="Last value, above or below the first")
    count: int = Field(ge=2, le=MOST_LANES, description="Number of values, both ends included")

    @model_validator(mode="after")
    def _check(self) -> Evenly:
        if self.start == self.stop:
            raise rule(f"must differ from start, and both are {self.start:g}", "stop", "start")
        if not math.isfinite(self.stop - self.start):
            raise rule("start and stop are further apart than a double can say", "stop", "start")
        return self

    @property
    def size(self) -> int:
        """Number of values."""
        return self.count

    def grid(self) -> Float[np.ndarray, " count"]:
        """The values from start to stop."""
        return np.linspace(self.start, self.stop, self.count)


class Named(Block):
    """Values named one by one."""

    values: tuple[float, ...] = Field(
        min_length=1, max_length=MOST_LANES, strict=False, description="The values, in the order they are wanted"
    )

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.values)

    def grid(self) -> Float[np.ndarray, " count"]:
        """The values as given."""
        return np.array(self.values, dtype=np.float64)


def _grid_kind(content: Any) -> str:
    named = "values" in content if isinstance(content, dict) else isinstance(content, Named)
    return "values" if named else "start, stop, count"


Grid: TypeAlias = Annotated[
    Annotated[Evenly, Tag("start, stop, count")] | Annotated[Named, Tag("values")], Discriminator(_grid_kind)
]
"""Values of an axis."""


class SweepBlock(Block, abc.ABC):
    """The axes of a sweep: parameters, or coordinates of the start state, to their values."""

    @property
    @abc.abstractmethod
    def grids(self) -> Mapping[str, Evenly | Named]:
        """Name to grid, in the order of the config."""

    @property
    @abc.abstractmethod
    def known(self) -> tuple[str, ...]:
        """Names that there are."""

    def check(self) -> None:
        """See that there is an axis, and that the product of all can be run."""
        if not self.grids:
            raise rule(f"name an axis and its values, one at least of {', '.join(self.known)}", "sweep")
        lanes = math.prod(grid.size for grid in self.grids.values())
        if lanes > MOST_LANES:
            keys = (f"sweep.{name}{key}" for key in ("", ".count", ".values") for name in self.grids)
            counts = " x ".join(f"{grid.size:,}" for grid in self.grids.values())
            raise rule(f"{counts} are {lanes:,} lanes, and {MOST_LANES:,} is the most", "sweep", *keys)


# ---- a system and its start


class InitialBlock(Block, abc.ABC):
    """The start state at t = 0."""

    @abc.abstractmethod
    def coordinates(self) -> Mapping[str, float | None]:
        """Coordinates by name; None where the config does not say and there is no default."""

    @property
    def given(self) -> frozenset[str]:
        """Names of the coordinates that the config says."""
        return frozenset(name for name in self.model_fields_set if self.coordinates().get(name) is not None)


class SystemBlock(Block, abc.ABC):
    """What moves."""

    @abc.abstractmethod
    def check(self, initial: Any, sweep: SweepBlock) -> None:
        """See that parameters, start state and sweep go together."""

    @abc.abstractmethod
    def flow(self, parameters: Mapping[str, float]) -> Flow:
        """The system in continuous time, with these parameters in place of its own."""

    @abc.abstractmethod
    def start(self, initial: Any) -> Mapping[str, float]:
        """Coordinates of the start state that the flow asks for."""

    def shares(self, name: str, values: Float[np.ndarray, " n"], flow: Flow) -> bool:
        """Whether all lanes of a program must have the same of these values of a parameter."""
        return flow.shares(name)
