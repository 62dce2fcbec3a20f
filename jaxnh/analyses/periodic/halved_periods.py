"""Orbits of half the period beside a doubling: which of the two that Newton takes for one another is there."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.periodic.newton_on_lanes import CONVERGED, largest_multiplier, orbits, section_distance
from jaxnh.analyses.periodic.recurrences import CLOSE
from jaxnh.maps.family import Maps
from jaxnh.orbits.newton import Orbit
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select

NEARLY_NEUTRAL = 1e-3
"""|1 − μ| below which an orbit of even period may be one that has just been born in a doubling, or is about to be."""


def stable_halves(
    lanes: LaneRunner,
    strobe: Maps,
    orbit: Orbit,
    p: Parameters,
    n: Int[np.ndarray, " lanes"],
    size: Float[np.ndarray, "lanes d"],
) -> tuple[Orbit, Int[np.ndarray, " lanes"]]:
    """Return orbits and their periods, with those of half the period where one of these is stable there.

    Just before a doubling points alternate for long, and P²ⁿ(u) − u, of which the orbit of period n is all but a
    threefold root, is small far around it. Newton on Pⁿ tells: the orbit of period n is there, and stable.
    """
    neutral = np.abs(largest_multiplier(orbit.monodromy) - 1.0) < NEARLY_NEUTRAL
    even = np.flatnonzero((n % 2 == 0) & (orbit.residual < CONVERGED) & neutral)
    if not len(even):
        return orbit, n
    half = orbits(lanes, strobe, orbit.u[even], select(p, even), n[even] // 2, size[even])
    beside = section_distance(strobe.chart, half.u, orbit.u[even], size[even]) < CLOSE
    stable = beside & (half.residual < CONVERGED) & (largest_multiplier(half.monodromy) < 1.0)
    orbit, n = Orbit(*map(np.array, orbit)), n.copy()
    for whole, part in zip((*orbit, n), (*half, n[even] // 2), strict=True):
        whole[even[stable]] = part[stable]
    return orbit, n
