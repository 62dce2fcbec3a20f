"""Tangencies of stable and unstable manifolds along a parameter, by Newton on both curves and the parameter.

Unknown are the places on both curves and the parameter. Both points are one and both tangents are parallel: the fold of
a crossing. What an error does along a curve moves the place and leaves the parameter as it is.

The parameter is measured in what moves the manifolds by a size at a meeting. Its own modulus says nothing of that: an
offset changes no manifold, and a parameter near zero moves them as much as any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.manifolds.branches import BranchSet, Side
from jaxnh.analyses.manifolds.crossings import Meetings, cross_product, distinct_orbits, joined
from jaxnh.analyses.manifolds.curves import Curves, ManifoldBranch, curves_of, tangents
from jaxnh.analyses.manifolds.saddles import Saddles, find_germs
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

KEPT = 4
"""Tangencies of a lane that are kept, the nearest ones."""

_CANDIDATES = 12  # of a lane
_FARTHEST = 0.4  # sizes: curves whose tangents are parallel so near may be tangent at a parameter near by
_ALIKE = 0.05  # of x, of places that are images of one another
_TRIVIAL = 0.05  # sizes: of both curves, where they begin
_PROBE = 1e-6  # of x, and in sizes: what probes of the parameter move points by
_DIGITS = 64.0  # spacings of the parameter's numbers: probes are no smaller, as these are what they move it by
_ALMOST = 10.0  # times: what moves points by as much more or less than a probe would is one as well
_FACTOR = 1e4  # from a probe to a better one at most: by what is rounding, or bent, it says the direction alone
_TRIES = 16  # of probes
_LARGEST_STEP = 0.05  # of x, and of the parameter in its units
_PLACE_STEPS = 8
_STEPS = 24
_NEAR = 1e-4  # of x, and of the parameter in its units: a step below it is one of Newton near the solution
_AT_REST = 1e-9  # of the parameter, in its units
_ZERO = 1e-7  # sizes, across
_ROUNDING = 1e-11  # sizes, across
_SAME = 1e-10  # of the parameter, in its units: values of one tangency, beyond their errors


class Tangencies(NamedTuple):
    """Tangencies of lanes.

    Attributes:
        meetings: the branches, and where on them; `arc` as of the candidates.
        value: of the parameter, (tangencies,), not a number where Newton does not come to rest.
        error: of it, (tangencies,).
        unit: of the parameter: what moves the manifolds by a size, (tangencies,).
    """

    meetings: Meetings
    value: Float[np.ndarray, " tangencies"]
    error: Float[np.ndarray, " tangencies"]
    unit: Float[np.ndarray, " tangencies"]

    def of(self, which: Int[np.ndarray, " some"]) -> Tangencies:
        """Return some of them."""
        return Tangencies(select(self.meetings, which), self.value[which], self.error[which], self.unit[which])


def near_tangencies(
    unstable: Sequence[tuple[int, ManifoldBranch]],
    stable: Sequence[tuple[int, ManifoldBranch]],
    size: Float[np.ndarray, " 2"],
    wrap: Wrap,
    curves: tuple[Curves, Curves],
) -> Meetings:
    """Return where tangents of two branches near each other are parallel, the nearest first, one of each orbit."""
    from scipy.spatial import KDTree  # here, as it takes a tenth of a second to import

    parts = list[Meetings]()
    for number, curve in unstable:
        for other_number, other in stable:
            if min(len(curve.x), len(other.x)) < 4:
                continue
            middle, way = _segments(curve, size, wrap)
            other_middle, other_way = _segments(other, size, wrap)
            distance, near = KDTree(other_middle).query(middle, distance_upper_bound=_FARTHEST)
            near = np.minimum(near, len(other_middle) - 1)
            sine = cross_product(way, other_way[near])
            gap = np.abs(cross_product(other_middle[near] - middle, other_way[near]))
            arcs = curve.arc[1:-1], other.arc[1:-1][near]
            kept = (sine[1:] * sine[:-1] <= 0.0) & np.isfinite(distance[1:]) & np.isfinite(distance[:-1])
            kept &= np.maximum(arcs[0][1:], arcs[1][1:]) > _TRIVIAL
            at = np.flatnonzero(kept) + 1
            share = sine[at - 1] / (sine[at - 1] - sine[at])
            centre = 0.5 * (curve.x[1:-1] + curve.x[2:])
            own = centre[at - 1] + share * (centre[at] - centre[at - 1])
            x = np.stack([own, _foot(other, near[at], middle[at], size)], axis=1)
            parts.append(Meetings(np.full(len(at), number), np.full(len(at), other_number), x, gap[at]))
    every = joined(parts)
    every = select(every, np.argsort(every.arc, kind="stable")[: 16 * _CANDIDATES])
    return select(every, distinct_orbits(every, curves, _ALIKE)[:_CANDIDATES])


class _Ends(NamedTuple):
    """Points of unstable and of stable branches, and where they begin.

    Attributes:
        points: (2, some, 2).
        ways: derivatives in x, in sizes, (2, some, 2).
        saddles: points of the orbits, (2, some, 2).
        size: (some, 2).
    """

    points: Float[np.ndarray, "2 some 2"]
    ways: Float[np.ndarray, "2 some 2"]
    saddles: Float[np.ndarray, "2 some 2"]
    size: Float[np.ndarray, "some 2"]


class _NewtonStep(NamedTuple):
    """A step of Newton at some places and parameters.

    Attributes:
        gap: across, before it, in sizes.
        place: what it moves x by, the more of both.
        value: what it moves the parameter by.
        rounding: what that of the gap across moves the parameter by.
    """

    gap: Float[np.ndarray, " some"]
    place: Float[np.ndarray, " some"]
    value: Float[np.ndarray, " some"]
    rounding: Float[np.ndarray, " some"]


class _System(NamedTuple):
    """The equations of tangencies near some parameters.

    Attributes:
        batch, lanes, sides, saddles, size: as of `locate_tangencies`.
        name: of the parameter.
        which: numbers of the maps, 0 or 1 for twice the steps.
        meetings: the branches.
        directions: that their germs have at the parameters of their lanes.
        probe: of the parameter, for differences, (meetings,).
        unit: of the parameter, (meetings,).
    """

    batch: LaneBatch
    lanes: LaneRunner
    sides: tuple[Side, Side]
    saddles: Saddles
    size: Float[np.ndarray, "lanes d"]
    name: str
    which: int
    meetings: Meetings
    directions: tuple[np.ndarray, np.ndarray]
    probe: Float[np.ndarray, " meetings"]
    unit: Float[np.ndarray, " meetings"]

    def of(self, which: Int[np.ndarray, " some"]) -> _System:
        """Return the system of some of its meetings."""
        return self._replace(meetings=select(self.meetings, which), probe=self.probe[which], unit=self.unit[which])

    def ends(self, number: Int[np.ndarray, " some"], z: Float[np.ndarray, "some 3"]) -> _Ends:
        """Return the points at places and parameters, not numbers where there are none."""
        at, lane = [], self.saddles.lane[self.meetings.unstable[number] // (2 * self.saddles.points.shape[1])]
        size = self.size[lane]
        for k, branches in enumerate((self.meetings.unstable, self.meetings.stable)):
            side, n = self.sides[k], self.saddles.points.shape[1]
            branch, strobe = branches[number], side.maps[self.which]
            saddle, point = branch // (2 * n), branch // 2 % n
            p = {**self.batch.parameters_of(lane), self.name: z[:, 2]}
            germs = find_germs(self.batch, self.lanes, strobe, p, self.saddles.points[saddle], size, side.backward)
            row = np.arange(len(number)) * n + point
            germs = select(germs, row)
            sign = np.sign(np.sum(germs.directions * self.directions[k][branch], axis=1))
            germs = germs._replace(directions=sign[:, None] * germs.directions)
            curves = curves_of(strobe, p, germs, n, size, again=bool(self.which))
            fine = np.isfinite(curves.multiplier) & np.isfinite(z).all(axis=1)
            points, ways = np.full((2, len(number), 2), np.nan)
            places = np.flatnonzero(fine)
            if len(places):
                points[fine], ways[fine] = tangents(self.lanes, curves, places, z[places, k])
            at.append((points, ways / size, germs.points))
        points, ways, begun = (np.stack(leaves) for leaves in zip(*at, strict=True))
        return _Ends(points, ways, begun, size)

    def residual(self, number: Int[np.ndarray, " some"], z: Float[np.ndarray, "some 3"]) -> Float[np.ndarray, "some 3"]:
        """Return the gap along the stable branch, the rate of that across, and the gap across, in sizes.

        The rate is that in x of the unstable branch. Where this is a parabola in x, however sharp, it is linear.
        """
        at = self.ends(number, z)
        gap = self.batch.chart.wrap(at.points[0] - at.points[1]) / at.size
        with np.errstate(divide="ignore", invalid="ignore"):
            way = at.ways[1] / np.linalg.norm(at.ways[1], axis=1, keepdims=True)
        return np.stack([np.sum(gap * way, axis=1), cross_product(at.ways[0], way), cross_product(gap, way)], axis=1)

    def measured(self, z: Float[np.ndarray, "some 3"]) -> _System:
        """Return the system with probes and units of the parameter at these places.

        A probe moves points by as much as differences need; it is looked for from a millionth of the parameter on. A
        unit is what it would take to move a saddle, or a manifold across itself, by a size.
        """
        number, ways = np.arange(len(z)), self.ends(np.arange(len(z)), z).ways
        largest = np.abs(z[:, 2])
        least = _DIGITS * np.spacing(largest)
        probe = np.maximum(_PROBE * np.where(largest == 0.0, 1.0, largest), least)
        unit, far = np.full(len(z), np.nan), np.ones(len(z), bool)
        for _ in range(_TRIES):
            shift = probe[:, None] * np.eye(3)[2]
            high, low = self.ends(number, z + shift), self.ends(number, z - shift)
            points, saddles = (
                self.batch.chart.wrap(end - begin) / (2.0 * high.size)
                for begin, end in ((low.points, high.points), (low.saddles, high.saddles))
            )
            with np.errstate(divide="ignore", invalid="ignore"):
                across = np.abs(cross_product(points, ways)) / np.linalg.norm(ways, axis=2)
                begun = np.linalg.norm(saddles, axis=2)
                unit = probe / np.maximum(across, begun).max(axis=0)
                factor = _PROBE / np.maximum(np.linalg.norm(points, axis=2), begun).max(axis=0)
            factor = np.clip(np.nan_to_num(factor, nan=0.0), 1.0 / _FACTOR, _FACTOR)
            better = np.maximum(probe * factor, least)
            far = np.maximum(better / probe, probe / better) > _ALMOST
            if not far.any():
                break
            probe = np.where(far, better, probe)
        return self._replace(probe=probe, unit=np.where(far, np.nan, unit))

    def solve(self, z: Float[np.ndarray, "some 3"]) -> tuple[Float[np.ndarray, "some 3"], Float[np.ndarray, "some 2"]]:
        """Return the solutions of Newton, not numbers where it does not come to rest, their errors and units.

        Places where tangents are parallel are solved for alone first, and after each step of the parameter.
        """
        z, error = z.copy(), np.full(len(z), np.inf)
        self.steps(z, 2, _PLACE_STEPS)
        system = self.measured(z)
        result, open_ = np.full_like(z, np.nan), np.arange(len(z))
        for _ in range(_STEPS):
            part, now = system.of(open_), z[open_]
            last = part.steps(now, 3, 1)
            spacing = np.spacing(np.abs(now[:, 2]))
            # Rounding moves places, and the gap along, by much more than what is across and decides the parameter.
            rest = (last.value < np.maximum(_AT_REST * part.unit, spacing)) & (last.gap < _ZERO) & (last.place < _NEAR)
            result[open_[rest]], error[open_[rest]] = now[rest], (last.value + last.rounding + spacing)[rest]
            left = ~rest & np.isfinite(now).all(axis=1)
            near = (last.value <= _NEAR * part.unit)[left].all()
            open_, now = open_[left], now[left]
            if not len(open_):
                break
            if not near:
                system.of(open_).steps(now, 2, 2)
            z[open_] = now
        return result, np.stack([error, system.unit], axis=1)

    def steps(self, z: Float[np.ndarray, "some 3"], free: int, count: int) -> _NewtonStep:
        """Make steps of Newton on the first unknowns, in place, not numbers where there is none; return the last."""
        last = _NewtonStep(*np.full((4, len(z)), np.nan))
        shifts = np.concatenate([np.zeros((1, 3)), np.eye(3)[:free], -np.eye(3)[:free]])
        one = np.ones(len(z))
        probes = np.stack([_PROBE * one, _PROBE * one, self.probe], axis=1)
        largest = _LARGEST_STEP * np.stack([one, one, self.unit], axis=1)
        for _ in range(count):
            every = z[None] + shifts[:, None] * probes[None]
            values = self.residual(np.tile(np.arange(len(z)), len(shifts)), every.reshape(-1, 3))
            values = values.reshape(len(shifts), len(z), 3)[:, :, :free]
            width = (every[1 : free + 1] - every[free + 1 :]).diagonal(axis1=0, axis2=2)  # of numbers as they are
            jacobian = np.moveaxis(values[1 : free + 1] - values[free + 1 :], 0, 2) / width[:, None]
            step = np.full((len(z), free), np.nan)
            fine = np.isfinite(values).all(axis=(0, 2)) & (np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 0.0)
            step[fine] = np.linalg.solve(jacobian[fine], values[0][fine][..., None])[..., 0]
            with np.errstate(invalid="ignore", divide="ignore"):
                share = np.minimum(1.0, np.min(largest[:, :free] / np.abs(step), axis=1))
                if free > 2:
                    rounding = _ROUNDING / np.abs(jacobian[:, 2, 2])
                    last = _NewtonStep(
                        np.abs(values[0, :, 2]), np.abs(step[:, :2]).max(axis=1), np.abs(step[:, 2]), rounding
                    )
            z[:, :free] -= share[:, None] * step
        return last


def locate_tangencies(
    batch: LaneBatch,
    lanes: LaneRunner,
    sides: tuple[Side, Side],
    saddles: Saddles,
    size: Float[np.ndarray, "lanes d"],
    grown: tuple[BranchSet, BranchSet],
    meetings: Meetings,
    name: str,
) -> Tangencies:
    """Return the tangencies that Newton finds from places where branches are nearly tangent.

    Args:
        sides: maps of unstable and of stable manifolds.
        grown: the branches.
        meetings: the places.
        name: of the parameter.
    """
    directions = grown[0].curves[0].directions, grown[1].curves[0].directions
    saddle = meetings.unstable // (2 * saddles.points.shape[1])
    values = np.asarray(batch.p[name], float)[saddles.lane[saddle]]
    start, solved = np.concatenate([meetings.x, values[:, None]], axis=1), list[np.ndarray]()
    more = np.full((len(start), 2), np.nan)
    for which in (0, 1):
        none = np.zeros(len(start))  # places alone move before it is measured
        system = _System(batch, lanes, sides, saddles, size, name, which, meetings, directions, none, none)
        known = np.flatnonzero(np.all(np.isfinite(start), axis=1))
        result = np.full_like(start, np.nan)
        if len(known):
            result[known], more[known] = system.of(known).solve(start[known])
        solved.append(result)
        start = result
    coarse, fine = solved
    error = np.abs(fine[:, 2] - coarse[:, 2]) + more[:, 0]
    return Tangencies(meetings._replace(x=fine[:, :2]), fine[:, 2], error, more[:, 1])


def nearest_tangencies(tangencies: Tangencies, value: float) -> Int[np.ndarray, " kept"]:
    """Return the numbers of those nearest to a value of the parameter, each once."""
    kept = list[int]()
    for i in np.argsort(np.abs(tangencies.value - value), kind="stable").tolist():
        same = _SAME * tangencies.unit[i] + tangencies.error[i] + tangencies.error
        if np.isfinite(tangencies.value[i]) and all(
            abs(tangencies.value[i] - tangencies.value[j]) > same[j] for j in kept
        ):
            kept.append(i)
    return np.array(kept[:KEPT], int)


def _foot(branch: ManifoldBranch, segment: np.ndarray, points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return x of the points of segments of a branch nearest to some points, in sizes."""
    begin, end = branch.points[1:-1][segment] / size, branch.points[2:][segment] / size
    way = end - begin
    share = np.clip(np.sum((points - begin) * way, axis=1) / np.sum(way * way, axis=1), 0.0, 1.0)
    return branch.x[1:-1][segment] + share * (branch.x[2:] - branch.x[1:-1])[segment]


def _segments(branch: ManifoldBranch, size: np.ndarray, wrap: Wrap) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles and the directions of the segments of a branch, but for the first, in sizes."""
    way = wrap(np.diff(branch.points[1:], axis=0)) / size
    middle = branch.points[1:-1] / size + 0.5 * way
    return middle, way / np.linalg.norm(way, axis=1, keepdims=True)
