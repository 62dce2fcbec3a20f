"""What is decided once for a sweep, and pieces of it computed. No files, no processes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses import ANALYSES
from jaxnh.analyses.base import LANE, Sweep
from jaxnh.analyses.scene import Axis, Rows, Scene
from jaxnh.config.blocks import MOST_LANES
from jaxnh.config.experiment import Experiment
from jaxnh.engine import kept_decisions
from jaxnh.engine.axes import Points, on_axes, places_of, points, points_in_rows, sampled, whole_on_axes
from jaxnh.engine.batches import Requested, in_rows, lanes_of
from jaxnh.engine.calibration import SAMPLED_LANES, Calibration, Plan
from jaxnh.engine.kept_decisions import Decision
from jaxnh.engine.lanes import Lanes, turns_of
from jaxnh.engine.levels import Level, filled, with_computed
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import make_strobe
from jaxnh.solvers import SOLVERS
from jaxnh.storage.pieces import Job, Piece, tile_lanes
from jaxnh.storage.provenance import versions
from jaxnh.storage.tiles import Spent

_MOST_CHOOSING = 1 << 16  # lanes of a sweep with more than are run unasked that analyses choose by
_LONGEST_RUN = 86400.0  # seconds that a sweep may take unasked: what takes days is a slip, or work for a cluster
_UNITS = ((172800.0, 86400.0, "days"), (7200.0, 3600.0, "hours"), (0.0, 60.0, "minutes"))  # from what time on
_TILES_A_PART = 4  # at least, so that parts differ by one in four at most


class Done(NamedTuple):
    """A piece that is computed.

    Attributes:
        piece: which.
        groups: its datasets over the axes, by analysis.
        counts: number of lanes of each kind, by analysis.
        spent: what it has cost.
    """

    piece: Piece
    groups: Mapping[str, xr.Dataset]
    counts: Mapping[str, Mapping[str, int]]
    spent: Spent


def spent(lanes: Lanes, seconds: float) -> Spent:
    """What a runner has spent so far, in so many seconds."""
    device = f"{len(lanes.devices)} x {lanes.devices[0].device_kind} ({lanes.devices[0].platform})"
    return Spent(seconds, lanes.compile_seconds, lanes.lane_periods, device)


# ---- what is decided once


def calibrate(experiment: Experiment, axes: Sequence[Axis], lanes: Lanes, target: float | None = None) -> Calibration:
    """Errors of one period on sample lanes of a sweep; where one target alone will be asked for, as far as it needs.

    Raises:
        AccuracyError: no lane has a period that can be computed, or the solver asked for is not made for the flow.
    """
    rows, asked = [points(experiment, axes, places) for places in sampled(axes, SAMPLED_LANES)], experiment.accuracy
    if asked.solver and asked.steps:
        try:
            make_strobe(rows[0].system, SOLVERS[asked.solver], asked.steps)
        except AccuracyError as error:
            raise AccuracyError(f"{experiment.label}: accuracy.solver: {error}") from None
    try:
        return Calibration(rows, lanes, experiment.precision, target)
    except AccuracyError as error:
        raise AccuracyError(f"{experiment.label}: sweep: {error}") from None


def plan_of(experiment: Experiment, calibration: Calibration) -> Plan:
    """The solver and steps asked for, or else the cheapest that meet the target.

    Raises:
        AccuracyError: nothing meets the target.
    """
    accuracy = experiment.accuracy
    if accuracy.solver and accuracy.steps:
        solver = SOLVERS[accuracy.solver]
        return Plan(solver, accuracy.steps, False, calibration.error(solver, accuracy.steps))
    try:
        return calibration.cheapest(accuracy.target)
    except AccuracyError as error:
        raise AccuracyError(f"{experiment.label}: accuracy.target: {error}") from None


def choose(
    experiment: Experiment, axes: Sequence[Axis], plan: Plan, requested: Requested, lanes: Lanes
) -> dict[str, dict[str, int]]:
    """What analyses choose from a whole sweep: of several values of the shared axes the largest."""
    found: dict[str, dict[str, int]] = {}
    choosing = [(a, options) for a, options in requested if a.choose and a.independent(options)]
    most = None if experiment.sweep.lanes <= MOST_LANES else _MOST_CHOOSING
    for places in sampled(axes, most) if choosing else ():
        scene = scene_of(points(experiment, axes, places), plan, experiment.precision)
        for analysis, options in choosing:
            assert analysis.choose is not None
            before = found.setdefault(analysis.name, {})
            for key, number in analysis.choose(options, scene, lanes).items():
                before[key] = max(number, before.get(key, number))
    return found


def job_of(
    experiment: Experiment,
    axes: Sequence[Axis],
    plan: Plan,
    chosen: Mapping[str, Mapping[str, int]],
    requested: Requested,
    machine: Mapping[str, str],
    tile: int | None = None,
    parts: int = 1,
) -> Job:
    """How a sweep is cut, with what has been decided for it.

    Args:
        machine: what computes it (`xla_options.machine`).
        tile: lanes a tile in place of those that the work of a lane suggests.
        parts: among how many the tiles are to be shared: there are at least as many.
    """
    count = int(np.prod([len(axis.values) for axis in axes]))
    split = [(analysis, options) for analysis, options in requested if analysis.independent(options)]
    if tile is None:
        tile = tile_lanes(work_of(split, count), numbers_of(split), count)
        parts *= _TILES_A_PART if parts > 1 else 1
    return Job(
        config_sha256=experiment.sha256,
        versions=versions(),
        solver=plan.solver.name,
        steps=plan.steps,
        compensated=plan.compensated,
        error_estimate=plan.error_estimate,
        chosen=chosen,
        order=tuple(analysis.name for analysis, _ in requested),
        independent=tuple(analysis.name for analysis, _ in split),
        axes=tuple((axis.name, len(axis.values), axis.kind == "shared") for axis in axes),
        tile=min(tile, -(-count // parts)),
        wholes=tuple((analysis.name, *analysis.whole.brings) for analysis, _ in requested if analysis.whole),
        machine=machine,
        levels=experiment.levels.count if experiment.levels else 1,
        refine=experiment.levels.refine if experiment.levels else "",
    )


def decide(
    experiment: Experiment,
    lanes: Lanes,
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
    name = kept_decisions.name_of(experiment, lanes)
    if kept := kept_decisions.find(name):
        plan, chosen = Plan(SOLVERS[kept.solver], kept.steps, kept.compensated, kept.error_estimate), kept.chosen
        lanes.fastest = min(lanes.fastest, kept.fastest)
        if not asked:
            check_size(experiment, axes, plan, requested, lanes)
    else:
        with lanes.stage("accuracy: errors of one period on sample lanes", 0):
            plan = plan_of(experiment, calibrate(experiment, axes, lanes, experiment.accuracy.only_target))
            if not asked:
                check_size(experiment, axes, plan, requested, lanes)
            chosen = choose(experiment, axes, plan, requested, lanes)
        kept_decisions.keep(name, Decision(plan.solver.name, *plan[1:], chosen, lanes.fastest))
    return job_of(experiment, axes, plan, chosen, requested, machine or lanes.machine, tile, parts)


def check_size(experiment: Experiment, axes: Sequence[Axis], plan: Plan, requested: Requested, lanes: Lanes) -> None:
    """See that a sweep is one that is run unasked: of no more than `MOST_LANES` lanes and `_LONGEST_RUN`.

    The time is that of its lane-periods in turns of the loop of the map, as fast as in the calibration.

    Raises:
        ConfigError: it is not; the message says how large it is and what it would take.
    """
    count = experiment.sweep.lanes
    work = work_of(requested, count) * count
    first = points(experiment, axes, tuple(np.zeros(1, int) for _ in axes))
    turns = turns_of((scene_of(first, plan, experiment.precision).strobe(),))
    seconds = work * turns * lanes.fastest if math.isfinite(lanes.fastest) else 0.0
    if count > MOST_LANES or seconds > _LONGEST_RUN:
        size = f", {8e-9 * count:.2g} GB a variable" if count > MOST_LANES else ""
        would = f"{size}, and about {_rounded(work)} lane-periods, {_said(seconds)} on this machine; --yes goes on"
        raise experiment.too_large(would)


def _said(seconds: float) -> str:
    """A time in words."""
    _, unit, name = next(one for one in _UNITS if seconds >= one[0])
    return f"{float(f'{seconds / unit:.2g}'):,g} {name}"


def _rounded(number: float) -> str:
    """Two digits of a large number."""
    digits, power = f"{number:.1e}".split("e")
    return f"{digits}e{int(power)}"


def work_of(analyses: Requested, lanes: int) -> float:
    """Expected lane-periods a lane."""
    return sum(analysis.periods(options, lanes) for analysis, options in analyses) / lanes


def work_of_pieces(
    requested: Requested, job: Job, pieces: Sequence[Piece], level: Level | None = None
) -> dict[int, float]:
    """Expected lane-periods of pieces, by their numbers; of those made of all tiles, few and not known before."""
    options = {analysis.name: (analysis, options) for analysis, options in requested}
    kinds = {piece.names for piece in pieces}
    each = {names: work_of([options[name] for name in names if name in options], job.lanes) for names in kinds}
    return {
        piece.number: 0.0 if job.is_whole(piece) else each[piece.names] * lanes_of(piece, level) for piece in pieces
    }


def numbers_of(analyses: Requested) -> int:
    """About how many numbers a lane leaves."""
    return sum(analysis.numbers(options) for analysis, options in analyses)


# ---- scenes


def scene_of(
    at: Points,
    plan: Plan,
    precision: str,
    chosen: Mapping[str, Mapping[str, int]] | None = None,
    place: np.ndarray | None = None,
    along: Axis | None = None,
) -> Scene:
    """Lanes with the solver and steps that were decided on."""
    rows = Rows(at.flows) if at.flows else None
    more = {"place": place, "along": along, "rows": rows, "chosen": chosen or {}, "precision": precision}
    return Scene(at.system, at.start, at.p, *plan, **more)


def plan_of_job(job: Job) -> Plan:
    """The solver and steps of a job."""
    return Plan(SOLVERS[job.solver], job.steps, job.compensated, job.error_estimate)


# ---- pieces


def compute(
    experiment: Experiment,
    axes: Sequence[Axis],
    requested: Requested,
    job: Job,
    batch: Sequence[Piece],
    lanes: Lanes,
    gathered: Callable[[str], xr.Dataset],
    level: Level | None = None,
) -> list[Done]:
    """The datasets of pieces of a batch, each what it is if computed alone, bit for bit.

    Args:
        axes: of the sweep, or of a level of it with the values that this has.
        gathered: name of an analysis to what all its tiles say, for a piece that is made of them.
        level: of the job of one, which lanes are computed, and what the others are filled with.
    """
    if job.is_whole(batch[0]):
        return [_of_all_tiles(experiment, axes, requested, job, piece, lanes, gathered) for piece in batch]
    began, before = time.perf_counter() - lanes.earlier_seconds, spent(lanes, 0.0)
    line = batch[0].names != job.independent
    places = tuple(np.concatenate(parts) for parts in zip(*map(places_of, batch), strict=True))
    if level is not None:
        wanted = np.concatenate([level.wanted_in(piece) for piece in batch])
        places = tuple(place[wanted] for place in places)
    groups = _groups(experiment, axes, requested, job, batch[0].names, places, lanes, line=line)
    after = spent(lanes, time.perf_counter() - began)
    done, first = [], 0
    for piece in batch:
        some = lanes_of(piece, level)
        rows = {LANE: slice(first, first + some)}
        first += some
        cut = {name: data.isel(rows, missing_dims="ignore") for name, data in groups.items()}
        if level is not None:
            cut = {name: filled(level, name, piece, axes, cut.get(name) if some else None) for name in piece.names}
        counts = {n: {} if ANALYSES[n].whole else dict(ANALYSES[n].count(data)) for n, data in cut.items()}
        share = some / len(places[0]) if len(places[0]) else 1.0 / len(batch)
        cost = Spent(
            after.seconds * share,
            (after.compile_seconds - before.compile_seconds) * share,
            (after.lane_periods - before.lane_periods) * share,
            after.device,
        )
        done.append(Done(piece, {n: on_axes(data, piece, axes, line=line) for n, data in cut.items()}, counts, cost))
    return done


def _groups(
    experiment: Experiment,
    axes: Sequence[Axis],
    requested: Requested,
    job: Job,
    names: Sequence[str],
    places: Sequence[np.ndarray],
    lanes: Lanes,
    *,
    line: bool,
) -> dict[str, xr.Dataset]:
    """The datasets of analyses of the lanes at some places along the axes; none where there are no lanes."""
    if not len(places[0]):
        return {}
    rows = not line and in_rows(experiment, axes, requested, job)
    at = (points_in_rows if rows else points)(experiment, axes, places)
    place = places[0] * job.step
    scene = scene_of(at, plan_of_job(job), experiment.precision, job.chosen, place, axes[0] if line else None)
    if line and axes[0].kind == "shared":
        shared = {axis.name: float(at.where[axis.name][0]) for axis in axes[1:] if axis.kind == "shared"}
        scene = replace(scene, flow_at=lambda value: experiment.flow({**shared, axes[0].name: value}))
    options = {analysis.name: options for analysis, options in requested}
    groups: dict[str, xr.Dataset] = {}
    for name in names:
        analysis = ANALYSES[name]
        needed = ({need: groups[need] for need in analysis.needs},) if analysis.needs else ()
        groups[name] = analysis.run(options[name], scene, lanes, *needed)
    return groups


def _of_all_tiles(
    experiment: Experiment,
    axes: Sequence[Axis],
    requested: Requested,
    job: Job,
    piece: Piece,
    lanes: Lanes,
    gathered: Callable[[str], xr.Dataset],
) -> Done:
    """What an analysis makes of all its tiles."""
    began, before = time.perf_counter() - lanes.earlier_seconds, spent(lanes, 0.0)
    [(analysis, options)] = [(a, o) for a, o in requested if a.name == piece.names[0]]
    assert analysis.whole is not None
    number = np.arange(job.lanes).reshape(job.shape)
    shared = [k for k, axis in enumerate(axes) if axis.kind == "shared"]
    rows = []
    for at in np.ndindex(*(job.shape[k] for k in shared)):
        chosen = dict(zip(shared, at, strict=True))
        some = number[tuple(chosen.get(k, slice(None)) for k in range(len(axes)))].ravel()
        places = np.unravel_index(some, job.shape)
        at_row = points(experiment, axes, places)
        place = places[0] * job.step
        rows.append((some, scene_of(at_row, plan_of_job(job), experiment.precision, job.chosen, place)))
    data = gathered(analysis.name)
    groups = analysis.whole.run(options, Sweep(tuple(axes), tuple(rows)), lanes, data)
    if job.level:
        groups = {name: with_computed(group, data) for name, group in groups.items()}
    after = spent(lanes, time.perf_counter() - began)
    cost = after._replace(
        compile_seconds=after.compile_seconds - before.compile_seconds,
        lane_periods=after.lane_periods - before.lane_periods,
    )
    counts = {name: dict(analysis.count(data)) if name == analysis.name else {} for name, data in groups.items()}
    return Done(piece, {name: whole_on_axes(data, axes) for name, data in groups.items()}, counts, cost)


def count_warnings(name: str, counts: Mapping[str, int]) -> tuple[str, ...]:
    """What is to be said of the trajectories of an analysis over the whole sweep."""
    if not counts.get("not_finite"):
        return ()
    return (f"{name}: {counts['not_finite']} of {counts['trajectories']} trajectories are not finite at their end",)


class Clock(NamedTuple):
    """What the lanes of a sweep are strobed by.

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
    flows = [
        experiment.flow({axis.name: float(grid.ravel()[k]) for axis, grid in zip(shared, grids, strict=True)})
        for k in range(grids[0].size if shared else 1)
    ]
    periods = np.array([flow.period for flow in flows])
    return Clock(float(periods[0]) if np.all(periods == periods[0]) else periods, flows[0].section)
