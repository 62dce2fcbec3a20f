"""Manifolds of saddle orbits of the return map of every lane: curves, their crossings and their tangencies.

Saddles are sought by Newton from random starts (`saddles`); branches grow from them as images of short segments
(`curves`), stable ones under the inverse of the map. In a plane they cross in homoclinic and heteroclinic points
(`crossings`), and along a parameter they come to do so in tangencies (`tangencies`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import Analysis, OptionError, Setting, Table, check_names
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.manifolds.branches import SIDES, BranchSet, Side, grow_branches, has_branches, side_of
from jaxnh.analyses.manifolds.crossings import (
    Crossings,
    Meetings,
    crossing_segments,
    distinct_orbits,
    joined,
    refine_crossings,
    take,
)
from jaxnh.analyses.manifolds.curves import ManifoldBranch
from jaxnh.analyses.manifolds.equilibrium_surfaces import find_saddles, grow_surfaces, local_surfaces
from jaxnh.analyses.manifolds.saddles import Saddles, find_germs, find_orbits, parameters_of, take_orbits
from jaxnh.analyses.manifolds.surface_tables import Surfaces, surface_table, surface_variables
from jaxnh.analyses.manifolds.surfaces import Growth, Surface
from jaxnh.analyses.manifolds.tables import KINDS, OWN_NAMES, Manifolds, table, variables
from jaxnh.analyses.manifolds.tangencies import Tangencies, locate_tangencies, near_tangencies, nearest_tangencies
from jaxnh.analyses.options.orbits import ManifoldsOptions
from jaxnh.analyses.periodic.flow_cycles import no_collocation
from jaxnh.analyses.periodic.location import price_of_orbits
from jaxnh.analyses.random_starts import check_box
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.maps.iterate import section_map
from jaxnh.systems.discrete_map import DiscreteMap

_UNDOES = 1e-5  # sizes: how far from it an inverse map may take a point back
_SHARE = 0.01  # of the accuracy, that the local part of a surface may leave
_LEAST, _MOST = 1e-11, 1e-6  # sizes: deviations of surfaces that steps are chosen by, where none is asked for
_REACHED = 0.1  # of a unit of time, for a size: how fast motions of surfaces are, for the expected work
_RETURNS = 24.0  # of a point of a branch, for the expected work


def periods(options: ManifoldsOptions, lanes: int) -> float:
    """Return the lane-periods of a run: a guess, as saddles and points are not known before."""
    if options.dimension == 2:
        return lanes * options.saddles * _REACHED * options.max_points * options.spacing
    points = options.saddles * options.period**2 * 4 * min(options.max_points, 2 * options.length / options.spacing)
    return lanes * (options.n_starts * options.period * 60.0 + 2 * _RETURNS * points)


def check(options: ManifoldsOptions, setting: Setting) -> None:
    """Check the box, names, and that there are curves to grow and a parameter to move, or surfaces."""
    flow = setting.flow
    if options.dimension == 2:
        _check_surfaces(setting)
    if flow.exponents - int(setting.autonomous) < 2:
        raise OptionError("manifolds are curves among other directions of the map, and it has one alone")
    if not options.box:
        raise OptionError("needs a box to draw the starts of Newton from", "box")
    check_names("manifolds", OWN_NAMES, setting)
    check_box(options.box, setting, "box")
    movable = [axis.name for axis in setting.axes if axis.kind == "lane"]
    if options.tangency is not None and options.tangency not in movable:
        known = f"these are {', '.join(movable)}" if movable else "there is none"
        raise OptionError(f"tangencies are along an axis that lanes may differ in; {known}", "tangency")


def run(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return saddles, branches, crossings and tangencies of all lanes, or surfaces."""
    if options.dimension == 2:
        return _run_surfaces(options, batch.without_section(), lanes)
    sides = _sides(options, batch)
    with lanes.stage(f"manifolds: saddles of {batch.count:,} lanes", 0):
        orbits, size = find_orbits(batch, lanes, options.period, options.n_starts, options.seed, options.box)
        p, scale = parameters_of(batch, orbits.lane), size[orbits.lane]
        kept = np.zeros(len(orbits.lane), bool)
        for side in sides.values():
            germs = find_germs(batch, lanes, side.maps[0], p, orbits.points, scale, side.backward)
            kept |= has_branches(germs, options.period)
        if 1 in sides:
            _check_inverse(batch, lanes, sides[1], orbits, size)
    saddles = take_orbits(orbits, kept, options.saddles)
    number = np.bincount(orbits.lane[kept], minlength=batch.count)
    with lanes.stage(f"manifolds: {len(saddles.lane):,} saddles", periods(options, batch.count)):
        grown = {
            kind: grow_branches(batch, lanes, side, saddles, size, options.length, options.spacing, options.max_points)
            for kind, side in sides.items()
        }
    crossings, tangencies = None, None
    if len(sides) == 2 and batch.chart.dimension == 2:
        both = grown[0], grown[1]
        if options.crossings:
            crossings = _crossings(options, batch, lanes, saddles, size, both)
        if options.tangency is not None:
            tangencies = _tangencies(options.tangency, batch, lanes, (sides[0], sides[1]), saddles, size, both)
    made = Manifolds(saddles, number, grown, crossings, tangencies)
    return xr.Dataset(variables(options, batch, lanes, made), attrs=section_attrs(batch))


def _check_surfaces(setting: Setting) -> None:
    """Check that the system is a smooth flow without a clock, with directions beside two."""
    flow = setting.flow
    if not flow.continuous:
        raise OptionError("surfaces are of flows, and this is a map; take dimension: 1", "dimension")
    if not setting.autonomous:
        message = (
            "surfaces are of equilibria, which a flow with a clock has not; take dimension: 1 for those of its map"
        )
        raise OptionError(message, "dimension")
    if why := no_collocation(flow):
        raise OptionError(f"surfaces are not grown: {why}", "dimension")
    if flow.chart.dimension < 3:
        raise OptionError("a surface is all there is of a flow with two coordinates", "dimension")


def _run_surfaces(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return saddle equilibria and their manifolds of dimension two."""
    tolerance = max(batch.target or float(np.fmin(batch.error_estimate, _MOST)), _LEAST)
    kinds = [kind for kind, word in enumerate(KINDS) if options.kind in (word, "both")]
    with lanes.stage(f"manifolds: equilibria of {batch.count:,} lanes", 0):
        known, size = find_saddles(batch, lanes, options.n_starts, options.seed, options.box)
        local = {kind: local_surfaces(batch, lanes, known, size, SIDES[kind], _SHARE * tolerance) for kind in kinds}
    two = np.array([any(of[k] is not None for of in local.values()) for k in range(len(known.lane))], bool)
    number = np.bincount(known.lane[two], minlength=batch.count)
    place = np.cumsum(two) - 1 - (np.cumsum(number) - number)[known.lane]
    kept = np.flatnonzero(two & (place < options.saddles))
    lane = known.lane[kept]
    grown, eigenvalues = dict[int, list[Surface | None]](), dict[int, np.ndarray]()
    with lanes.stage(f"manifolds: surfaces of {len(kept):,} saddles", periods(options, batch.count)):
        for kind in kinds:
            of_kind = [local[kind][k] for k in kept]
            own = [i for i, each in enumerate(of_kind) if each is not None]
            growth = Growth(
                batch.flow,
                size[lane[own]],
                parameters_of(batch, lane[own]),
                SIDES[kind],
                options.spacing,
                options.max_points,
                tolerance,
            )
            surfaces = grow_surfaces(lanes, growth, [each for each in of_kind if each is not None], options.length)
            grown[kind], eigenvalues[kind] = [None] * len(kept), np.full((len(kept), 2), np.nan + 0j)
            for i, surface in zip(own, surfaces, strict=True):
                grown[kind][i] = surface
                eigenvalues[kind][i] = SIDES[kind] * of_kind[i].eigenvalues  # pyright: ignore[reportOptionalMemberAccess]
    made = Surfaces(lane, place[kept], known.points[kept], number, grown, eigenvalues, size)
    return xr.Dataset(surface_variables(options, batch, lanes, made), attrs=section_attrs(batch))


def _table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return the table of curves or of surfaces."""
    return surface_table(data) if "surface_kind" in data else table(data)


def _sides(options: ManifoldsOptions, batch: LaneBatch) -> dict[int, Side]:
    """Return the maps of the kinds that are asked for."""
    sides = dict[int, Side]()
    if options.kind != "stable":
        sides[0] = side_of(batch.strobe, backward=False)
    if options.kind != "unstable":
        try:
            sides[1] = side_of(batch.inverse, backward=True)
        except TypeError as error:
            raise OptionError(f"{error}; stable manifolds need that: take kind: unstable", "kind") from None
    return sides


def _check_inverse(
    batch: LaneBatch, lanes: LaneRunner, side: Side, orbits: Saddles, size: Float[np.ndarray, "lanes d"]
) -> None:
    """Check that an inverse that a map says takes points of its orbits back."""
    if not isinstance(batch.system, DiscreteMap) or not len(orbits.lane):
        return
    last = orbits.points[:, -1]
    back = np.asarray(
        lanes(section_map, (side.maps[0], np.int32(1)), (orbits.points[:, 0], parameters_of(batch, orbits.lane)))
    )
    if not np.max(np.abs(batch.chart.wrap(back - last)) / size[orbits.lane]) < _UNDOES:
        raise OptionError("the map gives no inverse of itself: it does not take a point of an orbit back", "kind")


def _of_lane(grown: BranchSet, saddles: Saddles, lane: int) -> list[tuple[int, ManifoldBranch]]:
    """Return the branches of a lane with their numbers."""
    each = len(grown.branches) // max(len(saddles.lane), 1)
    of = (b for s in np.flatnonzero(saddles.lane == lane) for b in range(each * s, each * (s + 1)))
    return [(int(b), branch) for b in of if (branch := grown.branches[b]) is not None]


def _pairs_of_lane(
    grown: tuple[BranchSet, BranchSet], saddles: Saddles, lane: int
) -> tuple[list[tuple[int, ManifoldBranch]], list[tuple[int, ManifoldBranch]]]:
    """Return unstable and stable branches of a lane: of the first only those of the orbits' first points.

    Every homoclinic orbit has points on these.
    """
    unstable, stable = (_of_lane(of, saddles, lane) for of in grown)
    return [(b, branch) for b, branch in unstable if b // 2 % saddles.points.shape[1] == 0], stable


def _lane_of(meetings: Meetings, saddles: Saddles, period: int) -> Int[np.ndarray, " meetings"]:
    return saddles.lane[meetings.unstable // (2 * period)]


def _crossings(
    options: ManifoldsOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    saddles: Saddles,
    size: Float[np.ndarray, "lanes 2"],
    grown: tuple[BranchSet, BranchSet],
) -> tuple[Crossings, Float[np.ndarray, " crossings"], Int[np.ndarray, " crossings"]]:
    """Return the shortest crossings of each lane, in order of lanes, how far twice the steps move them, and lanes."""
    wrap, angles = batch.chart.wrap, any(batch.chart.angles)
    seen = joined(
        [
            crossing_segments(*_pairs_of_lane(grown, saddles, lane), size[lane], wrap, angles, options.crossings)
            for lane in np.unique(saddles.lane).tolist()
        ]
    )
    coarse, fine = ((grown[0].curves[k], grown[1].curves[k]) for k in (0, 1))
    refined = refine_crossings(lanes, coarse, seen, wrap)
    good = np.flatnonzero(np.isfinite(refined.angle))
    good = good[distinct_orbits(take(refined.meetings, good), coarse)]
    lane = _lane_of(take(refined.meetings, good), saddles, options.period)
    place = np.arange(len(lane)) - np.searchsorted(lane, lane)
    good, lane = good[place < options.crossings], lane[place < options.crossings]
    kept = Crossings(take(refined.meetings, good), refined.points[good], refined.angle[good])
    again = refine_crossings(lanes, fine, kept.meetings, wrap)
    deviation = np.linalg.norm(wrap(again.points - kept.points) / size[lane], axis=1)
    return kept, deviation, lane


def _tangencies(
    name: str,
    batch: LaneBatch,
    lanes: LaneRunner,
    sides: tuple[Side, Side],
    saddles: Saddles,
    size: Float[np.ndarray, "lanes 2"],
    grown: tuple[BranchSet, BranchSet],
) -> tuple[Tangencies, Int[np.ndarray, " tangencies"]]:
    """Return the nearest tangencies of each lane, in order of lanes, and their lanes."""
    if any(batch.chart.angles):
        raise OptionError("tangencies are located in a plane without angles", "tangency")
    period = saddles.points.shape[1]
    curves = grown[0].curves[0], grown[1].curves[0]
    places = [
        near_tangencies(*_pairs_of_lane(grown, saddles, lane), size[lane], batch.chart.wrap, curves)
        for lane in np.unique(saddles.lane).tolist()
    ]
    meetings = joined(places)
    located = locate_tangencies(batch, lanes, sides, saddles, size, grown, meetings, name)
    lane, kept = _lane_of(meetings, saddles, period), [np.zeros(0, int)]
    for number in np.unique(lane).tolist():
        own = np.flatnonzero(lane == number)
        part = Tangencies(take(meetings, own), located.value[own], located.error[own])
        kept.append(own[nearest_tangencies(part, float(batch.p[name][number]))])
    order = np.concatenate(kept)
    return Tangencies(take(located.meetings, order), located.value[order], located.error[order]), lane[order]


ANALYSIS = Analysis(
    "manifolds",
    ManifoldsOptions,
    periods,
    run,
    numbers=lambda options: 3 * options.saddles * 4 * options.period * options.max_points,  # of surfaces about as many
    check=check,
    table=_table,
    price=price_of_orbits,
    brief={"period": 1, "n_starts": 4, "max_points": 16, "crossings": 0},
)
