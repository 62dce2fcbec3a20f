"""Computation of pieces of a sweep, after the decisions for all of it (`plan`). No files, no processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxnh.analyses.base import LANE, Analysis, SweepLanes
from jaxnh.analyses.batch import Axis, LaneBatch
from jaxnh.analyses.options.base import Options
from jaxnh.analyses.registry import ANALYSES
from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.accuracy.cost_model import lanes_a_tile
from jaxnh.engine.accuracy.step_classes import classes_of, lanes_together, steps_of
from jaxnh.engine.axes import (
    SweepPoints,
    join_lanes,
    places_of,
    points,
    points_along,
    points_together,
    to_axes,
    whole_to_axes,
)
from jaxnh.engine.batches import Requested, lanes_of, stackable
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.threads import run_slices
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import Level, fill_level, mark_computed
from jaxnh.jobs.cutting import Piece
from jaxnh.jobs.job import Job, NumericalPlan
from jaxnh.jobs.provenance import SecondsSpent
from jaxnh.solvers import NAMED
from jaxnh.solvers.adaptive import in_loop

if TYPE_CHECKING:
    import xarray as xr  # imported where the first result is made: with pandas it takes a third of a second


class ComputedPiece(NamedTuple):
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
    spent: SecondsSpent


def seconds_spent(lanes: LaneExecutor, seconds: float) -> SecondsSpent:
    """Cost of an executor so far; `seconds` is the time it took."""
    device = f"{len(lanes.devices)} x {lanes.devices[0].device_kind} ({lanes.devices[0].platform})"
    return SecondsSpent(seconds, lanes.accounts.compile_seconds, lanes.accounts.lane_periods, device)


# ---- batches


def batch_of(
    at: SweepPoints,
    plan: Plan,
    experiment: Experiment,
    chosen: Mapping[str, Mapping[str, int]] | None = None,
    place: np.ndarray | None = None,
    axis: Axis | None = None,
) -> LaneBatch:
    """Lanes with the solver and steps that were decided on."""
    more = {"place": place, "axis": axis, "family": at.family, "chosen": chosen or {}, "sizes": plan.sizes}
    given = {"precision": experiment.precision, "given_sizes": experiment.accuracy.sizes}
    largest = {each.name: float(np.abs(each.values).max()) for each in experiment.axes if each.kind != "start"}
    return LaneBatch(at.system, at.start, at.p, *plan[:4], largest=largest, **given, **more)


def solver_plan(plan: NumericalPlan) -> Plan:
    """The solver and steps of a numerical plan."""
    solver = NAMED[plan.solver]
    form = in_loop(solver) if plan.rolled else solver
    own = plan.parts, plan.step_classes
    return Plan(form, plan.steps, plan.compensated, plan.error_estimate, plan.sizes, *own)


def numerical_plan(plan: Plan, chosen: Mapping[str, Mapping[str, int]]) -> NumericalPlan:
    """The numerical plan of a solver and steps, with settings that analyses have chosen."""
    rolled = bool(getattr(plan.solver, "rolled", False))
    common = plan.solver.name, plan.steps, plan.compensated, plan.error_estimate
    return NumericalPlan(*common, chosen, rolled, plan.sizes, plan.parts, plan.step_classes)


def executor_for(analysis: Analysis, options: Options, count: int, lanes: LaneExecutor, plan: Plan) -> LaneExecutor:
    """The executor in tiles for a sweep of so many lanes, of an analysis that has no others than these."""
    by_lane = analysis.independent(options) and analysis.starts(options) is None
    return lanes.in_tiles(lanes_a_tile(count, plan.kicks)) if by_lane else lanes


# ---- pieces


def compute(
    experiment: Experiment,
    axes: Sequence[Axis],
    requested: Requested,
    job: Job,
    batch: Sequence[Piece],
    lanes: LaneExecutor,
    gather: Callable[[str], xr.Dataset],
    level: Level | None = None,
    earlier: float = 0.0,
) -> list[ComputedPiece]:
    """The datasets of pieces of a batch, each what it is if computed alone, bit for bit.

    Args:
        axes: of the sweep, or of a level of it with the values that this has.
        gather: name of an analysis to the dataset of all its tiles, for a piece that is made of them.
        level: which lanes are computed, and the values that the others are filled with.
        earlier: seconds that a stopped run has spent on the results in a journal.
    """
    sweep = _DecidedSweep(experiment, axes, requested, job)
    if job.cutting.is_whole(batch[0]):
        return [_combine_tiles(sweep, piece, lanes, gather, earlier) for piece in batch]
    began, before = time.perf_counter() - earlier, seconds_spent(lanes, 0.0)
    line = batch[0].names != job.cutting.independent
    places = tuple(np.concatenate(parts) for parts in zip(*map(places_of, batch), strict=True))
    if level is not None:
        wanted = np.concatenate([level.wanted_in(piece) for piece in batch])
        places = tuple(place[wanted] for place in places)
    order = None if line or not lanes.on_card else _order_on_card(axes, places)
    args = sweep, batch[0].names, places if order is None else tuple(place[order] for place in places), lanes
    groups = _groups(*args, line=True) if line else _on_cores(*args)
    if order is not None:
        groups = {name: join_lanes([data], np.argsort(order)) for name, data in groups.items()}
    after = seconds_spent(lanes, time.perf_counter() - began)
    done, first = [], 0
    for piece in batch:
        count = lanes_of(piece, level)
        rows = {LANE: slice(first, first + count)}
        first += count
        cut = {name: data.isel(rows, missing_dims="ignore") for name, data in groups.items()}
        if level is not None:
            cut = {name: fill_level(level, name, piece, axes, cut.get(name) if count else None) for name in piece.names}
        counts = {n: {} if ANALYSES[n].whole else dict(ANALYSES[n].count(data)) for n, data in cut.items()}
        share = count / len(places[0]) if len(places[0]) else 1.0 / len(batch)
        cost = SecondsSpent(
            after.seconds * share,
            (after.compile_seconds - before.compile_seconds) * share,
            (after.lane_periods - before.lane_periods) * share,
            after.device,
        )
        done.append(
            ComputedPiece(piece, {n: to_axes(data, piece, axes, line=line) for n, data in cut.items()}, counts, cost)
        )
    return done


class _DecidedSweep(NamedTuple):
    """A sweep, or a level of it, with all that has been decided for it."""

    experiment: Experiment
    axes: Sequence[Axis]
    requested: Requested
    job: Job


def _groups(
    sweep: _DecidedSweep,
    names: Sequence[str],
    places: Sequence[np.ndarray],
    lanes: LaneExecutor,
    *,
    line: bool,
    halvings: int = 0,
    count: int = 0,
) -> dict[str, xr.Dataset]:
    """The datasets of analyses of the lanes at some places along the axes; none where there are no lanes.

    Args:
        halvings: class of steps of all of them.
        count: lanes that tiles are for, by default all of the sweep.
    """
    if not len(places[0]):
        return {}
    experiment, axes, requested, job = sweep
    if line:
        at = (points_along if axes[0].kind == "shared" else points)(experiment, axes, places)
    else:
        stacked = stackable(experiment, axes, requested, job.plan.solver)
        at = (points_together if stacked else points)(experiment, axes, places)
    place = places[0] * job.cutting.step
    plan = solver_plan(job.plan)
    plan = plan._replace(steps=steps_of(plan.steps, halvings))
    lane_batch = batch_of(at, plan, experiment, job.plan.chosen, place, axes[0] if line else None)
    options = {analysis.name: options for analysis, options in requested}
    groups: dict[str, xr.Dataset] = {}
    for name in names:
        analysis = ANALYSES[name]
        needs = analysis.options.needs
        needed = ({need: groups[need] for need in needs},) if needs else ()
        few = executor_for(analysis, options[name], count or experiment.sweep.lanes, lanes, plan)
        groups[name] = analysis.run(options[name], lane_batch, few, *needed)
    return groups


def _on_cores(
    sweep: _DecidedSweep, names: Sequence[str], places: Sequence[np.ndarray], lanes: LaneExecutor
) -> dict[str, xr.Dataset]:
    """Results of lanes that depend on no others: on several cores in as many slices, if each fills a tile.

    Of calls of few lanes, as Newton's, the tiles of one call are too few for all cores.
    """
    compute_slice = _by_class if sweep.job.plan.step_classes else partial(_groups, line=False)
    tile = min(lanes.tile, lanes_a_tile(sweep.experiment.sweep.lanes, solver_plan(sweep.job.plan).kicks))
    count = 1 if lanes.on_card else min(len(lanes.devices), -(-len(places[0]) // tile))
    if count < 2:
        return compute_slice(sweep, names, places, lanes)
    asked = [(analysis, options) for analysis, options in sweep.requested if analysis.name in names]
    work = sum(analysis.periods(options, len(places[0])) for analysis, options in asked)
    rows = _rows_of_slices(sweep.axes, len(places[0]), count)
    slices = run_slices(
        lanes,
        [tuple(place[row] for place in places) for row in rows],
        (f"{', '.join(names)}: {len(places[0]):,} lanes", work),
        lambda own, executor: compute_slice(sweep, names, own, executor),
    )
    return {name: join_lanes([groups[name] for groups in slices], np.argsort(np.concatenate(rows))) for name in names}


def _rows_of_slices(axes: Sequence[Axis], lanes: int, count: int) -> list[np.ndarray]:
    """Numbers of the lanes of each slice: of neighbours, which take as long, one each; in a row, if they share."""
    every = np.arange(lanes)
    if any(axis.kind == "shared" for axis in axes):
        return np.array_split(every, count)
    return [every[first::count] for first in range(count)]


def _order_on_card(axes: Sequence[Axis], places: Sequence[np.ndarray]) -> np.ndarray | None:
    """Order of lanes by what they share, in which neighbours read the same tables; None if they are in it."""
    shared = [place for axis, place in zip(axes, places, strict=True) if axis.kind == "shared"]
    order = np.lexsort(shared[::-1]) if shared else np.arange(0)
    return order if np.any(order[1:] < order[:-1]) else None


def _by_class(
    sweep: _DecidedSweep, names: Sequence[str], places: Sequence[np.ndarray], lanes: LaneExecutor
) -> dict[str, xr.Dataset]:
    """Results of lanes of several classes of steps, each class in calls of its own."""
    job, shape = sweep.job, [len(axis.values) for axis in sweep.experiment.axes]
    every = classes_of(job.plan.step_classes)
    classes = every[np.ravel_multi_index([place * job.cutting.step for place in places], shape)]
    order: list[np.ndarray] = []
    parts: list[dict[str, xr.Dataset]] = []
    for halvings in np.unique(classes).tolist():
        order.append(np.flatnonzero(classes == halvings))
        of_class, count = [place[order[-1]] for place in places], lanes_together(every, halvings)
        parts.append(_groups(sweep, names, of_class, lanes, line=False, halvings=halvings, count=count))
    if len(parts) < 2:
        return parts[0] if parts else {}
    back = np.argsort(np.concatenate(order))
    return {name: join_lanes([part[name] for part in parts], back) for name in names}


def _combine_tiles(
    sweep: _DecidedSweep, piece: Piece, lanes: LaneExecutor, gather: Callable[[str], xr.Dataset], earlier: float
) -> ComputedPiece:
    """Compute what an analysis makes of all its tiles."""
    experiment, axes, requested, job = sweep
    began, before = time.perf_counter() - earlier, seconds_spent(lanes, 0.0)
    [(analysis, options)] = [(a, o) for a, o in requested if a.name == piece.names[0]]
    assert analysis.whole is not None
    shape = job.cutting.shape
    number = np.arange(job.cutting.lanes).reshape(shape)
    shared = [k for k, axis in enumerate(axes) if axis.kind == "shared"]
    rows = []
    for at in np.ndindex(*(shape[k] for k in shared)):
        chosen = dict(zip(shared, at, strict=True))
        members = number[tuple(chosen.get(k, slice(None)) for k in range(len(axes)))].ravel()
        places = np.unravel_index(members, shape)
        at_row = points(experiment, axes, places)
        place = places[0] * job.cutting.step
        rows.append((members, batch_of(at_row, solver_plan(job.plan), experiment, job.plan.chosen, place)))
    data = gather(analysis.name)
    groups = analysis.whole.run(options, SweepLanes(tuple(axes), tuple(rows)), lanes, data)
    if job.cutting.level:
        groups = {name: mark_computed(group, data) for name, group in groups.items()}
    after = seconds_spent(lanes, time.perf_counter() - began)
    cost = after._replace(
        compile_seconds=after.compile_seconds - before.compile_seconds,
        lane_periods=after.lane_periods - before.lane_periods,
    )
    counts = {name: dict(analysis.count(data)) if name == analysis.name else {} for name, data in groups.items()}
    return ComputedPiece(piece, {name: whole_to_axes(data, axes) for name, data in groups.items()}, counts, cost)
