"""Transient chaos of every lane: lifetimes of random starts in a region, the escape rate, and the chaotic saddle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import LANE, Analysis, Entry, OptionError, Setting, Table, as_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.options.chaos import TransientsOptions
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.random_starts import check_box, draw_starts, random_start_batch
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.analyses.transients.crisis_scaling import FEWEST_VALUES, fit_crisis
from jaxnh.analyses.transients.lifetimes import EscapeRate, escape_rate, lifetimes, region_of
from jaxnh.analyses.transients.saddle import MOTIONS, POINTS, Saddle, find_saddle, saddle_dimension
from jaxnh.analyses.transients.stagger import saddle_orbits
from jaxnh.maps.iterate import derivative_and_volume
from jaxnh.maps.section import outputs
from jaxnh.systems.readout import status

_USUAL = 64  # periods that most motions stay, for the expected work
_STAGGERED = 1024  # periods of tries for a point by stagger and step


def periods(options: TransientsOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    return float(lanes * (options.n_starts * min(options.max_periods, _USUAL) + _STAGGERED * options.saddle_points))


def check(options: TransientsOptions, setting: Setting) -> None:
    """Check the box of starts, and that the region is one of coordinates."""
    if not options.box:
        raise OptionError("needs a box to draw its starts from", "box")
    check_box(options.box, setting)
    for name in options.region:
        if name not in setting.flow.coordinates:
            known = ", ".join(setting.flow.coordinates)
            raise OptionError(f"there is no coordinate {name}; known are {known}", f"region.{name}")
    if options.crisis and len(np.unique(setting.axes[0].values)) < FEWEST_VALUES:
        message = f"a power law is fitted to {FEWEST_VALUES} values of the first axis or more: sweep over so many"
        raise OptionError(message, "crisis")


def run(options: TransientsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return lifetimes, escape rates and saddles of all lanes."""
    many, drawn = random_start_batch(batch, options.n_starts, options.seed, options.box)
    shape = batch.count, options.n_starts
    with lanes.stage(f"transients: {many.count:,} motions until they leave", periods(options, batch.count)):
        lived = lifetimes(many, lanes, region_of(options.box, options.region), options.max_periods)
    life, escaped = lived.periods.reshape(shape), lived.escaped.reshape(shape)
    rate = escape_rate(life, escaped, options.transient)
    with lanes.stage(f"transients: saddles of {batch.count} lanes", 0):
        saddle = find_saddle(many, lanes, life)
    if options.saddle_points:
        with lanes.stage(f"transients: orbits on saddles of {batch.count} lanes", 0):
            region = region_of(options.box, options.region)
            states = saddle_orbits(many, lanes, region, life, saddle.growth, options.saddle_points, options.seed)
        saddle = saddle._replace(states=states)
    unit, flow = iterate_units(batch.system), batch.flow
    variables: dict[str, Entry] = {
        "lifetime": variable(
            (LANE, "start"),
            life.astype(np.int32),
            "time until the motion is out of the region, or is followed no longer",
            counted_in=unit,
        ),
        "escaped": variable((LANE, "start"), escaped.astype(np.int8), "whether the motion has left the region"),
        **{
            name: variable(
                (LANE, "start"),
                values.reshape(shape),
                f"{flow.readout.labels.long_names[name]} of the start state",
                flow.readout.labels.units[name],
            )
            for name, values in drawn.items()
        },
        **_of_lanes(rate, saddle, unit),
        **_of_saddle(batch, saddle),
        **(_of_crisis(batch, rate) if options.crisis else {}),
        "status": as_variable(LANE, status(np.zeros(batch.count, int))),
    }
    return xr.Dataset(variables, attrs=section_attrs(batch))


def _of_lanes(rate: EscapeRate, saddle: Saddle, unit: str) -> dict[str, Entry]:
    """Return rates, exponents and dimensions."""
    dimension, error = _dimension(rate, saddle)
    variables = dict[str, Entry]()
    for name, values, words in (
        ("escape_rate", rate.rate, "rate at which motions leave the region, per period of the map"),
        ("mean_lifetime", rate.mean, "mean of the time that motions have before them"),
    ):
        attrs = {"counted_in": unit if name == "mean_lifetime" else f"1/{unit}"}
        for ending, side, data in zip(
            ("", "_low", "_high"),
            ("", "lower end of the 95 % interval of the ", "upper end of the 95 % interval of the "),
            values,
            strict=True,
        ):
            variables[f"{name}{ending}"] = variable(LANE, data, f"{side}{words}", **attrs)
    return variables | {
        "escapes": variable(LANE, rate.escapes.astype(np.int32), "number of escapes that the rate is known from"),
        "counted_from": variable(
            LANE,
            rate.transient.astype(np.int32) + 1,
            "first of the times at which escapes are counted, as their rate is steady from there on",
            counted_in=unit,
        ),
        "saddle_exponents": variable(
            (LANE, "exponent"), saddle.exponents, "Lyapunov exponents on the saddle, per period of the map"
        ),
        "saddle_exponents_error": variable((LANE, "exponent"), saddle.error, "errors of the exponents at 95 %"),
        "saddle_dimension": variable(LANE, dimension, "information dimension of the saddle"),
        "saddle_dimension_error": variable(LANE, error, "error of the dimension at 95 %"),
    }


def _dimension(rate: EscapeRate, saddle: Saddle) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the dimension and its error: by what the rate changes, and by what all exponents may change together."""
    value, exponents = saddle_dimension(rate.rate[0], saddle.exponents), saddle.exponents

    def change(rates: np.ndarray, moved: np.ndarray) -> np.ndarray:
        return np.abs(saddle_dimension(rates, moved) - value)

    by_rate = np.maximum(*(change(end, exponents) for end in rate.rate[1:]))
    by_exponents = np.zeros(len(value))
    for own in np.eye(exponents.shape[1]):
        by_exponents += np.maximum(*(change(rate.rate[0], exponents + s * own * saddle.error) for s in (1.0, -1.0)))
    return value, np.hypot(by_rate, by_exponents)


def _of_saddle(batch: LaneBatch, saddle: Saddle) -> dict[str, Entry]:
    named = outputs(batch.flow, saddle.states, np.zeros(1))
    return {
        f"{name}_points": variable(
            (LANE, "point"),
            named[name].data,
            f"{named[name].long_name} of points near the saddle",
            **named[name].attrs,
        )
        for name in batch.flow.coordinates
        if name in named
    }


def _of_crisis(batch: LaneBatch, rate: EscapeRate) -> dict[str, Entry]:
    axis = batch.first_axis
    fitted = fit_crisis(axis.values, rate.rate[0], rate.escapes)
    words = f"{axis.long_name} at the crisis, where the escape rate comes to zero"
    exponent = "exponent of the escape rate over the distance from the crisis"
    return {
        "crisis": variable((), fitted.value, words, axis.units),
        "crisis_error": variable((), fitted.value_error, f"error of the {words}, at 95 %", axis.units),
        "crisis_exponent": variable((), fitted.exponent, exponent),
        "crisis_exponent_error": variable((), fitted.exponent_error, f"error of the {exponent}, at 95 %"),
    }


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """Return the range over lanes of the escape rate, of the mean lifetime, and of the saddle's numbers."""
    names = "escape_rate", "mean_lifetime", "saddle_exponents", "saddle_dimension", "crisis", "crisis_exponent"
    rows = []
    for name in (name for name in names if name in data):
        largest = data[name].isel(exponent=0) if "exponent" in data[name].dims else data[name]
        values = largest.to_numpy().ravel()
        finite = values[np.isfinite(values)]
        said = f"{finite.min():.6g} to {finite.max():.6g}" if finite.size > 1 else "".join(f"{v:.6g}" for v in finite)
        rows.append((name.replace("_", " "), said or "–"))
    return Table("Transient chaos", ("quantity", "values"), tuple(rows), left=(0,))


def price(options: TransientsOptions, batch: LaneBatch) -> Price:
    """Return the price of the tangents, which points of the saddle alone have."""
    lanes = batch.chart.host_points(batch.start), dict(batch.p)
    strobe = batch.map()
    program = PricedProgram(derivative_and_volume, (strobe,), lanes, strobe.trip_counts, tile=ORBIT_TILE)
    return Price(program, map_alone(batch, tile=ORBIT_TILE), "tangents at points of the saddle, the map alone before")


ANALYSIS = Analysis(
    "transients",
    TransientsOptions,
    periods,
    run,
    independent=lambda options: not options.crisis,
    numbers=lambda options: 4 * options.n_starts + 8 * max(MOTIONS * POINTS, options.saddle_points),
    starts=draw_starts,
    check=check,
    table=table,
    price=price,
    brief={"max_periods": 16, "transient": 0},
)
