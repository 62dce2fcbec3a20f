"""Lanes run to their attractors, each by itself: averaged over windows, each twice as long, until it has settled.

A lane has settled where its means over both halves of a window agree. It is restless where they are far apart, or no
nearer than in the window before: chaos, a motion too long for the window, or a slow approach; which of these it is,
the whole sweep decides. Neither depends on other lanes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.section_points import points_at, states_at, statuses
from jaxnh.analyses.window_averages import WindowAverages, average_window, units
from jaxnh.systems.rows import select
from jaxnh.systems.state import State, is_finite
from jaxnh.systems.status import STATUS

SETTLED_TO = 1e-4
"""Difference of means over both halves of a window of a lane that has settled, in sizes of the motion."""

_LEAST = 1e-4  # of the size at the start: a coordinate that vanishes on an attractor is as large as that
_RESTLESS = 1e-2  # likewise, of one whose motion is no slow approach
_FALLS = 0.25  # from a look to the next of what an approach or a smooth mean leaves; of chaos half is left, or more
_GROWN = 1.5  # from one look to one twice as long, of what goes to infinity in proportion to time
OPEN, SETTLED, RESTLESS, FAILED, CONSERVATIVE, TRANSIENT = range(6)
"""States of knowledge of a lane; `clustering` decides which lanes are conservative, and which on a transient."""


class LaneRecords(NamedTuple):
    """Records of lanes.

    Attributes:
        known: `OPEN`, `SETTLED`, `RESTLESS`, `FAILED`, `CONSERVATIVE` or `TRANSIENT`, (lanes,).
        time: periods since the start, (lanes,).
        status: number in `STATUS`, (lanes,).
        gap: between means over both halves of the last window, the largest in sizes of the motion, (lanes,).
        means: smooth ones over the last window, (lanes, F).
        unit: how well these are known where a lane has settled, (lanes, F).
        u: section coordinates at its end, (lanes, d). The last window is that before one in which a lane fails.
        size: of the motion, its largest coordinates over the last window and the one before, (lanes, d).
        least: lower bound of the size, (lanes, d): a coordinate that vanishes on an attractor decays for ever.
    """

    known: Int8[np.ndarray, " lanes"]
    time: Int[np.ndarray, " lanes"]
    status: Int8[np.ndarray, " lanes"]
    gap: Float[np.ndarray, " lanes"]
    means: Float[np.ndarray, "lanes F"]
    unit: Float[np.ndarray, "lanes F"]
    u: Float[np.ndarray, "lanes d"]
    size: Float[np.ndarray, "lanes d"]
    least: Float[np.ndarray, "lanes d"]


def settle(batch: LaneBatch, lanes: LaneRunner, transient: int, longest: int, steps: int | None = None) -> LaneRecords:
    """Run lanes from their start states, in windows from `transient` periods on, for at most `longest` periods.

    After half of the transient a period has `steps` steps (`steps_after_transient`), or as many as before.
    """
    start, count, d = batch.start, batch.count, batch.chart.dimension
    width = units(np.array(batch.chart.angles), np.ones((1, d))).shape[1]
    records = LaneRecords(
        np.full(count, OPEN, np.int8),
        np.zeros(count, np.int64),
        np.zeros(count, np.int8),
        np.full(count, np.inf),
        *np.full((2, count, width), np.nan),
        *np.full((3, count, d), np.nan),
    )
    absent = ~is_finite(start)
    records.known[absent], records.status[absent] = FAILED, STATUS.index("off_constraint")
    finite = np.flatnonzero(~absent)
    active = batch.take(finite)
    first = average_window(active, lanes, active.start, transient // 2) if len(finite) else None
    if first is None:
        return records
    batch, active = (replace(part, steps=steps or part.steps) for part in (batch, active))
    window = average_window(active, lanes, first.state, transient // 2)
    records.least[finite] = _LEAST * np.fmax(np.abs(points_at(active, lanes, active.start)), first.largest)
    records.size[finite] = np.fmax(window.largest, records.least[finite])
    records.time[finite], records.u[finite] = transient, points_at(batch, lanes, window.state)
    scale = units(np.array(batch.chart.angles), np.fmax(first.largest, window.largest))
    records.gap[finite] = _gap(window, scale)
    records.means[finite], records.unit[finite] = window.whole, 2.0 * SETTLED_TO * scale
    _fail(records, finite, batch, window.state)
    left = records.known[finite] == OPEN
    _extend_windows(batch, lanes, records, finite[left], select(window.state, left), transient, longest)
    return records


def resume(
    batch: LaneBatch, lanes: LaneRunner, records: LaneRecords, subset: Int[np.ndarray, " some"], longest: int
) -> None:
    """Run lanes on, in place, from where they are."""
    records.known[subset] = OPEN
    for elapsed in np.unique(records.time[subset]).tolist():
        group = subset[records.time[subset] == elapsed]
        state = states_at(batch, lanes, records.u[group])
        _extend_windows(batch, lanes, records, group, state, elapsed, longest)


def _extend_windows(
    batch: LaneBatch,
    lanes: LaneRunner,
    records: LaneRecords,
    active: Int[np.ndarray, " some"],
    state: State,
    elapsed: int,
    longest: int,
) -> None:
    """Average lanes over windows as long as all time before, until they are done."""
    turns = np.array(batch.chart.angles)
    while len(active) and 2 * elapsed <= longest:
        active_batch = batch.take(active)
        window = average_window(active_batch, lanes, state, elapsed)
        elapsed *= 2
        records.time[active] = elapsed
        _fail(records, active, batch, window.state)
        finite = is_finite(window.state)
        active, window = active[finite], select(window, finite)
        if not len(active):
            return
        before = records.size[active]
        records.size[active] = np.fmax(before, window.largest)
        scale = units(turns, records.size[active])
        gap = _gap(window, scale)
        settled, restless = gap <= SETTLED_TO, (gap > _RESTLESS) | (gap > _FALLS * records.gap[active])
        known = np.where(settled, SETTLED, np.where(restless, RESTLESS, OPEN)).astype(np.int8)
        records.known[active], records.gap[active] = known, gap
        records.means[active], records.unit[active] = window.whole, 2.0 * SETTLED_TO * scale
        records.u[active] = points_at(batch, lanes, window.state)
        if 2 * elapsed > longest:
            _escape(records, active, window, before, turns)
        records.size[active] = np.fmax(window.largest, records.least[active])
        left = records.known[active] == OPEN
        active, state = active[left], select(window.state, left)


def _gap(window: WindowAverages, scale: Float[np.ndarray, "some F"]) -> Float[np.ndarray, " some"]:
    """Return the largest difference of the means over both halves of a window, in sizes of the motion."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(window.halves[:, 0] - window.halves[:, 1])
        return np.max(apart / np.where(scale > 0.0, scale, 1.0), axis=1)


def _escape(
    records: LaneRecords,
    subset: Int[np.ndarray, " some"],
    window: WindowAverages,
    before: Float[np.ndarray, "some d"],
    turns: np.ndarray,
) -> None:
    """Mark lanes that go to infinity: not done, and in the last window beyond all positions before."""
    beyond = np.maximum(window.low, -window.high) > 0.99 * before
    grows = beyond & (window.largest > _GROWN * before) & ~turns
    gone = np.any(grows, axis=1) & np.isin(records.known[subset], (OPEN, RESTLESS))
    records.known[subset[gone]], records.status[subset[gone]] = FAILED, STATUS.index("escaped")


def _fail(records: LaneRecords, subset: Int[np.ndarray, " some"], batch: LaneBatch, state: State) -> None:
    """Mark lanes whose state is not finite, with their reasons."""
    status = statuses(batch, state)
    gone = status > 0
    records.known[subset[gone]], records.status[subset[gone]] = FAILED, status[gone]
