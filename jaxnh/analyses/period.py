"""Least period of the attractor of every lane, from Newton on its orbit: not from how near strobe points come.

Strobe points after a transient only name candidates. What decides is whether Newton finds a stable orbit of that
period there, so that neither the slow convergence near a doubling (a decaying oscillation of period 2n) nor a
coexisting partner orbit is taken for another period.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int
from pydantic import Field

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    LaneRunner,
    Options,
    Price,
    Scene,
    counted_in,
    newton_price,
    picked,
    section_points,
    variable,
)
from jaxnh.maps.iterate import iterate, record, section_map
from jaxnh.maps.protocol import Strobe
from jaxnh.orbits.newton import Look, Orbit, find_doubled, find_orbits, look
from jaxnh.systems.flow import Parameters, State

CONVERGED = 1e-7
"""Residual of an orbit that Newton has found."""

_CLOSE = 0.03  # strobe points nearer than this may be the same point of a slowly converging orbit
_NEARLY_NEUTRAL = 1e-3  # |1 − μ| below which an orbit of even period may be one that has just been born in a doubling
ORBIT_TILE = 64
# Few lanes have long orbits, and a tile takes as long for one lane as for all of it: eight lanes, a vector, a third of
# the time that 64 take. Where there are many, a lane takes five times as long as in tiles of 64.
_SHORT, _LONG_TILE = 8, 8


class PeriodOptions(Options):
    """Options of `period`."""

    limit: int = Field(default=64, ge=1, le=1024, description="Largest period looked for")
    transient: int = Field(default=512, ge=0, description="Periods before the strobe points are looked at")


class Survey(NamedTuple):
    """Lanes on their attractors.

    Attributes:
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
        residual: largest component of Pⁿ(u) − u, NaN where no orbit was found, (lanes,).
        multiplier: largest modulus of the multipliers, NaN likewise, (lanes,).
        failed: whether the state of the lane is not finite, (lanes,).
    """

    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]
    residual: Float[np.ndarray, " lanes"]
    multiplier: Float[np.ndarray, " lanes"]
    failed: Bool[np.ndarray, " lanes"]


def periods(options: PeriodOptions, lanes: int) -> float:
    """Lane-periods of a run: the transient, the points looked at, and as much again for Newton."""
    return 2.0 * lanes * (options.transient + 2 * options.limit)


def numbers(options: PeriodOptions) -> int:
    """Numbers that a lane needs: the strobe points it is judged by."""
    return 6 * options.limit


def run(options: PeriodOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """Least period of every lane with its residual and largest multiplier."""
    start = section_points(scene) if scene.flow is scene.system else _first_crossings(scene, lanes)
    found = survey(scene, lanes, start, options.limit, "period", options.transient)
    found = beyond_doublings(lanes, scene.strobe(), dict(scene.p), found)
    unit = counted_in(scene.system)
    variables = {
        "period": variable(LANE, found.period, "least period, 0: none up to the limit", unit),
        "residual": variable(LANE, found.residual, "largest component of Pⁿ(u) − u of the orbit"),
        "multiplier": variable(LANE, found.multiplier, "largest modulus of the Floquet multipliers of the orbit"),
        "failed": variable(LANE, found.failed.astype(np.int8), "1 where the state is not finite"),
    }
    attrs = {
        "limit": options.limit,
        "transient": options.transient,
        "panel": "integers",
        "panel_variables": "period",
        "panel_label": "least period",
    }
    return xr.Dataset(variables, attrs=attrs)


def _first_crossings(scene: Scene, lanes: LaneRunner) -> Float[np.ndarray, "lanes d"]:
    """Coordinates of the first point on a section, of every lane."""
    return lanes(_first_crossing, (scene.strobe(),), scene.lanes, periods=1)


def _first_crossing(strobe: Strobe, state: State, p: Parameters) -> Float[Array, " d"]:
    return strobe.system.chart(strobe(state, p))


def survey(
    scene: Scene,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    limit: int,
    label: str,
    transient: int,
    least: int = 1,
    only_doublings: bool = False,
) -> Survey:
    """Attractor and period (from `least` up to a limit) of every lane of a scene, from start points u.

    The period is a multiple of the least n after which the points roughly recur; with `only_doublings`, for a cascade,
    2, 4, 8, … times that alone are tried.
    """
    strobe, apart, count, p = scene.strobe(), scene.system.apart, scene.count, dict(scene.p)
    cost = transient + 2 * limit
    with lanes.stage(f"{label}: {count} lanes to their attractors", count * cost):
        points = lanes(_strobe_points, (strobe, np.int32(transient)), (u, p), periods=cost, static=(2 * limit,))
    period = np.zeros(count, int)
    base = np.zeros(count, int)  # least n after which the points recur, roughly: a multiple of it is the period
    found = np.array(points[:, 0])
    residual, multiplier = np.full(count, np.nan), np.full(count, np.nan)
    for n in range(least, limit + 1):
        recurs = np.max(apart(points[:, n : n + limit], points[:, :limit]), axis=1) < _CLOSE
        base[(base == 0) & recurs] = n
        ratio, rest = np.divmod(n, np.maximum(base, 1))
        possible = (rest == 0) & ((ratio & (ratio - 1) == 0) | (not only_doublings))
        open_ = np.flatnonzero((period == 0) & recurs & possible)
        if not len(open_):
            continue
        with lanes.stage(f"{label}: orbits of period {n} of {len(open_)} lanes", 0):
            orbit = orbits(lanes, strobe, found[open_], picked(p, open_), n)
        near = apart(orbit.u, found[open_]) < 2 * _CLOSE
        largest = largest_multiplier(orbit.monodromy)
        settled = (orbit.residual < CONVERGED) & near & (largest < 1.0)
        shortest = least_period(lanes, strobe, orbit.u[settled], picked(p, open_[settled]), n)
        for d in np.unique(shortest):
            part = np.flatnonzero(settled)[shortest == d]
            here = open_[part]
            exact = picked(orbit, part) if d == n else orbits(lanes, strobe, orbit.u[part], picked(p, here), d)
            period[here], found[here] = d, exact.u
            residual[here], multiplier[here] = exact.residual, largest_multiplier(exact.monodromy)
    return Survey(period, found, residual, multiplier, ~np.all(np.isfinite(points), axis=(1, 2)))


def beyond_doublings(lanes: LaneRunner, strobe: Strobe, p: Parameters, found: Survey) -> Survey:
    """A survey whose orbits just beyond the doubling that they were born in are right to rounding, multipliers too."""
    period, u, residual, multiplier, failed = (leaf.copy() for leaf in found)
    near = (period > 0) & (period % 2 == 0) & (np.abs(multiplier - 1.0) < _NEARLY_NEUTRAL)
    for n in np.unique(period[near]):
        here = np.flatnonzero(near & (period == n))
        orbit = lanes(find_doubled, (strobe, np.int32(n // 2)), (u[here], picked(p, here)), tile=ORBIT_TILE)
        settled = (orbit.residual < CONVERGED) & (strobe.system.apart(orbit.u, u[here]) < 2 * _CLOSE)
        part = here[settled]
        u[part], residual[part] = orbit.u[settled], orbit.residual[settled]
        multiplier[part] = largest_multiplier(orbit.monodromy[settled])
    return Survey(period, u, residual, multiplier, failed)


def orbits(lanes: LaneRunner, strobe: Strobe, u: Float[np.ndarray, "lanes d"], p: Parameters, n: int) -> Orbit:
    """`find_orbits` of period n over lanes, whose parameters are (lanes,)."""

    def look_at(u: Float[np.ndarray, "some d"], some: Int[np.ndarray, " some"]) -> Look:
        return lanes(look, (strobe, np.int32(n)), (u, picked(p, some)), tile=ORBIT_TILE if n <= _SHORT else _LONG_TILE)

    return find_orbits(look_at, u)


def least_period(
    lanes: LaneRunner, strobe: Strobe, u: Float[np.ndarray, "lanes d"], p: Parameters, n: int
) -> Int[np.ndarray, " lanes"]:
    """Least d that divides n with P^d(u) = u, for points u of orbits of period n.

    A lane that was still on its way may miss its orbit at d and meet it at a multiple.
    """
    period = np.full(len(u), n)
    for d in (d for d in range(1, n) if n % d == 0):
        open_ = np.flatnonzero(period == n)
        if not len(open_):
            break
        image = lanes(section_map, (strobe, np.int32(d)), picked((u, p), open_), periods=d, tile=ORBIT_TILE)
        period[open_[np.max(np.abs(strobe.system.wrap(image - u[open_])), axis=1) < CONVERGED]] = d
    return period


def largest_multiplier(monodromy: Float[np.ndarray, "lanes d d"]) -> Float[np.ndarray, " lanes"]:
    """Largest modulus of the eigenvalues; infinite where the matrix is not finite."""
    finite = np.all(np.isfinite(monodromy), axis=(1, 2))
    moduli = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], monodromy, 0.0)))
    return np.where(finite, moduli.max(axis=1), np.inf)


def _strobe_points(
    strobe: Strobe, transient: ArrayLike, u: Float[Array, " d"], p: Parameters, count: int
) -> Float[Array, "points d"]:
    """Section points after a transient, of one lane."""
    system = strobe.system
    settled = iterate(strobe, transient, system.unchart(u), p)
    return jax.vmap(system.chart)(record(strobe, settled, p, count)[1])


def price(options: PeriodOptions, scene: Scene) -> Price:
    """Orbits and their multipliers need the derivatives of a period; before them comes the map alone."""
    return newton_price(scene, ORBIT_TILE)


ANALYSIS = Analysis(
    "period",
    PeriodOptions,
    periods,
    run,
    newton=True,
    numbers=numbers,
    price=price,
    brief={"transient": 1, "limit": 1},
)
"""The entry of this analysis in the table."""
