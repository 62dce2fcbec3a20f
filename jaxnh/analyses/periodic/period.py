"""Least period of the attractor of every lane, with the residual and the largest multiplier of its orbit."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from jaxnh.analyses.base import LANE, Analysis, Entry, Setting, as_variable, number_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.options.orbits import PeriodOptions
from jaxnh.analyses.periodic.attractor_survey import Survey, polish_beyond_doublings, survey_from_start
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.periodic.phase_response import check_phase_response, phase_response_variables
from jaxnh.analyses.periodic.sensitivities import lane_sensitivities
from jaxnh.analyses.periodic.sensitivity_tables import sensitivity_variables
from jaxnh.analyses.price import newton_price
from jaxnh.systems.readout import status


def check(options: PeriodOptions, setting: Setting) -> None:
    """Check that a system has phase responses, where they are asked for."""
    if options.phase_response:
        check_phase_response(setting)


def run(options: PeriodOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Least period of every lane with its residual and largest multiplier."""
    attractors = survey_from_start(batch, lanes, options.max_period, "period", options.transient)
    attractors = polish_beyond_doublings(lanes, batch.strobe(), dict(batch.p), attractors)
    variables = {
        "period": number_variable(
            LANE, attractors.period, "least period up to the limit", ("none",), counted_in=iterate_units(batch.system)
        ),
        "residual": variable(
            LANE, attractors.residual, "largest component of Pⁿ(u) − u of the orbit, in sizes of the motion"
        ),
        "multiplier": variable(LANE, attractors.multiplier, "largest modulus of the Floquet multipliers of the orbit"),
        "status": as_variable(LANE, status(attractors.status)),
    }
    if options.sensitivities:
        variables |= _sensitivities(batch, lanes, attractors)
    attrs: dict[str, Any] = {"max_period": options.max_period, "transient": options.transient}
    if options.phase_response:
        variables |= phase_response_variables(batch, lanes, attractors, options.phase_response)
        if missed := np.count_nonzero(~attractors.failed & np.isnan(variables["time"][1])):
            attrs["warnings"] = f"period: {missed} lanes have no phase response: at rest, or no cycle was found"
    return xr.Dataset(variables, attrs=attrs)


def _sensitivities(batch: LaneBatch, lanes: LaneRunner, attractors: Survey) -> dict[str, Entry]:
    """Variables of what the largest multiplier, and without a clock the time of an orbit, depend on."""
    period = np.where(attractors.failed, 0, attractors.period)
    derived, words = lane_sensitivities(batch, lanes, period, attractors.u), "the largest modulus of the multipliers"
    variables = sensitivity_variables(derived.multiplier, batch, (LANE,), "multiplier", words, "1")
    if derived.time is not None:
        words, units = "the time that the orbit takes", batch.flow.readout.labels.units["t"]
        variables["time"] = variable(LANE, derived.times, words, units)
        variables |= sensitivity_variables(derived.time, batch, (LANE,), "time", words, units)
    return variables


ANALYSIS = Analysis(
    "period",
    PeriodOptions,
    lambda options, lanes: 2.0 * lanes * (options.transient + 2 * options.max_period),
    run,
    stackable=True,
    numbers=lambda options: 6 * options.max_period + 4 * (options.phase_response or 0),
    classes=lambda data: np.where(data["status"].to_numpy() > 0, -1, data["period"].to_numpy()),
    check=check,
    price=lambda _, batch: newton_price(batch, ORBIT_TILE),
    brief={"transient": 1, "max_period": 1},
)
