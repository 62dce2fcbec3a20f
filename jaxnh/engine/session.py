"""A session: one experiment, calibrated once, its programs kept, and any analysis of it on any lanes, in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float
from pydantic import ValidationError

from jaxnh.analyses import ANALYSES
from jaxnh.analyses.base import Analysis, Axis, OptionError, Options, Setting
from jaxnh.config.experiment import Experiment
from jaxnh.engine import dask_workers
from jaxnh.engine.calibration import Plan
from jaxnh.engine.lanes import Lanes
from jaxnh.engine.plan import (
    Requested,
    batches,
    calibrate,
    choose,
    compute,
    count_warnings,
    job_of,
    plan_of,
    root_of,
)
from jaxnh.engine.progress import Calling, Progress, Silent
from jaxnh.engine.run import How, check_output, is_there, run_to_file
from jaxnh.engine.xla_options import configure
from jaxnh.exceptions import InputError
from jaxnh.storage.hdf5 import open_result
from jaxnh.storage.merge import Extra, assemble
from jaxnh.systems.flow import Flow

ProgressCallback = Callable[[str, float, float], None]
"""(label, lane-periods done, lane-periods in all) of the stage in hand; an exception raised in it stops the call."""


class Session:
    """Runs analyses of one experiment in memory, as datasets over named axes.

    The solver and its steps are chosen once for the experiment's own sweep, and once more for each call that goes
    beyond the ends of it. Results are those of a run of the same lanes, bit for bit.

    Attributes:
        experiment: what is run.
    """

    def __init__(
        self,
        experiment: Experiment,
        *,
        progress: ProgressCallback | Progress | None = None,
        devices: Sequence[jax.Device] | None = None,
    ) -> None:
        """Prepare JAX, if it has not started; nothing is computed yet.

        Args:
            progress: told of all work; an exception raised in it, as `jaxnh.Stopped`, ends the call.
            devices: those that lanes go to, by default all.

        Warns:
            JaxStartedWarning: JAX had started without the options of the package.
        """
        configure()
        self.experiment = experiment
        self._lanes = Lanes(as_progress(progress), list(devices) if devices else None)
        self._plans: list[tuple[tuple[Axis, ...], Plan]] = []

    @property
    def plan(self) -> Plan:
        """Solver, steps, summation and error of one period for the experiment's own sweep.

        Raises:
            AccuracyError: nothing meets the target.
        """
        return self._plan_for(self.experiment.axes)

    def run(self, analysis: str, options: Mapping[str, Any] | Options | None = None, **axes: ArrayLike) -> xr.Dataset:
        """One analysis, on the experiment's lanes or on others.

        Args:
            analysis: its name.
            options: in place of those of the experiment; what is not named has its default.
            **axes: values of parameters or of coordinates of the start state, by name: an array replaces the axis of
                that name or adds one, a number fixes it. Axes of the experiment that are not named stay.

        Returns:
            The dataset, with the axes as dimensions in the order of the experiment, then of the call.

        Raises:
            InputError: there is no such analysis, option, parameter or coordinate, or they do not go together.
            AccuracyError: nothing meets the accuracy asked for.
        """
        found = self._axes(axes)
        fixed = [name for name, values in axes.items() if np.ndim(values) == 0]
        groups = self._groups(self._requested(analysis, options), found)
        return groups[analysis].squeeze(fixed, drop=False) if fixed else groups[analysis]

    def tree(self) -> xr.DataTree:
        """All analyses that the experiment asks for, with the attributes that a result file has at its root."""
        groups = self._groups(self.experiment.requested(), self.experiment.axes)
        return xr.DataTree.from_dict({"/": xr.Dataset(attrs=self.attributes()), **groups})

    def attributes(self) -> dict[str, Any]:
        """What decides the numbers of the experiment: config, solver, steps, errors, axes."""
        plan, experiment = self.plan, self.experiment
        return {
            "title": experiment.title,
            "config": experiment.text,
            "config_sha256": experiment.sha256,
            "solver": plan.solver.name,
            "steps_per_period": plan.steps,
            "summation": "compensated" if plan.compensated else "plain",
            "precision": experiment.precision,
            "error_estimate": plan.error_estimate,
            **root_of(experiment, experiment.axes),
        }

    # ---- how

    def _requested(self, name: str, options: Mapping[str, Any] | Options | None) -> Requested:
        """The analysis with its options, after those that it needs."""
        if name not in ANALYSES:
            raise InputError(f"there is no analysis {name}; known are {', '.join(ANALYSES)}")
        asked = {analysis.name: given for analysis, given in self.experiment.requested()}
        analysis = ANALYSES[name]
        own = asked.get(name) if options is None else _options(analysis, options)
        needed = [(ANALYSES[need], asked.get(need) or ANALYSES[need].options()) for need in analysis.needs]
        return [*needed, (analysis, own or analysis.options())]

    def _axes(self, given: Mapping[str, ArrayLike]) -> tuple[Axis, ...]:
        """The experiment's axes with those of a call in their places."""
        flow = self.experiment.flow()
        own = {axis.name: axis for axis in self.experiment.axes}
        for name, values in given.items():
            own[name] = Axis(name, _values(name, values), *self._meaning(name, flow))
        return tuple(own.values())

    def _meaning(self, name: str, flow: Flow) -> tuple[str, Any]:
        """Words for a parameter or coordinate, and its kind of axis."""
        known = {axis.name: axis.kind for axis in self.experiment.axes}
        parameters = [*flow.parameters, *(axis for axis, kind in known.items() if kind != "start")]
        if name in parameters:
            return flow.words(name), "shared" if flow.shares(name) else "lane"
        if name in self.experiment.coordinates:
            return flow.words(name), "start"
        names = dict.fromkeys([*parameters, *self.experiment.coordinates])
        raise InputError(f"there is no parameter or coordinate {name}; known are {', '.join(names)}")

    def _plan_for(self, axes: tuple[Axis, ...]) -> Plan:
        """The plan of a sweep that has these lanes, calibrated if there is none yet."""
        for known, plan in self._plans:
            if _within(axes, known):
                return plan
        own = self.experiment.axes
        wanted = own if _within(axes, own) else axes
        with self._lanes.stage("accuracy: errors of one period on sample lanes", 0):
            plan = plan_of(self.experiment, calibrate(self.experiment, wanted, self._lanes))
        self._plans.append((wanted, plan))
        return plan

    def _groups(self, requested: Requested, axes: tuple[Axis, ...]) -> dict[str, xr.Dataset]:
        """The datasets of analyses over axes."""
        experiment, lanes = self.experiment, self._lanes
        flow = experiment.flow()
        setting = Setting(flow.flow, flow.autonomous, axes, experiment.precision)
        for analysis, options in requested:
            try:
                analysis.check(options, setting)
            except OptionError as error:
                raise InputError(f"{analysis.name}{error.key and f'.{error.key}'}: {error}") from None
        plan = self._plan_for(axes)
        chosen = choose(experiment, axes, plan, requested, lanes)
        job = job_of(experiment, axes, plan, chosen, requested)
        parts: dict[str, list[Any]] = {name: [] for name in job.order}
        counts: dict[str, dict[str, int]] = {name: {} for name in job.order}
        for batch in batches(requested, job, job.pieces(), len(lanes.devices)):
            for done in compute(experiment, axes, requested, job, batch, lanes):
                for name, data in done.groups.items():
                    parts[name].append((done.piece, data))
                    for kind, number in done.counts[name].items():
                        counts[name][kind] = counts[name].get(kind, 0) + number
        extras = {name: Extra(found, count_warnings(name, found)) for name, found in counts.items()}
        whole = {name: assemble(parts[name], job, extras[name]) for name in job.order}
        for data in whole.values():
            data.attrs["axes"] = " ".join(job.names)
        return whole


def run(
    experiment: Experiment,
    output: str | Path | None = None,
    *,
    progress: ProgressCallback | Progress | None = None,
    fresh: bool = False,
    dask: str | None = None,
    tile: int | None = None,
) -> xr.DataTree:
    """All analyses that an experiment asks for, as a tree with a dataset each.

    Args:
        output: a result file to write, by tiles in a folder beside it: a call that was stopped goes on where it
            stopped, and a file that is there already is read. Without it everything stays in memory.
        progress: told of all work; an exception raised in it, as `jaxnh.Stopped`, ends the call.
        fresh: replace an output that is there.
        dask: workers to use: "local", "local:N", "tcp://HOST:PORT" or a scheduler file; needs an output.
        tile: lanes a tile of the output, by default some ten seconds of work.

    Raises:
        InputError: an argument cannot be used.
        AccuracyError: nothing meets the accuracy asked for.
        RunError: the run cannot go on; the message says what is kept.

    Warns:
        JaxStartedWarning: JAX had started without the options of the package.
    """
    if output is None:
        if dask or tile:
            raise InputError("dask and tile are for a run with an output")
        return Session(experiment, progress=progress).tree()
    path = Path(output)
    if dask:
        dask_workers.check(dask)
    if not is_there(experiment, path, fresh=fresh):
        check_output(path)
        configure()
        run_to_file(experiment, path, How(fresh=fresh, dask=dask, tile=tile), as_progress(progress))
    return open_result(path)


def as_progress(progress: ProgressCallback | Progress | None) -> Progress:
    """Progress of a function, or as it is."""
    if progress is None:
        return Silent()
    return progress if hasattr(progress, "start") else Calling(progress)  # pyright: ignore[reportReturnType, reportArgumentType]


def _options(analysis: Analysis, options: Mapping[str, Any] | Options) -> Options:
    try:
        return options if isinstance(options, Options) else analysis.options(**options)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(f"{analysis.name}{key and f'.{key}'}: {first['msg']}") from None


def _values(name: str, values: ArrayLike) -> Float[np.ndarray, " n"]:
    found = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if found.ndim != 1 or not found.size or not np.all(np.isfinite(found)):
        raise InputError(f"{name}: an axis is a number or a list of finite numbers, one after the other")
    return found


def _within(axes: Sequence[Axis], known: Sequence[Axis]) -> bool:
    """Whether a calibration of some axes holds for others: the same ones, between their ends."""
    ends = {axis.name: (axis.values.min(), axis.values.max()) for axis in known}
    if {axis.name for axis in axes} != set(ends):
        return False
    return all(ends[a.name][0] <= a.values.min() and a.values.max() <= ends[a.name][1] for a in axes)
