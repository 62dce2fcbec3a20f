"""Error of the first doubling point of a sweep against the time spent on it, by three methods.

Plain detection of the period after growing transients is biased by critical slowing down, whatever the number of lanes.
Multisection on the multiplier of the orbit, which Newton finds stable or not, gains a fixed number of digits a round;
interpolation of det(M + 1), M the monodromy matrix, at nodes that narrow about its root gains several times as many.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from jaxnh.analyses.base import Entry, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.cascade import follow
from jaxnh.analyses.periodic.location import period_map, refined_maps, walk
from jaxnh.analyses.periodic.newton_on_lanes import CONVERGED, orbits
from jaxnh.analyses.section_points import points_after
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import Derivatives, section_map
from jaxnh.orbits.bifurcations.doubling_points import doubling_point, follow_branch, refine_doubling
from jaxnh.orbits.newton import Orbit
from jaxnh.orbits.shooting import Period

DETECTION, MULTISECTION, INTERPOLATION = "period detection", "multisection", "interpolation"

_TRANSIENTS = (100, 300, 1000, 3000, 10_000)  # periods before the period is looked at
_THRESHOLD = 1e-5  # strobe points nearer than this are taken for the same
_DETECTED = 5e-7  # width of the bracket at which plain detection ends: six decimals
_CANDIDATES, _TILE = 64, 32
_SETTLED = 512  # periods before the orbit is looked for
_ROUNDS = 12
_BEHIND, _AHEAD = 2.0, 0.5  # ends of the bracket about the doubling, in distances to the next one


class DoublingBracket(NamedTuple):
    """A bracket: the orbit of period n, stable at the first end of the bracket, doubles before the second."""

    n: int
    bracket: tuple[float, float]


class Estimate(NamedTuple):
    """The value of the parameter after so much work: periods of transient, or rounds.

    Times are of the clock on the wall and of all processors, since the method began.
    """

    method: str
    effort: int
    value: float
    seconds: float
    cpu_seconds: float


class _Watch:
    """Time since it was made: of the clock on the wall, and of all processors."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        return time.perf_counter() - self._wall, time.process_time() - self._cpu


def price(batch: LaneBatch, lanes: LaneExecutor) -> xr.Dataset | None:
    """Every estimate with its error and times; None where the sweep has no doubling."""
    with lanes.stage("cost: the first doubling of the sweep", 0):
        place = _first_doubling(batch, lanes.without_stages())
    if place is None:
        return None
    with lanes.stage(f"cost: doubling of period {place.n} by three methods", 0):
        by_detection(batch, lanes, place, (1,))  # compile, and read the clock the second time
        by_multiplier(batch, lanes, place)
        by_interpolation(batch, lanes, place)
        rounds, reference = by_interpolation(batch, lanes, place)
        estimates = [*by_detection(batch, lanes, place, _TRANSIENTS), *by_multiplier(batch, lanes, place), *rounds]
    return _dataset(batch, estimates, reference, place)


def _first_doubling(batch: LaneBatch, lanes: LaneRunner) -> DoublingBracket | None:
    """The first doubling that the analysis finds, in a bracket of several times the distance to the next one."""
    doublings = follow.follow(batch, lanes, 2)
    if not doublings.points:
        return None
    n, first = doublings.period, doublings.points[0].value
    low, high = batch.first_axis.values.min(), batch.first_axis.values.max()
    if (
        len(doublings.points) == 1
    ):  # then half of what the sweep has on either side, in the direction in which it doubles
        reach = min(first - low, high - first) / 2
        tried = [DoublingBracket(n, (first - ahead, first + ahead)) for ahead in (reach, -reach)]
        return next((c for c in tried if _narrow_bracket(batch, lanes, n, _settle(batch, lanes, c), c.bracket)), None)
    ends = np.clip(first + np.array([-_BEHIND, _AHEAD]) * (doublings.points[1].value - first), low, high)
    return DoublingBracket(n, (float(ends[0]), float(ends[1])))


def by_detection(
    batch: LaneBatch, lanes: LaneRunner, place: DoublingBracket, transients: Sequence[int]
) -> list[Estimate]:
    """Multisection on whether strobe points recur after n periods, an estimate a transient.

    Nothing is given for a transient too short for any lane to have settled.
    """
    estimates = []
    for transient in transients:
        watch, (near, far) = _Watch(), place.bracket
        while abs(far - near) > _DETECTED:
            values = np.linspace(near, far, _CANDIDATES)
            row = batch.at_values(values)
            points = points_after(row, lanes, row.chart.host_points(row.start), transient, 2 * place.n, _TILE)
            gap = np.max(np.abs(row.chart.wrap(points[:, place.n :] - points[:, : place.n]))[..., 0], axis=1)
            first = _first(gap > _THRESHOLD)
            if first is None:
                break
            near, far = values[first - 1], values[first]
        else:
            estimates.append(Estimate(DETECTION, transient, 0.5 * (near + far), *watch.read()))
    return estimates


def by_multiplier(batch: LaneBatch, lanes: LaneRunner, place: DoublingBracket) -> list[Estimate]:
    """Multisection on whether the orbit's smallest real multiplier is below −1, an estimate a round."""
    watch = _Watch()
    estimates = []
    u, bracket = _settle(batch, lanes, place), place.bracket
    for round_ in range(_ROUNDS):
        narrowed = _narrow_bracket(batch, lanes, place.n, u, bracket)
        if narrowed is None:
            break
        width = abs(bracket[1] - bracket[0])
        orbit, bracket = narrowed
        u = orbit.u
        estimates.append(Estimate(MULTISECTION, round_ + 1, 0.5 * (bracket[0] + bracket[1]), *watch.read()))
        if not 0 < abs(bracket[1] - bracket[0]) < width:
            break
    return estimates


def by_interpolation(batch: LaneBatch, lanes: LaneRunner, place: DoublingBracket) -> tuple[list[Estimate], float]:
    """Locate the doubling by rounds of nodes, with the batch's steps and then twice as many; an estimate a round.

    Returns:
        The estimates, and the value with the finest steps, whose time is not counted.
    """
    watch = _Watch()
    roots: dict[float, Estimate] = {}  # by value, each as it was when the orbit there was closed

    def watched(strobe: Maps) -> Period:
        period = period_map(batch, lanes, strobe)

        def look(u: np.ndarray, values: np.ndarray) -> Derivatives:
            derivatives, value = period(u, values), float(values[0])
            if np.all(values == value):  # all points of one orbit, at the root of a round
                roots.pop(value, None)  # the next map begins where the one before has ended
                roots[value] = Estimate(INTERPOLATION, len(roots) + 1, value, *watch.read())
            return derivatives

        return look

    coarse, fine, finest = refined_maps(batch)
    points = walk(batch, lanes, _settle(batch, lanes, place)[None], place.bracket[0], place.n)
    wrap = batch.chart.wrap
    branch = follow_branch(period_map(batch, lanes, coarse), points, *place.bracket, wrap)
    point = branch and doubling_point(watched(coarse), branch, wrap)
    for period in (watched(fine), period_map(batch, lanes, finest)):
        point = point and refine_doubling(period, point, wrap)
    return (list(roots.values()), point.value) if point else ([], math.nan)


def _settle(batch: LaneBatch, lanes: LaneRunner, place: DoublingBracket) -> Float[np.ndarray, " d"]:
    """A point near the orbit at the stable end of the bracket."""
    row = batch.at_values(np.array(place.bracket[:1]))
    strobe, start = batch.strobe(0.5), (row.chart.host_points(row.start), row.p)
    return lanes(section_map, (strobe, np.int32(_SETTLED)), start, periods=_SETTLED, tile=_TILE)[0]


def _narrow_bracket(
    batch: LaneBatch, lanes: LaneRunner, n: int, u: Float[np.ndarray, " d"], bracket: tuple[float, float]
) -> tuple[Orbit, tuple[float, float]] | None:
    """The orbit at the stable end of the part of a bracket in which its multiplier passes −1, and that part."""
    values = np.linspace(*bracket, _CANDIDATES)
    start = np.broadcast_to(u, (_CANDIDATES, len(u)))
    orbit = orbits(lanes, batch.strobe(), start, batch.at_values(values).p, n)
    ok = (orbit.residual < CONVERGED) & np.all(np.isfinite(orbit.monodromy), axis=(1, 2))
    smallest = _smallest_multiplier(np.where(ok[:, None, None], orbit.monodromy, 0.0))
    first = _first(ok & (smallest < -1.0))
    if first is None:
        return None
    return Orbit(*(leaf[first - 1] for leaf in orbit)), (float(values[first - 1]), float(values[first]))


def _smallest_multiplier(monodromy: Float[np.ndarray, "lanes d d"]) -> Float[np.ndarray, " lanes"]:
    """The smallest real eigenvalue; +∞ where all are complex."""
    values = np.linalg.eigvals(monodromy)
    return np.where(np.abs(values.imag) < 1e-12, values.real, np.inf).min(axis=1)


def _first(beyond: Bool[np.ndarray, " lanes"]) -> int | None:
    """Place of the first True; None where there is none or nothing before it."""
    first = int(np.argmax(beyond))
    return first if first > 0 else None


def _dataset(batch: LaneBatch, estimates: list[Estimate], reference: float, place: DoublingBracket) -> xr.Dataset:
    def column(data: Any, long_name: str, units: str = "1") -> Entry:
        return variable("estimate", data, long_name, units)

    axis = batch.first_axis
    method, effort, value, seconds, cpu_seconds = zip(*estimates, strict=True)
    error = np.abs(np.array(value) - reference)
    variables = {
        "method": column(method, "method"),
        "effort": column(effort, "periods of transient, or rounds"),
        "value": column(value, f"{axis.long_name} at the doubling", axis.units),
        "error": column(
            error, f"distance of {axis.name} from that by interpolation with four times the steps", axis.units
        ),
        "seconds": column(seconds, "time since the method began, compilation apart", "s"),
        "cpu_seconds": column(cpu_seconds, "time of all processors since the method began", "s"),
        "reference": variable((), reference, f"{axis.name} by interpolation with four times the steps", axis.units),
        "period": variable((), place.n, "period of the orbit that doubles", counted_in=iterate_units(batch.system)),
        "bracket": variable("end", np.array(place.bracket), f"ends of the {axis.name} that is searched", axis.units),
    }
    return xr.Dataset(variables, attrs={"along": axis.name, "threshold": _THRESHOLD})
