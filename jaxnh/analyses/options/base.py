"""Base of the options of analyses, and how a rule of several keys is told. Nothing here imports JAX."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from jaxnh.exceptions import InputError

BLOCKS = 16
"""Equal parts of an average, each a mean of its own."""

Side = Annotated[tuple[float, float], Field(strict=False)]
"""The lowest and the highest value of a coordinate."""

Box = Annotated[
    dict[str, Side], Field(description="Coordinates of random starts, each with its lowest and highest value")
]
"""Sides of the box that random starts are drawn from, by coordinate."""


Extra = Annotated[bool | None, AfterValidator(lambda asked: asked or None)]
"""Choice of numbers beside those that there are always; None for no: what decides no number is in no hash."""


Omission = Annotated[bool | None, AfterValidator(lambda asked: None if asked else asked)]
"""Choice of numbers that there are where nothing is said; None for yes, likewise."""


class Block(BaseModel, frozen=True):
    """A mapping in a config: frozen, strict about types, and a key that is not known is an error."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    def _set_private(self, **values: Any) -> None:
        """Set private attributes, which a type checker takes to be as frozen as the others."""
        for name, value in values.items():
            setattr(self, name, value)


class _OptionsType(type(BaseModel)):
    """Options that are made by hand say what is wrong with them in one line, as those of a config do."""

    if not TYPE_CHECKING:  # which would know no arguments of options any more

        def __call__(cls, *arguments, **options):
            name, known = cls.__name__.removesuffix("Options"), list(cls.model_fields)
            if arguments:
                raise InputError(f"options are given by name, as {name}({known[0] if known else ''}=...)")
            try:
                return super().__call__(**options)
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
            key = ".".join(map(str, first["loc"]))
            if first["type"] == "extra_forbidden":
                raise InputError(f"{name} has no option {key}; it has {', '.join(known) or 'none'}")
            message = first["msg"].replace("Input should be", "must be")
            raise InputError(f"{name}{key and f'({key}=...)'}: {message}")


class Options(BaseModel, metaclass=_OptionsType):
    """Base of the options of an analysis.

    Attributes:
        needs: analyses that run before it, with their defaults where the config does not ask for them.
        in_time: whether it follows a flow without a clock in time, and needs no section of it.
        newton: whether it rests on Newton for orbits, for which single precision is too coarse.
        extended: whether it makes use of `accuracy.precision: extended`.
        untimed: whether its results have no time, so that the flow may be in time over its period.
    """

    model_config = Block.model_config

    needs: ClassVar[tuple[str, ...]] = ()
    in_time: ClassVar[bool] = False
    newton: ClassVar[bool] = False
    extended: ClassVar[bool] = False
    untimed: ClassVar[bool] = False


class SensitivityOptions(Options):
    """Options of analyses whose numbers have derivatives in the parameters of the flow."""

    sensitivities: Extra = Field(
        default=None, description="Whether to give the derivatives of its numbers in every parameter of the flow too"
    )


def rule(message: str, *keys: str) -> PydanticCustomError:
    """The error a validator raises for values that do not go together; the config gives it its line.

    Args:
        message: what is wrong, and what would be right.
        keys: dotted paths, from where the validator stands, of the values concerned, the most likely culprit first.
    """
    return PydanticCustomError("rule", "{message}", {"message": message, "keys": keys})


def check_random_starts(
    box: Mapping[str, tuple[float, float]], n_starts: int, seeded: bool, name: str = "n_starts"
) -> None:
    """Check that random starts have a box to be drawn from, whose sides are in order, and that a seed is of some."""
    if bool(n_starts) != bool(box):
        raise rule(
            *(
                (f"goes with {name}, the number of random starts in it", "box")
                if box
                else ("needs a box to draw from", name)
            )
        )
    check_sides(box)
    if seeded and not n_starts:
        raise rule(f"goes with {name}, and there are none", "seed")


def check_sides(box: Mapping[str, tuple[float, float]], key: str = "box") -> None:
    """Check that of each side of a box, the option of a name, the lower number stands first."""
    for name, (low, high) in box.items():
        if not low < high:
            raise rule(f"the first number must be the lower one, not {low:g} and {high:g}", f"{key}.{name}", key)
