"""Covariant Lyapunov vectors of the return map of every lane: exponents, angles, and whether the motion is hyperbolic.

A run follows the lanes, takes the derivative of the map at each point, and sweeps forward and backward over these
matrices (`vectors`). On a section the direction along the flow is none of the vectors; in time alone it is, and its
exponent is zero. Vectors are measured in sizes of the motion.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int, Int8

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    Entry,
    OptionError,
    Setting,
    Table,
    as_variable,
    flag,
    kind_of_lanes,
    table_of_kinds,
    variable,
)
from jaxnh.analyses.batch import LaneBatch, LaneRunner, rate_attrs
from jaxnh.analyses.covariant.hyperbolicity import (
    KINDS,
    SPLITS,
    TANGENT,
    UNDECIDED,
    exponents_alike,
    judge,
    judge_search,
    judge_splits,
    small_angles,
)
from jaxnh.analyses.covariant.least_angles import DERIVATIVE, SearchedMotions, least_angles, searched_returns
from jaxnh.analyses.covariant.vectors import (
    CovariantVectors,
    covariant_vectors,
    sheared,
    smallest_angles,
    volume_growth,
)
from jaxnh.analyses.exponents.errors import Average, average_blocks
from jaxnh.analyses.exponents.estimates import step_error
from jaxnh.analyses.exponents.triangles import HIDDEN
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import CovariantOptions
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.section_points import points_at, shear_along_flow
from jaxnh.analyses.trajectories.states import check_transient, section_attrs, settle_lanes
from jaxnh.maps.iterate import derivative_and_volume
from jaxnh.maps.section import reports
from jaxnh.systems.discrete_map import DiscreteMap
from jaxnh.systems.rows import select
from jaxnh.systems.state import LaneStates, is_finite

_SETTLED = 4  # returns that directions settle in, for the expected work of a search
_SETTLING = 8  # part of the strobes that either sweep takes more
_ROOM = 1 << 25  # numbers of frames and triangles in memory at once
_BINS = 36
_SHARES = (0.25, 0.5)
_AT_REST = 1e-9  # standard deviation, in units of the largest coordinate: of rounding
_COMMENT = "not a number where every return contracts by more than a double can tell"


class Motions(NamedTuple):
    """Motions of lanes, point by point.

    Attributes:
        states: after each return, (lanes, points).
        u: section coordinates, (lanes, points, d).
        size: of the motion in each of them, (lanes, d).
        matrices: derivatives of the map there, in sizes of the motion, (lanes, points, d, d).
        volumes: moduli of their determinants, by the map itself, (lanes, points).
        sound: whether all of it is finite and no matrix is zero, (lanes,).
    """

    states: LaneStates
    u: Float[np.ndarray, "lanes points d"]
    size: Float[np.ndarray, "lanes d"]
    matrices: Float[np.ndarray, "lanes points d d"]
    volumes: Float[np.ndarray, "lanes points"]
    sound: Bool[np.ndarray, " lanes"]


def periods(options: CovariantOptions, lanes: int) -> float:
    """Return the lane-periods of a run; a period with tangents costs one and about two more for each."""
    return _following(options, lanes) + lanes * options.search * searched_returns(_SETTLED) * (1.0 + DERIVATIVE)


def check(options: CovariantOptions, setting: Setting) -> None:
    """Check that there are directions to be between, and that the first strobe is on the section."""
    if setting.flow.exponents - int(setting.autonomous) < 2:
        raise OptionError("angles are between directions of the map, and it has one alone; take lyapunov")
    check_transient(options.transient, setting)


def run(options: CovariantOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return exponents, angles and the verdict of every lane, from as many points as options say."""
    d = batch.chart.dimension
    at_once = max(1, _ROOM // (3 * _points(options) * d * d))
    parts = []
    for first in range(0, batch.count, at_once):
        parts.append(_variables(options, batch.take(slice(first, first + at_once)), lanes))
    joined = {
        name: (dims, np.concatenate([part[name][1] for part in parts]) if dims[0] == LANE else values, attrs)
        for name, (dims, values, attrs) in parts[0].items()
    }
    return xr.Dataset(joined, attrs={"strobes": options.strobes, "search": options.search, **section_attrs(batch)})


def _following(options: CovariantOptions, lanes: int) -> float:
    return float(lanes * (options.transient + _points(options) * (1.0 + DERIVATIVE)))


def _points(options: CovariantOptions) -> int:
    return options.strobes + 2 * (options.strobes // _SETTLING)


def _motions(options: CovariantOptions, batch: LaneBatch, lanes: LaneRunner) -> Motions:
    strobe, (start, p), count = batch.strobe(), batch.lanes, _points(options)
    start = settle_lanes(lanes, strobe, options.transient, start, p, ORBIT_TILE)
    states = lanes.record(strobe, count, (start, p), tile=ORBIT_TILE)
    u = points_at(batch, lanes, states, ORBIT_TILE)
    d = u.shape[-1]
    each = {name: np.repeat(values, count) for name, values in p.items()}
    points = u.reshape(-1, d), each
    moved = lanes(derivative_and_volume, (strobe,), points, periods=DERIVATIVE, tile=ORBIT_TILE)
    matrices, volumes = (np.array(leaf).reshape(*u.shape[:2], *leaf.shape[1:]) for leaf in moved)
    sound = np.isfinite(matrices).all(axis=(1, 2, 3)) & is_finite(select(states, np.s_[:, -1]))
    size = _sizes(u, np.array(batch.chart.angles), sound)
    matrices = matrices * (size[:, None, None, :] / size[:, None, :, None])
    sound &= np.min(np.max(np.abs(matrices), axis=(2, 3)), axis=1) > 0.0
    matrices[~sound], volumes[~sound] = np.eye(d), 1.0
    return Motions(states, u, size, matrices, volumes, sound)


def _sizes(
    u: Float[np.ndarray, "lanes points d"], turns: Bool[np.ndarray, " d"], sound: Bool[np.ndarray, " lanes"]
) -> Float[np.ndarray, "lanes d"]:
    """Return the standard deviation of each coordinate, the largest where one rests, and 1 of an angle."""
    u = np.where(sound[:, None, None], u, 0.0)
    size = np.std(u, axis=1)
    resting = size <= _AT_REST * np.max(np.abs(u), axis=(1, 2))[:, None]
    largest = np.max(np.where(turns | resting, 0.0, size), axis=1, keepdims=True)
    return np.where(turns, 1.0, np.where(resting, np.where(largest > 0.0, largest, 1.0), size))


def _variables(options: CovariantOptions, batch: LaneBatch, lanes: LaneRunner) -> dict[str, Entry]:
    with lanes.stage(f"covariant: {batch.count:,} lanes", _following(options, batch.count)):
        motions = _motions(options, batch, lanes)
    settling = options.strobes // _SETTLING
    neutral = int(batch.flow.autonomous and not batch.on_section)
    k = batch.flow.exponents - int(batch.flow.autonomous) + neutral
    whole = k == motions.u.shape[2]  # with constraints volumes are those of other coordinates
    vectors = covariant_vectors(motions.matrices, settling, k, motions.volumes if whole else None)
    points, seen = motions.u[:, settling : settling + options.strobes], vectors
    if batch.on_section:
        seen = sheared(vectors, shear_along_flow(batch, lanes, points, motions.size, ORBIT_TILE))
    angles = smallest_angles(seen)
    each = _exponents(batch, motions, vectors, settling)
    hidden = np.all(vectors.rounding >= HIDDEN, axis=1)
    sound = motions.sound
    splits = judge_splits(angles)
    alike = exponents_alike(each.mean[:, :k], each.error[:, :k]) & ~hidden[:, 1:]
    splits[alike] = UNDECIDED
    vanishing = np.zeros((batch.count, k), np.bool_)
    if isinstance(batch.system, DiscreteMap):  # flows have an inverse
        vanishing = judge_splits(np.exp(volume_growth(vectors))) == TANGENT
    searched = {}
    if options.search:
        growing = np.where(sound, np.sum(each.mean[:, :k] > each.error[:, :k], axis=1), 0)
        motion = SearchedMotions(batch, lanes, points, motions.size, vectors, angles)
        searched["angle_found"] = _search(motion, growing, neutral, options.search, splits)
    kind = judge(splits, each.mean[:, :k], each.error[:, :k], each.mean[:, k:], each.error[:, k:], neutral, vanishing)
    ended = reports(batch.flow, motions.states)["status"]
    density = _densities(angles)
    values, errors = (np.where(hidden, np.nan, leaf[:, :k]) for leaf in each)
    splits[~sound] = UNDECIDED
    for leaf in (angles, density, *searched.values()):
        leaf[~sound], leaf[alike] = np.nan, np.nan
    shares = [np.min(angles[..., : int(share * angles.shape[-1])], axis=-1) for share in _SHARES]
    rate, between = rate_attrs(batch.flow), (LANE, "split")
    words = "smallest angle between the first vectors and the others"
    undefined = "not a number where exponents on its sides may be equal: directions are none of the motion's then"
    edges = np.linspace(0.0, np.pi / 2, _BINS + 1)
    return {
        "exponent": variable("exponent", np.arange(1, k + 1), "number of the vector, largest exponent first"),
        "split": variable("split", np.arange(1, k), "number of vectors on the faster side of the angle"),
        "angle": variable("angle", 0.5 * (edges[1:] + edges[:-1]), "middle of a bin of angles", "rad"),
        "kind": flag(LANE, kind, "hyperbolicity of the motion", KINDS),
        "tangency": flag(between, splits, "whether the angle is bounded away from zero", SPLITS),
        "exponents": variable(
            (LANE, "exponent"), values, "Lyapunov exponents of the vectors", **rate, comment=_COMMENT
        ),
        "exponents_error": variable((LANE, "exponent"), errors, "error of the exponents at 95 %", **rate),
        "angle_min": variable(between, np.min(angles, axis=-1), words, "rad", comment=undefined),
        "angle_min_half": variable(between, shares[1], f"{words}, of the first half of the points", "rad"),
        "angle_min_quarter": variable(between, shares[0], f"{words}, of the first quarter of the points", "rad"),
        **{name: variable(between, values, f"{words}, by a search", "rad") for name, values in searched.items()},
        "angle_median": variable(between, np.median(angles, axis=-1), "median of the angle", "rad"),
        "angle_density": variable((LANE, "split", "angle"), density, "density of the angle", "1/rad"),
        "status": as_variable(LANE, ended),
    }


def _search(
    motions: SearchedMotions,
    growing: Int[np.ndarray, " lanes"],
    neutral: int,
    rounds: int,
    splits: Int8[np.ndarray, "lanes splits"],
) -> Float[np.ndarray, "lanes splits"]:
    """Return the smallest angles that a search finds where vectors cease to grow, and change what is said of them.

    Both sides of the direction along a flow in time alone are such places. Where angles of the motions are those of a
    tangency, none is looked for.
    """
    smallest = np.full(splits.shape, np.nan)
    for along in sorted({0, neutral}):
        first = growing + along
        (which,) = np.nonzero((growing > 0) & (first <= splits.shape[1]))
        which = which[splits[which, first[which] - 1] != TANGENT]
        at = which, first[which] - 1
        subset = motions.take(which)
        least = least_angles(subset, small_angles(motions.angles)[at], first[which], neutral - along, rounds)
        splits[at], smallest[at] = judge_search(splits[at], least, np.min(motions.angles[at], axis=-1)), least.angle
    return smallest


def _densities(angles: Float[np.ndarray, "lanes splits points"]) -> Float[np.ndarray, "lanes splits bins"]:
    """Return the density of each angle over even bins from 0 to π/2."""
    places = np.minimum((angles / (0.5 * np.pi) * _BINS).astype(int), _BINS - 1)
    counts = np.stack([np.sum(places == k, axis=-1) for k in range(_BINS)], axis=-1)
    return counts * (_BINS / (0.5 * np.pi * angles.shape[-1]))


def _exponents(batch: LaneBatch, motions: Motions, vectors: CovariantVectors, settling: int) -> Average:
    """Return exponents of the vectors and the sums of the first ones, (lanes, 2 k), a unit of time."""
    growth, rounding = (np.concatenate([x, np.cumsum(x, axis=2)], axis=2) for x in (vectors.growth, vectors.rounding))
    count = growth.shape[1]
    if not batch.on_section:
        time = np.full((len(growth), count), float(batch.flow.period))
    else:  # a return takes a time of its own
        crossings: Any = motions.states
        time = np.diff(crossings.t, axis=1)[:, settling : settling + count]
    rates = np.sum(growth, axis=1) / np.sum(time, axis=1)[:, None]
    missed = (growth - rates[:, None] * time[:, :, None]) / np.mean(time, axis=1)[:, None, None]
    blocks = missed[:, : count // BLOCKS * BLOCKS].reshape(len(growth), BLOCKS, -1, growth.shape[2]).mean(axis=2)
    # Vectors that turn, as on a focus, leave a sum that strays; and lengths in other units, of a factor e, one of 1.
    strayed = np.maximum(np.ptp(np.cumsum(missed, axis=1), axis=1), 1.0 / np.mean(time, axis=1)[:, None]) / count
    error = np.maximum(average_blocks(blocks).error, strayed) + np.sum(rounding, axis=1) / np.sum(time, axis=1)[:, None]
    error += step_error(batch) / np.mean(time, axis=1)[:, None]
    rates[~motions.sound], error[~motions.sound] = np.nan, np.nan
    return Average(rates, error)


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return how many lanes are of each kind, with the ranges of their largest exponents and smallest angles."""
    columns = {
        "largest exponent": data["exponents"].isel(exponent=0).to_numpy(),
        "smallest angle (rad)": np.fmin.reduce(data["angle_min"].transpose(..., "split").to_numpy(), axis=-1),
    }
    caption = f"{data.attrs.get('strobes', '')} points a lane"
    return table_of_kinds("Covariant Lyapunov vectors", data, KINDS, columns, caption)


def price(options: CovariantOptions, batch: LaneBatch) -> Price:
    """Return the price of the derivative of the map at each point; both sweeps are linear algebra on the host."""
    strobe = batch.map()
    points = batch.chart.host_points(batch.start), dict(batch.p)
    program = PricedProgram(derivative_and_volume, (strobe,), points, strobe.trip_counts, tile=ORBIT_TILE)
    note = f"{batch.chart.dimension} tangents and the volume at every point"
    return Price(program, map_alone(batch, tile=ORBIT_TILE), note)


ANALYSIS = Analysis(
    "covariant",
    CovariantOptions,
    periods,
    run,
    classes=kind_of_lanes,
    check=check,
    table=table,
    price=price,
    brief={"transient": 1, "strobes": 256},
)
