"""Decisions made once for a sweep. No files, no processes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.base import Starts
from jaxnh.analyses.batch import Axis, LaneBatch
from jaxnh.config.blocks import MOST_LANES
from jaxnh.engine.accuracy import cost_model
from jaxnh.engine.accuracy.calibration import SAMPLED_LANES, Calibration, Plan
from jaxnh.engine.accuracy.step_classes import ClassSearch, find_classes, text_of
from jaxnh.engine.axes import SweepPoints, points, sample_places
from jaxnh.engine.batches import Requested, lanes_of, shared_values_a_tile
from jaxnh.engine.cache import calibrations
from jaxnh.engine.cache.calibrations import Decision
from jaxnh.engine.compute import batch_of, executor_for, numerical_plan, solver_plan
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.tiles import count_of, inner_trip_count
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import Level
from jaxnh.exceptions import AccuracyError
from jaxnh.jobs.cutting import Cutting, Piece, tile_lanes
from jaxnh.jobs.job import Job
from jaxnh.jobs.provenance import Provenance, versions
from jaxnh.maps.build import make_return_map, scheme_of
from jaxnh.maps.section import Section, flow_of
from jaxnh.solvers import SOLVERS, AdaptiveMethod, Solver, iteration
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.flow import Flow
from jaxnh.systems.rows import concatenate, select, spread_indices

_MOST_CHOOSING = 1 << 16  # lanes of a sweep with more than are run unasked that analyses choose by
_LONGEST_RUN = 86400.0  # seconds that a sweep may take unasked: what takes days is a slip, or work for a cluster
_UNITS = ((172800.0, 86400.0, "days"), (7200.0, 3600.0, "hours"), (0.0, 60.0, "minutes"))  # from what time on
_LANES_CHECKED = 512  # on which steps of lanes of their own are
_TILES_A_PART = 4  # at least, so that parts differ by one in four at most


# ---- what is decided once


def calibrate(
    experiment: Experiment,
    axes: Sequence[Axis],
    lanes: LaneExecutor,
    target: float | None = None,
    requested: Requested | None = None,
) -> Calibration:
    """Errors of one period on sample lanes of a sweep; for a single target, as far as that needs.

    Args:
        requested: analyses whose random starts are among the samples, by default those of the experiment.

    Raises:
        AccuracyError: no lane has a period that can be computed, or the solver asked for is not made for the flow.
    """
    asked, requested = experiment.accuracy, experiment.requested() if requested is None else requested
    rows = [points(experiment, axes, places) for places in sample_places(axes, SAMPLED_LANES)]
    for draw in start_samplers(requested).values():
        rows = [_with_starts(row, draw, SAMPLED_LANES // len(rows)) for row in rows]
    if asked.solver and asked.steps:
        try:
            make_return_map(rows[0].system, SOLVERS[asked.solver], asked.steps)
        except AccuracyError as error:
            raise AccuracyError(f"{experiment.label}: accuracy.solver: {error}") from None
    try:
        solver = SOLVERS[asked.solver] if asked.solver else None
        sampled = sum(count_of(row.start) for row in rows)  # random starts among them, more than the sweep has lanes
        tile = cost_model.lanes_a_tile(max(sampled, experiment.sweep.lanes, 2))  # of one lane too there are many states
        few = lanes.in_tiles(tile) if tile < lanes.tile else lanes  # whose programs analyses share
        calibration = Calibration(rows, few, experiment.precision, target, asked.sizes, solver)
    except AccuracyError as error:
        raise AccuracyError(f"{experiment.label}: sweep: {error}") from None
    if calibration.passes_jumps:
        raise AccuracyError(
            f"{experiment.label}: accuracy.solver: {asked.solver} takes each lane by steps of its own across surfaces "
            "where the right-hand side jumps, and tangents along them miss that; leave the solver out"
        )
    return calibration


def start_samplers(requested: Requested) -> dict[str, Starts]:
    """Return the random starts of analyses, by analysis and the options that decide them."""
    starts = {}
    for analysis, options in requested:
        if (draw := analysis.starts(options)) is not None:
            starts[f"{analysis.name} {options.model_dump_json(include={'n_starts', 'seed', 'box'})}"] = draw
    return starts


def _with_starts(row: SweepPoints, draw: Starts, most: int) -> SweepPoints:
    """Sample lanes, with `most` of their random starts."""
    state, lane = draw(LaneBatch(row.system, row.start, row.p, scheme_of(row.system).reference, 1, False, math.inf))
    subset = spread_indices(len(lane), most)
    drawn = select(state, subset), *select((dict(row.p), dict(row.where)), lane[subset])
    own = row.start, dict(row.p), dict(row.where)
    start, p, where = concatenate([own, drawn])
    return row._replace(start=start, p=p, where=where)


def find_plan(experiment: Experiment, axes: Sequence[Axis], lanes: LaneExecutor, requested: Requested) -> Plan:
    """The solver and steps of a sweep, which is calibrated for it; of a map, which has no steps, none.

    Raises:
        AccuracyError: as of `calibrate` and `plan_of`.
    """
    if not experiment.flow().continuous:
        return Plan(iteration, 1, False, float(np.finfo(float).eps))
    with lanes.stage("accuracy: errors of one period on sample lanes", 0):
        calibration = calibrate(experiment, axes, lanes.on_host(), experiment.accuracy.only_target, requested)
        plan = plan_of(experiment, calibration, requested)
        if experiment.accuracy.steps:
            return plan
        return calibration.rehearse(plan, math.ceil(work_of(requested, experiment.sweep.lanes)))


def find_or_keep_plan(experiment: Experiment, axes: Sequence[Axis], lanes: LaneExecutor, requested: Requested) -> Plan:
    """The plan of `find_plan`, kept for later sessions of the same experiment; it is the same bit for bit.

    Raises:
        AccuracyError: as of `find_plan`.
    """
    name = calibrations.name_of(experiment, lanes.devices, lanes.tile, "plan of a session")
    if kept := calibrations.find(name):
        lanes.accounts.fastest = min(lanes.accounts.fastest, kept.fastest)
        return solver_plan(kept.plan)._replace(rehearsed=kept.rehearsed)
    plan = find_plan(experiment, axes, lanes, requested)
    if experiment.flow().continuous:
        calibrations.keep(name, Decision(numerical_plan(plan, {}), lanes.accounts.fastest, plan.rehearsed))
    return plan


def plan_of(experiment: Experiment, calibration: Calibration, requested: Requested | None = None) -> Plan:
    """The solver and steps asked for, or else the cheapest that meet the target.

    Args:
        requested: analyses that it is for, a short run of which is not worth a comparison of solvers.

    Raises:
        AccuracyError: nothing meets the target.
    """
    accuracy = experiment.accuracy
    if accuracy.solver and accuracy.steps:
        solver = SOLVERS[accuracy.solver]
        return Plan(solver, accuracy.steps, False, calibration.error(solver, accuracy.steps), calibration.sizes)

    def enough(plan: Plan) -> bool:
        double = experiment.precision == "float64"  # in extended precision an operation takes a hundred times as long
        return double and requested is not None and is_short(experiment, plan, requested)

    try:
        return calibration.cheapest(accuracy.target, enough)
    except AccuracyError as error:
        raise AccuracyError(f"{experiment.label}: accuracy.target: {error}") from None


def is_short(experiment: Experiment, plan: Plan, requested: Requested) -> bool:
    """Return whether analyses of a sweep are done before another solver would be compiled and measured."""
    return cost_model.is_short(*_job(experiment, plan, requested))


def in_quickest_form(experiment: Experiment, plan: Plan, requested: Requested, *, on_card: bool = False) -> Plan:
    """The plan with the steps in the form that is quickest for so many lane-periods, compiling included.

    On a graphics card they are written out: arrays of stages would leave the registers.
    """
    return plan if on_card else plan._replace(solver=cost_model.quickest_form(*_job(experiment, plan, requested)))


def with_step_classes(
    experiment: Experiment, axes: Sequence[Axis], plan: Plan, requested: Requested, lanes: LaneExecutor
) -> Plan:
    """The plan with fewer steps for lanes that need fewer than others, where that saves half of all steps."""
    if why_common_steps(experiment, axes, plan, requested):
        return plan
    count = experiment.sweep.lanes
    [sampled] = sample_places(axes, _LANES_CHECKED)
    shape = [len(axis.values) for axis in axes]
    every = points(experiment, axes, np.unravel_index(np.arange(count), shape))
    few = lanes.on_host().in_tiles(cost_model.lanes_a_tile(count))
    with lanes.stage("accuracy: steps of lanes of their own", 0):
        search = ClassSearch(every, plan, experiment.accuracy.target, few)
        classes = find_classes(search, np.ravel_multi_index(sampled, shape))
    return plan._replace(step_classes=text_of(classes))


def why_common_steps(experiment: Experiment, axes: Sequence[Axis], plan: Plan, requested: Requested) -> str:
    """Return why lanes are not even looked at for steps of their own; "" where they are."""
    flow, own = experiment.flow(), [(a, options) for a, options in requested if a.independent(options)]
    if experiment.accuracy.steps or not flow.continuous:
        return "they are given"
    if experiment.sweep.lanes == 1:
        return "there is one lane"
    if isinstance(plan.solver, AdaptiveMethod):
        return "the solver chooses steps for every lane"
    if scheme_of(flow, plan.solver).stacked or any(axis.kind == "shared" for axis in axes):
        return "lanes share tables of time"
    if experiment.precision != "float64" or plan.parts > 1:
        return "rounding, and not steps alone, decides on errors"
    if any(analysis.starts(options) is not None for analysis, options in requested):
        return "random starts may need more than the lanes that are looked at"
    if not cost_model.is_worth_classes(*_job(experiment, plan, own)):
        return "the run is short"
    return ""


def _job(experiment: Experiment, plan: Plan, requested: Requested) -> tuple[Solver, Flow, float]:
    """The solver, a flow and the lane-steps of a sweep, those that fill up vectors and tiles too."""
    lanes = experiment.sweep.lanes
    tile = cost_model.lanes_a_tile(lanes)
    lane_steps = work_of(requested, lanes) * plan.steps * -(-lanes // tile) * max(tile, cost_model.VECTOR)
    return plan.solver, experiment.flow(), lane_steps


def choose(
    experiment: Experiment, axes: Sequence[Axis], plan: Plan, requested: Requested, lanes: LaneExecutor
) -> dict[str, dict[str, int]]:
    """Settings that analyses choose from a whole sweep: of several values of the shared axes the largest."""
    choices: dict[str, dict[str, int]] = {}
    choosing = [(a, options) for a, options in requested if a.choose and a.independent(options)]
    most = None if experiment.sweep.lanes <= MOST_LANES else _MOST_CHOOSING
    accuracy, precision = experiment.accuracy, experiment.precision
    target = accuracy.target if precision == "float64" and not accuracy.steps else 0.0
    for places in sample_places(axes, most) if choosing else ():
        lane_batch = replace(batch_of(points(experiment, axes, places), plan, experiment), target=target)
        for analysis, options in choosing:
            assert analysis.choose is not None
            before = choices.setdefault(analysis.name, {})
            few = executor_for(analysis, options, experiment.sweep.lanes, lanes.on_host(), plan)
            for key, number in analysis.choose(options, lane_batch, few).items():
                before[key] = max(number, before.get(key, number))
    return choices


def job_of(
    experiment: Experiment,
    axes: Sequence[Axis],
    plan: Plan,
    chosen: Mapping[str, Mapping[str, int]],
    requested: Requested,
    machine: Mapping[str, str],
    tile: int | None = None,
    parts: int = 1,
    *,
    on_card: bool = False,
) -> Job:
    """Return the job of a sweep: its cutting, with all that has been decided for it.

    Args:
        machine: what computes it (`xla_options.machine`).
        tile: lanes a tile in place of those that the work of a lane suggests.
        parts: number of parts that share the tiles: there are at least as many tiles.
        on_card: whether graphics cards compute it.
    """
    count = int(np.prod([len(axis.values) for axis in axes]))
    split = [(analysis, options) for analysis, options in requested if analysis.independent(options)]
    if tile is None:
        numbers = sum(analysis.numbers(options) for analysis, options in split)
        tile = tile_lanes(work_of(split, count), numbers, count, on_card=on_card)
        parts *= _TILES_A_PART if parts > 1 else 1
    cutting = Cutting(
        order=tuple(analysis.name for analysis, _ in requested),
        independent=tuple(analysis.name for analysis, _ in split),
        axes=tuple((axis.dim, len(axis.values), axis.kind == "shared") for axis in axes),
        tile=min(tile, -(-count // parts)),
        shared_values=shared_values_a_tile(experiment, axes, requested, plan.solver.name, on_card=on_card),
        wholes=tuple((analysis.name, *analysis.whole.brings) for analysis, _ in requested if analysis.whole),
        levels=experiment.levels.count if experiment.levels else 1,
        refine=experiment.levels.refine if experiment.levels else "",
    )
    return Job(numerical_plan(plan, chosen), cutting, Provenance(experiment.sha256, versions(), machine))


def decide(
    experiment: Experiment,
    lanes: LaneExecutor,
    tile: int | None = None,
    parts: int = 1,
    machine: Mapping[str, str] | None = None,
    *,
    asked: bool = True,
) -> Job:
    """Everything that holds for the whole sweep of an experiment: an earlier run's decision, or a new one.

    Args:
        machine: what computes it, where that is not this process.
        asked: whether it may be larger than is run unasked.

    Raises:
        AccuracyError: no solver meets the target.
        ConfigError: it is too large.
    """
    axes, requested = experiment.axes, experiment.requested()
    name = calibrations.name_of(experiment, lanes.devices, lanes.tile)
    if kept := calibrations.find(name):
        plan, chosen = solver_plan(kept.plan), kept.plan.chosen
        lanes.accounts.fastest = min(lanes.accounts.fastest, kept.fastest)
        if not asked:
            check_size(experiment, axes, plan, requested, lanes)
    else:
        plan = find_plan(experiment, axes, lanes, requested)
        plan = in_quickest_form(experiment, plan, requested, on_card=lanes.on_card)
        if not asked:
            check_size(experiment, axes, plan, requested, lanes)
        plan = with_step_classes(experiment, axes, plan, requested, lanes)
        with lanes.stage("accuracy: settings of analyses on sample lanes", 0):
            chosen = choose(experiment, axes, plan, requested, lanes)
        calibrations.keep(name, Decision(numerical_plan(plan, chosen), lanes.accounts.fastest, plan.rehearsed))
    how = machine or lanes.machine, tile, parts
    return job_of(experiment, axes, plan, chosen, requested, *how, on_card=lanes.on_card)


def check_size(
    experiment: Experiment, axes: Sequence[Axis], plan: Plan, requested: Requested, lanes: LaneExecutor
) -> None:
    """Check that a sweep may run unasked: it has at most `MOST_LANES` lanes and takes at most `_LONGEST_RUN`.

    The time is estimated from its lane-periods and the fastest iteration of a loop in the calibration.

    Raises:
        ConfigError: it may not; the message gives its size and time.
    """
    count = experiment.sweep.lanes
    work = work_of(requested, count) * count
    first = points(experiment, axes, tuple(np.zeros(1, int) for _ in axes))
    looped = batch_of(first, plan._replace(solver=in_loop(plan.solver)), experiment)  # as calibrations are
    iterations = inner_trip_count((looped.strobe(),))
    if looped.solver != plan.solver:
        iterations /= cost_model.LOOP_OVER_WRITTEN_OUT
    seconds = work * iterations * lanes.accounts.fastest if math.isfinite(lanes.accounts.fastest) else 0.0
    if count > MOST_LANES or (seconds > _LONGEST_RUN and not lanes.on_card):
        size = f", {8e-9 * count:.2g} GB a variable" if count > MOST_LANES else ""
        would = f"{size}, and about {_rounded(work)} lane-periods, {_duration(seconds)} on this machine; --yes goes on"
        raise experiment.too_large(would)


def _duration(seconds: float) -> str:
    """A time in words."""
    _, unit, name = next(unit_of for unit_of in _UNITS if seconds >= unit_of[0])
    return f"{float(f'{seconds / unit:.2g}'):,g} {name}"


def _rounded(number: float) -> str:
    """Two digits of a large number."""
    digits, power = f"{number:.1e}".split("e")
    return f"{digits}e{int(power)}"


def work_of(analyses: Requested, lanes: int) -> float:
    """Expected lane-periods a lane."""
    return sum(analysis.periods(options, lanes) for analysis, options in analyses) / lanes


def work_of_pieces(
    requested: Requested, cutting: Cutting, pieces: Sequence[Piece], level: Level | None = None
) -> dict[int, float]:
    """Expected lane-periods of pieces, by their numbers; of those made of all tiles, few and not known before."""
    options = {analysis.name: (analysis, options) for analysis, options in requested}
    kinds = {piece.names for piece in pieces}
    each = {names: work_of([options[name] for name in names if name in options], cutting.lanes) for names in kinds}
    return {
        piece.number: 0.0 if cutting.is_whole(piece) else each[piece.names] * lanes_of(piece, level) for piece in pieces
    }


class Clock(NamedTuple):
    """The strobe of the lanes of a sweep.

    Attributes:
        period: strobe period, or one for each value of the shared axes, in C order, where it is not the same for all.
        section: where there is no clock, the section in words, else "".
    """

    period: float | Float[np.ndarray, " rows"]
    section: str


def clock_of(experiment: Experiment, axes: Sequence[Axis]) -> Clock:
    """The clock of a sweep."""
    shared = [axis for axis in axes if axis.kind == "shared"]
    grids = np.meshgrid(*(axis.values for axis in shared), indexing="ij")
    systems = [
        experiment.dynamics({axis.name: float(grid.ravel()[k]) for axis, grid in zip(shared, grids, strict=True)})
        for k in range(grids[0].size if shared else 1)
    ]
    periods = np.array([flow_of(system).period for system in systems])
    section = systems[0].description if isinstance(systems[0], Section) else ""
    return Clock(float(periods[0]) if np.all(periods == periods[0]) else periods, section)
