"""The work of `jaxnh.cost`: solvers or effects of a config priced, written, drawn and shown."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from rich.console import Console

from jaxnh.analyses.batch import LaneBatch
from jaxnh.cli.arguments import command_line
from jaxnh.cli.terminal import progress, show
from jaxnh.costs import STUDIES, forms, solvers, tables
from jaxnh.costs import effects as costs_of_effects
from jaxnh.engine.accuracy.calibration import Calibration, Plan
from jaxnh.engine.accuracy.step_classes import lanes_by_steps, mean_steps
from jaxnh.engine.axes import points
from jaxnh.engine.compute import batch_of, seconds_spent
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.output import check_output
from jaxnh.engine.plan import calibrate, in_quickest_form, job_of, plan_of, why_common_steps, with_step_classes, work_of
from jaxnh.engine.result_attributes import attributes
from jaxnh.engine.xla_options import configure, devices_of
from jaxnh.exceptions import ArgumentError, InputError, ResultError
from jaxnh.plotting import costs as figures_cost
from jaxnh.plotting.style import save
from jaxnh.storage import hdf5

_LOG_WIDTH = 130  # columns where the output goes to a file


class PricedExperiment(NamedTuple):
    """An experiment to be priced: its lanes along the first axis that they do not share, and a runner."""

    experiment: Experiment
    batch: LaneBatch
    plan: Plan
    calibration: Calibration
    lanes: LaneExecutor
    began: float


def price(experiment: Experiment, output: Path | None, repeats: int, began: float, *, effects: bool) -> None:
    """Price accuracy, or effects, into a file; by default results/NAME_cost.h5 or results/NAME_effects.h5.

    Raises:
        InputError: the system is a map, which has no steps to price.
        ArgumentError: the file cannot be written, or is something else.
        AccuracyError: nothing meets the accuracy asked for.
    """
    if not experiment.flow().continuous:
        raise InputError(f"{experiment.label}: the cost of accuracy is that of steps in time, and a map has none")
    path = output or Path("results") / f"{Path(experiment.label).stem}_{'effects' if effects else 'cost'}.h5"
    _check_replaceable(path)
    check_output(path)
    (price_effects if effects else price_accuracy)(experiment, path, repeats, began)


def _check_replaceable(path: Path) -> None:
    """Check that a file that is there is of this command, and no name of a figure is taken.

    Raises:
        ArgumentError: it is not.
    """
    if path.suffix.lower() == ".png":
        raise ArgumentError("output", f"{path} is a name for a figure; those are put beside the result file")
    if not path.is_file():
        return
    try:
        ours = "cost_of" in hdf5.read_attrs(path)
    except ResultError:
        ours = False
    if not ours:
        raise ArgumentError("output", f"{path} is there and is no file of jaxnh.cost; name another")


def price_accuracy(experiment: Experiment, path: Path, repeats: int, began: float) -> None:
    """Price solvers, forms of a step and derived quantities that the config asks for; write, draw and show them.

    Solvers and derived quantities are priced on a strobe map, of systems with a clock.
    """
    console, times = Console(), dict[str, float]()
    with _part("accuracy", times):
        bench = _bench(experiment, began)
    with _part("steps", times):
        print(_steps(bench))
    groups: dict[str, xr.Dataset] = {}
    if experiment.autonomous:
        print("solvers are priced on a strobe map, and this scene has no clock: stages alone are", file=sys.stderr)
    else:
        with _part("solvers", times):
            target, work = experiment.accuracy.target, _work(bench)
            groups["solvers"] = solvers.price(bench.batch, bench.calibration, target, work, bench.lanes, repeats)
        console.print(show(tables.solvers(groups["solvers"])))
    with _part("stages", times):
        both = _forms(bench)
    if both is not None:
        groups["stages"] = both
        console.print(show(tables.forms(both)))
    studies = {} if experiment.autonomous else _studies(bench, times)
    groups |= {f"{name}_cost": data for name, data in studies.items()}
    with _part("figures", times):
        _write(bench, path, groups)
        pictures = [_save(path, suffix, figure) for suffix, figure in figures_cost.figures(path).items()]
    for name, data in studies.items():
        console.print(show(STUDIES[name].table(data)))
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in times.items())
    print(
        f"{time.perf_counter() - began:.1f} s: {parts}; of these, compile {bench.lanes.accounts.compile_seconds:.1f} s"
    )
    print("wrote " + ", ".join(map(str, (path, *pictures))))


def price_effects(experiment: Experiment, path: Path, repeats: int, began: float) -> None:
    """Price every effect and analysis; write and show them."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=_LOG_WIDTH)
    bench = _bench(experiment, began)
    data = costs_of_effects.price(bench.batch, experiment.requested(), bench.lanes, repeats)
    _write(bench, path, {"effects": data})
    console.print(show(tables.effects(data)))
    print(f"{time.perf_counter() - began:.1f} s; of these, compile {bench.lanes.accounts.compile_seconds:.1f} s")
    print(f"wrote {path}")


def _bench(experiment: Experiment, began: float) -> PricedExperiment:
    """The lanes along the first axis that is not shared, at the first point of all others.

    Raises:
        AccuracyError: nothing meets the accuracy asked for.
    """
    configure()
    lanes, axes = LaneExecutor(progress(Console(stderr=True)), devices_of(experiment)), experiment.axes
    with lanes.stage("accuracy: errors of one period on sample lanes", 0):
        calibration = calibrate(experiment, axes, lanes.on_host())
        plan = plan_of(experiment, calibration, experiment.requested())
    along = next((axis for axis in axes if axis.kind != "shared"), None)
    count = len(along.values) if along else 1
    places = [np.arange(count) if axis is along else np.zeros(count, int) for axis in axes]
    along = along if along and along.kind == "lane" else None
    batch = batch_of(points(experiment, axes, places), plan, experiment, axis=along)
    return PricedExperiment(experiment, batch, plan, calibration, lanes, began)


def _steps(bench: PricedExperiment) -> str:
    """The steps of lanes, common ones or their own, and why."""
    args = bench.experiment, bench.experiment.axes, bench.plan, bench.experiment.requested()
    common = f"{bench.plan.steps} steps for every lane: "
    if why := why_common_steps(*args):
        return common + why
    plan = with_step_classes(*args, bench.lanes)
    if not (by_steps := lanes_by_steps(plan)):
        return f"{common}lanes are alike, steps of their own would save less than half of all"
    mean = mean_steps(plan)
    each = ", ".join(f"{count:,} take {steps}" for steps, count in by_steps.items())
    return f"steps of lanes of their own: {each}; {mean:.3g} in the mean, {plan.steps / mean:.2g} times fewer in all"


def _forms(bench: PricedExperiment) -> xr.Dataset | None:
    """Both forms of a step of the solver that is picked."""
    experiment, requested = bench.experiment, bench.experiment.requested()
    lanes = experiment.sweep.lanes
    on_card = bench.lanes.on_card
    chosen = in_quickest_form(experiment, bench.plan, requested, on_card=on_card)
    rolled = bool(getattr(chosen.solver, "rolled", False))
    work = work_of(requested, lanes)
    return forms.price(bench.batch, requested, bench.lanes, lanes, work, rolled=rolled)


def _work(bench: PricedExperiment) -> float:
    """Lane-periods of the whole run; devices always get whole tiles."""
    chunk = bench.lanes.tile * len(bench.lanes.devices)
    padded = chunk * math.ceil(math.prod(len(axis.values) for axis in bench.experiment.axes) / chunk)
    return padded * work_of(bench.experiment.requested(), padded)


def _studies(bench: PricedExperiment, times: dict[str, float]) -> dict[str, xr.Dataset]:
    """The accuracy of what the config asks for and has a study, by the name of the analysis."""
    studies: dict[str, xr.Dataset] = {}
    for analysis, _ in bench.experiment.requested():
        study = STUDIES.get(analysis.name)
        if study is None:
            continue
        data, absent = None, "no axis is a parameter that lanes have of their own"
        if bench.batch.axis is not None:
            absent = study.absent
            with _part(analysis.name, times):
                data = study.price(bench.batch, bench.lanes)
        if data is None:
            print(f"warning: {analysis.name}: {absent}; its cost is left out", file=sys.stderr)
        else:
            studies[analysis.name] = data
    return studies


def _write(bench: PricedExperiment, path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """The file, with what decides its numbers as attributes."""
    experiment = bench.experiment
    job = job_of(experiment, experiment.axes, bench.plan, {}, experiment.requested(), bench.lanes.machine)
    total = seconds_spent(bench.lanes, time.perf_counter() - bench.began)
    attrs = attributes(experiment, job, total, command_line("jaxnh.cost"))
    attrs = {("cost_of" if name == "config_sha256" else name): value for name, value in attrs.items()}
    hdf5.write(path, attrs, groups)


@contextmanager
def _part(name: str, times: dict[str, float]) -> Iterator[None]:
    began = time.perf_counter()
    yield
    times[name] = time.perf_counter() - began


def _save(path: Path, suffix: str, figure: figures_cost.Figure) -> Path:
    picture = path.with_name(f"{path.stem}{suffix}.png")
    save(figure, picture)
    return picture
