"""Manifolds of dimension two of saddle cycles: motions from the curves of the return map on, for one return each.

The manifold of the cycle is all that its branches on the section pass until they come to it again: a motion from every
point of a branch, up to the next point of the section, is each part of it once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.manifolds.branches import BranchSet
from jaxnh.analyses.manifolds.curves import LENGTH as WHOLE
from jaxnh.analyses.manifolds.curves import Curves, ManifoldBranch, positions, tangents
from jaxnh.analyses.manifolds.motions import ROUNDING, Front
from jaxnh.analyses.manifolds.surfaces import (
    LENGTH,
    MAX_POINTS,
    Fan,
    Growth,
    SurfaceMesh,
    fitting,
    follow,
    grow_fans,
)
from jaxnh.analyses.section_points import states_at
from jaxnh.maps.iterate import return_time
from jaxnh.systems.chart import general_directions
from jaxnh.systems.rows import concatenate, select

_TRIED, _SAMPLE = 64, 8  # parts, and motions of a rim, by which it is seen how many parts are needed
_LEAST = 8  # parts of a return


@dataclass(frozen=True)
class BranchRim:
    """A branch on the section as a rim, whose places are values of x; that of the cycle itself is −∞.

    Attributes:
        batch, lanes: of the section's map.
        curves: as twice the steps that the accuracy asks for have them.
        number: of the branch.
        branch: its points.
        deviation: of the branch, in sizes.
        size: of all coordinates of the flow, (d,).
        spacing: largest distance of neighbours, in sizes.
        parts: of a return.
    """

    batch: LaneBatch
    lanes: LaneRunner
    curves: Curves
    number: int
    branch: ManifoldBranch
    deviation: float
    size: Float[np.ndarray, " d"]
    spacing: float
    parts: int

    @property
    def closed(self) -> bool:
        """Return that it is not."""
        return False

    @property
    def first(self) -> Float[np.ndarray, "motions 1"]:
        """Return points of the branch about half a spacing apart, the cycle's first: next to it there are many more.

        They end a turn of the cycle before the branch, so that motions come to all of it and to no more.
        """
        within = self.branch.x <= max(self.branch.x[-1] - 1.0, self.branch.x[1])
        steps = np.floor(2.0 * self.branch.arc[within] / self.spacing)
        kept = np.concatenate([[True], np.diff(steps) > 0.0])
        kept[-1] = True
        return self.branch.x[within][kept][:, None]

    @property
    def inner(self) -> int:
        """Return that there is no corner but those of motions."""
        return 0

    def between(self, first: np.ndarray, second: np.ndarray) -> Float[np.ndarray, "pairs 1"]:
        """Return places between two; next to the cycle a turn of it nearer."""
        return np.where(np.isfinite(first), 0.5 * (first + second), second - 1.0)

    def begin(self, places: Float[np.ndarray, "motions 1"]) -> Front:
        """Return the motions that begin at places."""
        x, curves, which = places[:, 0], self.curves, np.full(len(places), self.number)
        u = np.repeat(curves.points[[self.number]], len(x), axis=0)
        way = np.repeat(curves.directions[[self.number]], len(x), axis=0)
        far = np.flatnonzero(np.isfinite(x))
        if len(far):
            u[far], way[far] = tangents(self.lanes, curves, which[far], x[far])
            u[far] = positions(self.lanes, curves, which[far], x[far])
        duration = np.abs(self.lanes(return_time, (curves.strobe,), (u, select(dict(curves.p), which))))
        points = whole_points(self.batch, self.lanes, u) / self.size
        zero = whole_points(self.batch, self.lanes, np.zeros_like(way)) / self.size
        tangent = whole_points(self.batch, self.lanes, way) / self.size - zero  # the chart of a section is linear
        normal = np.repeat(np.array(general_directions(points.shape[1], 1)), len(x), axis=0)
        rounding = self.deviation + ROUNDING * (1.0 + np.linalg.norm(points, axis=1))
        followed = np.isfinite(duration) & (duration > 0.0)
        part = np.where(followed, duration, 1.0) / self.parts
        return Front(points, tangent, np.zeros_like(points), normal, rounding, part, followed)

    def arc(self, places: Float[np.ndarray, "motions 1"]) -> Float[np.ndarray, " motions"]:
        """Return arc lengths of places along the branch."""
        x = places[:, 0]
        arc = np.interp(x, self.branch.x[1:], self.branch.arc[1:])
        return np.where(np.isfinite(x), arc, 0.0)


def whole_points(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "points e"]
) -> Float[np.ndarray, "points d"]:
    """Return all coordinates of points of a section."""
    return batch.flow.chart.host_points(states_at(batch, lanes, u).state)


def grow_surfaces_of_cycles(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: Growth,
    grown: BranchSet,
    lane: Int[np.ndarray, " saddles"],
) -> list[SurfaceMesh | None]:
    """Return the surfaces that the branches of each saddle lead to; None where there are no branches.

    Args:
        batch, lanes: of the section's map.
        growth: of surfaces, with sizes and parameters of each lane of the batch.
        grown: the branches, as many of each saddle.
        lane: numbers of the lanes of saddles.
    """
    each, rims, of_saddle = len(grown.branches) // max(len(lane), 1), list[BranchRim](), list[int]()
    for b, branch in enumerate(grown.branches):
        if branch is not None and np.isfinite(grown.deviation[b]):
            size, deviation = growth.size[lane[b // each]], float(grown.deviation[b])
            rims.append(BranchRim(batch, lanes, grown.curves[1], b, branch, deviation, size, growth.spacing, _TRIED))
            of_saddle.append(b // each)
    own = lane[np.array(of_saddle, int)]
    growth = growth.take(own)._replace(most=growth.most // max(each, 1))
    rims = [replace(rim, parts=parts) for rim, parts in zip(rims, _parts(lanes, growth, rims), strict=True)]
    fans = grow_fans(lanes, growth, rims)
    surfaces = [fitting(_surface(rim, fan), growth.most) for rim, fan in zip(rims, fans, strict=True)]
    return [
        _joined([surface for surface, s in zip(surfaces, of_saddle, strict=True) if s == k]) for k in range(len(lane))
    ]


def _parts(lanes: LaneRunner, growth: Growth, rims: Sequence[BranchRim]) -> list[int]:
    """Return how many parts a return from each rim needs, for all of some motions to be no longer than the spacing."""
    few = [rim.first[:: max(1, len(rim.first) // _SAMPLE)] for rim in rims]
    which = np.repeat(np.arange(len(rims)), [len(places) for places in few])
    if not len(which):
        return []
    front = concatenate(rim.begin(places) for rim, places in zip(rims, few, strict=True))
    points, _ = follow(lanes, growth, 1, which, front, _TRIED)
    longest = np.linalg.norm(np.diff(points, axis=1), axis=2)
    longest = np.max(longest, axis=1, where=np.isfinite(longest), initial=0.0)
    return [max(_LEAST, math.ceil(_TRIED * longest[which == k].max() / growth.spacing)) for k in range(len(rims))]


def _surface(rim: BranchRim, fan: Fan) -> SurfaceMesh:
    """Return the corners and triangles of one branch."""
    counted = fan.counted
    numbers = np.where(counted, np.cumsum(counted).reshape(counted.shape) - 1, -1)
    points, error = fan.points[:, : fan.parts + 1][counted], fan.error[:, : fan.parts + 1][counted]
    arc = np.repeat(rim.arc(fan.places), counted.sum(axis=1))
    end = MAX_POINTS if fan.end == MAX_POINTS or rim.branch.end != WHOLE else LENGTH
    return SurfaceMesh(points, error, arc, np.array(fan.bands(numbers), int).reshape(-1, 3), end, fan.gaps)


def _joined(parts: Sequence[SurfaceMesh]) -> SurfaceMesh | None:
    """Return the branches of a saddle as one surface."""
    if not parts:
        return None
    first = np.cumsum([0, *(len(part.points) for part in parts)])
    triangles = [part.triangles + start for part, start in zip(parts, first, strict=False)]
    points, error, arc = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("points", "error", "arc")
    )
    end, gaps = max(part.end for part in parts), sum(part.gaps for part in parts)
    return SurfaceMesh(points, error, arc, np.concatenate(triangles), end, gaps)
