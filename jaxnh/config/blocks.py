"""Blocks of a config that are the same for all systems, and what those of a system, its start and its sweep have.

Nothing here imports JAX: blocks hold names and numbers, of which `engine.experiment` makes flows.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
from jaxtyping import Float
from pydantic import (
    AfterValidator,
    ConfigDict,
    Discriminator,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    Tag,
    create_model,
    field_validator,
    model_validator,
)

from jaxnh.analyses.options import OPTIONS
from jaxnh.analyses.options.base import Block, Options, rule
from jaxnh.config.messages import close_match, show_value
from jaxnh.config.solver_names import ADAPTIVE, NYSTROM, SOLVERS, SPLITTINGS
from jaxnh.maps.limits import LONGEST_RETURN

MOST_LANES = 10_000_000
"""Lanes of a sweep, the product of its axes, that are run unasked: a dozen variables of them fill a gigabyte."""


class OrderedBlock(Block, frozen=True):
    """A block whose keys have an order that counts."""

    _order: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="wrap")
    @classmethod
    def _keep_order(cls, content: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        block = handler(content)
        if isinstance(content, dict):
            block._set_private(_order=tuple(content))
        return block


# ---- a sweep


class EvenGrid(Block, frozen=True):
    """Evenly spaced values, both ends included."""

    start: float = Field(description="First value")
    stop: float = Field(description="Last value, above or below the first")
    count: int = Field(ge=2, le=MOST_LANES, description="Number of values, both ends included")

    @model_validator(mode="after")
    def _check(self) -> EvenGrid:
        if self.start == self.stop:
            raise rule(f"start and stop must differ, and both are {self.start:g}", "stop", "start")
        if not math.isfinite(self.stop - self.start):
            raise rule("start and stop are further apart than a double can say", "stop", "start")
        return self

    @property
    def size(self) -> int:
        """Number of values."""
        return self.count

    @property
    def first(self) -> float:
        """The first value."""
        return self.start

    def grid(self) -> Float[np.ndarray, " count"]:
        """The values from start to stop."""
        return np.linspace(self.start, self.stop, self.count)


class ValueGrid(Block, frozen=True):
    """Values named one by one."""

    values: tuple[float, ...] = Field(
        min_length=1, max_length=MOST_LANES, strict=False, description="The values, in the order they are wanted"
    )

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.values)

    @property
    def first(self) -> float:
        """The first value."""
        return self.values[0]

    def grid(self) -> Float[np.ndarray, " count"]:
        """The values as given."""
        return np.array(self.values, dtype=np.float64)


def _grid_kind(content: Any) -> str:
    named = "values" in content if isinstance(content, dict) else isinstance(content, ValueGrid)
    return "values" if named else "start, stop, count"


Grid: TypeAlias = Annotated[
    Annotated[EvenGrid, Tag("start, stop, count")] | Annotated[ValueGrid, Tag("values")], Discriminator(_grid_kind)
]
"""Values of an axis."""


class SweepBlock(Block, abc.ABC, frozen=True):
    """The axes of a sweep: parameters, or coordinates of the start state, to their values."""

    @property
    @abc.abstractmethod
    def grids(self) -> Mapping[str, EvenGrid | ValueGrid]:
        """Name to grid, in the order of the config."""

    @property
    @abc.abstractmethod
    def known(self) -> tuple[str, ...]:
        """Names that there are."""

    def check(self) -> None:
        """Check that there is an axis."""
        if not self.grids:
            choice = f", one at least of {', '.join(self.known)}" if self.known else ""
            raise rule(f"name an axis and its values{choice}", "sweep")

    @property
    def lanes(self) -> int:
        """The product of all axes."""
        return math.prod(grid.size for grid in self.grids.values())


class Levels(Block, frozen=True):
    """A sweep from coarse to fine: every level has twice as many values of each axis as the one before."""

    count: int = Field(
        ge=2, le=16, description="Number of levels; the coarsest has every 2^(count - 1)-th value of each axis"
    )
    refine: Literal["all", "boundary"] = Field(
        default="all",
        description="Lanes that a level adds: all, or those near a change of period, verdict, sign of the largest "
        "exponent or attractor in the level before; the others are filled from it",
    )

    @property
    def coarsest(self) -> int:
        """Step of the coarsest level along the axes."""
        return 2 ** (self.count - 1)


# ---- a system and its start


class InitialBlock(Block, abc.ABC, frozen=True):
    """The start state at t = 0."""

    @abc.abstractmethod
    def coordinates(self) -> Mapping[str, float | None]:
        """Coordinates by name; None where the config does not say and there is no default."""

    @property
    def given(self) -> frozenset[str]:
        """Names of the coordinates that the config says."""
        return frozenset(name for name in self.model_fields_set if self.coordinates().get(name) is not None)


class SystemBlock(Block, abc.ABC, frozen=True):
    """The system that moves."""

    prescribed: ClassVar[bool] = False
    """Return whether it is a particle at a prescribed speed."""

    @abc.abstractmethod
    def check(self, initial: Any, sweep: SweepBlock) -> None:
        """Check that parameters, start state and sweep go together."""

    def has_clock(self, sweep: SweepBlock) -> bool | None:
        """Return whether a forcing or a disturbance keeps time; None where the config alone does not say."""
        return None

    @abc.abstractmethod
    def start(self, initial: Any) -> Mapping[str, float]:
        """Coordinates of the start state that the flow asks for."""


class SectionBlock(Block, abc.ABC, frozen=True):
    """Section of a flow without a clock."""

    direction: Literal["up", "down", "both"] = Field(default="up", description="In which it passes the value")
    longest_return: float | None = Field(
        default=None,
        gt=0,
        description="Time without a crossing after which a lane has failed, in units of time; by default "
        f"{LONGEST_RETURN:g}",
    )

    @property
    def longest(self) -> float:
        """Time without a crossing after which a lane has failed."""
        return self.longest_return or LONGEST_RETURN


# ---- accuracy, analyses, published values


class Accuracy(Block, frozen=True):
    """Accuracy of the map of one period, or the method and steps that it is computed by."""

    target: float = Field(
        default=1e-10,
        ge=1e-13,
        le=1e-2,
        description="Error of one period's map that 9,999 in 10,000 of the periods of a sweep's lanes keep; of a "
        "user's system relative to the size of the motion in each coordinate",
    )
    solver: str | None = Field(
        default=None,
        description="Solver to use instead of the one chosen for the target; needs steps, but for those with steps "
        "of a lane's own (rodas5p for stiff systems), whose fineness is chosen for the target",
        json_schema_extra={"enum": [*SOLVERS, None]},
    )
    steps: int | None = Field(
        default=None, ge=1, le=1_000_000, description="Steps a period instead of those chosen for the target"
    )

    precision: Literal["float64", "float32", "extended"] | None = Field(
        default=None,
        description="Arithmetic within a period: float64, or if asked for float32, with errors of 1e-5 and more, or"
        " extended, which is double-double for doublings once they are located",
    )

    @property
    def sizes(self) -> Mapping[str, float]:
        """Sizes of the motion that the config gives, by coordinate."""
        return {}

    @property
    def only_target(self) -> float | None:
        """The target, where it decides; None where a solver is given, whose error is measured as well as can be."""
        return None if self.steps else self.target

    @field_validator("solver")
    @classmethod
    def _known(cls, solver: str | None) -> str | None:
        if solver is not None and solver not in SOLVERS:
            raise rule(f"must be one of {', '.join(SOLVERS)}, not {show_value(solver)}{close_match(solver, SOLVERS)}")
        return solver

    @model_validator(mode="after")
    def _check(self) -> Accuracy:
        if (self.solver is None) != (self.steps is None) and self.solver not in ADAPTIVE:
            given, absent = ("solver", "steps") if self.steps is None else ("steps", "solver")
            raise rule(f"solver and steps go together; give {absent} as well", given)
        if self.precision == "float32" and self.solver and self.solver not in SPLITTINGS:
            raise rule(f"float32 goes with the splittings, and {self.solver} is none", "precision", "solver")
        if self.precision == "extended" and self.solver in (*NYSTROM, *ADAPTIVE):
            raise rule(f"extended goes with all solvers but {self.solver}", "precision", "solver")
        return self


class AnalysesBase(OrderedBlock, frozen=True):
    """The analyses asked for, each with its options; None where an analysis is absent."""

    @model_validator(mode="before")
    @classmethod
    def _defaults(cls, content: Any) -> Any:
        """A name with nothing behind it means all defaults."""
        if content in (None, {}):
            raise rule(f"at least one analysis is needed; known are {', '.join(OPTIONS)}")
        if not isinstance(content, dict):
            return content
        return {name: {} if options is None else options for name, options in content.items()}

    def options(self) -> dict[str, Options]:
        """Options of each analysis by name, in the order of the config; those that one needs come before it."""
        order = dict.fromkeys(word for name in self._order for word in (*OPTIONS[name].needs, name))
        return {name: getattr(self, name) or OPTIONS[name]() for name in order}

    def asked_for(self) -> list[tuple[str, list[Options]]]:
        """Each analysis that the config names, with its options and those of the analyses that it needs."""
        options = self.options()
        return [(name, [options[word] for word in (*OPTIONS[name].needs, name)]) for name in self._order]


if TYPE_CHECKING:
    Analyses = AnalysesBase
else:
    Analyses = create_model(
        "Analyses",
        __base__=AnalysesBase,
        __doc__=AnalysesBase.__doc__,
        **{
            name: (
                options | None,
                Field(default=None, description=f"Options of {name}; nothing or {{}} for all defaults"),
            )
            for name, options in OPTIONS.items()
        },
    )


def _nan_for_null(column: tuple[float | None, ...]) -> tuple[float, ...]:
    return tuple(math.nan if number is None else number for number in column)


Column = Annotated[tuple[float | None, ...], Field(strict=False), AfterValidator(_nan_for_null)]
"""Published numbers of one variable; NaN where the publication has none (null in YAML)."""


class PublishedValues(Block, frozen=True):
    """Published values of an analysis: where they are from, what they are of, and a list of numbers a variable."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Column] = Field(init=False)  # pyright: ignore[reportIncompatibleVariableOverride]

    source: str = Field(description="Where the values are published")
    system: dict[str, Any] = Field(
        default_factory=dict, description="The system they are of, all its parameters; others do not show the values"
    )
    initial: dict[str, Any] = Field(default_factory=dict, description="The start state they are of, all coordinates")

    def columns(self) -> dict[str, np.ndarray]:
        """Variable name to its published values, each float64 of shape (n,)."""
        return {name: np.array(column, dtype=np.float64) for name, column in self.__pydantic_extra__.items()}


class ExploreBlock(Block, frozen=True):
    """The view that the page of `jaxnh explore` opens with; no number of a run depends on it."""

    view: dict[str, int | float | str] = Field(
        default_factory=dict,
        description="Axes with their ranges, the quantity, and its depth, as in the page's address",
    )
    whole: dict[str, tuple[float, float]] = Field(
        default_factory=dict, description="Range of each axis that the page goes back to"
    )
    selected: dict[str, float] | None = Field(default=None, description="Values of the axes of the lane clicked at")
    hidden: list[str] = Field(default_factory=list, description="Layers of the legend that are switched off")
    over: list[str] = Field(default_factory=list, description="Result files laid over the picture, beside this file")
    result: str | None = Field(default=None, description="Result file that is shown in place of computing")
    system_file: str | None = Field(
        default=None, description="Text of the user's file, for where that is not beside this file"
    )
    camera: dict[Literal["azimuth", "elevation"], float] | None = Field(
        default=None, description="Angles in degrees of the portrait in three dimensions, where that is shown"
    )

    @field_validator("whole", mode="before")
    @classmethod
    def _as_pairs(cls, whole: Any) -> Any:
        pairs = isinstance(whole, dict) and all(isinstance(ends, list) for ends in whole.values())
        return {name: tuple(ends) for name, ends in whole.items()} if pairs else whole
