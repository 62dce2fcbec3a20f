"""The input of an analysis: the lanes of one system with the solver that meets the accuracy, and a way to run them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, Protocol, TypeVar, overload

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnh.maps.build import make_return_map, prepare_tables
from jaxnh.maps.family import Maps, ParameterFamily
from jaxnh.maps.inverse import make_inverse_map
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import Section, System, flow_of
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import Solver
from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.readout import UNSAID
from jaxnh.systems.rows import select
from jaxnh.systems.state import State


@dataclass(frozen=True)
class Axis:
    """One axis of a sweep.

    Attributes:
        name: of the parameter, or of the coordinate of the start state.
        values: in the order of the config, (n,).
        long_name: what it is, in words, its name included.
        kind: "lane", a parameter that lanes side by side may differ in; "start", a coordinate of the start state;
            "shared", a parameter that changes what all lanes of a program share, as the table of kicks.
        units: of its values.
    """

    name: str
    values: Float[np.ndarray, " n"]
    long_name: str
    kind: Literal["lane", "start", "shared"] = "lane"
    units: str = "1"

    @property
    def dim(self) -> str:
        """Name of the dimension in results: that of the axis, after `start_` for a coordinate of the start state."""
        return f"start_{self.name}" if self.kind == "start" else self.name


@dataclass(frozen=True)
class LaneBatch:
    """Lanes of one system, and the solver that meets the accuracy asked for.

    Attributes:
        system: the flow, or without a clock the flow on its section; that of the first lane where they differ.
        start: start states, components (lanes,).
        p: parameters of lanes, by name, each (lanes,): those of their own, and those of the family.
        solver, steps, compensated: what P is computed with.
        error_estimate: error of one period's map that about one in 10,000 of the periods of a sweep's lanes exceeds.
        sizes: of the motion, that this error is relative to, by coordinate in the order of the components that errors
            are compared in; none where it is absolute.
        given_sizes: those among them that the config gives.
        largest: modulus of the values of each parameter over the whole sweep, of those that are swept: what differences
            in it are small against, so that results do not depend on which lanes are computed together.
        place: (lanes,) place of each lane along the first axis of the sweep; by default in order.
        axis: the first axis, where the lanes are those along it, at one point of all others.
        family: where lanes differ in parameters that a program shares, the system at each value of these.
        chosen: what analyses have chosen from the whole sweep (`Analysis.choose`), by analysis.
        precision: "float64" or, where asked for, "float32" or "extended", of the arithmetic within a period.
        target: the error asked for, while analyses choose by it steps of their own; 0 where they are to have none.
    """

    system: System
    start: State
    p: Mapping[str, Float[np.ndarray, " lanes"]]
    solver: Solver
    steps: int
    compensated: bool
    error_estimate: float
    place: Int[np.ndarray, " lanes"] | None = None
    axis: Axis | None = None
    family: ParameterFamily[System] | None = None
    chosen: Mapping[str, Mapping[str, int]] = field(default_factory=dict[str, Mapping[str, int]])
    precision: str = "float64"
    target: float = 0.0
    sizes: Mapping[str, float] = field(default_factory=dict[str, float])
    given_sizes: Mapping[str, float] = field(default_factory=dict[str, float])
    largest: Mapping[str, float] = field(default_factory=dict[str, float])

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

    @functools.cached_property
    def cache(self) -> dict[Any, Any]:
        """Intermediate results of one analysis that another one needs for the same lanes."""
        return {}

    @property
    def flow(self) -> Flow:
        """The system in continuous time."""
        return flow_of(self.system)

    @property
    def on_section(self) -> bool:
        """Return whether its return map goes from crossing to crossing of a section."""
        return isinstance(self.system, Section)

    @property
    def chart(self) -> Chart:
        """The coordinates that its return map acts on."""
        return self.system.chart

    def without_section(self) -> LaneBatch:
        """Return the same batch without a section, for averages and paths over time."""
        return replace(self, system=self.flow, start=self.start.state) if self.on_section else self

    def take(self, lanes: slice | Int[np.ndarray, " some"]) -> LaneBatch:
        """Return the batch of a subset of its lanes: a slice, or an array of their numbers."""
        start, p = select((self.start, dict(self.p)), lanes)
        axis = self.axis and replace(self.axis, values=self.axis.values[lanes])
        return replace(self, start=start, p=p, place=self.places[lanes], axis=axis)

    def parameters_of(self, lanes: Int[np.ndarray, " some"]) -> dict[str, Float[np.ndarray, " some"]]:
        """Return the parameters of lanes by their numbers."""
        return select(dict(self.p), lanes)

    def parameters_at(
        self, names: Sequence[str], values: Float[np.ndarray, "points names"]
    ) -> dict[str, Float[np.ndarray, " points"]]:
        """Return parameters of lanes at values of some of them, all others as in the first lane."""
        p = {name: np.full(len(values), own[0]) for name, own in self.p.items()}
        return p | dict(zip(names, values.T, strict=True))

    @property
    def first_axis(self) -> Axis:
        """The first axis, along which the lanes lie.

        Raises:
            ValueError: they do not lie along one.
        """
        if self.axis is None:
            raise ValueError("the lanes of this batch do not lie along one axis")
        return self.axis

    def at_values(self, values: Float[np.ndarray, " points"]) -> LaneBatch:
        """Return the batch at other values along the first axis, the start state and all else as in its first lane."""
        axis = replace(self.first_axis, values=np.asarray(values))

        def repeated(leaf: np.ndarray) -> np.ndarray:
            return np.full(len(values), leaf[0])

        start, p = jax.tree.map(repeated, (self.start, dict(self.p)))
        return replace(self, start=start, p={**p, axis.name: axis.values}, place=None, axis=axis)

    def with_system(self, system: System) -> LaneBatch:
        """Return the batch with one system of its family, without the parameters that are part of this system."""
        assert self.family is not None
        p = {name: values for name, values in self.p.items() if name not in self.family.names}
        return replace(self, system=system, p=p, family=None)

    def strobe(self, refinement: float = 1) -> Maps:
        """Return P with `refinement` times the steps that the accuracy asks for; for a family one for each value."""
        if (family := self.family) is not None:
            return family.maps(
                self.system,
                ("period", refinement),
                lambda tree: self.with_system(tree).map(refinement),
                lambda trees: prepare_tables(trees, self.solver, round(self.steps * refinement)),
            )
        return self.map(refinement)

    def map(self, refinement: float = 1) -> ReturnMap:
        """Return P for lanes with one system, with `refinement` times the steps."""
        steps = round(self.steps * refinement)
        strobe = make_return_map(self.system, self.solver, steps, compensated=self.compensated)
        return in_precision(strobe, self.precision)

    def inverse(self, refinement: float = 1) -> Maps:
        """Return the inverse of P, with `refinement` times the steps; for a family one for each value.

        Raises:
            TypeError: motions are not followed backwards, or a map says no inverse.
        """
        if (family := self.family) is not None:
            key = "inverse", refinement
            return family.maps(self.system, key, lambda tree: self.with_system(tree).inverse_of_lanes(refinement))
        return self.inverse_of_lanes(refinement)

    def inverse_of_lanes(self, refinement: float = 1) -> ReturnMap:
        """Return the inverse of P for lanes with one system, with `refinement` times the steps."""
        steps = round(self.steps * refinement)
        return in_precision(
            make_inverse_map(self.system, self.solver, steps, compensated=self.compensated), self.precision
        )


def rate_attrs(flow: Flow) -> dict[str, str]:
    """Return the units of a rate, for `variable`; of a map also what it is counted in."""
    if not flow.continuous:
        return {"units": "1", "counted_in": "1/iterate"}
    time = flow.readout.labels.units["t"]
    return {"units": time if time in ("1", UNSAID) else f"1/{time}" if time.isalpha() else f"1/({time})"}


def iterate_units(system: System) -> str:
    """Return the unit that iterates of a system's map count: periods, iterates, crossings, or units of time."""
    if isinstance(system, Section):
        return "crossings"
    if not system.autonomous:
        return "periods" if system.continuous else "iterates"
    return system.readout.labels.iterates


def keep_all(result: Any) -> tuple[Any, Any]:
    """Leave all of a result to the next function, and bring all of it to the host."""
    return result, result


class Link(NamedTuple):
    """A function of a chain over lanes: function(*shared, *lane, *static), the first of `lane` from the link before.

    Attributes:
        function: pure function of one lane, defined at module level (programs are kept by it).
        shared: pytrees that all lanes see alike, or families, of which a lane sees the tree at its own values.
        static: further hashable arguments, part of the program.
        periods: periods that a lane costs.
        keep: of the result, what the next link takes, and what comes to the host; nothing is computed in it.
    """

    function: Callable[..., Any]
    shared: tuple[Any, ...]
    static: tuple[Any, ...] = ()
    periods: float = 0.0
    keep: Callable[[Any], tuple[Any, Any]] = keep_all


Result = TypeVar("Result")


class LaneRunner(Protocol):
    """Runs a per-lane function over any number of lanes (`jaxnh.engine.executor.lanes.LaneExecutor`).

    What comes back has the type of the function's result, of NumPy's arrays: a record stays a record.
    """

    @property
    def on_card(self) -> bool:
        """Return whether lanes run on a card, where the host is slow beside them."""
        ...

    @overload
    def __call__(
        self,
        function: Callable[..., Array],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        *,
        periods: float = 0.0,
        tile: int | None = None,
        static: tuple[Any, ...] = (),
    ) -> np.ndarray: ...

    @overload
    def __call__(
        self,
        function: Callable[..., Result],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        *,
        periods: float = 0.0,
        tile: int | None = None,
        static: tuple[Any, ...] = (),
    ) -> Result:
        """function(*shared, *lane, *static) for every lane, results stacked along a new first axis."""

    def iterate(self, maps: Maps, n: int, lanes: tuple[State, Parameters], *, tile: int | None = None) -> State:
        """Return Pⁿ of every lane, in as many calls as are needed to let a run be stopped in time."""
        ...

    def record(self, maps: Maps, count: int, lanes: tuple[State, Parameters], *, tile: int | None = None) -> State:
        """Return the states of every lane after 1, 2, …, count periods, components (lanes, count)."""
        ...

    def observe(
        self,
        maps: Maps,
        count: int,
        lanes: tuple[State, Parameters],
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        *,
        tile: int | None = None,
    ) -> tuple[Any, State]:
        """Return function(*shared, state) of the states of `record`, (lanes, count, …), and the last of them."""
        ...

    def summarise(
        self,
        maps: Maps,
        count: int,
        lanes: tuple[State, Parameters],
        beside: Any,
        function: Callable[..., Result],
        static: tuple[Any, ...] = (),
        *,
        tile: int | None = None,
    ) -> Result:
        """Return function(maps, (states, beside), p, *static) of the states of `record`, which stay on the device."""
        ...

    def chain(self, links: Sequence[Link], lanes: tuple[Any, ...], *, tile: int | None = None) -> list[Any]:
        """Return what comes to the host of each of some functions, each of what the one before leaves on the device."""
        ...

    def stage(self, label: str, total: float) -> AbstractContextManager[None]:
        """Show the calls inside as one stage of `total` lane-periods."""
        ...
