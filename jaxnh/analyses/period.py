"""Least period of the attractor of every lane, from Newton on its orbit: not from how near strobe points come.

Strobe points after a transient only name candidates. What decides is whether Newton finds a stable orbit of that
period there, so that neither the slow convergence near a doubling (a decaying oscillation of period 2n) nor a
coexisting partner orbit is taken for another period.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array
from pydantic import Field

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene, Variable
from jaxnh.maps.iterate import iterate, record, section_map
from jaxnh.maps.protocol import Strobe
from jaxnh.orbits.newton import Orbit, find_orbit

CONVERGED = 1e-7
"""Residual of an orbit that Newton has found."""

_CLOSE = 0.03  # strobe points nearer than this may be the same point of a slowly converging orbit
ORBIT_TILE = 64


class PeriodOptions(Options):
    """Options of `period`."""

    limit: int = Field(default=64, ge=1, le=1024, description="Largest period looked for")
    transient: int = Field(default=512, ge=0, description="Periods before the strobe points are looked at")


class Survey(NamedTuple):
    """Lanes on their attractors.

    Attributes:
        b: (lanes,).
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
        residual: largest component of Pⁿ(u) − u, NaN where no orbit was found, (lanes,).
        multiplier: largest modulus of the multipliers, NaN likewise, (lanes,).
        failed: whether the lane has left the numbers, (lanes,).
    """

    b: np.ndarray
    period: np.ndarray
    u: np.ndarray
    residual: np.ndarray
    multiplier: np.ndarray
    failed: np.ndarray

    def without_holes(self) -> Survey:
        """The survey without lanes that stand alone or in pairs and are no part of a cascade.

        Undecided ones lie in windows or at doublings; ones of another period than both neighbours, which have the
        same, are on a coexisting attractor.
        """
        starts = np.flatnonzero(np.diff(self.period, prepend=-1))
        lengths = np.diff(np.append(starts, len(self.period)))
        found = self.period[starts]
        before, after = np.append(-1, found[:-1]), np.append(found[1:], -2)
        keep = np.repeat((lengths > 2) | ((found != 0) & (before != after)), lengths)
        return Survey(*(leaf[keep] for leaf in self))

    def run_end(self, first: int) -> int:
        """Last lane of the run of equal periods that begins at a lane."""
        other = np.flatnonzero(self.period[first:] != self.period[first])
        return first + int(other[0]) - 1 if len(other) else len(self.b) - 1


def periods(options: PeriodOptions, lanes: int) -> float:
    """Lane-periods of a run: the transient, the points looked at, and as much again for Newton."""
    return 2.0 * lanes * (options.transient + 2 * options.limit)


def numbers(options: PeriodOptions) -> int:
    """Numbers that a lane needs: the strobe points it is judged by."""
    return 6 * options.limit


def run(options: PeriodOptions, scene: Scene, lanes: LaneRunner) -> Group:
    """Least period of every lane with its residual and largest multiplier."""
    start = section_points(scene) if scene.flow is scene.system else _first_crossings(scene, lanes)
    found = survey(scene, lanes, scene.values, start, options.limit, "period", options.transient)
    unit = "forcing periods" if scene.flow is scene.system else "crossings"
    variables = {
        "b": Variable(("b",), found.b, scene.system.sweeps),
        "period": Variable(("b",), found.period, "least period, 0: none up to the limit", unit),
        "residual": Variable(("b",), found.residual, "largest component of Pⁿ(u) − u of the orbit"),
        "multiplier": Variable(("b",), found.multiplier, "largest modulus of the Floquet multipliers of the orbit"),
        "failed": Variable(("b",), found.failed.astype(np.int8), "1 where the lane has left the numbers"),
    }
    return Group(variables, {"limit": options.limit})


def section_points(scene: Scene) -> np.ndarray:
    """(lanes, d) section coordinates of the start state, in every lane."""
    return np.broadcast_to(scene.system.section_point(scene.start), (len(scene.values), scene.system.dimension))


def _first_crossings(scene: Scene, lanes: LaneRunner) -> np.ndarray:
    """(lanes, d) coordinates of the first point on a section, of every lane."""
    start = jax.tree.map(lambda leaf: np.full(len(scene.values), leaf, float), scene.start)
    return lanes(_first_crossing, (scene.strobe(),), (start, scene.values), periods=1)


def _first_crossing(strobe: Strobe, state: Any, b: Any) -> Array:
    return strobe.system.chart(strobe(state, b))


def survey(
    scene: Scene,
    lanes: LaneRunner,
    b: np.ndarray,
    u: np.ndarray,
    limit: int,
    label: str,
    transient: int,
    least: int = 1,
    only_doublings: bool = False,
) -> Survey:
    """Attractor and period (from `least` up to a limit) of every lane from start points u (lanes, d).

    The period is a multiple of the least n after which the points roughly recur; with `only_doublings`, for a cascade,
    2, 4, 8, … times that alone are tried.
    """
    strobe, apart = scene.strobe(), scene.system.apart
    cost = transient + 2 * limit
    with lanes.stage(f"{label}: {len(b)} values to their attractors", len(b) * cost):
        points = lanes(_strobe_points, (strobe, np.int32(transient)), (u, b), periods=cost, static=(2 * limit,))
    period = np.zeros(len(b), int)
    base = np.zeros(len(b), int)  # least n after which the points recur, roughly: a multiple of it is the period
    found = np.array(points[:, 0])
    residual, multiplier = np.full(len(b), np.nan), np.full(len(b), np.nan)
    for n in range(least, limit + 1):
        recurs = np.max(apart(points[:, n : n + limit], points[:, :limit]), axis=1) < _CLOSE
        base[(base == 0) & recurs] = n
        ratio, rest = np.divmod(n, np.maximum(base, 1))
        possible = (rest == 0) & ((ratio & (ratio - 1) == 0) | (not only_doublings))
        open_ = np.flatnonzero((period == 0) & recurs & possible)
        if not len(open_):
            continue
        with lanes.stage(f"{label}: orbits of period {n} at {len(open_)} values", 0):
            orbit = orbits(lanes, strobe, found[open_], b[open_], n)
        near = apart(orbit.u, found[open_]) < 2 * _CLOSE
        largest = largest_multiplier(orbit.monodromy)
        settled = (orbit.residual < CONVERGED) & near & (largest < 1.0)
        shortest = least_period(lanes, strobe, orbit.u[settled], b[open_[settled]], n)
        for d in np.unique(shortest):
            part = np.flatnonzero(settled)[shortest == d]
            here = open_[part]
            exact = (
                Orbit(*(leaf[part] for leaf in orbit)) if d == n else orbits(lanes, strobe, orbit.u[part], b[here], d)
            )
            period[here], found[here] = d, exact.u
            residual[here], multiplier[here] = exact.residual, largest_multiplier(exact.monodromy)
    return Survey(b, period, found, residual, multiplier, ~np.all(np.isfinite(points), axis=(1, 2)))


def orbits(lanes: LaneRunner, strobe: Strobe, u: np.ndarray, b: np.ndarray, n: int) -> Orbit:
    """`find_orbit` of period n over lanes (lanes, d), (lanes,)."""
    return lanes(find_orbit, (strobe, np.int32(n)), (u, b), tile=ORBIT_TILE)


def least_period(lanes: LaneRunner, strobe: Strobe, u: np.ndarray, b: np.ndarray, n: int) -> np.ndarray:
    """Least d that divides n with P^d(u) = u, for points (lanes, d) of orbits of period n: (lanes,).

    A lane that was still on its way may miss its orbit at d and meet it at a multiple.
    """
    period = np.full(len(b), n)
    for d in (d for d in range(1, n) if n % d == 0):
        open_ = np.flatnonzero(period == n)
        if not len(open_):
            break
        image = lanes(section_map, (strobe, np.int32(d)), (u[open_], b[open_]), periods=d, tile=ORBIT_TILE)
        period[open_[np.max(np.abs(strobe.system.wrap(image - u[open_])), axis=1) < CONVERGED]] = d
    return period


def largest_multiplier(monodromy: np.ndarray) -> np.ndarray:
    """Largest modulus of the eigenvalues, (lanes,); infinite where the matrix is not finite."""
    finite = np.all(np.isfinite(monodromy), axis=(1, 2))
    moduli = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], monodromy, 0.0)))
    return np.where(finite, moduli.max(axis=1), np.inf)


def _strobe_points(strobe: Strobe, transient: Any, u: Array, b: Any, count: int) -> Array:
    """(count, d) section points after a transient, of one lane."""
    system = strobe.system
    settled = iterate(strobe, transient, system.unchart(u), b)
    return jax.vmap(system.chart)(record(strobe, settled, b, count)[1])
