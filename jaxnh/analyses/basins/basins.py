"""Basins of attraction: the attractors, and the one that every start state leads to. None is given beforehand.

First every lane is run by itself until its means have settled (`settling`), in tiles like any other analysis. From the
records of all lanes the attractors are derived (`clustering`, `classification`), numbered from 1 by the size of their
basins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import numpy as np
import xarray as xr
from jaxtyping import Int

from jaxnh.analyses.base import LANE, Analysis, Setting, SweepLanes, SweepReduction, variable
from jaxnh.analyses.basins.attractor_sensitivities import attractor_sensitivities
from jaxnh.analyses.basins.boundary import boundary_variables, check_plane
from jaxnh.analyses.basins.classification import POINTS, Attractors
from jaxnh.analyses.basins.clustering import find_attractors
from jaxnh.analyses.basins.comparison import join_attractors
from jaxnh.analyses.basins.continuation import ContinuedAttractors, Grid, continue_attractors
from jaxnh.analyses.basins.paths import batch_from_points, record_points
from jaxnh.analyses.basins.settling import FAILED, LaneRecords, settle
from jaxnh.analyses.basins.steps_after_transient import choose_steps
from jaxnh.analyses.basins.tables import SweepAttractors, attractors_group, basins_group, shares
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.basins import BasinsOptions
from jaxnh.analyses.periodic.sensitivities import Sensitivities
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.random_starts import check_box, draw_starts, random_start_batch
from jaxnh.analyses.section_points import states_at
from jaxnh.analyses.window_averages import average_window, maps, window_averages
from jaxnh.maps.section import outputs
from jaxnh.systems.readout import Output
from jaxnh.systems.rows import select, spread_indices, write_rows

_SAMPLED = 1024  # lanes by which steps are chosen
_MANY = 16 * _SAMPLED  # lanes of a sweep that are worth it
_USUAL = 2.0  # looks as long as the transient that most lanes take, the transient among them


def periods(options: BasinsOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    return _USUAL * options.transient * lanes * max(1, options.n_starts)


def check(options: BasinsOptions, setting: Setting) -> None:
    """Check that random starts have a box and exclude other start states, and that `boundary` has a plane."""
    if options.n_starts:
        check_box(options.box, setting)
    if options.boundary:
        check_plane(setting)


def choose(options: BasinsOptions, batch: LaneBatch, lanes: LaneRunner) -> dict[str, int]:
    """Choose the steps of a period after the first window, the same for all lanes of a sweep: fewer if worthwhile."""
    batch = batch.without_section()
    if batch.count * max(1, options.n_starts) < _MANY:
        return {"steps": batch.steps}
    drawn = _draw_starts(options, batch.take(spread_indices(batch.count, _SAMPLED)))[0]
    sample = drawn.take(spread_indices(drawn.count, _SAMPLED))
    window = average_window(sample, lanes, sample.start, options.transient // 2)
    return {"steps": choose_steps(sample, lanes, window.state)}


def run(options: BasinsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Run every lane by itself and return the `LaneRecords`, each (lane,), (lane, mean) or (lane, component).

    With random starts `start` is a dimension after the lanes.
    """
    batch = batch.without_section()
    rows = (batch.count, options.n_starts) if options.n_starts else (batch.count,)
    with lanes.stage(f"basins: {math.prod(rows):,} lanes to their attractors", periods(options, batch.count)):
        starting, steps = _draw_starts(options, batch)[0], _with_settled_steps(batch).steps
        records = settle(starting, lanes, options.transient, options.max_periods, steps)
    dims = (LANE, "start")[: len(rows)]
    second = {
        "means": "lane_mean",
        "unit": "lane_mean",
        "u": "lane_component",
        "size": "lane_component",
        "least": "lane_component",
    }
    return xr.Dataset(
        {
            f"lane_{name}": variable(
                (*dims, second[name]) if name in second else dims,
                values.reshape(*rows, *values.shape[1:]),
                f"{name} of a lane",
            )
            for name, values in records._asdict().items()
        }
    )


def reduce(options: BasinsOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """Return the groups `basins` and `attractors`, from the records of all lanes."""
    shape = tuple(len(axis.values) for axis in sweep.axes)
    starts = (options.n_starts,) if options.n_starts else ()
    each = math.prod(starts)
    count = math.prod(shape) * each
    left = (data[f"lane_{name}"].to_numpy() for name in LaneRecords._fields)
    records = LaneRecords(*(np.array(values).reshape(count, *values.shape[len(shape + starts) :]) for values in left))
    own = [k for k, axis in enumerate(sweep.axes) if axis.kind != "start"]
    sizes = tuple(shape[k] for k in own)
    place = np.unravel_index(np.arange(count) // each, shape)
    point = np.ravel_multi_index([place[k] for k in own], sizes) if own else np.zeros(count, int)
    on, parts, point_of, judged = np.full(count, -1), list[Attractors](), np.zeros(0, int), 0
    drawn: dict[str, np.ndarray] = {name: np.zeros(count) for name in options.box}
    for row, at_row in sweep.rows:
        subset = (row[:, None] * each + np.arange(each)).ravel()
        batch, draws = _draw_starts(options, _with_settled_steps(at_row))
        part = select(records, subset)
        for name, values in draws.items():
            drawn[name][subset] = values
        assignment = find_attractors(batch, lanes, part, point[subset], options.max_period, options.max_periods)
        write_rows(records, subset, part)
        judged += assignment.judged
        if assignment.attractors is None:
            continue
        used, index = np.unique(assignment.number, return_inverse=True)
        used, index = used[used >= 0], index - (len(used) - np.sum(used >= 0))
        on[subset] = np.where(index >= 0, index + len(point_of), -1)
        parts.append(select(assignment.attractors, used))
        point_of = np.concatenate([point_of, assignment.point[used]])
    every = join_attractors(parts) if len(point_of) else None
    grid = _grid(sweep, own, point[::each])
    number = np.where(records.known == FAILED, -1, 0).astype(np.int32)
    table = SweepAttractors(point_of, np.zeros(0, np.int32), None, {}, ())
    if every is not None:
        tracked = continue_attractors(grid, lanes, every, point_of, options.transient, options.max_periods)
        table, numbers = _number_attractors(grid, lanes, every, point_of, tracked, on)
        number[on >= 0] = numbers[on[on >= 0]]
    derived = dict[str, Sensitivities]()
    if options.sensitivities:
        names = [name for name in table.coordinates if not name.endswith("_points")]
        derived = attractor_sensitivities(grid, lanes, table.point, table.judged, names)
    flow = sweep.rows[0][1].flow
    unit = iterate_units(flow)
    axes = tuple(sweep.axes[k] for k in own)
    hits = shares(number, point, math.prod(sizes), max([1, *table.number.tolist()]))
    basins = basins_group(records, number, unit, flow, drawn, (count // each, *starts), judged)
    if options.boundary:
        basins = basins.merge(boundary_variables(number, sweep.axes))
    return {"basins": basins, "attractors": attractors_group(table, axes, hits, unit, sweep.rows[0][1], derived)}


def _with_settled_steps(batch: LaneBatch) -> LaneBatch:
    """Return the batch in time, with as many steps as its lanes need near their attractors."""
    return replace(batch.without_section(), steps=batch.chosen.get("basins", {}).get("steps", batch.steps))


def _draw_starts(options: BasinsOptions, batch: LaneBatch) -> tuple[LaneBatch, dict[str, np.ndarray]]:
    """Return the lanes with their random starts, if any, and the values drawn."""
    return random_start_batch(batch, options.n_starts, options.seed, options.box) if options.n_starts else (batch, {})


def _grid(sweep: SweepLanes, own: Sequence[int], point: Int[np.ndarray, " lanes"]) -> Grid:
    """Return the values of the axes that are parameters, each with its first lane."""
    first = np.unique(point, return_index=True)[1]
    row, lane = np.zeros((2, len(first)), int)
    for number, (subset, _) in enumerate(sweep.rows):
        inside = np.isin(first, subset)
        row[inside], lane[inside] = number, np.searchsorted(subset, first[inside])
    values = tuple(sweep.axes[k].values for k in own)
    return Grid(values, [_with_settled_steps(batch) for _, batch in sweep.rows], row, lane)


def _number_attractors(
    grid: Grid,
    lanes: LaneRunner,
    every: Attractors,
    point: Int[np.ndarray, " attractors"],
    tracked: ContinuedAttractors,
    on: Int[np.ndarray, " lanes"],
) -> tuple[SweepAttractors, Int[np.ndarray, " attractors"]]:
    """Return all attractors, with those that no start leads to, and the numbers of those that some lead to.

    Numbers are from 1 on, by the size of the basin over all values, ties by the first lane.
    """
    lanes_on = np.flatnonzero(on >= 0)
    same = tracked.same
    size = np.bincount(same[on[lanes_on]], minlength=len(same))
    first = np.full(len(same), len(on))
    np.minimum.at(first, same[on[lanes_on]], lanes_on)
    groups = np.unique(same)
    number = np.zeros(len(same), np.int32)
    number[groups[np.lexsort((first[groups], -size[groups]))]] = np.arange(1, len(groups) + 1)
    number = number[same]
    unseen = tracked.unseen
    origin = np.array([orbit.origin for orbit in unseen], int)
    at = np.concatenate([point, np.array([orbit.point for orbit in unseen], int)])
    if unseen:
        u, multiplier, exponent = (
            np.array([getattr(orbit, k) for orbit in unseen]) for k in ("u", "multiplier", "exponent")
        )
        orbits = select(every, origin)._replace(u=u, multiplier=multiplier, exponent=exponent)
        for block, batch in grid.batches_at(at[len(same) :]):
            orbits.points[block, :POINTS] = record_points(batch_from_points(batch, lanes, u[block]), lanes, POINTS)
        every = join_attractors([every, orbits])
    coordinates = dict[str, Output]()
    for block, batch in grid.batches_at(at):
        for name, output in _coordinates(batch, lanes, select(every, block)).items():
            kept = coordinates.setdefault(
                name, output._replace(data=np.full((len(at), *output.data.shape[1:]), np.nan))
            )
            kept.data[block] = output.data
    changes = [change._replace(attractor=int(number[change.attractor])) for change in tracked.changes]
    return SweepAttractors(at, np.concatenate([number, number[origin]]), every, coordinates, changes), number


def _coordinates(batch: LaneBatch, lanes: LaneRunner, judged: Attractors) -> dict[str, Output]:
    """Return coordinates of a point of every attractor, and as NAME_points of its points, at the strobe."""
    count, points = len(judged.u), judged.points[:, :POINTS]
    state = states_at(batch, lanes, judged.u)
    states = states_at(batch, lanes, points.reshape(-1, points.shape[-1]))
    states = jax.tree.map(lambda leaf: leaf.reshape(count, -1), states)
    start = np.zeros(1)
    coordinates = outputs(batch.flow, select(state, np.s_[:, None]), start)
    coordinates = {name: output._replace(data=output.data[:, 0]) for name, output in coordinates.items()}
    return coordinates | {f"{name}_points": output for name, output in outputs(batch.flow, states, start).items()}


def price(options: BasinsOptions, batch: LaneBatch) -> Price:
    """Return the price of a period of a window, with its means, against the map alone."""
    batch = batch.without_section()
    strobe, parts = maps(batch)
    trip_counts = (float(BLOCKS), 1.0, *((float(parts),) if parts else ()), *strobe.trip_counts)
    program = PricedProgram(
        window_averages, (strobe, np.int32(1)), batch.lanes, trip_counts, (parts,), BLOCKS, whole=True
    )
    return Price(program, map_alone(batch), "means of every coordinate and its square")


ANALYSIS = Analysis(
    "basins",
    BasinsOptions,
    periods,
    run,
    whole=SweepReduction(("attractors",), reduce),
    numbers=lambda options: 12 * BLOCKS * max(1, options.n_starts),
    choose=choose,
    starts=draw_starts,
    classes=lambda data: data["attractor"].to_numpy(),
    check=check,
    price=price,
    brief={"transient": 2 * BLOCKS},
)
