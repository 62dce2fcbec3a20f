"""What every analysis takes and gives: a scene and a way to run lanes in, a dataset out. No files.

An analysis is one file: its options, what it needs, its numbers, its table for the terminal and its panel of figures;
`analyses.ANALYSES` lists them. Its dataset has the lanes as dimension `LANE`, which the engine turns into the axes of
the sweep.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, Protocol

import jax
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int
from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

from jaxnh.exceptions import InputError
from jaxnh.maps.along import StrobeAlong
from jaxnh.maps.build import make_strobe
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.protocol import Strobe
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import Solver
from jaxnh.systems.flow import Flow, State

LANE = "lane"
"""Dimension of lanes side by side."""


# ---- what an analysis is asked for


class Options(BaseModel):
    """Base of the options of an analysis: frozen, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def rule(message: str, *keys: str) -> PydanticCustomError:
    """The error a validator raises for values that do not go together; the config gives it its line.

    Args:
        message: what is wrong, and what would be right.
        keys: dotted paths, from where the validator stands, of the values concerned, the most likely culprit first.
    """
    return PydanticCustomError("rule", "{message}", {"message": message, "keys": keys})


class OptionError(InputError):
    """Options that a scene or sweep has no place for.

    Attributes:
        key: the option, "" for the analysis as such.
    """

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True)
class Axis:
    """One axis of a sweep.

    Attributes:
        name: of the parameter, or of the coordinate of the start state; the name of the dimension in results.
        values: in the order of the config, (n,).
        long_name: what it is, in words, its name included.
        kind: "lane", a parameter that lanes side by side may differ in; "start", a coordinate of the start state;
            "shared", a parameter that changes what all lanes of a program share, as the table of kicks.
    """

    name: str
    values: Float[np.ndarray, " n"]
    long_name: str
    kind: Literal["lane", "start", "shared"] = "lane"


class Setting(NamedTuple):
    """What `Analysis.check` may look at.

    Attributes:
        flow: the system in continuous time.
        autonomous: whether it has no clock and is seen on a section.
        axes: of the sweep.
        precision: "float64" or "float32".
        flow_at: the system in continuous time at a value of the first axis; raises ValueError where there is none.
    """

    flow: Flow
    autonomous: bool
    axes: tuple[Axis, ...]
    precision: str
    flow_at: Callable[[float], Flow]

    @property
    def advice(self) -> str:
        """What to say of a first axis that is no parameter of a lane's own: which one may be put in its place."""
        names = [axis.name for axis in self.axes if axis.kind == "lane"]
        names = names[:1] or sorted(name for name in self.flow.parameters if not self.flow.shares(name))[-1:]
        return f"; put a parameter such as {names[0]} first" if names else ""


# ---- what an analysis is given


@dataclass(frozen=True)
class Scene:
    """Lanes of one system, and the solver that meets the accuracy asked for.

    Attributes:
        system: the flow, or without a clock the flow on its section.
        start: start states, components (lanes,).
        p: parameters that lanes have of their own, by name, each (lanes,).
        solver, steps, compensated: what P is computed with.
        error_estimate: error of one period's map that about one in 10,000 of the periods of a sweep's lanes exceeds.
        place: (lanes,) place of each lane along the first axis of the sweep; by default in order.
        along: the first axis, where the lanes are those along it, at one point of all others.
        flow_at: where all lanes share the parameter that is this axis, the system at a value of it; else None.
        chosen: what analyses have chosen from the whole sweep (`Analysis.choose`), by analysis.
        precision: "float64" or, where asked for, "float32", of the arithmetic within a period.
    """

    system: Flow
    start: State
    p: Mapping[str, Float[np.ndarray, " lanes"]]
    solver: Solver
    steps: int
    compensated: bool
    error_estimate: float
    place: Int[np.ndarray, " lanes"] | None = None
    along: Axis | None = None
    flow_at: Callable[[float], Flow] | None = None
    chosen: Mapping[str, Mapping[str, int]] = field(default_factory=dict[str, Mapping[str, int]])
    precision: str = "float64"

    @property
    def count(self) -> int:
        """Number of lanes."""
        return len(jax.tree.leaves(self.start)[0])

    @property
    def lanes(self) -> tuple[State, Mapping[str, Float[np.ndarray, " lanes"]]]:
        """Start states and parameters, as lane functions take them."""
        return self.start, dict(self.p)

    @property
    def places(self) -> Int[np.ndarray, " lanes"]:
        """Place of each lane along the first axis."""
        return np.arange(self.count) if self.place is None else self.place

    @property
    def flow(self) -> Flow:
        """The system in continuous time."""
        return self.system.flow

    def in_time(self) -> Scene:
        """The same scene with no section, for what is an average or a path over time."""
        return replace(self, system=self.flow, start=self.start.state) if self.flow is not self.system else self

    def take(self, lanes: slice | Int[np.ndarray, " some"]) -> Scene:
        """The scene of some of its lanes: a slice, or an array of their numbers."""
        start, p = picked((self.start, dict(self.p)), lanes)
        along = self.along and replace(self.along, values=self.along.values[lanes])
        return replace(self, start=start, p=p, place=self.places[lanes], along=along)

    @property
    def line(self) -> Axis:
        """The first axis, along which the lanes lie.

        Raises:
            ValueError: they do not lie along one.
        """
        if self.along is None:
            raise ValueError("the lanes of this scene do not lie along one axis")
        return self.along

    def at(self, values: Float[np.ndarray, " points"]) -> Scene:
        """The scene at other values along the first axis, the start state and all else as in its first lane."""
        along = replace(self.line, values=np.asarray(values))

        def repeated(leaf: np.ndarray) -> np.ndarray:
            return np.full(len(values), leaf[0])

        start, p = jax.tree.map(repeated, (self.start, dict(self.p)))
        return replace(self, start=start, p={**p, along.name: along.values}, place=None, along=along)

    def moved(self, value: float) -> Scene:
        """The scene under the system at a value of the first axis, which all lanes share."""
        assert self.flow_at is not None
        return replace(self, system=self.flow_at(value), flow_at=None)

    def strobe(self, refinement: float = 1) -> Strobe:
        """P with `refinement` times the steps that the accuracy asks for; of a shared axis, one for each value."""
        if self.flow_at is not None:

            @functools.cache
            def at(value: float) -> Strobe:
                return self.moved(value).strobe(refinement)

            return StrobeAlong(self.system, self.line.name, at)
        steps = round(self.steps * refinement)
        strobe = make_strobe(self.system, self.solver, steps, compensated=self.compensated)
        return in_precision(strobe, self.precision)


def picked(tree: Any, lanes: slice | Int[np.ndarray, " some"] | Bool[np.ndarray, " lanes"]) -> Any:
    """Some lanes of a pytree whose leaves have the lanes as first axis."""

    def some(leaf: np.ndarray) -> np.ndarray:
        return leaf[lanes]

    return jax.tree.map(some, tree)


def spread(start: State, lanes: int) -> State:
    """A start state of floats as lanes, components of shape (lanes,)."""

    def lane(component: float) -> np.ndarray:
        return np.full(lanes, component, float)

    return jax.tree.map(lane, start)


def section_points(scene: Scene) -> Float[np.ndarray, "lanes dimension"]:
    """Section coordinates of the start states, on the host."""
    return scene.system.section_point(scene.start)


def counted_in(system: Flow) -> str:
    """Units of a number of iterates of a system's map: periods, crossings, or without either units of time."""
    if system.flow is not system:
        return "crossings"
    if not system.autonomous:
        return "periods"
    return "units of time 2 pi/omega" if "omega" in system.parameters else "units of time"


class LaneRunner(Protocol):
    """Runs a per-lane function over any number of lanes (`jaxnh.engine.lanes.Lanes`)."""

    def __call__(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        *,
        periods: float = 0.0,
        tile: int | None = None,
        static: tuple[Any, ...] = (),
    ) -> Any:
        """function(*shared, *lane, *static) for every lane, results stacked along a new first axis."""

    def stage(self, label: str, total: float) -> AbstractContextManager[None]:
        """Show the calls inside as one stage of `total` lane-periods."""
        ...


# ---- what an analysis gives


Entry = tuple[tuple[str, ...], np.ndarray, dict[str, Any]]
"""A variable as `xarray.Dataset` takes it: dimensions, data, attributes."""


def variable(dims: Sequence[str] | str, data: Any, long_name: str, units: str = "1", **attrs: Any) -> Entry:
    """A variable of a dataset, with its words and units; "1" where it has none."""
    names = (dims,) if isinstance(dims, str) else tuple(dims)
    return names, np.asarray(data), {"long_name": long_name, "units": units, **attrs}


class Table(NamedTuple):
    """A table for the terminal, all of it text.

    Attributes:
        title: stands above it.
        heads: of the columns, (columns,).
        rows: cells, (rows, columns).
        caption: stands below it.
        left: numbers of the columns that are aligned on the left; all others are on the right.
        ruled: whether columns have lines between them; without, cells are never wrapped.
        bold: number of a row that stands out.
        breaks: numbers of the rows that begin a new part.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str | None = None
    left: tuple[int, ...] = ()
    ruled: bool = True
    bold: int | None = None
    breaks: tuple[int, ...] = ()


class Program(NamedTuple):
    """A compiled function of lanes that stands for a period of an analysis, for `jaxnh.cost --effects`.

    Attributes:
        function, shared, lanes, static, tile: as a `LaneRunner` takes them.
        turns: how often its loops turn in a period, outermost first; of a `whole` program in a call, where it does not
            say itself.
        periods: periods a call.
        whole: whether all of it counts, as it runs, and not the loop of a period alone.
    """

    function: Callable[..., Any]
    shared: tuple[Any, ...]
    lanes: tuple[Any, ...]
    turns: tuple[float, ...]
    static: tuple[Any, ...] = ()
    periods: int = 1
    tile: int | None = None
    whole: bool = False


class Price(NamedTuple):
    """The program of an analysis (None: it is not measured), that without it, and a note that says why or how."""

    with_it: Program | None
    without_it: Program
    note: str


def map_alone(scene: Scene, strobe: Strobe | None = None, tile: int | None = None) -> Program:
    """One period of the scene's own map, or of another one of the same lanes, and nothing else."""
    strobe = scene.strobe() if strobe is None else strobe
    return Program(iterate, (strobe, np.int32(1)), scene.lanes, (1.0, *strobe.turns), tile=tile)


def newton_price(scene: Scene, tile: int) -> Price:
    """A period of Newton on orbits: the map with a tangent for every coordinate, against the map alone."""
    strobe = scene.strobe()
    lanes = section_points(scene), dict(scene.p)
    program = Program(derivatives, (strobe, np.int32(1)), lanes, (1.0, *strobe.turns), tile=tile)
    note = f"{scene.system.dimension} tangents in every period of Newton, the map alone before it"
    return Price(program, map_alone(scene, tile=tile), note)


def _always(options: Any) -> bool:
    return True


def _few(options: Any) -> int:
    return 64


def _nothing(data: xr.Dataset) -> Mapping[str, int]:
    return {}


def _all_right(options: Any, setting: Setting) -> None:
    return None


@dataclass(frozen=True)
class Analysis:
    """An entry in the table of analyses.

    Attributes:
        name: the key in YAML and the group in the result file.
        options: the model of its options.
        periods: (options, number of lanes) to the lane-periods that a run of it is expected to integrate.
        run: (options, scene, lane runner) to its dataset; with `needs`, also a mapping of the datasets it needs.
            Attributes of the dataset are those of the group: `panel` and what the panel reads, and `warnings`, lines
            for the user.
        needs: analyses that have to run before, with their defaults where the config does not ask for them.
        independent: options to whether its lanes know nothing of each other. If not, it is run along the whole first
            axis, once for each point of the others (`Scene.along`); variables without dimensions are then attributes
            of the group, or get the other axes where there are some.
        newton: whether it rests on Newton for orbits, for which single precision is too coarse.
        clock: whether it needs a clock.
        in_time: whether it looks at a flow without a clock in time, and needs no section of it.
        numbers: options to about how many numbers a lane leaves.
        choose: (options, scene, lane runner) to whole numbers that hold for all lanes of a sweep; of several scenes
            that sample one, the largest count. `run` finds them in `Scene.chosen`.
        count: dataset to the number of lanes of each kind: attributes of the group, that add up over parts.
        check: (options, setting) raises `OptionError` where they do not go together.
        table: (dataset, published values by name, their source) to a table for the terminal.
        price: (options, scene) to what a period of it costs; without, it is not measured.
        brief: options that make a run short and leave as many numbers a lane.
    """

    name: str
    options: type[Options]
    periods: Callable[[Any, int], float]
    run: Callable[..., xr.Dataset]
    needs: tuple[str, ...] = ()
    independent: Callable[[Any], bool] = _always
    newton: bool = False
    clock: bool = False
    in_time: bool = False
    numbers: Callable[[Any], int] = _few
    choose: Callable[[Any, Scene, LaneRunner], Mapping[str, int]] | None = None
    count: Callable[[xr.Dataset], Mapping[str, int]] = _nothing
    check: Callable[[Any, Setting], None] = _all_right
    table: Callable[[xr.Dataset, Mapping[str, np.ndarray], str], Table] | None = None
    price: Callable[[Any, Scene], Price] | None = None
    brief: Mapping[str, int] = field(default_factory=dict[str, int])
