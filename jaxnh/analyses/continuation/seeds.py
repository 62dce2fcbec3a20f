"""Orbits that branches are begun with: those that lanes have settled on, and what Newton finds from random starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.periodic.attractor_survey import first_points
from jaxnh.analyses.periodic.location import period_map
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.random_starts import Box, random_start_batch
from jaxnh.analyses.section_points import points_after
from jaxnh.maps.iterate import section_map
from jaxnh.orbits.shooting import orbits_from_afar
from jaxnh.systems.chart import Wrap

_FIRST_WAVE = 8  # lanes; every later wave has twice as many, half as far apart
_WINDOWS, _WINDOW = 4, 16  # of a motion: the nearest return in each of so many stretches of so many strobes
_SAME = 1e-6  # sizes of the motion: orbits this near are one
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

    Orbits are sought where a motion, or the same after a transient, nearly comes back (Auerbach et al., Phys. Rev.
    Lett. 58 (1987) 2387), by multiple shooting: a motion that passes an unstable orbit is near all of its points.
    """
    many, _ = random_start_batch(batch, starts, seed, box)
    many = replace(many, axis=replace(batch.first_axis, values=np.repeat(batch.first_axis.values, starts)))
    strobe, wrap, values = many.strobe(), batch.chart.wrap, np.tile(many.first_axis.values, 2)
    count, u = _WINDOWS * _WINDOW + limit, first_points(many, lanes)
    paths = [points_after(many, lanes, u, wait, count) for wait in (0, transient)]
    path, period = np.concatenate(paths), period_map(many, lanes, strobe)
    seeds = list[SeedOrbit]()
    for n in range(1, limit + 1):
        points, lane = _returns(path, n, wrap, size)
        orbit = orbits_from_afar(period, points, values[lane], size, wrap)
        near = np.max(np.abs(orbit.points) / size, axis=(1, 2)) < _FARTHEST
        good = orbit.converged & near & _is_least(orbit.points, wrap, size)
        for value in np.unique(values[lane[good]]).tolist():
            here = orbit.points[good & (values[lane] == value)]
            while len(here):  # the first, and all others but those that are it
                seeds.append(SeedOrbit(here[0], value))
                turns = [np.roll(here[0], m, 0) for m in range(n)]
                away = [np.max(np.abs(wrap(here - turn)) / size, axis=(1, 2)) > _SAME for turn in turns]
                here = here[np.all(away, axis=0)]
    return seeds


def _returns(
    path: Float[np.ndarray, "lanes points d"], n: int, wrap: Wrap, size: Float[np.ndarray, " d"]
) -> tuple[Float[np.ndarray, "some n d"], Int[np.ndarray, " some"]]:
    """The first n points of paths, and of every window those after which it comes nearest to where it was.

    With the number of the path. The first are random, and lead to what repels from all sides as well.
    """
    lanes, count = len(path), _WINDOWS * _WINDOW
    gap = np.max(np.abs(wrap(path[:, n : n + count] - path[:, :count])) / size, axis=2)
    gap = np.where(np.isfinite(gap), gap, np.inf).reshape(lanes, _WINDOWS, _WINDOW)
    nearest = np.argmin(gap, axis=2) + _WINDOW * np.arange(_WINDOWS)
    first = np.concatenate([np.zeros((lanes, 1), int), nearest], axis=1).ravel()
    lane = np.repeat(np.arange(lanes), _WINDOWS + 1)
    points = path[lane[:, None], first[:, None] + np.arange(n)]
    known = np.isfinite(points).all(axis=(1, 2))
    return points[known], lane[known]


def _is_least(
    points: Float[np.ndarray, "some n d"], wrap: Wrap, size: Float[np.ndarray, " d"]
) -> Bool[np.ndarray, " some"]:
    """Return whether orbits have no period shorter than their number of points."""
    least, n = np.ones(len(points), bool), points.shape[1]
    for m in (m for m in range(1, n) if n % m == 0):
        least &= np.max(np.abs(wrap(points - np.roll(points, m, 1))) / size, axis=(1, 2)) > _SAME
    return least


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
        part = np.unique(np.linspace(0, count - 1, size).round().astype(int))
        waves.append(part[~seen[part]])
        seen[part] = True
        size = min(2 * size - 1, count) if size > 1 else count
    return waves
