"""The group `edges`: attractors, edge states and least shocks of lanes as variables, and their table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import LANE, Entry, Table, flag, number_variable, range_in_words, variable
from jaxnh.analyses.batch import LaneRunner, iterate_units
from jaxnh.analyses.coordinates import named_points
from jaxnh.analyses.edges.bisection import Bracket, Space
from jaxnh.analyses.edges.destinations import ESCAPES, MOST, UNDECIDED, LaneAttractors
from jaxnh.analyses.edges.shocks import Shocks
from jaxnh.analyses.edges.tracking import EQUILIBRIUM, KINDS, SADDLE_ORBIT, EdgeStates
from jaxnh.analyses.manifolds.saddles import find_germs
from jaxnh.analyses.options.basins import EdgesOptions
from jaxnh.analyses.orbits.measurement import measure
from jaxnh.analyses.table_arrays import RowPlaces, ordered_places
from jaxnh.analyses.verdict import KINDS as MOTIONS
from jaxnh.orbits.recognition import Cycles, equal_cycles
from jaxnh.systems.status import NOT_FINITE, STATUS

OWN_NAMES = (
    "attractor", "pair", "point", "attractor_kind", "attractor_period", "share", "attractors", "kind", "period",
    "edge_state", "multiplier", "multiplier_error", "second_multiplier", "second_multiplier_error", "returns",
    "edge_from", "edge_to", "shock", "shock_error", "shock_point", "shock_to", "shocks_tried", "status",
)  # fmt: skip
"""Names of variables and dimensions that no parameter or coordinate may have."""

POINTS = 64
"""Points of a motion in a boundary that are kept, the last ones."""

_SPECIAL = ("none", "escapes")  # −1 and 0: numbers of attractors are from 1 on
_ROUNDING = 32.0 * np.finfo(float).eps  # sizes: of a point of an orbit, where it is far from a bifurcation
_SIZES = "in halves of the box"
_STEP = 1e-4  # sizes: differences that give directions in coordinates, of charts that are not linear


class Edges(NamedTuple):
    """Edges of the basins of a batch.

    Attributes:
        space: section coordinates, of pairs and edge states.
        whole: coordinates of the flow in time, of attractors and shocks.
        known: attractors of each lane.
        pairs: starts that lead to different ones.
        states: what the boundaries between them lead to.
        shocks: the least of each attractor; None: not wanted.
        tried: how many were tried for each of these.
    """

    space: Space
    whole: Space
    known: Sequence[LaneAttractors]
    pairs: Bracket
    states: EdgeStates
    shocks: Shocks | None
    tried: np.ndarray


class _Exact(NamedTuple):
    """Saddle orbits by the map of twice the steps: points, directions there, and differences from those of the map."""

    points: np.ndarray
    coarse: np.ndarray
    direction: np.ndarray
    multipliers: np.ndarray
    errors: np.ndarray


def variables(options: EdgesOptions, lanes: LaneRunner, made: Edges) -> dict[str, Entry]:
    """Return all variables of a batch."""
    entries = _of_attractors(made, lanes) | _of_pairs(options, made, lanes)
    if made.shocks is not None:
        entries |= _of_shocks(made, lanes, made.shocks)
    status = np.array([status_of(known.labels) for known in made.known], int)
    words = "whether the lane has edges, or why not"
    entries["status"] = flag(LANE, status, words, (*STATUS, "one_attractor", "no_attractor"))
    return entries


def status_of(labels: np.ndarray) -> int:
    """Return the status of a lane, from where its starts lead; `one_attractor` and `no_attractor` follow `STATUS`."""
    if not np.any(labels >= 0):
        return NOT_FINITE if np.all(labels == ESCAPES) else len(STATUS) + 1
    return len(STATUS) if len(np.unique(labels[labels != UNDECIDED])) == 1 else 0


def _of_attractors(made: Edges, lanes: LaneRunner) -> dict[str, Entry]:
    count, d = made.whole.size.shape
    dims, shape = (LANE, "attractor"), (count, MOST)
    kind, period = np.full(shape, -1, np.int8), np.zeros(shape, np.int32)
    share, point = np.full(shape, np.nan), np.full((*shape, d), np.nan)
    for lane, known in enumerate(made.known):
        if known.attractors is None:
            continue
        some = len(known.targets)
        kind[lane, :some], period[lane, :some] = known.attractors.kind, known.attractors.period
        share[lane, :some] = [np.mean(known.labels == k) for k in range(some)]
        point[lane, :some] = known.attractors.points[:, 0]
    of_period, unit = "least period of a periodic attractor", iterate_units(made.whole.batch.system)
    number = np.arange(1, MOST + 1, dtype=np.int32)
    return {
        "attractor": variable("attractor", number, "number of the attractor of a lane, by the mean of its points"),
        "attractors": variable(LANE, np.sum(kind >= 0, axis=1).astype(np.int32), "number of attractors of the lane"),
        "attractor_kind": flag(dims, kind, "kind of motion on the attractor", ("absent", *MOTIONS), -1),
        "attractor_period": number_variable(dims, period, of_period, ("none",), counted_in=unit),
        "share": variable(dims, share, "share of the starts that lead to the attractor"),
        **named_points(made.whole.batch, lanes, point, dims, "_attractor", "of a point of the attractor"),
    }


def _of_pairs(options: EdgesOptions, made: Edges, lanes: LaneRunner) -> dict[str, Entry]:
    """Return edge states, over the pairs of starts that have led to them."""
    pairs, states, unit = made.pairs, made.states, iterate_units(made.space.batch.system)
    dims, at = (LANE, "pair"), ordered_places(pairs.lane, (made.space.batch.count, options.pairs))

    def number(name: str, values: np.ndarray, words: str, **attrs: Any) -> dict[str, Entry]:
        return {name: number_variable(dims, at.put(values, 0, np.int32), words, ("none",), **attrs)}

    exact = _exact(made, lanes)
    return {
        "kind": flag(dims, at.put(states.kind, 0, np.int8), "kind of the edge state that the boundary leads to", KINDS),
        **number("period", states.period, "returns of a saddle orbit", counted_in=unit),
        **number("edge_state", _numbered(made), "number of the saddle orbit among those of the lane"),
        **number("returns", states.returns, "returns that the boundary was followed for", counted_in=unit),
        "edge_from": _attractor(dims, at.put(pairs.near_label + 1, -1, np.int32), "attractor on one side"),
        "edge_to": _attractor(
            dims, at.put(pairs.far_label + 1, -1, np.int32), "attractor that the other start leads to"
        ),
        **_multipliers(dims, at, exact),
        **_of_points(made, lanes, dims, at, exact),
    }


def _multipliers(dims: tuple[str, ...], at: RowPlaces, exact: _Exact) -> dict[str, Entry]:
    """Return the multiplier along the unstable direction and the largest of the others, with errors."""
    entries = dict[str, Entry]()
    names = "multiplier", "second_multiplier"
    words = "multiplier of the edge state along its unstable direction", "largest modulus of its other multipliers"
    for k, (name, said) in enumerate(zip(names, words, strict=True)):
        if k < exact.multipliers.shape[1]:
            values = np.real(exact.multipliers[:, k]) if k == 0 else np.abs(exact.multipliers[:, k])
            entries[name] = variable(dims, at.put(values), said)
            entries[f"{name}_error"] = variable(dims, at.put(exact.errors[:, k]), f"error of the {said}")
    return entries


def _of_points(made: Edges, lanes: LaneRunner, dims: tuple[str, ...], at: RowPlaces, exact: _Exact) -> dict[str, Entry]:
    """Return coordinates of edge states with errors, their unstable directions, and motions in the boundary."""
    batch, size = made.space.batch, made.space.size[made.pairs.lane]

    def named(points: np.ndarray, ending: str, words: str, *more: str) -> dict[str, Entry]:
        return named_points(batch, lanes, at.put(points), (*dims, *more), ending, words)

    edge = named(exact.points, "_edge", "of a point of the edge state")
    others = [named(points, "_edge", "") for points in (exact.coarse, exact.points + _rounding(exact)[:, None] * size)]
    ahead, back = (
        named(exact.points + step * exact.direction, "_direction", "along the unstable direction at that point")
        for step in (_STEP, -_STEP)
    )
    return {
        **edge,
        **{f"{name}_error": _sum_of_changes(entry, [other[name] for other in others]) for name, entry in edge.items()},
        **{name: _quotient(ahead[name], back[name], 2 * _STEP) for name in ahead},
        **named(made.states.path[:, -POINTS:], "_points", "of the motion in the boundary", "point"),
    }


def _exact(made: Edges, lanes: LaneRunner) -> _Exact:
    """Return saddle orbits with all that is measured of them, NaN where there is none."""
    pairs, states, batch = made.pairs, made.states, made.space.batch
    count, d = pairs.near.shape
    empty = np.full((count, d), np.nan)
    exact = _Exact(empty.copy(), empty.copy(), empty.copy(), empty.astype(complex), empty.copy())
    closed = np.isin(states.kind, (SADDLE_ORBIT, EQUILIBRIUM))
    strobes = batch.strobe(1), batch.strobe(2)
    for n in np.unique(states.period[closed]).tolist():
        own = np.flatnonzero(closed & (states.period == n))
        lane, points = pairs.lane[own], states.points[own, :n]
        p, size = batch.parameters_of(lane), made.space.size[lane]
        germs = [find_germs(batch, lanes, strobe, p, points, size) for strobe in strobes]
        coarse, fine = (each.points.reshape(len(own), n, d)[:, 0] for each in germs)
        measured = measure(batch, lanes, strobes, Cycles(lane, points, np.zeros(len(own), int)), made.space.size)
        exact.coarse[own], exact.points[own] = coarse, fine
        exact.direction[own] = germs[1].directions.reshape(len(own), n, d)[:, 0]
        exact.multipliers[own], exact.errors[own] = measured.multipliers, measured.multipliers_error
    return exact


def _rounding(exact: _Exact) -> Float[np.ndarray, " pairs"]:
    """Return how well rounding leaves points known, in sizes."""
    with np.errstate(divide="ignore"):
        return _ROUNDING * np.maximum(1.0, 1.0 / np.min(np.abs(1.0 - exact.multipliers), axis=1))


def _numbered(made: Edges) -> np.ndarray:
    """Return the numbers of the saddle orbits of each lane, from 1 on; 0 where there is none."""
    states, lane, wrap = made.states, made.pairs.lane, made.space.batch.chart.wrap
    first = np.arange(len(lane))
    for n in np.unique(states.period[states.period > 0]).tolist():
        own = np.flatnonzero(states.period == n)
        first[own] = own[equal_cycles(lane[own], states.points[own, :n], made.space.size[lane[own]], wrap)]
    number = np.zeros(len(lane), int)
    for k in np.flatnonzero(states.period > 0).tolist():
        own = np.flatnonzero(lane == lane[k])
        number[k] = number[first[k]] if first[k] < k else number[own].max(initial=0) + 1
    return number


def _of_shocks(made: Edges, lanes: LaneRunner, shocks: Shocks) -> dict[str, Entry]:
    """Return the least shock of each attractor, with how many were tried."""
    dims, at = (LANE, "attractor"), RowPlaces((made.whole.batch.count, MOST), (shocks.lane, shocks.attractor))
    base, hit = (
        named_points(made.whole.batch, lanes, at.put(points), dims, "_shock", "of the displacement")
        for points in (shocks.base, shocks.base + shocks.displacement)
    )
    known = np.isfinite(shocks.length)
    of_length = f"least displacement known that leads to another attractor, {_SIZES}"
    of_point = "number of the point of the attractor that is displaced"
    return {
        "shock": variable(dims, at.put(shocks.length), of_length),
        "shock_error": variable(dims, at.put(np.where(known, shocks.error, np.nan)), "error of the least shock"),
        "shock_point": number_variable(
            dims, at.put(np.where(known, shocks.point + 1, 0), 0, np.int32), of_point, ("none",)
        ),
        "shock_to": _attractor(dims, at.put(np.where(known, shocks.to + 1, -1), -1, np.int32), "attractor after it"),
        "shocks_tried": number_variable(
            dims, at.put(made.tried, 0, np.int32), "points times directions that were tried", ("none",)
        ),
        **{name: _quotient(hit[name], base[name], 1.0) for name in base},
    }


def _attractor(dims: Sequence[str], numbers: np.ndarray, words: str) -> Entry:
    """Return numbers of attractors, 0 where motions end or go to infinity."""
    return number_variable(dims, numbers, words, _SPECIAL, -1)


def _quotient(numerator: Entry, denominator: Entry, over: float) -> Entry:
    """Return the difference of two variables of points over a step."""
    return numerator[0], (numerator[1] - denominator[1]) / over, numerator[2]


def _sum_of_changes(value: Entry, others: Sequence[Entry]) -> Entry:
    """Return the error of a variable of points: the sum of its differences from others."""
    return (
        value[0],
        np.sum([np.abs(value[1] - other[1]) for other in others], axis=0),
        value[2] | {"long_name": f"error of the {value[2]['long_name']}"},
    )


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return how many edge states of each kind there are, and the ranges of multipliers and shocks."""
    kinds = data["kind"].to_numpy()
    words = ", ".join(f"{np.sum(kinds == k)} {word}" for k, word in enumerate(KINDS) if k and np.any(kinds == k))
    rows = [
        ("attractors", range_in_words(data["attractors"].to_numpy().astype(float))),
        ("edge states", words or "–"),
        ("multiplier", range_in_words(data["multiplier"].to_numpy())),
    ]
    if "shock" in data:
        rows.append(("least shock", range_in_words(data["shock"].to_numpy())))
    return Table("Edges of basins", ("quantity", "values"), tuple(rows), left=(0,))
