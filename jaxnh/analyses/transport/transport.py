"""Transport: whether quantities of a motion grow for ever, and as which power of time; drift and diffusion of its path.

Speeds that grow as t^(1/2) or t^(1/3) are the nonholonomic acceleration of driven sleighs (Bizyaev, Borisov and Mamaev,
Regul. Chaotic Dyn. 22 (2017) 955); paths of chaotic motion may be random walks in the plane. Both are seen at strobes,
without a clock once a unit of time, of the start or of many random ones (`statistics`).

The rule, of an exponent a with the bar ε:

- undecided: ε is not below 1/2. It is so of exponential growth, of which a doubles in each octave.
- bounded: |a| ≤ ε. Growth is then growing or decaying, by the sign of a. Paths are normal where |a - 1| ≤ ε, and else
  subdiffusive, superdiffusive, or undecided where a < 0. A path that keeps to its drift but for rounding is bounded.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float, Int8

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    Entry,
    OptionError,
    Setting,
    Table,
    as_variable,
    flag,
    range_in_words,
    variable,
)
from jaxnh.analyses.batch import LaneBatch, LaneRunner, rate_attrs
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.trajectories import TransportOptions
from jaxnh.analyses.price import Price, map_alone
from jaxnh.analyses.random_starts import check_box, draw_starts, random_start_batch
from jaxnh.analyses.trajectories.poincare import recording_program
from jaxnh.analyses.trajectories.states import check_outputs, output_variables, settle_lanes
from jaxnh.analyses.transport.statistics import Diffusion, EstimateWithError, diffusion, growth_exponent
from jaxnh.maps.section import outputs, reports
from jaxnh.systems.definition import DefinedFlow
from jaxnh.systems.flow import Flow
from jaxnh.systems.readout import UNSAID, status
from jaxnh.systems.rows import select
from jaxnh.systems.state import State

GROWTH = ("bounded", "growing", "decaying", "undecided", "failed")
"""Meanings of the flags 0 to 4 of the kind of growth of a quantity."""

PATHS = ("bounded", "normal", "subdiffusive", "superdiffusive", "undecided", "failed")
"""Meanings of the flags 0 to 5 of `diffusion_kind`."""

_CLEAR = 0.5  # error below which an exponent says anything
_ROUNDING = 1e-12  # of the largest coordinate, that of the start included: displacements that are rounding


def periods(options: TransportOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    return float(lanes * max(options.n_starts, 1) * (options.transient + options.periods))


def check(options: TransportOptions, setting: Setting) -> None:
    """Check that something is asked for, that there is such, and the box of starts."""
    names = setting.flow.coordinates
    if not options.growth and not options.path:
        raise OptionError("asks for nothing: name quantities in growth, or coordinates in path", "growth")
    for name in options.path or ():
        if name not in names:
            raise OptionError(f"there is no coordinate {name}; known are {', '.join(names)}", "path")
    check_outputs([name for name in options.growth or () if name not in names], setting)
    if options.n_starts:
        check_box(options.box, setting)


def run(options: TransportOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return exponents of growth of the quantities, and the drift and the diffusion of the path, of every lane."""
    batch = batch.without_section()
    many = random_start_batch(batch, options.n_starts, options.seed, options.box)[0] if options.n_starts else batch
    with lanes.stage(f"transport: {many.count:,} motions", periods(options, batch.count)):
        record, path, ended = _record(options, many, lanes)
    shape = batch.count, many.count // batch.count
    failed = np.max(ended.reshape(shape), axis=1)
    variables: dict[str, Entry] = {}
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for name, (values, words) in record.items():
            variables |= _growth(name, words, growth_exponent(values.reshape(*shape, -1)), failed)
        if options.path:
            places = path.reshape(len(options.path), *shape, -1)
            start = _places(many.flow, _as_path(many.start), options.path).reshape(places.shape[:3])
            extent = np.maximum(np.max(np.abs(places), axis=3), np.abs(start))
            rounding = _ROUNDING * np.max(extent, axis=(0, 2))
            variables |= _diffusion(options.path, batch.flow, diffusion(places), rounding, failed)
    return xr.Dataset(variables | {"status": as_variable(LANE, status(failed))})


def _record(
    options: TransportOptions, batch: LaneBatch, lanes: LaneRunner
) -> tuple[dict[str, tuple[Float[np.ndarray, "motions strobes"], str]], np.ndarray, np.ndarray]:
    """Return quantities at strobes with their words, places of paths before and at strobes, and how motions ended.

    Places are (coordinates, motions, strobes + 1). Of the states no more than a part is kept at a time.
    """
    strobe, p, path = batch.strobe(), dict(batch.p), options.path or ()
    state = settle_lanes(lanes, strobe, options.transient, batch.start, p)
    quantities: dict[str, list[np.ndarray]] = {}
    places = [_places(batch.flow, _as_path(state), path)]
    words = dict[str, str]()
    for _ in range(BLOCKS):
        states = lanes.record(strobe, options.periods // BLOCKS, (state, p))
        for name, (_, values, attrs) in _quantities(options.growth or (), batch, lanes, states).items():
            quantities.setdefault(name, []).append(np.asarray(values))
            words[name] = attrs["long_name"]
        places.append(_places(batch.flow, states, path))
        state = select(states, np.s_[:, -1])
    ended = reports(batch.flow, _as_path(state))["status"].data
    record = {name: (np.concatenate(parts, axis=1), words[name]) for name, parts in quantities.items()}
    return record, np.concatenate(places, axis=-1), np.asarray(ended)


def _as_path(state: State) -> State:
    return select(state, np.s_[:, None])


def _quantities(names: tuple[str, ...], batch: LaneBatch, lanes: LaneRunner, states: State) -> dict[str, Entry]:
    """Return coordinates and outputs at states (lanes, strobes)."""
    flow, at, dims = batch.flow, np.zeros(1), (LANE, "strobe")
    known = outputs(flow, states, at)
    others = [name for name in names if name not in known]
    made = {name: as_variable(dims, known[name]) for name in names if name in known}
    return made | output_variables(others, lanes, flow, states, batch.p, at, dims)


def _places(flow: Flow, states: State, names: tuple[str, ...]) -> Float[np.ndarray, "coordinates motions strobes"]:
    """Return coordinates at states (motions, strobes), of angles with their whole turns."""
    known, leaves = outputs(flow, states, np.zeros(1)), jax.tree.leaves(states)
    angles = dict(zip(flow.names, flow.angles, strict=True)) if isinstance(flow, DefinedFlow) else {}
    numbers = {name: number for number, name in enumerate(angles)}
    of_each = [leaves[numbers[name]] if angles.get(name) else known[name].data for name in names]
    return np.reshape(of_each, (len(names), *np.shape(leaves[0])))


# ---- results


def judge_growth(exponent: EstimateWithError) -> Int8[np.ndarray, " lanes"]:
    """Apply the rule of this module to exponents of growth: numbers in `GROWTH`."""
    value, error = exponent
    conditions = [~(error < _CLEAR), np.abs(value) <= error, value > 0.0]
    return np.select(conditions, [GROWTH.index(word) for word in ("undecided", "bounded", "growing")], 2).astype(
        np.int8
    )


def judge_path(exponent: EstimateWithError, still: np.ndarray) -> Int8[np.ndarray, " lanes"]:
    """Apply the rule of this module to exponents of diffusion: numbers in `PATHS`."""
    value, error = exponent
    conditions = [
        still,
        ~(error < _CLEAR),
        np.abs(value) <= error,
        np.abs(value - 1.0) <= error,
        value > 1.0,
        value > 0.0,
    ]
    words = ("bounded", "undecided", "bounded", "normal", "superdiffusive", "subdiffusive")
    kind = np.select(conditions, [PATHS.index(word) for word in words], PATHS.index("undecided"))
    return kind.astype(np.int8)


def _growth(name: str, words: str, exponent: EstimateWithError, failed: np.ndarray) -> dict[str, Entry]:
    kind = np.where(failed > 0, GROWTH.index("failed"), judge_growth(exponent))
    value, error = (np.where(failed > 0, np.nan, each) for each in exponent)
    return {
        f"{name}_growth": variable(LANE, value, f"exponent of the power of time that {words} grows as"),
        f"{name}_growth_error": variable(LANE, error, "error of this exponent at 95 %"),
        f"{name}_kind": flag(LANE, kind, f"whether {words} grows", GROWTH),
    }


def _diffusion(
    names: tuple[str, ...], flow: Flow, made: Diffusion, rounding: Float[np.ndarray, " lanes"], failed: np.ndarray
) -> dict[str, Entry]:
    still = made.extent <= rounding**2
    kind = np.where(failed > 0, PATHS.index("failed"), judge_path(made.exponent, still))
    normal, fine = kind == PATHS.index("normal"), failed == 0
    units = {flow.readout.labels.units[name] for name in names}
    unit, time = units.pop() if len(units) == 1 else UNSAID, flow.period
    path = " and ".join(names)
    counted = {key: value for key, value in rate_attrs(flow).items() if key == "counted_in"}
    of_square = _units(unit, 2, rate_attrs(flow)["units"])
    variables: dict[str, Entry] = {}
    for number, name in enumerate(names):
        drift, error = (np.where(fine, each[number] / time, np.nan) for each in made.drift)
        its = _units(flow.readout.labels.units[name], 1, rate_attrs(flow)["units"])
        variables[f"{name}_drift"] = variable(LANE, drift, f"mean rate of {name}", its, **counted)
        variables[f"{name}_drift_error"] = variable(LANE, error, f"error of the mean rate of {name} at 95 %", its)
    power, power_error = (np.where(fine & ~still, each, np.nan) for each in made.exponent)
    rate, rate_error = (np.where(normal, each / time, np.nan) for each in made.coefficient)
    return variables | {
        "diffusion_exponent": variable(
            LANE, power, f"exponent of the power of time that the squared displacement of {path} grows as"
        ),
        "diffusion_exponent_error": variable(LANE, power_error, "error of this exponent at 95 %"),
        "diffusion_kind": flag(LANE, kind, f"diffusion of {path} about the drift", PATHS),
        "diffusion": variable(LANE, rate, f"diffusion coefficient of {path}", of_square, **counted),
        "diffusion_error": variable(LANE, rate_error, "error of the diffusion coefficient at 95 %", of_square),
    }


def _units(unit: str, power: int, rate: str) -> str:
    """Return the units of a coordinate's power times a rate."""
    if UNSAID in (unit, rate):
        return UNSAID
    factors = [] if unit == "1" else [f"({unit})" if power == 1 else f"({unit})^{power}"]
    factors += [] if rate == "1" else [f"({rate})"]
    return " ".join(factors) or "1"


def numbers(options: TransportOptions) -> int:
    """Return how many numbers a lane leaves."""
    return 3 * len(options.growth or ()) + 2 * len(options.path or ()) + 5


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return the range over lanes of the exponents, of the drift and of the diffusion coefficient, and their kinds."""
    rows = []
    for name in map(str, data.data_vars):
        if name.endswith(("_growth", "_drift", "_exponent")) or name == "diffusion":
            rows.append((name.replace("_", " "), range_in_words(data[name].to_numpy().ravel())))
        elif name.endswith("_kind"):
            words, counts = np.unique(data[name].to_numpy(), return_counts=True)
            names = str(data[name].attrs["flag_meanings"]).split()
            said = ", ".join(f"{count:,} {names[word]}" for word, count in zip(words, counts, strict=True))
            rows.append((name.replace("_", " "), said))
    return Table("Transport", ("quantity", "values"), tuple(rows), left=(0,))


def price(options: TransportOptions, batch: LaneBatch) -> Price:
    """Return the price of keeping every strobe; statistics on the host cost nothing beside it."""
    batch = batch.without_section()
    return Price(recording_program(batch), map_alone(batch), "every strobe is kept")


ANALYSIS = Analysis(
    "transport",
    TransportOptions,
    periods,
    run,
    numbers=numbers,
    starts=draw_starts,
    check=check,
    table=table,
    price=price,
    brief={"transient": 1, "periods": 256},
)
