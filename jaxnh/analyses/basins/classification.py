"""Motions that lanes have settled on: judged by the criteria of `verdict`, and confirmed by a longer window.

- periodic: Newton finds a stable orbit at the strobes, up to a period (`periodic.attractor_survey.survey`).
- equilibrium: without a clock, a zero of the field near by whose eigenvalues all have negative real parts.
- chaotic: the largest exponent, that along the flow aside, is positive as `verdict` asks for.
- limit_cycle: without a clock that exponent is negative, and the motion has gone to and fro.
- quasiperiodic: that exponent is zero within its error, and the look was long enough for the motion to leave what it
  nearly repeats: a slow passage, as beyond a fold, would have left. Without a clock what counts is how far the motion
  has come across itself, after whatever time it repeats itself best. In a plane without a clock there is no such
  motion: what looks so is a cycle whose exponent is not resolved, or the ghost of one, and nothing is said of it.

What is quasiperiodic or chaotic also has to contract phase volume (`volume`): a conservative motion is no attractor.
Every one of them has to stay: of a lane that had settled, the means over a window sixteen times as long are unchanged;
what is chaotic has not begun to repeat itself thousands of periods later. Where means have settled and an exponent is
positive, as on an unstable cycle in an invariant plane, a motion begun beside it has to stay on its set.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxnh.analyses.basins.paths import (
    LAGS,
    batch_from_points,
    drift_across,
    flow_steps,
    pad_points,
    record_points,
    recurrence_drift,
)
from jaxnh.analyses.basins.point_sets import lie_within, point_set, spacing
from jaxnh.analyses.basins.settling import RESTLESS, SETTLED, SETTLED_TO, LaneRecords
from jaxnh.analyses.basins.volume import keeps_volume
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.equilibria.search import find_equilibria
from jaxnh.analyses.exponents.lyapunov import run as exponents_of
from jaxnh.analyses.options.chaos import LyapunovOptions
from jaxnh.analyses.periodic.attractor_survey import polish_beyond_doublings, survey
from jaxnh.analyses.section_points import points_at, states_at
from jaxnh.analyses.verdict import KINDS, exceeds_shear, find_timeless, is_contracting, largest_across, nearly_zero
from jaxnh.analyses.window_averages import WindowAverages, average_window, points_a_unit, units
from jaxnh.systems.rows import concatenate, select, write_rows
from jaxnh.systems.state import State

NONE = -1
PERIODIC, QUASIPERIODIC, CHAOTIC, _, _, EQUILIBRIUM, LIMIT_CYCLE, _ = range(len(KINDS))

LONGER = 16
"""The window that confirms an attractor is so many times as long as that at which a lane was done."""

POINTS = 512
"""Points of an attractor that are kept."""


_CLOUD = 4096  # points that others' ends are held against
_AVERAGED = 1024  # periods that exponents are averages over
_NEAR_ORBIT = 0.01  # sizes: what ends so near to an orbit may be on it
_WIDER = 1.5  # than the largest distance of a point of a cloud from its earlier half
_REPEATS = 1e-6  # sizes a period: chaos parts points from rounding to more than that
_ASIDE, _GOLDEN = 1e-6, (np.sqrt(5.0) - 1.0) / 2.0  # sizes beside a motion, and what directions are made from
_TO_AND_FRO = 4.0  # ranges: a motion that has gone so far has come back
_TURNED = 4 * np.pi


class Attractors(NamedTuple):
    """Attractors, each with the representatives as first axis.

    Attributes:
        kind: number in `verdict.KINDS`, or `NONE`: it is none, or nothing is known, (reps,).
        period: least period of what is periodic, else 0, (reps,).
        exponent: largest Lyapunov exponent, 1/time; without a clock but for that along the flow, (reps,).
        multiplier: largest modulus of the multipliers of a periodic orbit, else NaN, (reps,).
        u: a point of it in section coordinates, (reps, d).
        means: smooth means of the features over the long window, (reps, F).
        unit: what these may be wrong by where the motion is regular, (reps, F).
        size: of the motion, (reps, d).
        points: in section coordinates, NaN of a motion that becomes infinite, (reps, points, d).
        near: distance from the points, in sizes, that the end of a lane on it keeps, (reps,).
        steps: displacement along the flow from each point to the next, zero with a clock, (reps, points, d).
        margin: as near, but from the set that points and steps describe (`point_sets`), (reps,).
    """

    kind: Int8[np.ndarray, " reps"]
    period: Int[np.ndarray, " reps"]
    exponent: Float[np.ndarray, " reps"]
    multiplier: Float[np.ndarray, " reps"]
    u: Float[np.ndarray, "reps d"]
    means: Float[np.ndarray, "reps F"]
    unit: Float[np.ndarray, "reps F"]
    size: Float[np.ndarray, "reps d"]
    points: Float[np.ndarray, "reps points d"]
    near: Float[np.ndarray, " reps"]
    steps: Float[np.ndarray, "reps points d"]
    margin: Float[np.ndarray, " reps"]


def classify(
    batch: LaneBatch, lanes: LaneRunner, records: LaneRecords, longest_period: int, longest: int
) -> Attractors:
    """Classify the motions of the lanes of a batch that are done; they go on from the points in the records.

    The batch has them at their start, which sizes are held against. A restless motion may come to rest or to an orbit
    while it is looked at, and is then no one thing: it is looked at once more from where it has come to.

    Args:
        longest_period: of periodic orbits.
        longest: periods that a lane may take.
    """
    judged, later, ends = _classify(batch, lanes, records, longest_period, longest)
    again = np.flatnonzero(later & (records.known == RESTLESS))
    if not len(again):
        return judged
    onwards = select(records, again)._replace(u=ends[again])
    second = _classify(batch.take(again), lanes, onwards, longest_period, longest)[0]
    return _with_rows(judged, again, second)


def _with_rows(judged: Attractors, rows: Int[np.ndarray, " some"], others: Attractors) -> Attractors:
    """Return attractors with others in place of some."""
    count = max(judged.points.shape[1], others.points.shape[1])
    judged, others = (
        each._replace(**dict(zip(("points", "steps"), pad_points(each.points, each.steps, count), strict=True)))
        for each in (judged, others)
    )
    whole = Attractors(*(leaf.copy() for leaf in judged))
    write_rows(whole, rows, others)
    return whole


def _classify(
    batch: LaneBatch, lanes: LaneRunner, records: LaneRecords, longest_period: int, longest: int
) -> tuple[Attractors, Bool[np.ndarray, " reps"], Float[np.ndarray, "reps d"]]:
    """Classify motions as one thing each.

    Returns:
        What they are; which of them may have become another one meanwhile: what has no kind, or one that chaos which
        ends seems to have too; and where these have come to, (reps, d).
    """
    window, state = _average_confirming_window(batch, lanes, records)
    size = np.where(batch.chart.angles, 1.0, np.maximum(window.largest, records.least))
    unit = 2.0 * SETTLED_TO * units(np.array(batch.chart.angles), size)
    stays = _stay(window, records, unit)
    u = points_at(batch, lanes, state)
    count = batch.count
    kind, period = np.full(count, NONE, np.int8), np.zeros(count, np.int64)
    exponent, multiplier = np.full((2, count), np.nan)
    moved_on = batch_from_points(batch, lanes, u)
    left = np.flatnonzero(stays)
    if batch.flow.autonomous:
        equilibria = find_equilibria(moved_on, lanes, u, records.size, window)
        at_rest = equilibria.exists & stays
        kind[at_rest & equilibria.stable], exponent[at_rest] = EQUILIBRIUM, equilibria.exponent[at_rest]
        u[at_rest] = equilibria.u[at_rest]
        left = np.flatnonzero(stays & ~equilibria.exists)
    elif len(left):
        orbits = _orbits(batch.take(left), lanes, u[left], longest_period)
        on_orbit = orbits.period > 0
        periodic = left[on_orbit]
        kind[periodic], period[periodic] = PERIODIC, orbits.period[on_orbit]
        multiplier[periodic], u[periodic] = orbits.multiplier[on_orbit], orbits.u[on_orbit]
        with np.errstate(divide="ignore"):
            exponent[periodic] = np.log(multiplier[periodic]) / (period[periodic] * batch.flow.period)
        left = left[~on_orbit]
    near, margin = np.full((2, count), _NEAR_ORBIT)
    points = record_points(batch_from_points(batch, lanes, u), lanes, POINTS)
    left, cloud = _clouds(moved_on, lanes, left, points)
    steps = np.zeros_like(points)
    if len(left):
        looked = LONGER * (records.time // 2)[left]
        kind[left], exponent[left] = _classify_recurrent(
            moved_on.take(left), lanes, (u[left], size[left], cloud), select(window, left), looked, longest
        )
        points, steps = pad_points(points, steps, _CLOUD)
        points[left], steps[left] = cloud, flow_steps(batch.take(left), lanes, cloud)
        for k in left:
            near[k] = _WIDER * spacing(batch.chart, points[k], np.zeros_like(steps[k]), size[k])
            margin[k] = max(_WIDER * spacing(batch.chart, points[k], steps[k], size[k]), _NEAR_ORBIT)
    subset = np.flatnonzero((kind == CHAOTIC) & (records.known == SETTLED))  # regular and unstable: a repeller?
    if len(subset):
        sets = (points[subset], steps[subset], size[subset], margin[subset])
        kind[subset[_leave_sets(moved_on.take(subset), lanes, u[subset], sets)]] = NONE
    means, ends, later = np.asarray(window.whole), u.copy(), np.zeros(count, np.bool_)
    if len(left):
        ends[left] = cloud[:, -1]
        later[left] = (kind[left] != CHAOTIC) | _comes_to_rest(batch, lanes, ends, size, window)[left]
    judged = Attractors(kind, period, exponent, multiplier, u, means, unit, size, points, near, steps, margin)
    return judged, later, ends


def _stay(window: WindowAverages, records: LaneRecords, unit: Float[np.ndarray, "reps F"]) -> Bool[np.ndarray, " reps"]:
    """Return whether motions have kept their means over the longer window, as restless ones need not."""
    with np.errstate(invalid="ignore"):
        kept = np.all(np.abs(window.whole - records.means) <= records.unit + unit, axis=1)
    return kept | (records.known == RESTLESS)


def _comes_to_rest(
    batch: LaneBatch,
    lanes: LaneRunner,
    ends: Float[np.ndarray, "lanes d"],
    size: Float[np.ndarray, "lanes d"],
    window: WindowAverages,
) -> Bool[np.ndarray, " lanes"]:
    """Return whether motions are at an equilibrium in the end, as with a clock none is."""
    if not batch.flow.autonomous:
        return np.zeros(len(ends), np.bool_)
    return find_equilibria(batch_from_points(batch, lanes, ends), lanes, ends, size, window).exists


def _clouds(
    batch: LaneBatch, lanes: LaneRunner, left: Int[np.ndarray, " left"], points: Float[np.ndarray, "reps points d"]
) -> tuple[Int[np.ndarray, " some"], Float[np.ndarray, "some cloud d"]]:
    """Return lanes that stay finite, and many points of each; points of the others become NaN, in place."""
    if not len(left):
        return left, np.empty((0, _CLOUD, points.shape[2]))
    cloud = record_points(batch.take(left), lanes, _CLOUD)
    finite = np.all(np.isfinite(cloud), axis=(1, 2))
    points[left[~finite]] = np.nan
    return left[finite], cloud[finite]


def _average_confirming_window(
    batch: LaneBatch, lanes: LaneRunner, records: LaneRecords
) -> tuple[WindowAverages, State]:
    """Average every lane over the long window that confirms it, lanes of equal length together."""
    look = records.time // 2
    parts, order = [], []
    for length in np.unique(look).tolist():
        group = np.flatnonzero(look == length)
        start = states_at(batch.take(group), lanes, records.u[group])
        parts.append(average_window(batch.take(group), lanes, start, LONGER * length))
        order.append(group)
    back = np.argsort(np.concatenate(order))
    window = select(concatenate(parts), back)
    return window, window.state


# ---- periodic


def _orbits(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], limit: int):
    orbits = survey(batch, lanes, u, limit, "basins", 0)
    return polish_beyond_doublings(lanes, batch.strobe(), dict(batch.p), orbits)


# ---- all others


def _classify_recurrent(
    batch: LaneBatch,
    lanes: LaneRunner,
    motion: tuple[Float[np.ndarray, "lanes d"], Float[np.ndarray, "lanes d"], Float[np.ndarray, "lanes points d"]],
    window: WindowAverages,
    looked: Int[np.ndarray, " lanes"],
    longest: int,
) -> tuple[Int8[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return kinds of motions on no orbit and no equilibrium, and the exponents that decide.

    Args:
        motion: point that each goes on from, its size, and points from there on.
        looked: periods of the window.
        longest: periods that a lane may take.
    """
    u, size, cloud = motion
    kind, exponent = _exponent_kinds(batch, lanes, window, looked)
    drift = recurrence_drift(batch.chart, cloud[:, -POINTS:], size)
    passing = kind == QUASIPERIODIC
    across = drift_across(batch, select((cloud, size), passing)) if batch.flow.autonomous else drift[passing]
    passing[passing] = across * looked[passing] < 1.0
    kind[passing | ((kind == CHAOTIC) & (drift <= _REPEATS))] = NONE
    kind[_keep_volume(batch, lanes, u, kind, longest)] = NONE
    return kind, exponent


def _exponent_kinds(
    batch: LaneBatch, lanes: LaneRunner, window: WindowAverages, looked: Int[np.ndarray, " lanes"]
) -> tuple[Int8[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return kinds by the largest exponents, and the exponent that decides."""
    clock, period = not batch.flow.autonomous, batch.flow.period
    if not clock and batch.flow.exponents == 1:  # along the flow there is one alone
        around = _comes_back(batch, window, looked)
        return np.where(around, LIMIT_CYCLE, NONE).astype(np.int8), np.full(batch.count, np.nan)
    options = LyapunovOptions(transient=LAGS, periods=_AVERAGED, exponents=min(2, batch.flow.exponents))
    spectrum = exponents_of(options, batch, lanes)
    every, errors = spectrum["exponents"].to_numpy(), spectrum["exponents_error"].to_numpy()
    largest, error = (every[:, 0], errors[:, 0]) if clock else largest_across(every, errors)
    chaotic = exceeds_shear(largest, error, _AVERAGED, period)
    neutral = nearly_zero(largest, error, period)
    kind = np.full(batch.count, NONE, np.int8)
    kind[chaotic], kind[neutral & ~chaotic] = CHAOTIC, QUASIPERIODIC
    if clock:
        steady = find_timeless(batch, lanes, np.flatnonzero(kind == QUASIPERIODIC))
        cycle = is_contracting(every[steady], errors[steady], period, np.full(len(steady), _AVERAGED))
        kind[steady] = np.where(cycle, LIMIT_CYCLE, NONE)
        largest[steady] = np.where(cycle, every[steady, -1], largest[steady])
    else:
        if len(batch.chart.angles) == 2 and sum(batch.chart.angles) < 2:  # Poincaré and Bendixson: nothing but cycles
            kind[:] = NONE
        kind[largest + error < 0.0] = LIMIT_CYCLE
        kind[(kind != CHAOTIC) & ~_comes_back(batch, window, looked)] = NONE
    return kind, largest


def _comes_back(
    batch: LaneBatch, window: WindowAverages, looked: Int[np.ndarray, " lanes"]
) -> Bool[np.ndarray, " lanes"]:
    """Return whether a motion without a clock has gone to and fro or around: a slow passage goes one way."""
    turns = np.array(batch.chart.angles)
    fro = ~turns & (window.path > _TO_AND_FRO * (window.high - window.low)) & (window.high > window.low)
    turned = turns & (np.abs(_mean_turns(turns, window)) * looked[:, None] * points_a_unit(batch) > _TURNED)
    return np.any(fro | turned, axis=1)


def _mean_turns(turns: Bool[np.ndarray, " d"], window: WindowAverages) -> Float[np.ndarray, "lanes d"]:
    """Return the mean turn of every angle from point to point, zero for other coordinates."""
    mean_turns, place = np.zeros((len(window.whole), len(turns))), 0
    for i, turning in enumerate(turns):
        mean_turns[:, i] = window.whole[:, place + 2] if turning else 0.0
        place += 3 if turning else 2
    return mean_turns


def _leave_sets(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], sets: tuple[np.ndarray, ...]
) -> Bool[np.ndarray, " lanes"]:
    """Return whether motions from points beside those of lanes leave the sets that the lanes are on.

    So they do from a cycle in a symmetry's invariant plane that attracts in that plane alone.

    Args:
        sets: points, steps, sizes and margins.
    """
    aside = 2.0 * np.mod(np.arange(1, u.shape[1] + 1) * _GOLDEN, 1.0) - 1.0  # along no symmetry
    cloud = record_points(batch_from_points(batch, lanes, u + _ASIDE * aside * sets[2]), lanes, _CLOUD)[:, -POINTS:]
    within = [
        np.all(np.isfinite(later))
        and np.mean(lie_within(point_set(batch.chart, points, steps, size), later, size, float(margin)))
        for later, points, steps, size, margin in zip(cloud, *sets, strict=True)
    ]
    return np.array(within) < 0.5


def _keep_volume(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], kind: Int8[np.ndarray, " lanes"], longest: int
) -> Bool[np.ndarray, " lanes"]:
    """Return whether quasiperiodic or chaotic motions keep phase volume: these are no attractors."""
    kept, recurrent = np.zeros(batch.count, np.bool_), np.flatnonzero(np.isin(kind, (QUASIPERIODIC, CHAOTIC)))
    if len(recurrent):
        kept[recurrent] = keeps_volume(batch.take(recurrent), lanes, u[recurrent], longest)
    return kept
