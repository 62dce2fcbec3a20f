"""Orbits that branches are begun with: those that lanes have settled on, and what Newton finds from random starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.periodic.close_returns import WINDOW, nearest_returns, stretches
from jaxnh.analyses.periodic.location import period_map
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.random_starts import Box, random_start_batch
from jaxnh.analyses.section_points import at_rest, points_after, points_from, points_of_starts
from jaxnh.maps.iterate import section_map
from jaxnh.orbits.recognition import equal_cycles, primitive_period
from jaxnh.orbits.shooting import orbits_from_afar
from jaxnh.systems.rows import spread_indices

_FIRST_WAVE = 8  # lanes; every later wave has twice as many, half as far apart
_WINDOWS = 4  # of a motion
_FARTHEST = 100.0  # sizes of the motion: orbits further out are none of this motion


def attractor_waves(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], period: Int[np.ndarray, " lanes"]
) -> list[list[SeedOrbit]]:
    """Orbits of the lanes that have one, in waves: evenly over the axis, then those between them, and so on."""
    order = np.argsort(batch.first_axis.values, kind="stable")
    orbits = _whole(batch, lanes, u, period)
    return [[orbits[k] for k in order[part] if k in orbits] for part in _waves(len(order))]


def random_wave(
    batch: LaneBatch,
    lanes: LaneRunner,
    starts: int,
    seed: int,
    box: Box,
    limit: int,
    size: Float[np.ndarray, " d"],
    transient: int,
) -> list[SeedOrbit]:
    """Orbits of all periods up to a limit, stable or not, that Newton finds near motions from random starts.

    Orbits are sought at the starts, and where a motion, or the same after a transient, nearly comes back, by multiple
    shooting.
    """
    many, _ = random_start_batch(batch, starts, seed, box)
    many = replace(many, axis=replace(batch.first_axis, values=np.repeat(batch.first_axis.values, starts)))
    wrap, values, count = batch.chart.wrap, many.first_axis.values, _WINDOWS * WINDOW + limit
    first, period = points_of_starts(many, lanes), period_map(many, lanes, many.strobe())
    begun = points_from(many.take(np.arange(len(first)) % many.count), lanes, first, limit)
    path = np.concatenate([points_after(many, lanes, first[: many.count], wait, count) for wait in (0, transient)])
    seeds = list[SeedOrbit]()
    for n in range(1, limit + 1):
        # Starts are random, and lead from all sides to what repels as well: motions have left it after a few returns.
        parts = (begun, np.zeros((len(begun), 1), int)), (path, nearest_returns(path, n, _WINDOWS, size, wrap))
        points, lane = map(np.concatenate, zip(*(stretches(each, n, places) for each, places in parts), strict=True))
        lane %= many.count
        orbit = orbits_from_afar(period, points, values[lane], size, wrap)
        near = np.max(np.abs(orbit.points) / size, axis=(1, 2)) < _FARTHEST
        good = orbit.converged & near & (primitive_period(orbit.points, size, wrap) == n)
        if n == 1:
            good &= ~at_rest(many.take(lane), lanes, orbit.points[:, 0])
        for value in np.unique(values[lane[good]]).tolist():
            here = good & (values[lane] == value)
            candidates, begun_at = orbit.points[here], lane[here]
            label = equal_cycles(np.zeros(len(candidates), int), candidates, size, wrap)
            for k in np.unique(label).tolist():
                seeds.append(SeedOrbit(candidates[k], value, tuple(np.unique(begun_at[label == k]).tolist())))
    return seeds


def _whole(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], period: Int[np.ndarray, " lanes"]
) -> Mapping[int, SeedOrbit]:
    """All points of the orbits of lanes from one of them, by number of the lane; without a period there is none."""
    points, strobe = [u], batch.strobe()
    for _ in range(1, int(period.max(initial=0))):
        arguments = (points[-1], dict(batch.p))
        points.append(lanes(section_map, (strobe, np.int32(1)), arguments, tile=ORBIT_TILE))
    path, values = np.stack(points, axis=1), batch.first_axis.values
    return {
        k: SeedOrbit(path[k, :n], float(values[k]))
        for k, n in enumerate(period.tolist())
        if n and np.isfinite(path[k]).all()
    }


def _waves(count: int) -> Sequence[Int[np.ndarray, " some"]]:
    """Numbers below a count in waves: evenly spread, then those half way between, until there are no more."""
    waves, seen, size = list[np.ndarray](), np.zeros(count, bool), min(count, _FIRST_WAVE)
    while not seen.all():
        part = spread_indices(count, size)
        waves.append(part[~seen[part]])
        seen[part] = True
        size = min(2 * size - 1, count) if size > 1 else count
    return waves
