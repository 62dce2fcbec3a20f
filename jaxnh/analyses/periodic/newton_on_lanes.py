"""Newton on periodic orbits of many lanes at once: orbits, their least periods and multipliers.

Which lanes share a tile is decided here; one lane's step is `orbits/newton.py`, and on a card all steps of a lane are
one program (`orbits/newton_program.py`).
"""

from __future__ import annotations

import math

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneRunner, select
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.orbits.multipliers import eigenvalues
from jaxnh.orbits.newton import Images, Orbit, find_orbits
from jaxnh.orbits.newton_program import MOST_COORDINATES, find_least_period, find_orbit
from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Parameters

CONVERGED = 1e-7
"""Largest residual of an orbit on which Newton has converged, in sizes of the motion."""

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
    orbits_by_group = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(of(*group) for group in groups))
    return select(orbits_by_group, np.argsort(np.concatenate([lane for lane, _ in groups])))


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
