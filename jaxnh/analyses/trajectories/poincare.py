"""Poincaré map: the states at successive strobes after a transient, of every lane.

Without a clock these are successive crossings of the section, and transients are counted in crossings as well.
"""

from __future__ import annotations

import jax
import numpy as np
import xarray as xr

from jaxnh.analyses.base import LANE, Analysis, Entry, Setting, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.trajectories import PoincareOptions
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.section_points import points_at
from jaxnh.analyses.trajectories.correlation import correlation_dimension
from jaxnh.analyses.trajectories.states import (
    TILE,
    check_outputs,
    check_transient,
    count,
    output_variables,
    section_attrs,
    settle_lanes,
    state_variables,
)
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import record
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State

_PRICED = 64  # strobes


def periods(options: PoincareOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    return float(lanes * (options.transient + options.strobes - 1))


def check(options: PoincareOptions, setting: Setting) -> None:
    """Check that the first strobe is on the section, and that there are the outputs."""
    check_transient(options.transient, setting)
    check_outputs(options.outputs or (), setting)


def run(options: PoincareOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return states at `strobes` strobes after the transient, from the start states, dimensions (lane, strobe)."""
    strobe, (start, p) = batch.strobe(), batch.lanes
    with lanes.stage(f"poincare: {options.strobes} strobes of {batch.count:,} lanes", periods(options, batch.count)):
        start = settle_lanes(lanes, strobe, options.transient, start, p, TILE)
        states = strobe_states(lanes, strobe, start, p, options.strobes, TILE)
    variables = {}
    if not batch.on_section:  # else every crossing has its own time
        time = batch.flow.period * (options.transient + np.arange(options.strobes))
        words = "time since the start" if batch.flow.continuous else "number of iterates since the start"
        variables["t"] = variable("strobe", time, words, batch.flow.readout.labels.units["t"])
    at = np.zeros(1), (LANE, "strobe"), {"coordinates": "t"}
    variables |= state_variables(batch.system, states, *at)
    variables |= output_variables(options.outputs or (), lanes, batch.system, states, p, *at)
    if options.correlation_dimension:
        variables |= _dimension(batch, lanes, states)
    return xr.Dataset(variables, attrs=section_attrs(batch))


def _dimension(batch: LaneBatch, lanes: LaneRunner, states: State) -> dict[str, Entry]:
    """Return the correlation dimension of the strobes of each lane."""
    points = points_at(batch, lanes, states, TILE)
    dimension = correlation_dimension(points, np.array(batch.chart.angles))
    words = "correlation dimension of the strobes"
    return {
        "correlation_dimension": variable(LANE, dimension.value, words),
        "correlation_dimension_error": variable(LANE, dimension.error, f"error of the {words} at 95 %"),
        "least_radius": variable(
            LANE, dimension.least, "least radius of the scaling region, over the range of coordinates"
        ),
        "largest_radius": variable(LANE, dimension.largest, "largest radius of the scaling region, likewise"),
    }


def strobe_states(
    lanes: LaneRunner, strobe: Maps, state: State, p: Parameters, count: int, tile: int | None = None
) -> State:
    """Return the states of lanes and those after each of the next periods, (lanes, count)."""
    following = lanes.record(strobe, count - 1, (state, p), tile=tile)
    return jax.tree.map(lambda z, later: np.concatenate([z[:, None], later], axis=1), state, following)


def price(options: PoincareOptions, batch: LaneBatch) -> Price:
    """Return the price of keeping every strobe; the transient is the map alone."""
    return Price(recording_program(batch, TILE), map_alone(batch, tile=TILE), "every strobe is kept")


def recording_program(batch: LaneBatch, tile: int | None = None) -> PricedProgram:
    """Return the program that keeps every strobe, over `_PRICED` of them."""
    strobe = batch.map()
    return PricedProgram(
        record,
        (strobe, np.int32(_PRICED)),
        batch.lanes,
        (float(_PRICED), *strobe.trip_counts),
        (_PRICED,),
        _PRICED,
        tile,
        whole=True,
    )


ANALYSIS = Analysis(
    "poincare",
    PoincareOptions,
    periods,
    run,
    numbers=lambda options: 4 * options.strobes,
    count=count,
    check=check,
    price=price,
    brief={"transient": 1},
)
