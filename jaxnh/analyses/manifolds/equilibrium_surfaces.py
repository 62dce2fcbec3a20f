"""Manifolds of dimension two of equilibria: the local one as rings of corners, and motions from its boundary on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.equilibria.search import equilibria_from_starts, field_and_slopes
from jaxnh.analyses.manifolds.local_surfaces import FieldValues, LocalSurface, fit_local_surface
from jaxnh.analyses.manifolds.motions import ROUNDING, Front
from jaxnh.analyses.manifolds.surfaces import Fan, Growth, SurfaceMesh, fitting, grow_fans, strip
from jaxnh.analyses.random_starts import Box, random_start_batch

_LEAST = 16  # motions
_SAME = 1e-6  # sizes: equilibria nearer to each other are one


class SaddleEquilibria(NamedTuple):
    """Equilibria of lanes.

    Attributes:
        lane: number of the lane of each, (equilibria,).
        points: (equilibria, d).
    """

    lane: Int[np.ndarray, " equilibria"]
    points: Float[np.ndarray, "equilibria d"]


class Disc(NamedTuple):
    """The boundary of a local manifold as a rim, whose places are points of the unit circle.

    Attributes:
        local: the manifold.
        length, spacing: arc length of motions, and of their parts, in sizes.
    """

    local: LocalSurface
    length: float
    spacing: float

    @property
    def closed(self) -> bool:
        """Return that it is."""
        return True

    @property
    def parts(self) -> int:
        """Return the parts of a motion."""
        return max(1, math.ceil(self.length / self.spacing))

    @property
    def rings(self) -> int:
        """Return the rings of corners, the rim among them."""
        return max(1, math.ceil(self._radius / self.spacing))

    @property
    def first(self) -> Float[np.ndarray, "motions 2"]:
        """Return places about as far apart as may be, those on the axes among them."""
        quarter = max(_LEAST // 4, math.ceil(0.5 * np.pi * self._radius / self.spacing))
        angle = 0.5 * np.pi * np.arange(quarter) / quarter
        turns = [np.stack([np.cos(angle), np.sin(angle)], axis=1)]
        for _ in range(3):
            turns.append(np.stack([-turns[-1][:, 1], turns[-1][:, 0]], axis=1))
        return np.concatenate(turns)

    @property
    def inner(self) -> int:
        """Return the number of corners within the rim."""
        return len(self.disc)

    @property
    def disc(self) -> Float[np.ndarray, "inner 2"]:
        """Return the places of the corners within the rim."""
        shares = np.arange(1, self.rings) / self.rings
        return np.concatenate([np.zeros((1, 2)), *(share * self.first for share in shares)])

    @property
    def _radius(self) -> float:
        return float(np.linalg.norm(self.local.plane, axis=0).max())

    def between(self, first: np.ndarray, second: np.ndarray) -> Float[np.ndarray, "pairs 2"]:
        """Return the middles of arcs: next to an axis they keep all digits of the distance from it."""
        middle = first + second
        return middle / np.linalg.norm(middle, axis=1, keepdims=True)

    def begin(self, places: Float[np.ndarray, "motions 2"]) -> Front:
        """Return the motions that begin at places."""
        points, count = self.local.points(places), len(places)
        normal = np.repeat(self.local.across.sum(axis=1)[None], count, axis=0)
        rounding, part = _rounding(points), np.full(count, self.spacing)
        error, followed = self.local.errors(places), np.ones(count, bool)
        return Front(points, self.local.tangents(places), error, normal, rounding, part, followed)

    def surface(self, fan: Fan) -> SurfaceMesh:
        """Return the corners within the rim and those of motions, with all triangles."""
        counted, local, disc = fan.counted, self.local, self.disc
        numbers = np.where(counted, len(disc) + np.cumsum(counted).reshape(counted.shape) - 1, -1)
        flat, cut = local.points(disc), fan.parts + 1
        radius = np.linalg.norm(fan.points[:, 0] - local.centre, axis=1)
        arc = (radius[:, None] + self.spacing * np.arange(cut))[counted]
        points = np.concatenate([flat, fan.points[:, :cut][counted]])
        local_error = np.linalg.norm(local.errors(disc), axis=1) + _rounding(flat)
        error = np.concatenate([local_error, fan.error[:, :cut][counted]])
        arc = np.concatenate([np.linalg.norm(flat - local.centre, axis=1), arc])
        triangles = np.array(self._disc_triangles(fan, numbers) + fan.bands(numbers), int)
        return SurfaceMesh(points, error, arc, triangles, fan.end, fan.gaps)

    def _disc_triangles(self, fan: Fan, numbers: Int[np.ndarray, "motions parts+1"]) -> list[tuple[int, int, int]]:
        """Return the triangles within the rim, from ring to ring."""
        first, triangles = self.first, list[tuple[int, int, int]]()
        n, ring = len(first), [0] * len(first)
        for k in range(self.rings - 1):
            after = list(range(1 + k * n, 1 + (k + 1) * n))
            for i in range(n):
                triangles += strip(ring[i], ring[i - n + 1], [after[i], after[i - n + 1]])
            ring = after
        inner = np.flatnonzero(fan.born == 0)
        outer = numbers[inner, 0].tolist()
        known = {place.tobytes(): k for k, place in enumerate(fan.places[inner])}
        at = [*(known[place.tobytes()] for place in first), len(outer)]
        for i in range(n):
            chain = [outer[k % len(outer)] for k in range(at[i], at[i + 1] + 1)]
            triangles += strip(ring[i], ring[i - n + 1], chain)
        return triangles


def _rounding(points: Float[np.ndarray, "points d"]) -> Float[np.ndarray, " points"]:
    return ROUNDING * (1.0 + np.linalg.norm(points, axis=1))


def find_saddles(
    batch: LaneBatch, lanes: LaneRunner, starts: int, seed: int, box: Box, size: Float[np.ndarray, "lanes d"]
) -> SaddleEquilibria:
    """Return all equilibria that Newton finds from the middle of a box and from random starts in it.

    Those nearest to the middle, in sizes, come first.
    """
    at_middle = {name: (0.5 * (low + high), 0.5 * (low + high)) for name, (low, high) in box.items()}
    chart = batch.chart
    middle = chart.host_points(random_start_batch(batch, 1, seed, at_middle)[0].start)
    many, _ = random_start_batch(batch, starts, seed, box)
    first = chart.host_points(many.start).reshape(batch.count, starts, -1)
    starts_of_lanes = np.concatenate([middle[:, None], first], axis=1)
    lane = np.repeat(np.arange(batch.count), starts + 1)
    every = batch.take(lane)
    zeros = equilibria_from_starts(every, lanes, starts_of_lanes.reshape(len(lane), -1), size[lane])
    away = np.max(np.abs(chart.wrap(zeros.u - middle[lane])) / size[lane], axis=1)
    kept = list[int]()
    for i in np.lexsort((zeros.u[:, 0], np.round(away, 6), lane)).tolist():
        of_lane = [k for k in kept if lane[k] == lane[i]] if zeros.exists[i] else []
        apart = np.abs(chart.wrap(zeros.u[i] - zeros.u[of_lane])) / size[lane[i]]
        if zeros.exists[i] and np.all(apart.max(axis=1, initial=0.0) > _SAME):
            kept.append(i)
    return SaddleEquilibria(lane[kept], zeros.u[kept])


def local_surfaces(
    batch: LaneBatch,
    lanes: LaneRunner,
    equilibria: SaddleEquilibria,
    size: Float[np.ndarray, "lanes d"],
    sign: float,
    tolerance: float,
) -> list[LocalSurface | None]:
    """Return the manifold near each equilibrium, None where it has not two dimensions."""
    local = list[LocalSurface | None]()
    for lane, point in zip(equilibria.lane.tolist(), equilibria.points, strict=True):
        scale = size[lane]

        def field(z: Float[np.ndarray, "points d"], lane: int = lane, scale: np.ndarray = scale) -> FieldValues:
            p = batch.parameters_of(np.full(len(z), lane))
            rate, slopes = field_and_slopes(batch.flow, lanes, z * scale, p)
            return sign * rate / scale, sign * slopes * scale[None, None, :] / scale[None, :, None]

        centre = point / scale
        local.append(fit_local_surface(field, centre, field(centre[None])[1][0], tolerance))
    return local


def grow_surfaces_of_equilibria(
    lanes: LaneRunner, growth: Growth, local: Sequence[LocalSurface], length: float
) -> list[SurfaceMesh]:
    """Return the surfaces that local ones are part of, up to an arc length of motions."""
    discs = [Disc(each, length, growth.spacing) for each in local]
    fans = grow_fans(lanes, growth, discs)
    return [fitting(disc.surface(fan), growth.most) for disc, fan in zip(discs, fans, strict=True)]
