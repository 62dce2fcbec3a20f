"""Least period of the attractor of every lane, from Newton on its orbit: not from how near strobe points come.

Strobe points after a transient only name candidates. What decides is whether Newton finds a stable orbit of that
period there, so that neither the slow convergence near a doubling (a decaying oscillation of period 2n) nor a
coexisting partner orbit is taken for another period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int
from pydantic import Field

from jaxnh.analyses.base import LANE, Analysis, Options, variable
from jaxnh.analyses.price import Price, newton_price
from jaxnh.analyses.scene import LaneRunner, Scene, counted_in, picked, section_points
from jaxnh.maps.iterate import iterate, record
from jaxnh.maps.protocol import Strobe
from jaxnh.orbits.newton import Look, Orbit, find_doubled, find_orbits, look
from jaxnh.systems.flow import Flow, Parameters, State

CONVERGED = 1e-7
"""Residual of an orbit that Newton has found, in sizes of the motion."""

_CLOSE = 0.03  # sizes of the motion: strobe points nearer than this may be one point of a slowly converging orbit
_NEARLY_NEUTRAL = 1e-3  # |1 − μ| below which an orbit of even period may be one that has just been born in a doubling
ORBIT_TILE = 64
# Few lanes have long orbits, and a tile takes as long for one lane as for all of it: sixteen take half the time that 64
# do, no longer than eight, and where there are many lanes a lane takes twice as long as in tiles of 64.
_SHORT, _LONG_TILE = 8, 16
# Lanes are looked at first after this share of the transient, for orbits no longer than this.
_EARLY, _EARLY_LIMIT = 8, 16


class PeriodOptions(Options):
    """Options of `period`."""

    limit: int = Field(default=64, ge=1, le=1024, description="Largest period looked for")
    transient: int = Field(default=512, ge=0, description="Periods before the last look at the strobe points")


class Survey(NamedTuple):
    """Lanes on their attractors.

    Attributes:
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
        residual: largest component of Pⁿ(u) − u in sizes of the motion, NaN where no orbit was found, (lanes,).
        multiplier: largest modulus of the multipliers, NaN likewise, (lanes,).
        monodromy: ∂Pⁿ/∂u at the point, NaN likewise, (lanes, d, d).
        failed: whether the state of the lane is not finite, (lanes,).
        size: of the motion in each section coordinate, (lanes, d): what `near` means.
    """

    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]
    residual: Float[np.ndarray, " lanes"]
    multiplier: Float[np.ndarray, " lanes"]
    monodromy: Float[np.ndarray, "lanes d d"]
    failed: Bool[np.ndarray, " lanes"]
    size: Float[np.ndarray, "lanes d"]


def periods(options: PeriodOptions, lanes: int) -> float:
    """Lane-periods of a run: the transient, the points looked at, and as much again for Newton."""
    return 2.0 * lanes * (options.transient + 2 * options.limit)


def numbers(options: PeriodOptions) -> int:
    """Numbers that a lane needs: the strobe points it is judged by."""
    return 6 * options.limit


def run(options: PeriodOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """Least period of every lane with its residual and largest multiplier."""
    found = survey_from_start(scene, lanes, options.limit, "period", options.transient)
    found = beyond_doublings(lanes, scene.strobe(), dict(scene.p), found)
    unit = counted_in(scene.system)
    variables = {
        "period": variable(LANE, found.period, "least period, 0: none up to the limit", unit),
        "residual": variable(
            LANE, found.residual, "largest component of Pⁿ(u) − u of the orbit, in sizes of the motion"
        ),
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


def first_points(scene: Scene, lanes: LaneRunner) -> Float[np.ndarray, "lanes d"]:
    """Section coordinates of every lane's start, or of its first crossing where there is a section."""
    if scene.flow is scene.system:
        return section_points(scene)
    return lanes(_first_crossing, (scene.strobe(),), scene.lanes, periods=1)


def _first_crossing(strobe: Strobe, state: State, p: Parameters) -> Float[Array, " d"]:
    return strobe.system.chart(strobe(state, p))


def survey_from_start(scene: Scene, lanes: LaneRunner, limit: int, label: str, transient: int) -> Survey:
    """Attractor and period, up to a limit, of every lane of a scene from its start state."""
    early, *late = _looks(transient, limit)
    if not late:
        return survey(scene, lanes, first_points(scene, lanes), limit, label, transient)
    return _continued(scene, lanes, first_look(scene, lanes, label, early), late, label)


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

    Lanes whose orbit is not found early are looked at again after the whole transient. The period is a multiple of the
    least n after which the points roughly recur; with `only_doublings`, for a cascade, 2, 4, 8, … times that alone are
    tried.
    """
    first, *late = _looks(transient, limit)
    seen = _look(scene, lanes, u, first, label, least, only_doublings)
    return _continued(scene, lanes, seen, late, label, least, only_doublings)


class Timing(NamedTuple):
    """When lanes are looked at, and how closely.

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
        """That it takes."""
        return self.wait + 2 * self.limit


class Seen(NamedTuple):
    """What was seen of lanes at one time, and their last points, (lanes, d)."""

    survey: Survey
    ends: Float[np.ndarray, "lanes d"]


def _looks(transient: int, limit: int) -> list[Timing]:
    """When lanes are looked at: the last time after the whole transient.

    All lanes are looked at early, since most are on their orbits long before the transient is over: only the least
    period that they recur after is tried, so that the others lose little. Those are looked at again after all of it.
    """
    if (early := early_look(transient, limit)) is None:
        return [Timing(transient, limit)]
    return [early, Timing(transient - early.periods, limit)]


def early_look(transient: int, limit: int = _EARLY_LIMIT) -> Timing | None:
    """The look before a transient is over; None where it is too short for one."""
    early = Timing(transient // _EARLY, min(limit, _EARLY_LIMIT), 1)
    return early if early.wait and early.periods < transient else None


def first_look(scene: Scene, lanes: LaneRunner, label: str, early: Timing) -> Seen:
    """What is seen of all lanes from their start states; the same for whichever analyses of a scene ask for it."""
    if early not in scene.seen:
        scene.seen[early] = _look(scene, lanes, first_points(scene, lanes), early, label)
    return scene.seen[early]


def _continued(
    scene: Scene,
    lanes: LaneRunner,
    seen: Seen,
    late: Sequence[Timing],
    label: str,
    least: int = 1,
    only_doublings: bool = False,
) -> Survey:
    """Those lanes whose orbits have not been seen are looked at again."""
    found = jax.tree.map(np.copy, seen.survey)
    open_, ends = np.arange(scene.count), seen.ends
    for timing in late:
        left = np.flatnonzero((found.period[open_] == 0) & ~found.failed[open_])
        if not len(left):
            break
        open_ = open_[left]
        part, ends = _look(scene.take(open_), lanes, ends[left], timing, label, least, only_doublings)
        for whole, some in zip(found, part, strict=True):
            whole[open_] = some
    return found


def _nothing_found(u: Float[np.ndarray, "lanes d"]) -> Survey:
    """A survey of lanes that have not been looked at."""
    count, d = u.shape
    nan, none = np.full(count, np.nan), np.zeros(count, np.bool_)
    monodromy = np.full((count, d, d), np.nan)
    return Survey(np.zeros(count, int), u.copy(), nan, nan.copy(), monodromy, none, np.ones_like(u))


def _look(
    scene: Scene,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes d"],
    timing: Timing,
    label: str,
    least: int = 1,
    only_doublings: bool = False,
) -> Seen:
    """What is seen of lanes some periods on, in 2 limit points of each."""
    strobe, count, p = scene.strobe(), scene.count, dict(scene.p)
    (wait, limit, tries), cost = timing, timing.periods
    with lanes.stage(f"{label}: {count} lanes to their attractors", count * cost):
        shared, static = (strobe, np.int32(wait)), (2 * limit,)
        if scene.system.dimensionless:
            points, size = lanes(strobe_points, shared, (u, p), periods=cost, static=static), np.ones_like(u)
        else:
            radian = 0.0 if scene.system.autonomous else scene.system.period / (2 * np.pi)
            points, size = lanes(_sized_points, (*shared, radian), (u, p), periods=cost, static=static)
    recurs = _recurrences(scene.system, points, size, limit, least, only_doublings)
    period, found, residual, multiplier, monodromy, failed, _ = _nothing_found(points[:, 0])
    failed |= ~np.all(np.isfinite(points), axis=(1, 2))
    rank, first, last = np.cumsum(recurs, axis=0), 1, 1
    while first <= tries and np.any(rank[-1, period == 0] >= first):
        # The next 1, 2, 4, … of every lane at once: few lanes have many, and those would wait for each other.
        n, lane = np.nonzero(recurs & (rank >= first) & (rank <= last) & (period == 0))
        first, last = last + 1, 2 * last + 1
        with lanes.stage(f"{label}: orbits of {len(np.unique(lane))} lanes", 0):
            orbit = orbits(lanes, strobe, found[lane], picked(p, lane), n, size[lane])
        near = apart(scene.system, orbit.u, found[lane], size[lane]) < 2 * _CLOSE
        largest = largest_multiplier(orbit.monodromy)
        settled = np.flatnonzero((orbit.residual < CONVERGED) & near & (largest < 1.0))
        here, least_of = np.unique(lane[settled], return_index=True)
        if not len(here):
            continue
        settled = settled[least_of]
        exact = picked(orbit, settled)
        shortest = least_period(lanes, strobe, exact.u, picked(p, here), n[settled], size[here])
        shorter = np.flatnonzero(shortest != n[settled])
        if len(shorter):
            some = here[shorter]
            turned = orbits(lanes, strobe, exact.u[shorter], picked(p, some), shortest[shorter], size[some])
            for whole, part in zip(exact, turned, strict=True):
                whole[shorter] = part
        period[here], found[here] = shortest, exact.u
        residual[here], monodromy[here] = exact.residual, exact.monodromy
    on_orbit = period > 0
    multiplier[on_orbit] = largest_multiplier(monodromy[on_orbit])
    return Seen(Survey(period, found, residual, multiplier, monodromy, failed, size), points[:, -1])


def _recurrences(
    system: Flow,
    points: Float[np.ndarray, "lanes points d"],
    size: Float[np.ndarray, "lanes d"],
    limit: int,
    least: int,
    only_doublings: bool,
) -> Bool[np.ndarray, "periods lanes"]:
    """Whether n may be the period of a lane, for n from 0 to a limit: a multiple of the least after which points recur.

    Newton decides: points that nearly recur do so too where a lane is still on its way.
    """
    possible = np.zeros((limit + 1, len(points)), np.bool_)
    base = np.zeros(len(points), int)
    for n in range(least, limit + 1):
        lanes = np.flatnonzero(apart(system, points[:, n], points[:, 0], size) < _CLOSE)  # most do not recur
        if not len(lanes):
            continue
        ahead, behind = points[lanes, n : n + limit], points[lanes, :limit]
        lanes = lanes[np.max(apart(system, ahead, behind, size[lanes, None]), axis=1) < _CLOSE]
        base[lanes] = np.where(base[lanes] == 0, n, base[lanes])
        ratio, rest = np.divmod(n, base[lanes])
        possible[n, lanes] = (rest == 0) & ((ratio & (ratio - 1) == 0) | (not only_doublings))
    return possible


def beyond_doublings(lanes: LaneRunner, strobe: Strobe, p: Parameters, found: Survey) -> Survey:
    """A survey whose orbits just beyond the doubling that they were born in are right to rounding, multipliers too."""
    period, u, residual, multiplier, monodromy, failed, size = (leaf.copy() for leaf in found)
    system = strobe.system
    near = (period > 0) & (period % 2 == 0) & (np.abs(multiplier - 1.0) < _NEARLY_NEUTRAL)
    for n in np.unique(period[near]):
        here = np.flatnonzero(near & (period == n))
        arguments = (u[here], picked(p, here), *sizes(system, size[here]))
        orbit = lanes(find_doubled, (strobe, np.int32(n // 2)), arguments, tile=ORBIT_TILE)
        settled = (orbit.residual < CONVERGED) & (apart(system, orbit.u, u[here], size[here]) < 2 * _CLOSE)
        part = here[settled]
        u[part], residual[part] = orbit.u[settled], orbit.residual[settled]
        multiplier[part], monodromy[part] = largest_multiplier(orbit.monodromy[settled]), orbit.monodromy[settled]
    return Survey(period, u, residual, multiplier, monodromy, failed, size)


def orbits(
    lanes: LaneRunner,
    strobe: Strobe,
    u: Float[np.ndarray, "lanes d"],
    p: Parameters,
    n: int | Int[np.ndarray, " lanes"],
    size: Float[np.ndarray, "lanes d"] | None = None,
) -> Orbit:
    """`find_orbits` of period n over lanes, whose parameters are (lanes,) and whose motions have these sizes, or 1.

    Lanes of like periods wait least for each other where they are neighbours.
    """
    n = np.broadcast_to(np.asarray(n, np.int32), len(u))

    def of(lane: Int[np.ndarray, " group"], tile: int) -> Orbit:
        def look_at(u: Float[np.ndarray, "some d"], some: Int[np.ndarray, " some"]) -> Look:
            which = lane[some]
            at = (n[which], u, picked(p, which), *(() if size is None else sizes(strobe.system, size[which])))
            return lanes(look, (strobe,), at, tile=tile)

        return find_orbits(look_at, u[lane])

    short, long = np.flatnonzero(n <= _SHORT), np.flatnonzero(n > _SHORT)
    groups = [(lane, tile) for lane, tile in ((short, ORBIT_TILE), (long, _LONG_TILE)) if len(lane)]
    found = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(of(*group) for group in groups))
    return picked(found, np.argsort(np.concatenate([lane for lane, _ in groups])))


def sizes(system: Flow, size: Float[np.ndarray, "lanes d"]) -> tuple[Float[np.ndarray, "lanes d"], ...]:
    """Sizes as Newton's last argument, which a flow without dimensions has none of."""
    return () if system.dimensionless else (size,)


def apart(
    system: Flow, one: Float[np.ndarray, "... d"], other: Float[np.ndarray, "... d"], size: Float[np.ndarray, "... d"]
) -> np.ndarray:
    """Largest difference (...) between section points in sizes of the motion; without dimensions that of positions."""
    if system.dimensionless:
        return system.apart(one, other)
    return np.max(np.abs(system.wrap(one - other)) / size, axis=-1)


def least_period(
    lanes: LaneRunner,
    strobe: Strobe,
    u: Float[np.ndarray, "lanes d"],
    p: Parameters,
    n: int | Int[np.ndarray, " lanes"],
    size: Float[np.ndarray, "lanes d"],
) -> Int[np.ndarray, " lanes"]:
    """Least d that divides n with P^d(u) = u, for points u of orbits of period n of motions with these sizes.

    All such d are multiples of the least, so that prime factors are taken off n one by one for as long as u comes
    back. A lane that was still on its way may miss its orbit at d and meet it at a multiple.
    """
    period = np.array(np.broadcast_to(n, len(u)))
    factor = _prime_factors(period, np.ones_like(period))
    while len(open_ := np.flatnonzero(factor)):
        open_ = open_[np.argsort(period[open_] // factor[open_], kind="stable")]
        d = (period[open_] // factor[open_]).astype(np.int32)
        at = (d, u[open_], picked(p, open_), *sizes(strobe.system, size[open_]))
        back = lanes(look, (strobe,), at, tile=ORBIT_TILE).residual < CONVERGED
        period[open_[back]] //= factor[open_[back]]
        factor[open_] = _prime_factors(period[open_], factor[open_] - back)
    return period


def _prime_factors(n: Int[np.ndarray, " lanes"], above: Int[np.ndarray, " lanes"]) -> Int[np.ndarray, " lanes"]:
    """The least prime factor of each n that is larger than a bound of its own, 0 where there is none."""
    most = int(np.max(n, initial=1))
    primes = np.array([q for q in range(2, most + 1) if all(q % d for d in range(2, math.isqrt(q) + 1))], int)
    divides = (n[:, None] % primes == 0) & (primes > above[:, None])
    return np.where(np.any(divides, axis=1), primes[np.argmax(divides, axis=1)], 0) if len(primes) else 0 * n


def largest_multiplier(monodromy: Float[np.ndarray, "lanes d d"]) -> Float[np.ndarray, " lanes"]:
    """Largest modulus of the eigenvalues; infinite where the matrix is not finite."""
    finite = np.all(np.isfinite(monodromy), axis=(1, 2))
    moduli = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], monodromy, 0.0)))
    return np.where(finite, moduli.max(axis=1), np.inf)


def strobe_points(
    strobe: Strobe, transient: ArrayLike, u: Float[Array, " d"], p: Parameters, count: int
) -> Float[Array, "points d"]:
    """Section points after a transient, of one lane."""
    system = strobe.system
    settled = iterate(strobe, transient, system.unchart(u), p)
    return jax.vmap(system.chart)(record(strobe, settled, p, count)[1])


def _sized_points(
    strobe: Strobe, transient: ArrayLike, radian: ArrayLike, u: Float[Array, " d"], p: Parameters, count: int
) -> tuple[Float[Array, "points d"], Float[Array, " d"]]:
    """Section points after a transient, of one lane, and the size of its motion in each section coordinate.

    The largest of a coordinate at the points, or with a clock of its rate over a radian of the period, which is not
    small as well where the coordinate happens to be; of an angle it is one. Where all that is zero, one.

    Args:
        radian: of the period, a length of time; zero without a clock.
    """
    system, flow = strobe.system, strobe.system.flow
    states = record(strobe, iterate(strobe, transient, system.unchart(u), p), p, count)[1]
    points = jax.vmap(system.chart)(states)
    size = jnp.max(jnp.abs(points), axis=0)
    if not flow.autonomous:
        rates = jax.vmap(lambda y: jnp.stack(flow.lower(y, flow.rhs(0.0, y, p))))(states)
        size = jnp.maximum(size, jnp.max(jnp.abs(rates), axis=0) * radian)
    turns = np.abs(system.wrap(np.full(system.dimension, 2 * np.pi))) < 1.0
    return points, jnp.where(~turns & (size > 0.0) & (size < jnp.inf), size, 1.0)


def price(options: PeriodOptions, scene: Scene) -> Price:
    """Orbits and their multipliers need the derivatives of a period; before them comes the map alone."""
    return newton_price(scene, ORBIT_TILE)


def classes(data: xr.Dataset) -> Int[np.ndarray, ...]:
    """Kind of motion: the period, 0 where there is none, -1 where the state is not finite."""
    return np.where(data["failed"].to_numpy() > 0, -1, data["period"].to_numpy())


ANALYSIS = Analysis(
    "period",
    PeriodOptions,
    periods,
    run,
    newton=True,
    numbers=numbers,
    classes=classes,
    price=price,
    brief={"transient": 1, "limit": 1},
)
"""The entry of this analysis in the table."""
