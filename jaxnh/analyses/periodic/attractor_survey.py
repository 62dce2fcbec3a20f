"""Attractors of lanes and their least periods, from Newton on their orbits: not from how near strobe points come.

Strobe points after a transient only name candidates. What decides is whether Newton finds a stable orbit of that
period there, so that neither the slow convergence near a doubling (a decaying oscillation of period 2n) nor a
coexisting partner orbit is taken for another period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.halved_periods import NEARLY_NEUTRAL, stable_halves
from jaxnh.analyses.periodic.newton_on_lanes import (
    CONVERGED,
    converged,
    images,
    largest_multiplier,
    least_period,
    orbits,
    section_distance,
)
from jaxnh.analyses.periodic.recurrences import CLOSE, Recurrence, recurrences, recurs_after
from jaxnh.analyses.section_points import at_rest, first_places, points_and_end, states_at, statuses
from jaxnh.maps.family import Maps
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import rates
from jaxnh.orbits.newton import find_doubled
from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select, write_rows
from jaxnh.systems.state import State

_SMALLEST = 1e-4  # of the size at the start: branches, followed to 1e-9 of a size, then are so to hundreds of roundings
# Lanes are looked at first after this share of the transient, for orbits no longer than this.
_EARLY, _EARLY_LIMIT = 8, 16
_MOST_KEPT = 128  # points of a lane that stay on a card: half a million lanes have gigabytes of them


class Survey(NamedTuple):
    """Lanes on their attractors.

    Attributes:
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
        residual: largest component of Pⁿ(u) − u in sizes of the motion, NaN where there is no orbit, (lanes,).
        multiplier: largest modulus of the multipliers, NaN likewise, (lanes,).
        monodromy: ∂Pⁿ/∂u at the point, NaN likewise, (lanes, d, d).
        status: of the lane, a number of `STATUS`, (lanes,).
        size: of the motion in each section coordinate, (lanes, d): what `near` means.
    """

    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]
    residual: Float[np.ndarray, " lanes"]
    multiplier: Float[np.ndarray, " lanes"]
    monodromy: Float[np.ndarray, "lanes d d"]
    status: Int[np.ndarray, " lanes"]
    size: Float[np.ndarray, "lanes d"]

    @property
    def failed(self) -> Bool[np.ndarray, " lanes"]:
        """Lanes whose state is not finite, (lanes,)."""
        return self.status > 0


def survey_from_start(batch: LaneBatch, lanes: LaneRunner, limit: int, label: str, transient: int) -> Survey:
    """Attractor and period, up to a limit, of every lane of a batch from its start state."""
    early, *late = _timings(transient, limit)
    if not late:
        return _survey_start(batch, lanes, Timing(transient, limit), label).survey
    return _survey_late(batch, lanes, survey_early(batch, lanes, label, early), late, label)


def survey(
    batch: LaneBatch,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    limit: int,
    label: str,
    transient: int,
    only_doublings: bool = False,
    tile: int | None = None,
) -> Survey:
    """Attractor and period (up to a limit) of every lane of a batch, from start points u.

    Lanes without an orbit by then are looked at again after the whole transient. The period is a multiple of the
    least n after which the points roughly recur; with `only_doublings`, for a cascade, 2, 4, 8, … times that alone are
    tried.

    Args:
        tile: lanes a tile on their way, where they are few.
    """
    first, *late = _timings(transient, limit)
    how = label, only_doublings, tile
    return _survey_late(batch, lanes, _survey_at(batch, lanes, u, first, *how), late, *how)


class Timing(NamedTuple):
    """Time and effort of one survey of lanes.

    Attributes:
        wait: periods before.
        limit: of the period; there are twice as many points.
        tries: how many periods of a lane are tried at most.
    """

    wait: int
    limit: int
    tries: float = math.inf

    @property
    def periods(self) -> int:
        """Periods integrated in total."""
        return self.wait + 2 * self.limit


class EarlySurvey(NamedTuple):
    """Survey of lanes at one time, and their last points, (lanes, d)."""

    survey: Survey
    ends: Float[np.ndarray, "lanes d"]


def _timings(transient: int, limit: int) -> list[Timing]:
    """Return the times of surveys, the last after the whole transient.

    All lanes are looked at early, since most are on their orbits long before the transient is over: only the least
    period that they recur after is tried, so that the others lose little. Those are looked at again after all of it.
    """
    if (early := early_timing(transient, limit)) is None:
        return [Timing(transient, limit)]
    return [early, Timing(transient - early.periods, limit)]


def periods_in_motion(batch: LaneBatch, lanes: LaneRunner, survey: Survey) -> Int[np.ndarray, " lanes"]:
    """Return the periods of lanes; 0 where one has failed, or has come to rest on a section through an equilibrium."""
    period = np.where(survey.failed, 0, survey.period)
    if period.any() and batch.on_section:
        period[at_rest(batch, lanes, np.where(period[:, None] > 0, survey.u, np.nan))] = 0
    return period


def early_timing(transient: int, limit: int = _EARLY_LIMIT) -> Timing | None:
    """Return the time of a survey before the transient is over; None where it is too short for one."""
    early = Timing(transient // _EARLY, min(limit, _EARLY_LIMIT), 1)
    return early if early.wait and early.periods < transient else None


def survey_early(batch: LaneBatch, lanes: LaneRunner, label: str, early: Timing) -> EarlySurvey:
    """Survey all lanes from their start states, once for all analyses of a batch."""
    if early not in batch.cache:
        batch.cache[early] = _survey_start(batch, lanes, early, label)
    return batch.cache[early]


def _survey_start(batch: LaneBatch, lanes: LaneRunner, timing: Timing, label: str) -> EarlySurvey:
    """Survey lanes some periods after their start states, or after their first crossings."""
    u, status = first_places(batch, lanes)
    seen = _survey_at(batch, lanes, u, timing, label)
    status = np.where(status > 0, status, seen.survey.status)
    return seen._replace(survey=seen.survey._replace(status=status))


def _survey_late(
    batch: LaneBatch,
    lanes: LaneRunner,
    seen: EarlySurvey,
    late: Sequence[Timing],
    label: str,
    only_doublings: bool = False,
    tile: int | None = None,
) -> Survey:
    """Survey again the lanes whose orbits are not known yet."""
    survey = jax.tree.map(np.copy, seen.survey)
    active, ends = np.arange(batch.count), seen.ends
    for timing in late:
        left = np.flatnonzero((survey.period[active] == 0) & ~survey.failed[active])
        if not len(left):
            break
        active = active[left]
        part, ends = _survey_at(batch.take(active), lanes, ends[left], timing, label, only_doublings, tile)
        write_rows(survey, active, part)
    return survey


def _nothing_found(u: Float[np.ndarray, "lanes d"]) -> Survey:
    """A survey of lanes that have not been looked at."""
    count, d = u.shape
    nan, zero = np.full(count, np.nan), np.zeros(count, int)
    monodromy = np.full((count, d, d), np.nan)
    return Survey(zero, u.copy(), nan, nan.copy(), monodromy, zero.copy(), np.ones_like(u))


def _survey_at(
    batch: LaneBatch,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    timing: Timing,
    label: str,
    only_doublings: bool = False,
    tile: int | None = None,
) -> EarlySurvey:
    """Survey lanes some periods later, from 2 limit points of each."""
    strobe, p, tries = batch.strobe(), dict(batch.p), timing.tries
    with lanes.stage(f"{label}: {batch.count} lanes to their attractors", batch.count * timing.periods):
        seen = _look(batch, lanes, u, timing, Recurrence(timing.limit, only_doublings), tile)
    size, recurs = seen.size, seen.recurs.T
    period, point, residual, multiplier, monodromy, *_ = _nothing_found(seen.first)
    rank, first, last = np.cumsum(recurs, axis=0), 1.0, 1.0
    while first <= tries and np.any(rank[-1, period == 0] >= first):
        # The next 1, 2, 4, … of every lane at once: few lanes have many, and those would wait for each other. On a card
        # they do not, and a call lasts as long as its longest orbit.
        tried = recurs & (rank >= first) & (rank <= last) & (period == 0)
        n, lane = np.nonzero(tried)
        first, last = last + 1, math.inf if lanes.on_card else 2 * last + 1
        with lanes.stage(f"{label}: orbits of {np.count_nonzero(tried.any(axis=0))} lanes", 0):
            orbit = orbits(lanes, strobe, point[lane], select(p, lane), n, size[lane])
            orbit, n = stable_halves(lanes, strobe, orbit, select(p, lane), n, size[lane])
        near = section_distance(batch.chart, orbit.u, point[lane], size[lane]) < 2 * CLOSE
        largest = largest_multiplier(orbit.monodromy)
        candidate = np.flatnonzero((orbit.residual < CONVERGED) & near & (largest < 1.0))
        which = select(orbit, candidate), select(p, lane[candidate]), n[candidate], size[lane[candidate]]
        settled = candidate[converged(lanes, strobe, *which)]
        lanes_settled, least_of = np.unique(lane[settled], return_index=True)
        if not len(lanes_settled):
            continue
        settled = settled[least_of]
        exact = select(orbit, settled)
        shortest = least_period(lanes, strobe, exact.u, select(p, lanes_settled), n[settled], size[lanes_settled])
        shorter = np.flatnonzero(shortest != n[settled])
        if len(shorter):
            subset = lanes_settled[shorter]
            turned = orbits(lanes, strobe, exact.u[shorter], select(p, subset), shortest[shorter], size[subset])
            write_rows(exact, shorter, turned)
        period[lanes_settled], point[lanes_settled] = shortest, exact.u
        residual[lanes_settled], monodromy[lanes_settled] = exact.residual, exact.monodromy
        multiplier[lanes_settled] = largest[settled]
        multiplier[lanes_settled[shorter]] = largest_multiplier(exact.monodromy[shorter])
    return EarlySurvey(Survey(period, point, residual, multiplier, monodromy, seen.status, size), seen.last)


class _Look(NamedTuple):
    """Findings from points of lanes.

    Attributes:
        first, last: of the points, (lanes, d).
        status: of the lane, (lanes,).
        size: of the motion, (lanes, d).
        recurs: whether each number of periods may be one after which they recur, (lanes, periods).
    """

    first: Float[np.ndarray, "lanes d"]
    last: Float[np.ndarray, "lanes d"]
    status: Int[np.ndarray, " lanes"]
    size: Float[np.ndarray, "lanes d"]
    recurs: Bool[np.ndarray, "lanes periods"]


def _look(
    batch: LaneBatch,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    timing: Timing,
    sought: Recurrence,
    tile: int | None,
) -> _Look:
    """Look at 2 limit points of lanes some periods later, on a card where they are: nothing of a lane is larger."""
    count, state, sized = 2 * timing.limit, states_at(batch, lanes, u, tile), not batch.chart.dimensionless
    if lanes.on_card and count <= _MOST_KEPT:
        strobe, p = batch.strobe(), dict(batch.p)
        state = lanes.iterate(strobe, timing.wait, (state, p), tile=tile) if timing.wait else state
        beside = least_sizes(batch, lanes) if sized else ()
        static = count, sought, None if batch.flow.autonomous else radian(batch)
        (*seen, finite), end = lanes.summarise(strobe, count, (state, p), beside, _look_at_lane, static, tile=tile)
        first, last, size, recurs = map(np.asarray, seen)
        return _Look(first, last, statuses(batch, end, np.asarray(finite)), size, recurs)
    points, end = points_and_end(batch, lanes, state, timing.wait, count, tile)
    size = motion_sizes(batch, lanes, points, end) if sized else np.ones_like(u)
    recurs = recurrences(batch.chart, lanes, points, size, sought).T
    status = statuses(batch, end, np.all(np.isfinite(points), axis=(1, 2)))
    return _Look(points[:, 0], points[:, -1], status, size, recurs)


def _look_at_lane(
    strobe: ReturnMap,
    carried: tuple[State, Any],
    p: Parameters,
    count: int,
    sought: Recurrence,
    radian: float | None,
) -> tuple[tuple[Array, ...], State]:
    """The parts of `_Look` of so many states of one lane, whether all are finite, and the last state.

    Args:
        radian: the time of one, None without a clock.
    """
    states, least = carried
    end = jax.tree.map(lambda x: x[count - 1], states)
    points, chart = jax.vmap(strobe.chart.point)(jax.tree.map(lambda x: x[:count], states)), strobe.chart
    size = jnp.ones_like(points[0])
    if not chart.dimensionless:
        size = jnp.maximum(jnp.max(jnp.abs(points), axis=0), least)
        if radian is not None:
            u, rate = _point_and_rate(strobe, end, p)
            size = jnp.maximum(size, jnp.maximum(jnp.abs(u), jnp.abs(rate) * radian))
        size = _usable_sizes(chart, size, jnp)
    finite = jnp.all(jnp.isfinite(points))
    return (points[0], points[-1], size, recurs_after(chart, points, size, sought), finite), end


def polish_beyond_doublings(lanes: LaneRunner, strobe: Maps, p: Parameters, survey: Survey) -> Survey:
    """A survey whose orbits just beyond the doubling that they were born in are right to rounding, multipliers too."""
    period, u, residual, multiplier, monodromy, status, size = (leaf.copy() for leaf in survey)
    chart = strobe.chart
    near = (period > 0) & (period % 2 == 0) & (np.abs(multiplier - 1.0) < NEARLY_NEUTRAL)
    for n in np.unique(period[near]):
        born = np.flatnonzero(near & (period == n))
        half = images(lanes, strobe, select(p, born), np.full(len(born), n // 2, np.int32))
        orbit = find_doubled(half, u[born], size[born], chart.wrap)
        settled = (orbit.residual < CONVERGED) & (section_distance(chart, orbit.u, u[born], size[born]) < 2 * CLOSE)
        part = born[settled]
        u[part], residual[part] = orbit.u[settled], orbit.residual[settled]
        multiplier[part], monodromy[part] = largest_multiplier(orbit.monodromy[settled]), orbit.monodromy[settled]
    return Survey(period, u, residual, multiplier, monodromy, status, size)


def motion_sizes(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "lanes points d"], end: State
) -> Float[np.ndarray, "lanes d"]:
    """Return the size of the motions in each section coordinate, from points of them and their last states.

    The largest of a coordinate at the points, or with a clock of its rate over a radian of the period, which is not
    small as well where the coordinate happens to be; of an angle it is one. Where an attractor has a coordinate that
    vanishes, all of that decays for ever: it is never less than a small share of the same at the start of the lane.
    Where that is zero too, one.
    """
    size = np.max(np.abs(points), axis=1)
    if not batch.flow.autonomous:
        size = np.maximum(size, extent(batch, lanes, end))
    return _usable_sizes(batch.chart, np.maximum(size, least_sizes(batch, lanes)), np)


def least_sizes(batch: LaneBatch, lanes: LaneRunner) -> Float[np.ndarray, "lanes d"]:
    """Return the smallest size of the motion of each lane, by its start: that of coordinates that vanish."""
    return _SMALLEST * extent(batch, lanes, batch.start)


def extent(batch: LaneBatch, lanes: LaneRunner, state: State) -> Float[np.ndarray, "lanes d"]:
    """The larger of each section coordinate of states and of its rate over a radian of the period."""
    u, rate = lanes(_point_and_rate, (batch.strobe(),), (state, dict(batch.p)))
    return np.maximum(np.abs(u), np.abs(rate) * radian(batch))


def _point_and_rate(strobe: ReturnMap, state: State, p: Parameters) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    return strobe.chart.point(state), jnp.stack(rates(strobe.system, state, p))


def radian(batch: LaneBatch) -> float:
    """The time of a radian of the period."""
    return float(batch.flow.period / (2 * np.pi))


def _usable_sizes(chart: Chart, size: Any, xp: Any) -> Any:
    """Sizes (..., d), one of an angle and where they are none."""
    return xp.where(~np.array(chart.angles) & (size > 0.0) & (size < np.inf), size, 1.0)
