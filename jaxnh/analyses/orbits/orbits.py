"""All periodic orbits of the return map of every lane up to a number of returns, stable or not.

Lanes settle by themselves; then orbits are sought in all of them together (`search`), so that each is tried with those
of its neighbours, and measured (`measurement`). How often orbits were met says how many are missing (`missing`), and
their numbers say how they grow (`entropy`). Where it is asked for, orbits are told to lie in the attractor or not
(`carriers`), and give averages over it (`averages`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Analysis, Setting, SweepLanes, SweepReduction, check_names, variable
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner
from jaxnh.analyses.options.orbits import OrbitsOptions
from jaxnh.analyses.orbits.averages import cycle_variables, motion_variables
from jaxnh.analyses.orbits.carriers import carrier_variables, place_variables, places_of_orbits
from jaxnh.analyses.orbits.measurement import measure
from jaxnh.analyses.orbits.search import WINDOWS, search, search_neighbours
from jaxnh.analyses.orbits.symmetry import add_images, check_signs
from jaxnh.analyses.orbits.tables import OWN_NAMES, LaneOrbits, counts_group, counts_table, orbits_group
from jaxnh.analyses.periodic.close_returns import WINDOW
from jaxnh.analyses.periodic.location import price_of_orbits, refined_maps
from jaxnh.analyses.random_starts import check_box
from jaxnh.analyses.section_points import first_places, points_after, points_and_end, states_at, statuses

_NEWTON = 60.0  # periods of a start of Newton for each return, the tangents of a period counted: a guess
_ROUNDS = 8  # that are made of most lanes


def periods(options: OrbitsOptions, lanes: int) -> float:
    """Return the lane-periods of a run: a guess, as the number of rounds is not known."""
    starts = (2 * WINDOWS + options.n_starts) * options.max_period**2 / 2
    rounds = min(options.rounds, _ROUNDS)
    return lanes * (options.transient + rounds * (WINDOWS * WINDOW + _NEWTON * starts))


def check(options: OrbitsOptions, setting: Setting) -> None:
    """Check the box of random starts, the symmetry, and that no name is one that the group needs."""
    check_names("orbits", OWN_NAMES, setting)
    check_signs(setting.flow, options.symmetry or ())
    if options.box:
        check_box(options.box, setting)


def run(options: OrbitsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return the point of every lane after the transient, and its status there."""
    with lanes.stage(f"orbits: {batch.count} lanes to their attractors", float(batch.count * options.transient)):
        first, status = first_places(batch, lanes)
        points, end = points_and_end(batch, lanes, states_at(batch, lanes, first), options.transient - 1, 1)
    status = np.where(status > 0, status, statuses(batch, end))
    return xr.Dataset(
        {
            "lane_u": variable((LANE, "lane_component"), points[:, 0], "point of a lane"),
            "lane_status": variable(LANE, status, "status of a lane there"),
        }
    )


def reduce(options: OrbitsOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """Return the groups `orbits` and `orbit_counts` of all lanes, from the points that they have settled at."""
    u = data["lane_u"].to_numpy()
    u = u.reshape(-1, u.shape[-1])
    shape = tuple(len(axis.values) for axis in sweep.axes)
    status = data["lane_status"].to_numpy().ravel()
    parts = list[LaneOrbits]()
    for numbers, batch in sweep.rows:
        strobes = refined_maps(batch)[:2]
        pairs = _neighbours(sweep.axes, shape, numbers)
        known = search(options, batch, lanes, strobes[0], u[numbers])
        with lanes.stage(f"orbits: those of neighbours in {batch.count} lanes", 0):
            known = search_neighbours(known, batch, lanes, strobes[0], pairs)
        if options.symmetry:
            with lanes.stage(f"orbits: images in {batch.count} lanes", 0):
                known = add_images(known, batch, lanes, strobes[0], options.symmetry)
        with lanes.stage("orbits: periods and multipliers", 0):
            measured = {
                n: measure(batch, lanes, strobes, cycles, known.size)
                for n, cycles in known.cycles.items()
                if len(cycles.lane)
            }
        parts.append(LaneOrbits(numbers, batch, known, measured, status[numbers]))
    return _groups(options, lanes, parts, u, [axis.values for axis in sweep.axes])


def _groups(
    options: OrbitsOptions,
    lanes: LaneRunner,
    parts: Sequence[LaneOrbits],
    u: Float[np.ndarray, "lanes d"],
    axes: Sequence[Float[np.ndarray, " values"]],
) -> dict[str, xr.Dataset]:
    """Return the groups of orbits that are measured, and what is asked for of attractors and averages."""
    count, motions, places = len(u), [], [None] * len(parts)
    orbits, counts = orbits_group(options, lanes, parts, count), counts_group(options.max_period, parts, count)
    if options.attractor is not None:
        with lanes.stage("orbits: distances from attractors", float(count * options.attractor)):
            motions = [points_after(part.batch, lanes, u[part.numbers], 0, options.attractor) for part in parts]
            places = [places_of_orbits(part, lanes, motion) for part, motion in zip(parts, motions, strict=True)]
        orbits = orbits.assign(place_variables(parts, places, count) | carrier_variables(parts, places, axes))
    if options.averages:
        counts = counts.assign(cycle_variables(parts, places, counts))
        if motions:
            with lanes.stage("orbits: averages in time", 0):
                counts = counts.assign(motion_variables(parts, motions, lanes, count))
    return {"orbits": orbits, "orbit_counts": counts}


def _neighbours(
    axes: Sequence[Axis], shape: tuple[int, ...], numbers: Int[np.ndarray, " lanes"]
) -> Int[np.ndarray, "pairs 2"]:
    """Return places among lanes of two whose values are neighbours along one axis, each pair both ways."""
    place = np.full(shape, -1)
    place.flat[numbers] = np.arange(len(numbers))
    pairs = [np.zeros((0, 2), int)]
    for k, axis in enumerate(axes):
        order = place.take(np.argsort(axis.values, kind="stable"), axis=k)
        ahead, behind = (np.moveaxis(order, k, 0)[part].ravel() for part in (slice(1, None), slice(None, -1)))
        both = np.stack([ahead, behind], axis=1)
        pairs += [both, both[:, ::-1]]
    every = np.concatenate(pairs)
    return every[(every >= 0).all(axis=1)]


ANALYSIS = Analysis(
    "orbits",
    OrbitsOptions,
    periods,
    run,
    whole=SweepReduction(("orbit_counts",), reduce),
    check=check,
    other_tables={"orbit_counts": counts_table},
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1},
)
