"""Edges of basins of every lane: edge states, and the least shocks that attractors do not survive.

Attractors are known from random starts (`destinations`). Boundaries between starts that lead to different ones are
followed to edge states (`tracking`), and points of attractors are displaced until they cross a boundary (`shocks`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Analysis, OptionError, Setting, check_names
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.edges.bisection import Bracket, Space
from jaxnh.analyses.edges.destinations import (
    MOST,
    UNDECIDED,
    Destinations,
    LaneAttractors,
    lane_attractors,
    returns,
    turns_of,
)
from jaxnh.analyses.edges.shocks import Shocks, directions_in, least_shocks
from jaxnh.analyses.edges.tables import OWN_NAMES, Edges, table, variables
from jaxnh.analyses.edges.tracking import track_edges
from jaxnh.analyses.options.basins import EdgesOptions
from jaxnh.analyses.periodic.location import price_of_orbits
from jaxnh.analyses.random_starts import box_size, check_box, draw_starts, random_start_batch
from jaxnh.analyses.section_points import first_points
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.systems.rows import spread_indices

_USUAL = 64.0  # periods that a state takes to its attractor, for the expected work
_LABELS = 64.0  # states that a pair of points is brought together by, again and again


def periods(options: EdgesOptions, lanes: int) -> float:
    """Return the lane-periods of a run: a guess, as attractors are not known before."""
    displaced = 2 * options.directions * options.shock_points * _LABELS
    return lanes * (4.0 * options.transient * options.n_starts + _USUAL * (8 * options.pairs * _LABELS + displaced))


def numbers(options: EdgesOptions) -> int:
    """Return how many numbers a lane leaves."""
    return options.n_starts + 8 * options.pairs * (options.max_period + 64) + 256


def check(options: EdgesOptions, setting: Setting) -> None:
    """Check the box, and names."""
    if not options.box:
        raise OptionError("needs a box to draw its starts from", "box")
    check_box(options.box, setting)
    check_names("edges", OWN_NAMES, setting)


def run(options: EdgesOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return attractors, edge states and least shocks of all lanes."""
    many, _ = random_start_batch(batch, options.n_starts, options.seed, options.box)
    timed, many_timed = batch.without_section(), many.without_section()
    with lanes.stage(f"edges: attractors of {batch.count:,} lanes", 2.0 * options.transient * many.count):
        known = lane_attractors(
            many_timed, lanes, options.n_starts, options.transient, options.max_periods, options.max_period
        )
    targets = Destinations(timed, timed.strobe(), [lane.targets for lane in known], options.max_periods)
    first = first_points(many, lanes)
    space = Space(batch, box_size(batch, options.box, first.reshape(batch.count, options.n_starts, -1)))
    whole = Space(timed, box_size(timed, options.box))
    pairs = _pairs(known, first, options.pairs)
    with lanes.stage(f"edges: {len(pairs.lane):,} boundaries", 0):
        states = track_edges(space, targets, lanes, pairs, options.transient, options.max_returns, options.max_period)
    shocks, tried = None, np.zeros(0, int)
    if options.directions:
        start = _points(known, options.shock_points, timed.chart.dimension)
        directions = directions_in(timed.chart.dimension, options.directions, options.seed)
        with lanes.stage(f"edges: shocks of {len(start.lane):,} points", 0):
            shocks, tried = least_shocks(whole, targets, lanes, start, directions, options.reach)
    made = Edges(space, whole, known, pairs, states, shocks, tried)
    return xr.Dataset(variables(options, lanes, made), attrs=section_attrs(batch))


def _pairs(known: Sequence[LaneAttractors], first: Float[np.ndarray, "starts d"], most: int) -> Bracket:
    """Return pairs of starts of each lane that lead to different attractors, as many of each two as of others.

    Starts are random, and so are pairs of them in the order in which they are drawn.
    """
    rows = list[tuple[int, int, int, int, int]]()
    for lane, points in enumerate(known):
        starts = len(points.labels)
        finite = np.isfinite(first[lane * starts : (lane + 1) * starts]).all(axis=1)
        groups = {
            int(k): np.flatnonzero((points.labels == k) & finite) for k in np.unique(points.labels) if k != UNDECIDED
        }
        order = sorted((k for k in groups if len(groups[k])), key=lambda k: k if k >= 0 else MOST)
        twos = [(a, b) for j, b in enumerate(order) for a in order[:j]]
        for turn in range(most if twos else 0):
            a, b = twos[turn % len(twos)]
            turn //= len(twos)
            near_start, far_start = groups[a][turn % len(groups[a])], groups[b][turn % len(groups[b])]
            rows.append((lane, lane * starts + int(near_start), lane * starts + int(far_start), a, b))
    lane, near_start, far_start, near, far = np.array(rows, int).reshape(-1, 5).T
    return Bracket(lane, first[near_start], first[far_start], near, far)


def _points(known: Sequence[LaneAttractors], most: int, d: int) -> Shocks:
    """Return points of all attractors, evenly over the motion on each, as shocks that are not known yet."""
    lane, attractor, point, period, base = list[int](), list[int](), list[int](), list[int](), [np.zeros((0, d))]
    for number, known_lane in enumerate(known):
        for place in range(len(known_lane.targets)):
            assert known_lane.attractors is not None
            turns = turns_of(known_lane.attractors, place)
            chosen = spread_indices(turns, most)
            base.append(known_lane.attractors.points[place, chosen])
            lane += [number] * len(chosen)
            attractor += [place] * len(chosen)
            point += chosen.tolist()
            period += [turns if returns(known_lane.attractors, place) else 0] * len(chosen)
    numbers = [np.array(values, int) for values in (lane, attractor, point, period)]
    unknown = np.full(len(lane), np.nan)
    return Shocks(
        lane=numbers[0],
        attractor=numbers[1],
        point=numbers[2],
        period=numbers[3],
        base=np.concatenate(base),
        displacement=np.full((len(lane), d), np.nan),
        length=unknown,
        to=np.full(len(lane), UNDECIDED),
        error=unknown,
    )


ANALYSIS = Analysis(
    "edges",
    EdgesOptions,
    periods,
    run,
    numbers=numbers,
    starts=draw_starts,
    check=check,
    table=table,
    price=price_of_orbits,
    brief={"n_starts": 4, "pairs": 1, "directions": 0, "max_returns": 64},
)
