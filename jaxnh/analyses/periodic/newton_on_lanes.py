"""Newton on periodic orbits of many lanes at once: orbits, their least periods and multipliers.

Which lanes share a tile is decided here; one lane's step is `orbits/newton.py`, and on a card all steps of a lane are
one program (`orbits/newton_program.py`).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.batch import LaneRunner
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.orbits.multipliers import eigenvalues
from jaxnh.orbits.newton import Images, Orbit, find_doubled, find_orbits, matvec, solve
from jaxnh.orbits.newton_program import MOST_COORDINATES, find_least_period, find_orbit
from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import concatenate, select

CONVERGED = 1e-7
"""Largest residual of an orbit on which Newton has converged, in sizes of the motion."""

_NEARLY_NEUTRAL = 0.1  # |μ − 1| of a multiplier below which a small residual alone tells no orbit
_ISOLATED = 0.25  # share of M − 1 that Newton's next step may change where there is an orbit
_BESIDE = 0.01  # sizes: from where Newton has ended to the orbit that has been born in a doubling there

ORBIT_TILE = 64
"""Lanes a tile of programs that follow orbits."""

# Few lanes have long orbits, and a tile takes as long for one lane as for all of it: sixteen take half the time that 64
# do, no longer than eight, and where there are many lanes a lane takes twice as long as in tiles of 64.
_SHORT, _LONG_TILE = 8, 16


def orbits(
    lanes: LaneRunner,
    strobe: Maps,
    u: Float[np.ndarray, "lanes d"],
    p: Parameters,
    n: int | Int[np.ndarray, " lanes"],
    size: Float[np.ndarray, "lanes d"] | None = None,
) -> Orbit:
    """`find_orbits` of period n over lanes, whose parameters are (lanes,) and whose motions have these sizes, or 1.

    Lanes of like periods are neighbours, and wait least for each other.
    """
    n = np.broadcast_to(np.asarray(n, np.int32), len(u))
    size = np.ones_like(u) if size is None else size
    if _in_programs(lanes, strobe):
        return lanes(find_orbit, (strobe,), (n, u, size, p))

    def of(lane: Int[np.ndarray, " group"], tile: int) -> Orbit:
        at = images(lanes, strobe, select(p, lane), n[lane], tile)
        return find_orbits(at, u[lane], size[lane], strobe.chart.wrap)

    order = np.argsort(n, kind="stable")
    short, long = order[n[order] <= _SHORT], order[n[order] > _SHORT]
    groups = [(lane, tile) for lane, tile in ((short, ORBIT_TILE), (long, _LONG_TILE)) if len(lane)]
    orbits_by_group = concatenate(of(*group) for group in groups)
    return select(orbits_by_group, np.argsort(np.concatenate([lane for lane, _ in groups])))


def converged(
    lanes: LaneRunner,
    strobe: Maps,
    orbit: Orbit,
    p: Parameters,
    n: Int[np.ndarray, " lanes"],
    size: Float[np.ndarray, "lanes d"],
) -> Bool[np.ndarray, " lanes"]:
    """Return whether Newton has converged, on an orbit that there is.

    Just before a fold in which orbits are born Pⁿ(u) − u is a x² + c along the direction that is nearly neutral, and
    its residual may be small without a zero. Newton's next step from such a place, −(x² + c/a)/(2x), changes the
    derivative M − 1 by the share (x² + c/a)/(2x²), more than half of itself; near a zero this share is small
    (Kantorovich's theorem, in the form that no scaling changes). It is half or more at multiple roots too, which are
    bifurcations to rounding, and beside the doubling that an orbit was born in as long as Newton is further from the
    orbit than that from the one of half the period: there Newton has that one divided out.
    """
    exists = orbit.residual < CONVERGED
    with np.errstate(invalid="ignore"):
        neutral = np.min(np.abs(eigenvalues(orbit.monodromy) - 1.0), axis=1) < _NEARLY_NEUTRAL
    doubtful = np.flatnonzero(exists & neutral)
    if len(doubtful):
        n = np.broadcast_to(np.asarray(n, np.int32), len(exists))
        at = images(lanes, strobe, select(p, doubtful), n[doubtful])
        exists[doubtful] = _contracts(at, orbit.u[doubtful], size[doubtful], strobe.chart)
        born = doubtful[~exists[doubtful] & (n[doubtful] % 2 == 0)]
        if len(born):
            at = images(lanes, strobe, select(p, born), n[born] // 2)
            doubled = find_doubled(at, orbit.u[born], size[born], strobe.chart.wrap)
            beside = section_distance(strobe.chart, doubled.u, orbit.u[born], size[born]) < _BESIDE
            partner = np.asarray(at(doubled.u, np.arange(len(born))).image)
            apart = section_distance(strobe.chart, doubled.u, partner, size[born]) > CONVERGED
            exists[born] = (doubled.residual < CONVERGED) & beside & apart
    return exists


def _contracts(
    at: Images, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"], chart: Chart
) -> Bool[np.ndarray, " lanes"]:
    """Return whether Newton's step from each point hardly changes M − 1 along itself."""
    every, identity = np.arange(len(u)), np.eye(u.shape[1])
    here = at(u, every)
    image, monodromy = np.asarray(here.image), np.asarray(here.monodromy)
    step = solve(monodromy - identity, chart.wrap(u - image))
    change = np.asarray(at(u + step, every).monodromy) - monodromy
    next_step = solve(monodromy - identity, matvec(change, step))
    return np.linalg.norm(next_step / size, axis=1) <= _ISOLATED * np.linalg.norm(step / size, axis=1)


def _in_programs(lanes: LaneRunner, strobe: Maps) -> bool:
    """Return whether all of Newton is a program: on a card, whose threads do not wait for each other."""
    return lanes.on_card and strobe.chart.dimension <= MOST_COORDINATES


def images(
    lanes: LaneRunner, strobe: Maps, p: Parameters, n: Int[np.ndarray, " lanes"], tile: int = ORBIT_TILE
) -> Images:
    """Pⁿ and ∂Pⁿ/∂u of lanes with these parameters (lanes,), as Newton asks for them."""

    def at(u: Float[np.ndarray, "points d"], lane: Int[np.ndarray, " points"]) -> Derivatives:
        return lanes(derivatives, (strobe,), (n[lane], u, select(p, lane)), tile=tile)

    return at


def section_distance(
    chart: Chart,
    first: Float[np.ndarray, "... d"],
    second: Float[np.ndarray, "... d"],
    size: Float[np.ndarray, "... d"],
) -> np.ndarray:
    """Largest difference (...) between section points in sizes of the motion; without dimensions that of positions."""
    if chart.dimensionless:
        return chart.distance(first, second)
    with np.errstate(invalid="ignore"):  # of lanes that escape
        return np.max(np.abs(chart.wrap(first - second)) / size, axis=-1)


def least_period(
    lanes: LaneRunner,
    strobe: Maps,
    u: Float[np.ndarray, "lanes d"],
    p: Parameters,
    n: int | Int[np.ndarray, " lanes"],
    size: Float[np.ndarray, "lanes d"],
) -> Int[np.ndarray, " lanes"]:
    """Least d that divides n with P^d(u) = u, for points u of orbits of period n of motions with these sizes.

    All such d are multiples of the least, so that prime factors are taken off n one by one for as long as u comes
    back. A lane that was still on its way may miss its orbit at d and meet it at a multiple.
    """
    if _in_programs(lanes, strobe):
        n = np.broadcast_to(np.asarray(n, np.int32), len(u))
        return np.array(lanes(find_least_period, (strobe,), (n, u, size, p), static=(CONVERGED,)), int)
    period = np.array(np.broadcast_to(n, len(u)))
    factor = _prime_factors(period, np.ones_like(period))
    while len(active := np.flatnonzero(factor)):
        active = active[np.argsort(period[active] // factor[active], kind="stable")]
        d = (period[active] // factor[active]).astype(np.int32)
        image = images(lanes, strobe, select(p, active), d)(u[active], np.arange(len(active))).image
        residual = np.max(np.abs(strobe.chart.wrap(image - u[active]) / size[active]), axis=1)
        back = residual < CONVERGED
        period[active[back]] //= factor[active[back]]
        factor[active] = _prime_factors(period[active], factor[active] - back)
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
    moduli = np.abs(eigenvalues(np.where(finite[:, None, None], monodromy, 0.0)))
    return np.where(finite, moduli.max(axis=1), np.inf)
