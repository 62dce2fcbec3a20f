"""Orbits that Newton finds within motions of lanes that have settled on none: what tori turn about, or begin at.

Beyond a supercritical Neimark–Sacker point motions are on tori, and within a torus that repels they may have gone to
infinity: branches of orbits that settled lanes lead to may miss the orbit that the torus is about. Newton goes to it
from the mean of a motion, and from the start of a lane.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.branches import SettledOrbits
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.continuation.motion_units import motion_unit
from jaxnh.analyses.periodic.location import period_map
from jaxnh.analyses.section_points import at_rest, first_points, points_from
from jaxnh.analyses.tori.tori import TurningMotions
from jaxnh.orbits.recognition import primitive_period
from jaxnh.orbits.shooting import orbits_from_afar
from jaxnh.systems.rows import spread_indices

_LANES = 9  # evenly over those that have settled on no orbit
_FARTHEST = 100.0  # sizes of the motion: orbits further out are none of this motion


def orbits_within_motions(
    batch: LaneBatch, lanes: LaneRunner, settled: SettledOrbits, motions: TurningMotions, limit: int
) -> list[SeedOrbit]:
    """Orbits up to a period, stable or not, near what some of the lanes do that have settled on none.

    Args:
        batch: lanes along the first axis.
        lanes: runs lanes.
        settled: orbits of lanes.
        motions: of all lanes after the transient.
        limit: largest period.
    """
    unsettled = np.flatnonzero(settled.period == 0)
    if not len(unsettled):
        return []
    places = spread_indices(len(unsettled), _LANES)
    sample = batch.take(unsettled[places])
    u, values = motions.u[unsettled[places]], sample.first_axis.values
    size, wrap = motion_unit([batch], lanes, settled.period, settled.size, {}), batch.chart.wrap
    starts = points_from(sample, lanes, first_points(sample, lanes), limit)
    period, seeds = period_map(batch, lanes, batch.strobe()), list[SeedOrbit]()
    for n in range(1, limit + 1):
        guesses = np.concatenate([_means(u, n, np.array(batch.chart.angles)), starts[:, :n]])
        lane = np.tile(np.arange(sample.count), 2)
        known = np.isfinite(guesses).all(axis=(1, 2))
        guesses, lane = guesses[known], lane[known]
        orbit = orbits_from_afar(period, guesses, values[lane], size, wrap)
        with np.errstate(invalid="ignore"):
            near = np.max(np.abs(orbit.points) / size, axis=(1, 2)) < _FARTHEST
        good = orbit.converged & near
        good[good] = primitive_period(orbit.points[good], size, wrap) == n
        if n == 1 and good.any():
            good[good] = ~at_rest(sample.take(lane[good]), lanes, orbit.points[good][:, 0])
        seeds += [SeedOrbit(orbit.points[k], float(values[lane[k]])) for k in np.flatnonzero(good)]
    return seeds


def _means(
    u: Float[np.ndarray, "lanes points d"], n: int, angles: Bool[np.ndarray, " d"]
) -> Float[np.ndarray, "lanes n d"]:
    """Means of every n-th point of motions, from each of the first n on; of angles on the circle."""
    with np.errstate(invalid="ignore", over="ignore"):
        parts = np.stack([u[:, k::n].mean(axis=1) for k in range(n)], axis=1)
        waves = np.stack([np.exp(1j * u[:, k::n]).mean(axis=1) for k in range(n)], axis=1)
    return np.where(angles, np.angle(waves), parts)
