"""Blocks of a config for a user's system: keys are its own parameters, coordinates and velocities.

Which keys there are is known from the user's file, which the blocks find in the context of their validation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from pydantic import ConfigDict, Field, PrivateAttr, ValidationInfo, model_validator

from jaxnh.analyses.base import rule
from jaxnh.config.blocks import Block, EvenGrid, Grid, InitialBlock, SectionBlock, SweepBlock, SystemBlock, ValueGrid
from jaxnh.config.messages import listed, unknown
from jaxnh.maps.section import Section
from jaxnh.systems.first_order import FirstOrder
from jaxnh.systems.flow import STATUS, Flow, Parameters
from jaxnh.systems.lagrangian import Lagrangian, Motion
from jaxnh.systems.user_file import OF_RESULTS, UserFile

_LARGEST_RESIDUAL = 1e-6  # of f at the start, in units of |A q̇| + 1: what the digits of a config leave
_MOST_CHECKED = 100_000  # lanes at which f is looked at
_MOST_CLOCKS = 1000  # values of a parameter at which the period is looked at


class UserBlock(Block):
    """A block whose further keys are named in the user's file."""

    model_config = ConfigDict(extra="allow")

    _file: UserFile = PrivateAttr()

    @model_validator(mode="after")
    def _check_keys(self, info: ValidationInfo) -> UserBlock:
        """Each key must be known."""
        assert isinstance(info.context, UserFile)
        self._file = info.context
        for name in self.model_extra or {}:
            if name not in self.known:
                raise rule(unknown(name, (*type(self).model_fields, *self.known)), name)
        return self

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the further keys."""
        raise NotImplementedError


class UserInitial(InitialBlock, UserBlock):
    """The start state at t = 0 of a user's system: coordinates NAME and velocities NAME_dot, zero where not given."""

    __pydantic_extra__: dict[  # pyright: ignore[reportIncompatibleVariableOverride]
        str, Annotated[float, Field(description="A coordinate NAME, or a velocity NAME_dot")]
    ] = Field(init=False)

    project: bool = Field(
        default=False, description="Move starts that are off the constraints to the nearest velocities on them"
    )

    @property
    def known(self) -> tuple[str, ...]:
        """Coordinates, of mechanics each with its velocity."""
        return self._file.states

    def coordinates(self) -> Mapping[str, float]:
        """Coordinates and velocities by name."""
        return {name: self.__pydantic_extra__.get(name, 0.0) for name in self.known}


class UserSweep(SweepBlock, UserBlock):
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
        """Parameters, then coordinates, of mechanics each with its velocity."""
        return (*self._file.parameters, *self._file.states)


class UserSection(SectionBlock):
    """Where a user's flow without a clock is looked at: where a coordinate, or a sum of several, passes a value."""

    coordinate: str | None = Field(default=None, description="Coordinate that decides; of mechanics a position")
    normal: dict[str, float] | None = Field(
        default=None, description="In place of a coordinate the normal of a plane: a number for each that has a part"
    )
    value: float = Field(default=0.0, description="Its value on the section")

    _names: tuple[str, ...] = PrivateAttr()

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> UserSection:
        assert isinstance(info.context, UserFile)
        self._names = info.context.coordinates
        if (self.coordinate is None) == (self.normal is None):
            raise rule("a section is by a coordinate or by the normal of a plane; give one of them", "coordinate")
        for name in self.normal or (self.coordinate,):
            if name not in self._names:
                key = "coordinate" if self.normal is None else f"normal.{name}"
                raise rule(unknown(str(name), self._names), key)
        if self.normal is not None and not any(self.normal.values()):
            raise rule("a normal has a length; one number at least must not be 0", "normal")
        return self

    def of(self, flow: Flow) -> Section:
        """A flow on this section."""
        if self.coordinate is not None:
            number = self._names.index(self.coordinate)
            return Section(flow, self.coordinate, number, self.value, self.direction, longest=self.longest)
        given = self.normal or {}
        normal = tuple(given.get(name, 0.0) for name in self._names)
        number = int(np.argmax(np.abs(normal)))
        made = Section(flow, self._names[number], number, self.value, self.direction, normal)
        return replace(made, longest=self.longest, title=_combination(given))


def _combination(weights: Mapping[str, float]) -> str:
    """A sum as people write it: "x - y", "2 x + 0.5 z"."""
    terms = [
        f"{'-' if weight < 0 else '+'} {'' if abs(weight) == 1 else f'{abs(weight):g} '}{name}"
        for name, weight in weights.items()
        if weight
    ]
    first, *others = terms
    return " ".join([first.replace("- ", "-").removeprefix("+ "), *others])


class UserSystem(SystemBlock, UserBlock):
    """A user's file, and its parameters."""

    __pydantic_extra__: dict[  # pyright: ignore[reportIncompatibleVariableOverride]
        str, Annotated[float, Field(description="A parameter of the system")]
    ] = Field(init=False)

    file: str = Field(description="Python file with a function system, beside the config")

    @property
    def known(self) -> tuple[str, ...]:
        """Parameters."""
        return tuple(self._file.parameters)

    @property
    def user_file(self) -> UserFile:
        """The file, read and tried out."""
        return self._file

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters, with the file's defaults where the config says nothing."""
        return {**self._file.parameters, **self.__pydantic_extra__}

    def start(self, initial: UserInitial) -> Mapping[str, float]:
        """Coordinates and velocities of the start state."""
        return initial.coordinates()

    def flow(self, parameters: Mapping[str, float]) -> Lagrangian | FirstOrder:
        """The system, with these parameters, which lanes may have of their own, in place of its own."""
        return self._file.flow({**self.parameters, **parameters}, tuple(parameters))

    def is_shared(self, name: str, values: Float[np.ndarray, " n"], flow: Flow) -> bool:
        """Whether the strobe period depends on a parameter: anywhere near its value, or between these."""
        picked = values[_evenly(len(values), _MOST_CLOCKS)]
        return (
            flow.is_shared(name)
            or len({self._file.period({**dict(flow.parameters), name: float(value)}) for value in picked}) > 1
        )

    def check(self, initial: UserInitial, sweep: SweepBlock) -> None:
        """See that no key says what an axis says, and that f = 0 holds at the start of every lane."""
        blocks = {"system": self.__pydantic_extra__, "initial": initial.__pydantic_extra__}
        for name in sweep.grids:
            for block, given in blocks.items():
                if name in given:
                    raise rule(f"{name} is swept; leave it out of {block}", f"{block}.{name}", f"sweep.{name}")
            if name in OF_RESULTS:
                message = f"results have a variable called {name}; give the parameter another name to sweep it"
                raise rule(message, f"sweep.{name}")
        if "project" in initial.known:
            raise rule("initial has a key project of its own; give the coordinate another name", "system.file")
        _check_constraints(self, initial, sweep)


# ---- f = 0 at the start


def _check_constraints(system: UserSystem, initial: UserInitial, sweep: SweepBlock) -> None:
    """See that the constraints hold at the start: at every point of the sweep, or if it is large at some of them.

    Where the start is swept it is enough that they hold somewhere: lanes that begin elsewhere fail (`admitted`).
    """
    axes = _product({name: grid.grid() for name, grid in sweep.grids.items()})
    lanes = len(next(iter(axes.values())))
    parameters = {name: values for name, values in axes.items() if name in system.known}
    flow = system.flow({name: float(values[0]) for name, values in parameters.items()})
    if isinstance(flow, FirstOrder) or not flow.constraints:
        if initial.project:
            raise rule("the system has no constraints; leave it out", "initial.project")
        return
    coordinates = {name: np.full(lanes, value) for name, value in initial.coordinates().items()}
    start = flow.start(coordinates | {name: values for name, values in axes.items() if name in coordinates})
    residuals, off = _off_constraint(flow, start, parameters)
    swept = [f"sweep.{name}" for name in axes if name in coordinates]
    if not np.any(off) or initial.project or (swept and not np.all(off)):
        return
    sizes = np.where(np.isfinite(residuals), np.abs(residuals), np.inf)
    number, lane = np.unravel_index(np.argmax(sizes), sizes.shape)
    state, p = jax.tree.map(lambda leaf: jnp.asarray(leaf[lane]), (start, parameters))
    near = flow.nearest(state, p)
    keys = [f"{coordinate}_dot" for coordinate in flow.names]
    where = listed([f"{name} = {values[lane]:g}" for name, values in axes.items()])
    message = f"f[{number}] is {residuals[number, lane]:.3g} at the start with {where}, and must be 0"
    if np.all(np.isfinite(np.array(near.v))):
        nearest = ", ".join(f"{key}: {float(v):.10g}" for key, v in zip(keys, near.v, strict=True))
        message += f"; the nearest velocities that make it so are {nearest} (initial.project: true moves starts there)"
    swept_velocities = [key for key in swept if key.endswith("_dot")]
    given = [f"initial.{key}" for key in (*keys, *flow.names)]
    raise rule(message, *swept_velocities, *given, *swept, "initial", "system")


def _off_constraint(flow: Lagrangian, start: Motion, p: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of f at start states, (constraints, lanes), and which lanes are off f = 0, (lanes,)."""
    residuals = np.asarray(jax.vmap(lambda y, p: jnp.stack(flow.residuals(0.0, y, p)), out_axes=1)(start, dict(p)))
    limit = _LARGEST_RESIDUAL * (1.0 + np.abs(np.stack([np.asarray(v) for v in start.v])).max(axis=0))
    return residuals, ~np.all(np.abs(residuals) <= limit, axis=0)


def admitted(flow: Flow, start: Motion, p: Parameters, *, project: bool) -> Motion:
    """Start states of a mechanical system (lanes,), those off its constraints failed: or moved onto them, if asked."""
    if not isinstance(flow, Lagrangian) or not flow.constraints:
        return start
    _, off = _off_constraint(flow, start, p)
    if not np.any(off):
        return start
    some = jax.tree.map(lambda leaf: leaf[off], (start, dict(p)))
    if project:
        moved = jax.vmap(flow.nearest)(*some)
    else:
        drift, reason = some[0].watch
        nowhere = jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), some[0])
        moved = nowhere._replace(watch=(drift, np.full_like(reason, STATUS.index("off_constraint"))))
    found = jax.tree.map(np.array, start)
    for leaf, part in zip(jax.tree.leaves(found), jax.tree.leaves(moved), strict=True):
        leaf[off] = part
    return found


def _product(axes: Mapping[str, Float[np.ndarray, " n"]]) -> dict[str, Float[np.ndarray, " lanes"]]:
    """All points of a product of axes, or of a large one some: evenly along each axis, its ends included."""
    counts = {name: len(values) for name, values in axes.items()}
    while np.prod([float(count) for count in counts.values()]) > _MOST_CHECKED:
        largest = max(counts, key=lambda name: counts[name])
        counts[largest] = -(-counts[largest] // 2)
    picked = [values[_evenly(len(values), counts[name])] for name, values in axes.items()]
    return dict(zip(axes, (grid.ravel() for grid in np.meshgrid(*picked, indexing="ij")), strict=True))


def _evenly(count: int, most: int) -> np.ndarray:
    """Numbers below a count, at most so many of them, evenly and with both ends."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
