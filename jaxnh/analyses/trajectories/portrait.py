"""Phase portraits: trajectories after a transient, sampled many times a period, of every lane."""

from __future__ import annotations

import jax
import numpy as np
import xarray as xr
from jax import lax

from jaxnh.analyses.base import LANE, Analysis, OptionError, Setting, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.trajectories import PortraitOptions
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.trajectories.states import (
    TILE,
    check_outputs,
    count,
    output_variables,
    settle_lanes,
    state_variables,
)
from jaxnh.maps.build import make_parts
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State

_PRICED_PERIODS = 2


def periods(options: PortraitOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    return float(lanes * (options.transient + options.periods))


def check(options: PortraitOptions, setting: Setting) -> None:
    """Check that there is something between strobes."""
    if not setting.flow.continuous:
        raise OptionError("a map has nothing between its iterates, which are in poincare: ask for that")
    check_outputs(options.outputs or (), setting)


def run(options: PortraitOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return trajectories of `periods` periods after the transient, from the start states, dimensions (lane, time)."""
    batch = batch.without_section()
    start, p = batch.lanes
    with lanes.stage(f"portrait: {options.periods} periods of {batch.count:,} lanes", periods(options, batch.count)):
        start = settle_lanes(lanes, batch.strobe(), options.transient, start, p, TILE)
        states = lanes(
            trajectory,
            (_parts(options, batch),),
            (start, p),
            periods=options.periods,
            tile=TILE,
            static=(options.periods,),
        )
    in_period = batch.flow.period * np.arange(options.samples) / options.samples
    elapsed = np.arange(options.periods * options.samples) / options.samples
    time = batch.flow.period * (options.transient + elapsed)
    variables = {
        "t": variable("time", time, "time since the start", batch.flow.readout.labels.units["t"]),
        **state_variables(batch.system, states, in_period, (LANE, "time"), {"coordinates": "t"}),
        **output_variables(
            options.outputs or (), lanes, batch.system, states, p, in_period, (LANE, "time"), {"coordinates": "t"}
        ),
    }
    return xr.Dataset(variables)


def trajectory(parts: ReturnMap, state: State, p: Parameters, count: int) -> State:
    """Return the states (count · samples,) of one lane over `count` periods.

    `parts` are the maps over the parts of a period, stacked (`maps.build.make_parts`).
    """

    def sample(z: State, part: ReturnMap) -> tuple[State, State]:
        return part(z, p), z

    def period(z: State, _: None) -> tuple[State, State]:
        return lax.scan(sample, z, parts)

    _, path = lax.scan(period, state, length=count)
    return jax.tree.map(lambda component: component.reshape(-1), path)


def price(options: PortraitOptions, batch: LaneBatch) -> Price:
    """Return the price of samples: each ends a step, which is then shorter than that of the map."""
    batch = batch.without_section()
    parts = _parts(options, batch)
    trip_counts = (1.0, float(options.samples), *parts.trip_counts)
    program = PricedProgram(trajectory, (parts,), batch.lanes, trip_counts, (_PRICED_PERIODS,), _PRICED_PERIODS, TILE)
    return Price(program, map_alone(batch, tile=TILE), "every sample ends a step, and is kept")


def _parts(options: PortraitOptions, batch: LaneBatch) -> ReturnMap:
    """Return the maps from sample to sample."""
    parts = make_parts(batch.flow, batch.solver, batch.steps, options.samples, compensated=batch.compensated)
    return in_precision(parts, batch.precision)


ANALYSIS = Analysis(
    "portrait",
    PortraitOptions,
    periods,
    run,
    numbers=lambda options: 4 * options.periods * options.samples,
    count=count,
    check=check,
    price=price,
    brief={"transient": 1},
)
