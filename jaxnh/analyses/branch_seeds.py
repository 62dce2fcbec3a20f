"""Orbits that branches are begun with: those that lanes have settled on, and what Newton finds from random starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.family_tree import Orbit
from jaxnh.analyses.period import CONVERGED, ORBIT_TILE, first_points, least_period, orbits
from jaxnh.analyses.random_starts import Box, started
from jaxnh.analyses.scene import LaneRunner, Scene, picked
from jaxnh.maps.iterate import section_map

_FIRST_WAVE = 8  # lanes; every later wave has twice as many, half as far apart
_FARTHEST = 100.0  # sizes of the motion: orbits found further out are none of this motion


def settled_waves(
    scene: Scene, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], period: Int[np.ndarray, " lanes"]
) -> list[list[Orbit]]:
    """Orbits of the lanes that have one, in waves: evenly over the axis, then those between them, and so on."""
    order = np.argsort(scene.line.values, kind="stable")
    found = _whole(scene, lanes, u, period)
    return [[found[k] for k in order[part] if k in found] for part in _between(len(order))]


def random_wave(
    scene: Scene,
    lanes: LaneRunner,
    starts: int,
    seed: int,
    box: Box,
    limit: int,
    size: Float[np.ndarray, " d"],
) -> list[Orbit]:
    """Orbits of all periods up to a limit, stable or not, that Newton finds from random starts in lanes of a scene."""
    many, _ = started(scene, starts, seed, box)
    values = np.repeat(scene.line.values, starts)
    many = replace(many, along=replace(scene.line, values=values))
    u, p = first_points(many, lanes), dict(many.p)
    each = np.tile(size, (len(u), 1))
    found = list[Orbit]()
    for n in range(1, limit + 1):
        orbit = orbits(lanes, many.strobe(), u, p, n, each)
        near = np.max(np.abs(orbit.u) / size, axis=1) < _FARTHEST
        good = np.flatnonzero((orbit.residual < CONVERGED) & near)
        if not len(good):
            continue
        least = least_period(lanes, many.strobe(), orbit.u[good], picked(p, good), n, each[good])
        here = good[least == n]
        if len(here):
            some = many.take(here)
            found += _whole(some, lanes, orbit.u[here], np.full(len(here), n)).values()
    return found


def _whole(
    scene: Scene, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], period: Int[np.ndarray, " lanes"]
) -> Mapping[int, Orbit]:
    """All points of the orbits of lanes from one of them, by number of the lane; without a period there is none."""
    points, strobe = [u], scene.strobe()
    for _ in range(1, int(period.max(initial=0))):
        arguments = (points[-1], dict(scene.p))
        points.append(lanes(section_map, (strobe, np.int32(1)), arguments, tile=ORBIT_TILE))
    path, values = np.stack(points, axis=1), scene.line.values
    return {
        k: Orbit(path[k, :n], float(values[k]))
        for k, n in enumerate(period.tolist())
        if n and np.isfinite(path[k]).all()
    }


def _between(count: int) -> Sequence[Int[np.ndarray, " some"]]:
    """Numbers below a count in waves: evenly spread, then those half way between, until there are no more."""
    waves, seen, size = list[np.ndarray](), np.zeros(count, bool), min(count, _FIRST_WAVE)
    while not seen.all():
        part = np.unique(np.linspace(0, count - 1, size).round().astype(int))
        waves.append(part[~seen[part]])
        seen[part] = True
        size = min(2 * size - 1, count) if size > 1 else count
    return waves
