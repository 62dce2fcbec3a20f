"""The orbit of twice the period that is born at a doubling: Newton finds it beyond, with no transient.

Near a doubling the daughter orbit is the old one ± an amplitude along the eigenvector of −1, and the amplitude grows
like the root of the distance. Distances before tell how far the next doubling is (Feigenbaum, J. Stat. Phys. 19 (1978)
25). So Newton starts at a few distances from a few amplitudes, both geometric. Along the eigenvector it solves the
equation of a pitchfork, y³ = y in units of the amplitude, and converges to 1 from any start above 0.58.

Of long orbits the derivative of a whole period is lost to rounding, and the map wanders off before it is over. By then
the cascade has been seen to follow the law, so that a few amplitudes at one distance are enough, by multiple shooting.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.cascade.plateaus import PeriodScan
from jaxnh.analyses.periodic.newton_on_lanes import (
    CONVERGED,
    largest_multiplier,
    least_period,
    orbits,
    section_distance,
)
from jaxnh.orbits.bifurcations.doubling_points import DoublingPoint, doubling_function, halves
from jaxnh.orbits.shooting import Period, close_orbits
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

_NEAR, _FAR = 1 / 16, 2.0  # distances beyond a doubling to look at first, in units of that expected to the next one

_DISTANCES, _AMPLITUDES = 8, 8  # in a window; their product is one tile of orbits
_AROUND = np.array([0.4, 0.63, 1.0, 1.6])  # amplitudes of a long orbit, of that expected
_RATIO = 2.5  # of amplitudes: that of successive ones in a cascade (2.5029…), and less than Newton's three or four


def doubled_lanes(
    batch: LaneBatch,
    lanes: LaneRunner,
    born: DoublingPoint,
    largest: float,
    size: Float[np.ndarray, " d"],
    distances: Float[np.ndarray, " distances"],
) -> PeriodScan:
    """Lanes at some distances beyond a doubling, on the stable orbit of twice the period where Newton converges on it.

    Args:
        batch: the batch; its lanes but for their values of the first axis.
        lanes: runs lanes.
        born: the doubling.
        largest: amplitude that the daughter orbit does not exceed, where the doubling orbit has only one point; in
            sizes of the motion.
        size: of the motion in each section coordinate.
        distances: from the doubling along the first axis, with sign, nearest first.

    Returns:
        A lane a distance, of period 0 where there is none.
    """
    n, chart = len(born.orbit), batch.chart
    at = int(np.argmax(np.linalg.norm(born.vector / size, axis=1)))
    origin, direction = born.orbit[at], born.vector[at] / np.linalg.norm(born.vector[at] / size)
    if n > 1:  # half way to the next point of its own the orbit of twice the period has another neighbour
        largest = float(np.delete(section_distance(chart, born.orbit, origin, size), at).min())
    sizes = largest * _RATIO ** -np.arange(_AMPLITUDES)
    growth = np.sqrt(np.abs(distances / distances[-1]))
    amplitude = np.outer(growth, sizes).ravel()
    value = np.repeat(born.value + distances, _AMPLITUDES)
    p = batch.at_values(value).p
    each = np.tile(size, (len(value), 1))
    orbit = orbits(lanes, batch.strobe(), origin + amplitude[:, None] * direction, p, 2 * n, each)
    ok = (orbit.residual < CONVERGED) & (largest_multiplier(orbit.monodromy) < 1.0)
    ok &= section_distance(chart, orbit.u, origin, size) <= largest
    candidates = np.flatnonzero(ok)
    shortest = least_period(lanes, batch.strobe(), orbit.u[candidates], select(p, candidates), 2 * n, each[candidates])
    ok[candidates[shortest != 2 * n]] = False
    ok = ok.reshape(len(distances), _AMPLITUDES)
    first = np.arange(len(distances)) * _AMPLITUDES + np.argmax(ok, axis=1)
    return PeriodScan(value[first], np.where(ok.any(axis=1), 2 * n, 0), orbit.u[first])


def long_doubled_orbit(
    period: Period, born: DoublingPoint, distance: float, gap: float, size: Float[np.ndarray, " d"], wrap: Wrap
) -> Float[np.ndarray, "2n d"] | None:
    """The stable orbit of twice the period at a distance beyond a doubling of even period; None where there is none.

    Args:
        period: P and ∂P/∂u over lanes.
        born: the doubling.
        distance: from it along the first axis, with sign.
        gap: distance to the next doubling that is expected.
        size: of the motion in each section coordinate.
        wrap: of differences of section coordinates.
    """
    before = np.linalg.norm(halves(born.orbit, wrap) / size, axis=-1).max()
    vector = born.vector / np.linalg.norm(born.vector / size, axis=1).max()
    expected = 0.5 * before / _RATIO * np.sqrt(distance / gap)
    moved = expected * _AROUND[:, None, None] * vector
    starts = np.concatenate([born.orbit + moved, born.orbit - moved], axis=1)
    orbits = close_orbits(period, starts, np.full(len(starts), born.value + distance), wrap)
    apart = np.linalg.norm(halves(orbits.points, wrap) / size, axis=-1).max(axis=-1)
    doubled = orbits.converged & (apart > expected * _AROUND[0]) & (apart < before)
    doubled[doubled] &= doubling_function(select(orbits, doubled)) > 0.0
    return orbits.points[np.argmax(doubled)] if doubled.any() else None


def window(expected: float, number: int, end: float) -> Float[np.ndarray, " distances"]:
    """Distances to look at, no further than the end, which then is the last; empty where they begin beyond it.

    Args:
        expected: distance to the next doubling, with its sign.
        number: 0 for distances about the expected one, 1, 2, … for those further out, −1, −2, … for closer ones.
        end: distance to the end of what is searched, with the same sign.
    """
    distances = expected * np.geomspace(_NEAR, _FAR, _DISTANCES) * (_FAR / _NEAR) ** number
    inside = np.abs(distances) < abs(end)
    if not expected * end > 0 or (number > 0 and not inside.any()):
        return distances[:0]
    return distances if inside.all() else np.append(distances[inside], end)
