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
from jaxnh.analyses.manifolds.branches import BranchSet, Side, find_saddle_orbits, grow_branches, sides_of
from jaxnh.analyses.manifolds.crossings import (
    Crossings,
    Meetings,
    crossing_segments,
    distinct_orbits,
    joined,
    refine_crossings,
)
from jaxnh.analyses.manifolds.curves import ManifoldBranch, error_of_distance
from jaxnh.analyses.manifolds.saddles import Saddles
from jaxnh.analyses.manifolds.surface_runs import check_surfaces, run_surfaces
from jaxnh.analyses.manifolds.surface_tables import surface_table
from jaxnh.analyses.manifolds.tables import OWN_NAMES, Manifolds, table, variables
from jaxnh.analyses.manifolds.tangencies import Tangencies, locate_tangencies, near_tangencies, nearest_tangencies
from jaxnh.analyses.options.orbits import ManifoldsOptions
from jaxnh.analyses.periodic.location import price_of_orbits
from jaxnh.analyses.random_starts import check_box
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.systems.rows import select

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
        check_surfaces(setting)
    if flow.exponents - int(setting.autonomous) < 2:
        raise OptionError("manifolds are curves among other directions of the map, and it has one alone")
    if not options.box:
        raise OptionError("needs a box to draw the starts of Newton from", "box")
    check_names("manifolds", OWN_NAMES, setting)
    check_box(options.box, setting)
    movable = [axis.name for axis in setting.axes if axis.kind == "lane"]
    if options.tangency is not None and options.tangency not in movable:
        known = f"these are {', '.join(movable)}" if movable else "there is none"
        raise OptionError(f"tangencies are along an axis that lanes may differ in; {known}", "tangency")


def run(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return saddles, branches, crossings and tangencies of all lanes, or surfaces."""
    if options.dimension == 2:
        return run_surfaces(options, batch, lanes)
    sides = sides_of(options, batch)
    with lanes.stage(f"manifolds: saddles of {batch.count:,} lanes", 0):
        saddles, number, size = find_saddle_orbits(options, batch, lanes, sides)
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


def _table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return the table of curves or of surfaces."""
    return surface_table(data) if "surface_kind" in data else table(data)


def _of_lane(grown: BranchSet, saddles: Saddles, lane: int) -> list[tuple[int, ManifoldBranch]]:
    """Return the branches of a lane with their numbers."""
    each = len(grown.branches) // max(len(saddles.lane), 1)
    numbers = (b for s in np.flatnonzero(saddles.lane == lane) for b in range(each * s, each * (s + 1)))
    return [(int(b), branch) for b in numbers if (branch := grown.branches[b]) is not None]


def _pairs_of_lane(
    grown: tuple[BranchSet, BranchSet], saddles: Saddles, lane: int
) -> tuple[list[tuple[int, ManifoldBranch]], list[tuple[int, ManifoldBranch]]]:
    """Return unstable and stable branches of a lane: of the first only those of the orbits' first points.

    Every homoclinic orbit has points on these.
    """
    unstable, stable = (_of_lane(curves, saddles, lane) for curves in grown)
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
    """Return the shortest crossings of each lane, in order of lanes, their errors in sizes, and lanes."""
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
    good = good[distinct_orbits(select(refined.meetings, good), coarse)]
    lane = _lane_of(select(refined.meetings, good), saddles, options.period)
    place = np.arange(len(lane)) - np.searchsorted(lane, lane)
    good, lane = good[place < options.crossings], lane[place < options.crossings]
    kept = Crossings(select(refined.meetings, good), refined.points[good], refined.angle[good])
    again = refine_crossings(lanes, fine, kept.meetings, wrap)
    moved = np.linalg.norm(wrap(again.points - kept.points) / size[lane], axis=1)
    # What is across either curve moves the point where they meet the further, the flatter their angle is.
    largest = np.abs(kept.points / size[lane]).max(axis=1, initial=0.0) / np.sin(kept.angle)
    return kept, error_of_distance(moved, largest), lane


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
        kept.append(own[nearest_tangencies(located.of(own), float(batch.p[name][number]))])
    order = np.concatenate(kept)
    return located.of(order), lane[order]


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
