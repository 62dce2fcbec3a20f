"""The group `manifolds`: saddles, branches, crossings and tangencies of lanes as variables, and their table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Entry, Table, as_variable, flag, number_variable, range_in_words, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.coordinates import named_points
from jaxnh.analyses.manifolds.branches import SIDES, BranchSet
from jaxnh.analyses.manifolds.crossings import Crossings
from jaxnh.analyses.manifolds.curves import ENDS
from jaxnh.analyses.manifolds.saddles import Saddles
from jaxnh.analyses.manifolds.tangencies import KEPT, Tangencies
from jaxnh.analyses.options.orbits import ManifoldsOptions
from jaxnh.analyses.section_points import statuses
from jaxnh.analyses.table_arrays import RowPlaces, ordered_places
from jaxnh.systems.readout import status

KINDS = ("unstable", "stable")
"""Meanings of the flags 0 and 1 of `branch_kind`."""

OWN_NAMES = (
    "saddle", "branch", "point", "crossing", "contact", "branch_kind", "branch_start", "branch_sign", "multiplier",
    "end", "arc_length", "deviation", "crossing_arc", "crossing_angle", "crossing_deviation", "crossing_from",
    "crossing_to", "tangency", "tangency_error", "tangency_from", "tangency_to", "saddles", "status", "surface",
    "surface_kind", "triangle", "corner", "triangles", "gaps", "eigenvalues", "eigenvalue", "part",
)  # fmt: skip
"""Names of variables and dimensions that no parameter or coordinate may have."""

SIZES = "in halves of the box"
"""Unit of the lengths of manifolds, in words."""


class Manifolds(NamedTuple):
    """Manifolds of the saddles of a batch.

    Attributes:
        saddles: those that are kept.
        number: of all saddles of each lane, (lanes,).
        grown: branches by number of their kind.
        crossings: with the error of each, in sizes, and the numbers of their lanes; None: not wanted.
        tangencies: the same with their lanes.
    """

    saddles: Saddles
    number: Int[np.ndarray, " lanes"]
    grown: Mapping[int, BranchSet]
    crossings: tuple[Crossings, Float[np.ndarray, " crossings"], Int[np.ndarray, " crossings"]] | None
    tangencies: tuple[Tangencies, Int[np.ndarray, " tangencies"]] | None


def variables(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner, made: Manifolds) -> dict[str, Entry]:
    """Return all variables of a batch."""
    n, kinds = options.period, list(made.grown)
    each = 2 * n
    start = np.tile(np.repeat(np.arange(1, n + 1), 2), len(kinds)).astype(np.int32)
    signs = np.tile(np.array(SIDES, np.int8), n * len(kinds))
    numbers, dims = np.bincount(made.saddles.lane, minlength=batch.count), (LANE, "branch")

    def repeated(values: np.ndarray) -> np.ndarray:
        return np.tile(values, (batch.count, 1))

    entries: dict[str, Entry] = {
        "branch_kind": flag(dims, repeated(np.repeat(kinds, each)), "kind of manifold that the branch is of", KINDS),
        "branch_start": variable(dims, repeated(start), "number of the point of the orbit that the branch begins at"),
        "branch_sign": variable(dims, repeated(signs), "side of the point that the branch begins to"),
        "saddles": variable(LANE, made.number.astype(np.int32), "number of saddle orbits known, kept or not"),
        **_of_branches(options, batch, lanes, made),
    }
    if made.crossings is not None:
        entries |= _of_crossings(options, batch, lanes, made, *made.crossings)
    if made.tangencies is not None:
        entries |= _of_tangencies(options, batch, made, *made.tangencies)
    entries["status"] = as_variable(LANE, status(np.where(numbers > 0, 0, statuses(batch, batch.start))))
    return entries


def _of_branches(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner, made: Manifolds) -> dict[str, Entry]:
    each, kinds, saddles = 2 * options.period, list(made.grown), made.saddles
    shape = batch.count, options.saddles, each * len(kinds)
    points = np.full((*shape, options.max_points, batch.chart.dimension), np.nan)
    arc, end = np.full(points.shape[:-1], np.nan), np.zeros(shape, np.int8)
    multiplier, deviation = np.full(shape, np.nan), np.full(shape, np.nan)
    for place, kind in enumerate(kinds):
        grown = made.grown[kind]
        for b, branch in enumerate(grown.branches):
            s, k = b // each, place * each + b % each
            at = saddles.lane[s], saddles.place[s], k
            of_turn = grown.curves[0].multiplier[b]
            multiplier[at] = of_turn if kind == 0 else 1.0 / of_turn
            deviation[at] = grown.deviation[b]
            if branch is not None:
                end[at] = branch.end
                points[at][: len(branch.x)], arc[at][: len(branch.x)] = branch.points, branch.arc
    orbit = RowPlaces(shape[:2], (saddles.lane, saddles.place)).put(saddles.points)
    dims = LANE, "saddle", "branch"
    return {
        **named_points(batch, lanes, orbit, (LANE, "saddle", "orbit_point"), "_orbit", "of the points of the saddle"),
        **named_points(batch, lanes, points, (*dims, "point"), "_points", "along the branch"),
        "arc_length": variable((*dims, "point"), arc, f"arc length from the saddle, {SIZES}"),
        "multiplier": variable(dims, multiplier, "multiplier along the branch"),
        "end": flag(dims, end, "how the branch ends", ENDS),
        "deviation": variable(
            dims,
            deviation,
            f"largest distance of points from the manifold, by twice the steps and a shorter start, {SIZES}",
        ),
    }


def _of_crossings(
    options: ManifoldsOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    made: Manifolds,
    crossings: Crossings,
    deviation: Float[np.ndarray, " crossings"],
    lane: Int[np.ndarray, " crossings"],
) -> dict[str, Entry]:
    at, dims = ordered_places(lane, (batch.count, options.crossings)), (LANE, "crossing")
    meetings, points = crossings.meetings, at.put(crossings.points)
    columns = (
        ("crossing_arc", meetings.arc, f"sum of the arc lengths of both branches, {SIZES}", "1"),
        ("crossing_angle", crossings.angle, "angle between the branches, coordinates in halves of the box", "rad"),
        ("crossing_deviation", deviation, f"error of the point, by twice the steps and a shorter start, {SIZES}", "1"),
    )
    return {
        **named_points(batch, lanes, points, dims, "_crossings", "of points where manifolds cross, one of each orbit"),
        **{name: variable(dims, at.put(data), words, unit) for name, data, words, unit in columns},
        **_ends("crossing", dims, at, made.saddles, meetings, options.period),
    }


def _of_tangencies(
    options: ManifoldsOptions,
    batch: LaneBatch,
    made: Manifolds,
    tangencies: Tangencies,
    lane: Int[np.ndarray, " tangencies"],
) -> dict[str, Entry]:
    at, dims = ordered_places(lane, (batch.count, KEPT)), (LANE, "contact")
    name = options.tangency
    assert name is not None
    words, unit = batch.flow.readout.labels.long_names[name], {"units": batch.flow.readout.labels.units[name]}
    return {
        "tangency": variable(dims, at.put(tangencies.value), f"{words} of tangencies, nearest first", **unit),
        "tangency_error": variable(dims, at.put(tangencies.error), "error of the value", **unit),
        **_ends("tangency", dims, at, made.saddles, tangencies.meetings, options.period),
    }


def _ends(
    kind: str, dims: tuple[str, ...], at: RowPlaces, saddles: Saddles, meetings: Any, period: int
) -> dict[str, Entry]:
    """Return the numbers of the saddles that orbits come from and go to."""
    entries = dict[str, Entry]()
    for ending, branches in (("from", meetings.unstable), ("to", meetings.stable)):
        numbers = at.put(saddles.place[branches // (2 * period)] + 1, 0, np.int32)
        words = f"number of the saddle whose {KINDS[ending == 'to']} manifold it is of"
        entries[f"{kind}_{ending}"] = number_variable(dims, numbers, words, ("none",))
    return entries


def _kinds(data: xr.Dataset) -> np.ndarray:
    """Return the kinds of branches, which are the same in all lanes, (branch,)."""
    kind = data["branch_kind"].transpose("branch", ...).to_numpy()
    return kind.reshape(len(kind), -1)[:, 0]


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return the ranges over lanes of arc lengths, deviations, crossings and tangencies."""
    kind, lane_dims = _kinds(data), [d for d in data["end"].dims if d != "branch"]
    rows = [("saddles", range_in_words(data["saddles"].to_numpy().astype(float)))]
    for number in np.unique(kind).tolist():
        arc = data["arc_length"].isel(branch=kind == number).transpose(*lane_dims, "branch", "point").to_numpy()
        longest = np.max(np.where(np.isfinite(arc), arc, -np.inf), axis=-1)
        off = data["deviation"].isel(branch=kind == number).to_numpy()
        rows += [
            (f"arc length, {KINDS[number]}", range_in_words(longest)),
            (f"deviation, {KINDS[number]}", range_in_words(off)),
        ]
    for name, words in (("crossing_arc", "crossings, arc length"), ("tangency", "tangencies")):
        if name in data:
            rows.append((words, range_in_words(data[name].to_numpy())))
    return Table("Manifolds", ("quantity", "values"), tuple(rows), left=(0,))
