"""Windows of periodic orbits over the first axis that are wider than one lane, with where each begins and ends.

What lanes settle on says where windows are; orbits followed from there say where they begin and end (`search`),
and the doublings of each where these accumulate (`cascade`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import Analysis, OptionError, Setting
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.cascade.cascade_sensitivities import cascade_sensitivities
from jaxnh.analyses.cascade.follow import follow_line
from jaxnh.analyses.cascade.limits import doublings_limit
from jaxnh.analyses.cascade.plateaus import PeriodScan
from jaxnh.analyses.continuation.families import orbit_family
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.continuation.known_branches import orbits_at
from jaxnh.analyses.continuation.motion_units import motion_unit, sizes_in_motion
from jaxnh.analyses.continuation.seeds import attractor_waves
from jaxnh.analyses.crises.band_phase import embed_points
from jaxnh.analyses.options.orbits import WindowsOptions
from jaxnh.analyses.periodic.attractor_survey import periods_in_motion, survey_from_start
from jaxnh.analyses.periodic.location import LocatedDoubling, price_of_orbits, refined_maps, walk
from jaxnh.analyses.periodic.sensitivities import CriticalOrbit, Sensitivities, bifurcation_sensitivities
from jaxnh.analyses.periodic.sensitivity_tables import absent_words, sensitivity_variables
from jaxnh.analyses.section_points import points_after
from jaxnh.analyses.windows.crisis import locate_crisis
from jaxnh.analyses.windows.search import DOUBLED, ENDS, End, Window, all_lanes, search
from jaxnh.analyses.windows.tables import NOWHERE, OWN_NAMES, LocatedValue, dataset, table
from jaxnh.orbits.continuation.arclength import Family, along_parameter, correct
from jaxnh.orbits.continuation.branches import follow_both_ways
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import StepControl
from jaxnh.systems.rows import concatenate

_DOUBLED = 4  # times max_period: lanes of orbits up to this period are seen, as those of doublings are
_REACH = 3.0  # distances from the first doubling to where they end that a crisis is looked for beyond; it is near one
_OFF = 1e-7  # sizes: paths start so far from an orbit that repels
_AWAY = 32  # turns of a path until it is all over the bands, from there
_STEPS = StepControl(0.04)  # of the branch of that orbit
_ENDS = ("begin", "end")
_WORDS = {
    "begin": "at the begin of the window",
    "end": "at the end of the window",
    "doubling": "at the doublings of the orbits",
    "limit": "where the doublings accumulate",
}
_WORK = 3.0  # of a run, in those of settling: a guess


def check(options: WindowsOptions, setting: Setting) -> None:
    """Check that there is one axis, a parameter that lanes may differ in, with several values."""
    first, *others = setting.axes
    if first.kind != "lane":
        what = "a coordinate of the start state" if first.kind == "start" else "what all lanes of a program share"
        raise OptionError(f"windows are looked for along a parameter, and {first.name} is {what}" + setting.advice)
    if several := [axis for axis in others if len(axis.values) > 1]:
        names = " and ".join(axis.name for axis in several)
        raise OptionError(f"windows are looked for along one axis; leave out {names}")
    if len(np.unique(first.values)) < 2:
        raise OptionError(f"windows are looked for over a range of {first.name}, and the sweep has one value of it")
    if first.name in OWN_NAMES:
        raise OptionError(f"{first.name} is what windows calls a number of its own; rename it")


def run(options: WindowsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return the windows that lanes along the first axis have settled in, in the order of the axis."""
    batch = batch.take(np.unique(batch.first_axis.values, return_index=True)[1])
    survey = survey_from_start(batch, lanes, _DOUBLED * options.max_period, "windows", options.transient)
    period = periods_in_motion(batch, lanes, survey)
    size = motion_unit([batch], lanes, period, sizes_in_motion(batch, lanes, survey), {})
    line = PeriodScan(batch.first_axis.values, period, survey.u)

    def stage(label: str) -> AbstractContextManager[object]:
        return lanes.stage(f"windows: {label}", 0)

    def orbits(subset: Int[np.ndarray, " some"]) -> list[SeedOrbit]:
        waves = attractor_waves(batch.take(subset), lanes, line.u[subset], line.period[subset])
        return [orbit for wave in waves for orbit in wave]

    def families(low: float, high: float) -> list[Family]:
        return [orbit_family(batch, lanes, strobe, size, (low, high)) for strobe in strobes]

    strobes = refined_maps(batch)
    windows = search(line, options.max_period, orbits, families, stage)
    windows.sort(key=lambda group: float(line.value[all_lanes(group)[0]]))
    doublings = [_doublings(options.levels, batch, lanes, line, group[0], size) for group in windows]
    limits = [_limit(located) for located in doublings]
    crises = [
        _crisis(options.crisis, batch, lanes, families, group[0], limit, size)
        for group, limit in zip(windows, limits, strict=True)
    ]
    data = dataset(options.max_period, options.levels, batch, line, windows, doublings, limits, crises)
    if not options.sensitivities:
        return data
    return _with_sensitivities(data, batch, lanes, [group[0] for group in windows], doublings)


def _with_sensitivities(
    data: xr.Dataset,
    batch: LaneBatch,
    lanes: LaneRunner,
    windows: Sequence[Window],
    doublings: Sequence[Sequence[LocatedDoubling]],
) -> xr.Dataset:
    """Return the dataset with derivatives of ends, doublings and limits in the other parameters of the flow."""
    axis, count = batch.first_axis, data.sizes["level"]
    derived = {name: _end_sensitivities(batch, lanes, [getattr(each, name) for each in windows]) for name in _ENDS}
    derived["doubling"], derived["limit"] = cascade_sensitivities(batch, lanes, doublings, count)
    lines = dict.fromkeys(str(data.attrs.get("warnings", "")).splitlines())
    for name, rates in derived.items():
        words = f"{axis.long_name} {_WORDS[name]}"
        data = data.assign(
            sensitivity_variables(rates, batch, tuple(map(str, data[name].dims)), name, words, axis.units)
        )
        lines |= dict.fromkeys(absent_words("windows", rates).splitlines())
    return data.assign_attrs({"warnings": "\n".join(lines)} if lines else {})


def _end_sensitivities(batch: LaneBatch, lanes: LaneRunner, ends: Sequence[End]) -> Sensitivities:
    """Return the derivatives of one end of all windows."""
    kinds = [KINDS.index(ENDS[end.kind]) if ENDS[end.kind] in KINDS else -1 for end in ends]
    critical = [CriticalOrbit(k, end.value, end.points, end.multipliers) for k, end in zip(kinds, ends, strict=True)]
    return bifurcation_sensitivities(batch, lanes, critical)


def _doublings(
    levels: int, batch: LaneBatch, lanes: LaneRunner, line: PeriodScan, window: Window, size: Float[np.ndarray, " d"]
) -> tuple[LocatedDoubling, ...]:
    """Return the doublings of a window beyond its end: between its lanes, or as far beyond as the sweep goes."""
    if not levels or window.end.kind != DOUBLED:
        return ()
    value = float(window.inside.value[0])
    up = window.beyond > value
    beyond = line.value > window.beyond if up else line.value < window.beyond  # what doubles first is known up to there
    order = np.flatnonzero(beyond) if up else np.flatnonzero(beyond)[::-1]
    own = np.flatnonzero(np.isin(order, window.lanes))
    others = line.take(order[: own.max(initial=-1) + 2])
    no_orbit = [
        PeriodScan(np.array([at]), np.zeros(1, int), window.inside.u)
        for at in (window.beyond, line.value[-1 if up else 0])
    ]
    start = concatenate([window.inside, no_orbit[0]])
    with lanes.stage(f"windows: doublings of period {window.period}", 0):
        return follow_line(batch, lanes, start.joined(others).joined(no_orbit[1]), levels, size)


def _limit(doublings: Sequence[LocatedDoubling]) -> LocatedValue:
    """Return the value where the doublings of a window accumulate."""
    if not doublings:
        return NOWHERE
    values, errors = (
        np.array(column) for column in zip(*((d.point.value, d.point.error) for d in doublings), strict=True)
    )
    limit = doublings_limit(values, errors)
    return LocatedValue(limit.value, limit.error + doublings[-1].error)


def _crisis(
    most: int,
    batch: LaneBatch,
    lanes: LaneRunner,
    families: Callable[[float, float], Sequence[Family]],
    window: Window,
    limit: LocatedValue,
    size: Float[np.ndarray, " d"],
) -> LocatedValue:
    """Return the value where the bands beyond the doublings of a window grow, within the sweep."""
    start, (low, high) = limit.value, (float(end(batch.first_axis.values)) for end in (np.min, np.max))
    if not most or window.period == 1 or not low < start < high:  # of one band no path is ever out of turn
        return NOWHERE
    stop = float(np.clip(start + _REACH * (start - window.end.value), low, high))
    inside, n = float(window.inside.value[0]), window.period
    family = families(min(inside, stop), max(inside, stop))[0]
    u, turning = window.inside.u, np.array(batch.chart.angles)
    with lanes.stage(f"windows: bands of period {n} up to {batch.first_axis.name} = {stop:.9g}", 0):
        points = walk(batch, lanes, u, inside, n)[None]
        edge = correct(family, points, window.inside.value, along_parameter(family, 1, n), FINE)
        if not edge.converged[0]:
            return NOWHERE
        branch = follow_both_ways(family, edge, _STEPS)[0]

        def paths(values: Float[np.ndarray, " values"], count: int) -> Float[np.ndarray, "values points k"]:
            seeds = (orbits_at(family, [branch], value) for value in values.tolist())
            begin = np.stack([orbits[0, 0] if len(orbits) else points[0, 0] for orbits in seeds]) + _OFF * size
            path = points_after(batch.at_values(values), lanes, begin, _AWAY * n, count, tile=len(begin))
            return embed_points(path, turning, size)

        crisis = locate_crisis(paths, start, stop, n, most)
    return LocatedValue(crisis.value, crisis.error + window.end.error) if crisis else NOWHERE


ANALYSIS = Analysis(
    "windows",
    WindowsOptions,
    # a guess, as the number of windows is not known
    lambda options, lanes: _WORK * lanes * (options.transient + 2 * _DOUBLED * options.max_period),
    run,
    independent=lambda _: False,
    check=check,
    table=table,
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1, "crisis": 64},
)
