"""Blocks of a config for a user's system: keys are its own parameters, coordinates and velocities.

The names in the user's file are the context of the validation. Where its text alone does not give them, the same blocks
check the keys once more after it has been run (`engine.experiment`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import ConfigDict, Field, PrivateAttr, ValidationInfo, model_validator

from jaxnh.analyses.options.base import Block, rule
from jaxnh.config.blocks import Accuracy, EvenGrid, Grid, InitialBlock, SectionBlock, SweepBlock, SystemBlock, ValueGrid
from jaxnh.config.messages import close_match, explain_unknown
from jaxnh.systems.user_text import OF_RESULTS, Names


class UserBlock(Block, frozen=True):
    """A block whose further keys are named in the user's file."""

    model_config = ConfigDict(extra="allow")

    _names: Names = PrivateAttr()

    @model_validator(mode="after")
    def _check_keys(self, info: ValidationInfo) -> UserBlock:
        """Check that each key is known, if it is known which are."""
        assert isinstance(info.context, Names)
        self._set_private(_names=info.context)
        for name in self.model_extra or {}:
            if name not in self.known:
                raise rule(explain_unknown(name, (*type(self).model_fields, *self.known)), name)
        return self

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the further keys; those that the block has, where the text of the user's file does not give them."""
        raise NotImplementedError

    def _or_own(self, names: tuple[str, ...] | None) -> tuple[str, ...]:
        return tuple(self.model_extra or ()) if names is None else names


class UserInitial(InitialBlock, UserBlock, frozen=True):
    """The start state at t = 0 of a user's system: coordinates NAME and velocities NAME_dot, zero where not given."""

    __pydantic_extra__: dict[  # pyright: ignore[reportIncompatibleVariableOverride]
        str, Annotated[float, Field(description="A coordinate NAME, or a velocity NAME_dot")]
    ] = Field(init=False)

    project: bool = Field(
        default=False, description="Move starts that are off the constraints to the nearest velocities on them"
    )

    level: dict[str, float] | None = Field(
        default=None,
        description="Value of an integral of the system, by name, that the start's velocities are scaled to",
    )

    @model_validator(mode="after")
    def _check_level(self, info: ValidationInfo) -> UserInitial:
        """Check that the level is of an integral, if it is known which there are, and of one."""
        assert isinstance(info.context, Names)
        known = info.context.integrals
        for name in self.level or {}:
            if known is not None and name not in known:
                raise rule(explain_unknown(name, known), f"level.{name}")
        if len(self.level or {}) > 1:
            raise rule("velocities are scaled to the level of one integral; leave out the others", "level")
        return self

    @property
    def known(self) -> tuple[str, ...]:
        """Coordinates, of mechanics each with its velocity."""
        return self._or_own(self._names.states)

    def coordinates(self) -> Mapping[str, float]:
        """Coordinates and velocities by name, and where one is given the level of an integral."""
        return {name: self.__pydantic_extra__.get(name, 0.0) for name in self.known} | (self.level or {})


class UserSweep(SweepBlock, UserBlock, frozen=True):
    """The axes of the sweep, whose product is what is run: parameters, coordinates NAME or velocities NAME_dot."""

    __pydantic_extra__: dict[  # pyright: ignore[reportIncompatibleVariableOverride]
        str, Annotated[Grid, Field(description="Start, stop and count, or values")]
    ] = Field(init=False)
    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    @property
    def grids(self) -> Mapping[str, EvenGrid | ValueGrid]:
        """Name to grid, in the order of the config."""
        return self.__pydantic_extra__

    @property
    def known(self) -> tuple[str, ...]:
        """Parameters, then coordinates, of mechanics each with its velocity, then integrals."""
        parameters, _, states, integrals = self._names
        if parameters is None or states is None or integrals is None:
            return self._or_own(None)
        return (*parameters, *states, *integrals)


class UserAccuracy(Accuracy, frozen=True):
    """Accuracy of the map of one period of a user's system, whose coordinates have sizes of their own."""

    scale: dict[str, Annotated[float, Field(gt=0)]] | None = Field(
        default=None,
        description="Size of the motion that the target is relative to, by coordinate NAME or velocity NAME_dot, in "
        "place of the size measured",
    )

    @model_validator(mode="after")
    def _check_scale(self, info: ValidationInfo) -> UserAccuracy:
        """Check that sizes are those of coordinates, if it is known which there are."""
        assert isinstance(info.context, Names)
        known = info.context.states
        for name in self.scale or {}:
            if known is not None and name not in known:
                raise rule(explain_unknown(name, known), f"scale.{name}")
        return self

    @property
    def sizes(self) -> Mapping[str, float]:
        """Sizes of the motion that the config gives, by coordinate."""
        return self.scale or {}


class UserSection(SectionBlock, frozen=True):
    """Section of a user's flow without a clock: a coordinate, or a sum of several, passes a value."""

    coordinate: str | None = Field(default=None, description="Coordinate that decides; of mechanics a position")
    normal: dict[str, float] | None = Field(
        default=None, description="In place of a coordinate the normal of a plane: a number for each that has a part"
    )
    value: float = Field(default=0.0, description="Its value on the section")

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> UserSection:
        assert isinstance(info.context, Names)
        names = info.context.coordinates
        if (self.coordinate is None) == (self.normal is None):
            raise rule("a section is by a coordinate or by the normal of a plane; give one of them", "coordinate")
        for name in self.normal or (self.coordinate,):
            if names and name not in names:
                key = "coordinate" if self.normal is None else f"normal.{name}"
                known = ", ".join(names)
                raise rule(f"there is no coordinate {name}{close_match(name, names)}; known are {known}", key)
        if self.normal is not None and not any(self.normal.values()):
            raise rule("a normal has a length; one number at least must not be 0", "normal")
        return self


class UserSystem(SystemBlock, UserBlock, frozen=True):
    """A user's file, and its parameters."""

    __pydantic_extra__: dict[  # pyright: ignore[reportIncompatibleVariableOverride]
        str, Annotated[float, Field(description="A parameter of the system")]
    ] = Field(init=False)

    file: str = Field(description="Python file with a function system, beside the config")

    @property
    def known(self) -> tuple[str, ...]:
        """Parameters."""
        return self._or_own(self._names.parameters)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters that the config gives; others have the defaults of the file."""
        return self.__pydantic_extra__

    def start(self, initial: UserInitial) -> Mapping[str, float]:
        """Coordinates and velocities of the start state."""
        return initial.coordinates()

    def check(self, initial: UserInitial, sweep: SweepBlock) -> None:
        """Check that no key gives what an axis gives."""
        level = initial.level or {}
        blocks = {"system": self.__pydantic_extra__, "initial": initial.__pydantic_extra__, "initial.level": level}
        for name in sweep.grids:
            for block, given in blocks.items():
                if name in given:
                    raise rule(f"{name} is swept; leave it out of {block}", f"{block}.{name}", f"sweep.{name}")
            if name in OF_RESULTS:
                message = f"results have a variable called {name}; give the parameter another name to sweep it"
                raise rule(message, f"sweep.{name}")
        for key in ("project", "level"):
            if key in initial.known:
                raise rule(f"initial has a key {key} of its own; give the coordinate another name", "system.file")
