"""Price of a sweep with the stages of a step written out and in a loop: compiling apart, and what more lanes change."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxnh.analyses.base import Entry, variable
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.price import PricedProgram, map_alone
from jaxnh.costs.effects import Requested
from jaxnh.engine.accuracy.cost_model import lanes_a_tile
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.programs import Programs
from jaxnh.solvers.adaptive import has_loop

_MULTIPLES = (1, 10, 100)  # of the lanes of the sweep
_TIMED_SECONDS = 0.2


class FormRow(NamedTuple):
    """One form of a step.

    Attributes:
        stages: "loop" or "written out".
        compiling: seconds for the programs of all analyses, none of them kept from before.
        runs: seconds of the whole run after that, for the sweep and for `_MULTIPLES` of its lanes.
    """

    stages: str
    compiling: float
    runs: tuple[float, ...]


def price(
    batch: LaneBatch, requested: Requested, lanes: LaneExecutor, count: int, work: float, *, rolled: bool
) -> xr.Dataset | None:
    """Both forms of the batch's solver; None where it has one alone.

    Args:
        batch: lanes of the sweep.
        count: lanes of the whole sweep.
        work: lane-periods a lane that all analyses take together.
        rolled: whether the plan of the sweep has the stages in a loop.
    """
    solver = batch.solver
    if not has_loop(solver):
        return None
    rows = []
    with lanes.stage("cost: both forms of a step", 0):
        for form in (True, False):
            formed = replace(batch, solver=replace(solver, rolled=form))
            compiling = _compiling(_programs(formed, requested), lanes, count)
            runs = tuple(_run(formed, lanes, multiple * count, work) for multiple in _MULTIPLES)
            rows.append(FormRow("loop" if form else "written out", compiling, runs))

    def column(data: Sequence[object], long_name: str, units: str = "1") -> Entry:
        return variable("form", np.array(data), long_name, units)

    variables = {
        "stages": column([row.stages for row in rows], "stages of a step"),
        "compiling": column([row.compiling for row in rows], "tracing and compiling, nothing kept", "s"),
        "run": variable(("form", "lanes"), [row.runs for row in rows], "run after that", "s"),
        "picked": column([int((row.stages == "loop") == rolled) for row in rows], "1 at the form of this sweep"),
        "lanes": variable("lanes", [multiple * count for multiple in _MULTIPLES], "lanes of a sweep like this one"),
    }
    return xr.Dataset(variables)


def _programs(batch: LaneBatch, requested: Requested) -> Iterator[PricedProgram]:
    """The map alone, and a program for each analysis that has a price."""
    yield map_alone(batch)
    for analysis, options in requested:
        cost = analysis.price(options, batch) if analysis.price else None
        if cost and cost.with_it:
            yield cost.with_it


def _compiling(programs: Iterator[PricedProgram], lanes: LaneExecutor, count: int) -> float:
    """Seconds for programs as a run of so many lanes compiles them."""
    runner = _runner(lanes, count)
    for program in programs:
        runner.program(program.function, program.shared, program.lanes, program.static, program.tile)
    return runner.accounts.compile_seconds


def _run(batch: LaneBatch, lanes: LaneExecutor, count: int, work: float) -> float:
    """Seconds of a run of so many lanes, by the time of a round of full tiles."""
    runner = _runner(lanes, count)
    strobe = batch.map()
    tile = min(runner.tile, strobe.most_lanes or runner.tile)
    round_ = tile * (len(runner.devices) if count > tile else 1)
    at = batch.take(np.arange(round_) % batch.count).lanes
    runner.iterate(strobe, 1, at)
    periods, seconds = 1, 0.0
    while True:
        began = time.perf_counter()
        runner.iterate(strobe, periods, at)
        seconds = time.perf_counter() - began
        if seconds > _TIMED_SECONDS or periods >= 1 << 16:
            break
        periods *= 4
    return math.ceil(count / round_) * work * seconds / periods


def _runner(lanes: LaneExecutor, count: int) -> LaneExecutor:
    """An executor like that of a run of so many lanes, which finds no programs."""
    apart = LaneExecutor(devices=lanes.devices, programs=Programs(kept=False))
    return apart.in_tiles(lanes_a_tile(count))
