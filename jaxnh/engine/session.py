"""A session: one experiment, calibrated once, with its programs; analyses of it on any lanes, in memory."""

from __future__ import annotations

import copy
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxnh.analyses.base import Analysis
from jaxnh.analyses.batch import Axis
from jaxnh.analyses.options import OPTIONS, Options
from jaxnh.analyses.registry import ANALYSES, analysis_of
from jaxnh.config.blocks import MOST_LANES
from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.batches import Requested, batches
from jaxnh.engine.compute import compute, seconds_spent
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.failures import count_warnings
from jaxnh.engine.from_python import System, experiment_of
from jaxnh.engine.levels.levels import Level, axes_of, level_of
from jaxnh.engine.plan import (
    choose,
    find_or_keep_plan,
    find_plan,
    in_quickest_form,
    is_short,
    job_of,
    start_samplers,
    with_step_classes,
    work_of,
)
from jaxnh.engine.progress import CallbackProgress, NullProgress, Progress
from jaxnh.engine.result_attributes import attributes
from jaxnh.engine.xla_options import configure, devices_of
from jaxnh.exceptions import InputError
from jaxnh.jobs.arrays import import_beside
from jaxnh.jobs.assembly import assemble
from jaxnh.jobs.job import Job

if TYPE_CHECKING:
    import xarray as xr  # imported where the first result is made: with pandas it takes a third of a second

ProgressCallback = Callable[[str, float, float], None]
"""(label, lane-periods done, lane-periods in all) of the stage in hand; an exception raised in it stops the call."""


class _KnownPlan(NamedTuple):
    """A calibration of a session, with what it was made for.

    Attributes:
        axes: between whose ends it holds.
        sectioned: whether it was of returns to a section, which are made of steps in time.
        starts: analyses, with the options that decide them, whose random starts it has seen.
        short: whether its sweep was too short to compare solvers.
        plan: solver and steps that it found.
    """

    axes: tuple[Axis, ...]
    sectioned: bool
    starts: frozenset[str]
    short: bool
    plan: Plan

    @classmethod
    def of(cls, experiment: Experiment, axes: tuple[Axis, ...], requested: Requested, plan: Plan) -> _KnownPlan:
        """Return the record of a plan that was made for a sweep."""
        starts, short = frozenset(start_samplers(requested)), is_short(experiment, plan, requested)
        return cls(axes, experiment.sectioned, starts, short, plan)

    def serves(self, experiment: Experiment, axes: tuple[Axis, ...], requested: Requested) -> bool:
        """Return whether a sweep may have this plan."""
        if not (_lies_within(axes, self.axes) and self.sectioned >= experiment.sectioned):
            return False
        if not self.starts >= frozenset(start_samplers(requested)):
            return False
        if self.short and not is_short(experiment, self.plan, requested):
            return False  # solvers were not compared, and a longer run is worth it
        return self.plan.is_rehearsed(work_of(requested, experiment.sweep.lanes))  # a longer run meets more violence


class Session:
    """Runs analyses of one experiment in memory, as datasets over named axes.

    The solver and its steps are chosen once for the experiment's own sweep, and once more for each call beyond its
    ends. Results are those of a run of the same lanes, bit for bit.

    Attributes:
        experiment: the experiment; of a system in Python that of the last call, whose `save` makes it a batch job.
    """

    def __init__(
        self,
        experiment: Experiment | System,
        start: Mapping[str, float] | None = None,
        target: float | None = None,
        parameters: Mapping[str, float] | None = None,
        *,
        progress: ProgressCallback | Progress | None = None,
        devices: Sequence[Any] | None = None,
    ) -> None:
        """Prepare JAX, if it has not started; nothing is computed yet.

        Args:
            experiment: what is run; or a system in Python, a function as of a user's file or a flow of the package.
            start: of a system in Python: coordinates of the start state by name.
            target: of a system in Python: error of one period's map that is allowed.
            parameters: of a system in Python: values in place of its defaults.
            progress: told of all work; an exception raised in it, as `jaxnh.Stopped`, ends the call.
            devices: those that lanes go to, by default all of the kind that the experiment names, or that JAX prefers.

        Raises:
            InputError: it is no experiment and no system; or what it says cannot be used.

        Warns:
            JaxStartedWarning: JAX had started without the options of the package.
        """
        configure()
        import_beside()
        if not isinstance(experiment, Experiment):
            experiment = experiment_of(experiment, start, target, parameters)
        elif start is not None or target is not None or parameters is not None:
            raise InputError("start, target and parameters go with a system in Python; an experiment says its own")
        self.experiment = self._base = experiment
        self._progress = as_progress(progress)
        self._lanes = LaneExecutor(self._progress, list(devices) if devices else devices_of(experiment))
        self._calibrated: list[_KnownPlan] = []

    def _repr_html_(self) -> str:
        """HTML for a notebook: its experiment, and what calibration has chosen so far; nothing is computed."""
        title, *facts = map(escape, self._describe())
        return "<br>".join([f"<b>{title}</b>", *facts])

    def __repr__(self) -> str:
        """The experiment and what calibration has chosen so far, in one line."""
        return f"<{', '.join(self._describe())}>"

    def _describe(self) -> list[str]:
        """Title, axes, and what calibration has chosen so far."""
        experiment = self.experiment
        axes = ", ".join(f"{axis.name} ({len(axis.values):,})" for axis in experiment.axes)
        turn, time = "return" if experiment.sectioned else "period", "a period"
        if experiment.sectioned:
            time = f"in a time of {experiment.flow().period:.4g}"
        if not experiment.flow().continuous:
            return [experiment.title or experiment.label, f"a session over {axes}", "iterates of a map"]
        chosen = [
            f"{plan.solver.name}, {plan.steps} steps {time}, error of one {turn} {plan.error_estimate:.1g}"
            f"{', relative to the size of the motion' if plan.sizes else ''}"
            for plan in (known.plan for known in self._calibrated)
        ]
        return [experiment.title or experiment.label, f"a session over {axes}", *(chosen or ["not calibrated yet"])]

    @property
    def devices(self) -> int:
        """Number of devices that lanes go to."""
        return len(self._lanes.devices)

    @property
    def programs(self) -> int:
        """Number of programs that it has."""
        return len(self._lanes.programs)

    @property
    def plan(self) -> Plan:
        """Solver, steps, summation and error of one period for the experiment's own sweep.

        Raises:
            AccuracyError: nothing meets the target.
        """
        return self._plan_for(self.experiment, self.experiment.axes, find_or_keep_plan)

    def on(
        self,
        coordinate: str | None = None,
        value: float = 0.0,
        direction: str | None = None,
        *,
        normal: Mapping[str, float] | None = None,
        longest_return: float | None = None,
    ) -> Session:
        """Return this session, with its programs, of a flow without a clock on a section.

        Args:
            coordinate: the one with a fixed value on the section; or give `normal`, coefficients of coordinates by
                name.
            value: of the coordinate on the section.
            direction: "up", "down" or "both", of crossings.
            longest_return: time without a crossing after which a lane fails.

        Raises:
            ConfigError: there is no such section.
        """
        section = {
            "coordinate": coordinate,
            "value": value,
            "direction": direction,
            "normal": normal,
            "longest_return": longest_return,
        }
        seen = copy.copy(self)
        seen._calibrated = []
        seen.experiment = seen._base = self._base.on(section)
        return seen

    def run(
        self, analysis: str | Options, options: Mapping[str, Any] | Options | None = None, **axes: ArrayLike
    ) -> xr.Dataset:
        """One analysis, on the experiment's lanes or on others.

        Args:
            analysis: its options, as `jaxnh.Lyapunov(periods=1000)`, or its name, or that of a group that one brings:
                of `attractors`, with the options of `basins`.
            options: in place of those of the experiment; options that are not named have their defaults.
            **axes: values of parameters or of coordinates of the start state, by name: an array replaces the axis of
                that name or adds one, a number fixes it. Axes of the experiment that are not named stay.

        Returns:
            The dataset, with the axes as dimensions in the order of the experiment, then of the call. Its `warnings`,
            as of lanes that have failed or of a search without a result, are each a `JaxnhWarning` too.

        Raises:
            InputError: there is no such analysis, option, parameter or coordinate, or they do not go together.
            AccuracyError: nothing meets the accuracy asked for.
        """
        if isinstance(analysis, Options):
            if options is not None:
                raise InputError("options are given once: by the first argument")
            analysis, options = name_of(analysis), analysis
        if isinstance(analysis, type):
            raise InputError(f"options are made by a call, as jaxnh.{analysis.__name__.removesuffix('Options')}()")
        asked_for = analysis_of(analysis) if isinstance(analysis, str) else None  # pyright: ignore[reportUnnecessaryIsInstance]
        if asked_for is None:
            raise InputError(f"there is no analysis {analysis}; known are {', '.join(ANALYSES)}")
        self._check_arguments(asked_for, options, axes)
        return self.groups({**dict.fromkeys(asked_for.options.needs), asked_for.name: options}, **axes)[analysis]

    def groups(
        self, analyses: Mapping[str, Mapping[str, Any] | Options | None], **axes: ArrayLike
    ) -> dict[str, xr.Dataset]:
        """Several analyses of the same lanes: what one needs of another is computed once.

        Args:
            analyses: name to options, as of `run`; None: those of the experiment.
            **axes: as of `run`.

        Returns:
            The datasets of all groups, those that analyses need among them.

        Raises:
            InputError: as of `run`.
            AccuracyError: as of `run`.
        """
        experiment = self._base.variant(analyses, axes)
        if self._base.filler:
            self.experiment = experiment
        _, groups = self._compute(experiment)
        fixed = {name for name, values in axes.items() if np.ndim(values) == 0} | {experiment.filler}
        fixed = [axis.dim for axis in experiment.axes if axis.name in fixed]
        return {name: data.squeeze([d for d in fixed if d in data.dims]) for name, data in groups.items()}

    def for_few_lanes(self, tile: int) -> Session:
        """This session for few lanes, with its accuracy and small tiles, so that a lane waits for no others.

        The last digits of chaotic motion differ from those of a run.
        """
        few = copy.copy(self)
        few._lanes = LaneExecutor(self._progress, self._lanes.devices[:1], tile)
        return few

    def tree(self) -> xr.DataTree:
        """All analyses that the experiment asks for, with the root attributes of a result file."""
        import xarray as xr

        began = time.perf_counter()
        job, groups = self._compute(self.experiment)
        attrs = attributes(self.experiment, job.stages()[-1], seconds_spent(self._lanes, time.perf_counter() - began))
        return xr.DataTree.from_dict({"/": xr.Dataset(attrs=attrs), **groups})  # pyright: ignore[reportUnknownMemberType]

    # ---- how

    def _check_arguments(self, analysis: Analysis, options: object, axes: Mapping[str, Any]) -> None:
        """Check that options are options, and that no option is given as an axis."""
        name = analysis.options.__name__.removesuffix("Options")
        if isinstance(options, Options) and not isinstance(options, analysis.options):
            raise InputError(f"{analysis.name} takes jaxnh.{name}(...), not options of {name_of(options)}")
        if options is not None and not isinstance(options, Options | Mapping):
            axis = self._base.sweep.known[0]
            raise InputError(
                f"options of {analysis.name} are jaxnh.{name}(...) or a mapping, not {type(options).__name__}; "
                f"values of an axis are given by its name, as {axis}=..."
            )
        for key in axes:
            if key in analysis.options.model_fields and key not in self._base.sweep.known:
                raise InputError(f"{key} is an option of {analysis.name}, and no axis: run(jaxnh.{name}({key}=...))")

    def _plan_for(self, experiment: Experiment, axes: tuple[Axis, ...], find: Callable[..., Plan] = find_plan) -> Plan:
        """The plan of a sweep that has these lanes, made if there is none yet."""
        requested = experiment.requested()
        for known in self._calibrated:
            if known.serves(experiment, axes, requested):
                return known.plan
        if _lies_within(axes, self.experiment.axes) and self.experiment.sectioned >= experiment.sectioned:
            experiment, axes = self.experiment, self.experiment.axes
        plan = find(experiment, axes, self._lanes, requested)
        self._calibrated.append(_KnownPlan.of(experiment, axes, requested, plan))
        return plan

    def _compute(self, experiment: Experiment) -> tuple[Job, dict[str, xr.Dataset]]:
        """The datasets of all analyses that an experiment asks for, this one's or a variant of it."""
        if experiment.sweep.lanes > MOST_LANES:
            raise experiment.too_large(
                f", and {MOST_LANES:,} is the most in memory; a run with an output may have more"
            )
        axes, requested, lanes = experiment.axes, experiment.requested(), self._lanes
        plan = self._plan_for(experiment, axes)
        plan = in_quickest_form(experiment, plan, requested, on_card=lanes.on_card)
        plan = with_step_classes(experiment, axes, plan, requested, lanes)
        chosen = choose(experiment, axes, plan, requested, lanes)
        job = job_of(experiment, axes, plan, chosen, requested, lanes.machine, on_card=lanes.on_card)
        whole: dict[str, xr.Dataset] = {}
        of_lanes: dict[str, xr.Dataset] = {}
        for stage in job.stages():
            level = level_of(stage.cutting, whole, of_lanes)
            whole, of_lanes = self._stage(experiment, requested, stage, level)
        for data in whole.values():
            data.attrs["axes"] = " ".join(job.cutting.names)
            for line in filter(None, str(data.attrs.get("warnings", "")).splitlines()):
                self._progress.warn(line)
        return job, whole

    def _stage(
        self, experiment: Experiment, requested: Requested, job: Job, level: Level | None
    ) -> tuple[dict[str, xr.Dataset], dict[str, xr.Dataset]]:
        """The groups of the result of a sweep, or of a level of it, and the groups of its lanes alone."""
        lanes, cutting = self._lanes, job.cutting
        axes = axes_of(experiment.axes, cutting)
        parts: dict[tuple[str, bool], list[Any]] = {}
        of_lanes: dict[str, xr.Dataset] = {}
        counts = {name: Counter[str]() for name in cutting.groups}

        def gather(name: str) -> xr.Dataset:
            of_lanes[name] = assemble(parts.pop((name, False)), cutting)
            return of_lanes[name]

        for batch in batches(experiment, axes, requested, job, cutting.pieces(), lanes, level, in_turn=True):
            for done in compute(experiment, axes, requested, job, batch, lanes, gather, level):
                for name, data in done.groups.items():
                    parts.setdefault((name, cutting.is_whole(done.piece)), []).append((done.piece, data))
                    counts[name].update(done.counts[name])
        said = {name: count_warnings(name, tally) for name, tally in counts.items()}
        made_of_all = {name: cutting.is_whole(cutting.sources(name)[0]) for name in counts}
        whole = {name: assemble(parts[name, made_of_all[name]], cutting, said[name]) for name in counts}
        return whole, {**whole, **of_lanes}


def name_of(options: Options) -> str:
    """The name of the analysis that options are of.

    Raises:
        InputError: there is none.
    """
    for name, known in OPTIONS.items():
        if type(options) is known:
            return name
    raise InputError(f"there is no analysis with options {type(options).__name__}")


def as_progress(progress: ProgressCallback | Progress | None) -> Progress:
    """Progress of a function, or as it is."""
    if progress is None:
        return NullProgress()
    if hasattr(progress, "start"):
        return progress  # pyright: ignore[reportReturnType]
    if not callable(progress):
        raise InputError(f"progress is a function of (label, done, in all), not {type(progress).__name__}")
    return CallbackProgress(progress)


def _lies_within(axes: Sequence[Axis], known: Sequence[Axis]) -> bool:
    """Return whether a calibration of some axes holds for others: the same ones, between their ends."""
    ends = {axis.name: (axis.values.min(), axis.values.max()) for axis in known}
    if {axis.name for axis in axes} != set(ends):
        return False
    return all(ends[a.name][0] <= a.values.min() and a.values.max() <= ends[a.name][1] for a in axes)
