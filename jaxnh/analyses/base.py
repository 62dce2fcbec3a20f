"""What every analysis takes and gives: a scene and a way to run lanes in, a group of named variables out. No files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict

from jaxnh.maps.build import make_strobe
from jaxnh.maps.protocol import Strobe, System
from jaxnh.maps.section import Flow, SectionedFlow
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import Solver


class Options(BaseModel):
    """Base of the options of an analysis: frozen, and a key that is not known is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Variable:
    """An array with named dimensions, as netCDF means it.

    Attributes:
        dims: names of the dimensions, one an axis.
        data: the array.
        long_name: what it is, in words.
        units: "1" where it has none.
        attrs: further attributes.
    """

    dims: tuple[str, ...]
    data: np.ndarray
    long_name: str
    units: str = "1"
    attrs: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Group:
    """The result of one analysis: coordinates are the variables named as their only dimension.

    Attributes:
        variables: name to variable.
        attrs: attributes of the group.
        warnings: sentences for the user, kept in the file as well.
    """

    variables: Mapping[str, Variable]
    attrs: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scene:
    """One system, its start state and sweep, and the solver that meets the accuracy asked for.

    Attributes:
        system: the flow, or without a clock the flow on its section.
        start: start state of every lane, floats: (q, n) of a particle at a prescribed speed.
        values: swept values of b in the order of the sweep, (lanes,).
        solver, steps, compensated: what P is computed with.
        error_estimate: estimated largest error of one period's map.
        first: place of the first value in the whole sweep, where these are a part of it.
        chosen: what analyses have chosen from the whole sweep (`Analysis.choose`), by analysis.
        precision: "float64" or, where asked for, "float32", of the arithmetic within a period.
    """

    system: System
    start: Any
    values: np.ndarray
    solver: Solver
    steps: int
    compensated: bool
    error_estimate: float
    first: int = 0
    chosen: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    precision: str = "float64"

    @property
    def flow(self) -> Flow:
        """The system in continuous time."""
        return self.system.flow if isinstance(self.system, SectionedFlow) else self.system

    def in_time(self) -> Scene:
        """The same scene with no section, for what is an average or a path over time."""
        return replace(self, system=self.flow, start=self.start.state) if self.flow is not self.system else self

    def strobe(self, refinement: float = 1) -> Strobe:
        """P with `refinement` times the steps that the accuracy asks for."""
        steps = round(self.steps * refinement)
        strobe = make_strobe(self.system, self.solver, steps, compensated=self.compensated)
        return in_precision(strobe, self.precision)


class LaneRunner(Protocol):
    """Runs a per-lane function over any number of lanes (`jaxnh.lanes.Lanes`)."""

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


def _always(options: Any) -> bool:
    return True


def _few(options: Any) -> int:
    return 64


def _nothing(variables: Mapping[str, Variable]) -> Mapping[str, int]:
    return {}


@dataclass(frozen=True)
class Analysis:
    """An entry in the table of analyses.

    Attributes:
        name: the key in YAML and the group in the result file.
        options: the model of its options.
        periods: (options, number of lanes) to the lane-periods that a run of it is expected to integrate.
        run: (options, scene, lane runner) to its group; with `needs`, also a mapping of the groups it needs.
        needs: analyses that have to run before, with their defaults where the config does not ask for them.
        splits: options to whether its lanes know nothing of each other, so that a sweep may be run in parts: every
            variable either has b as first dimension or is the same in all parts.
        numbers: options to about how many numbers a lane leaves.
        choose: (options, scene of the whole sweep, lane runner) to whole numbers that are chosen from all lanes and
            hold for each part; `run` finds them in `Scene.chosen`.
        count: variables over b to how many lanes are what: attributes of the group, that add up over parts.
    """

    name: str
    options: type[Options]
    periods: Callable[[Any, int], float]
    run: Callable[..., Group]
    needs: tuple[str, ...] = ()
    splits: Callable[[Any], bool] = _always
    numbers: Callable[[Any], int] = _few
    choose: Callable[[Any, Scene, LaneRunner], Mapping[str, int]] | None = None
    count: Callable[[Mapping[str, Variable]], Mapping[str, int]] = _nothing
