"""The groups `orbits`, over lanes and their orbits, and `orbit_counts`, over numbers of returns; the table of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Int

from jaxnh.analyses.base import LANE, Entry, Table, as_variable, flag, number_variable, range_in_words, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.coordinates import coordinates_at
from jaxnh.analyses.options.orbits import OrbitsOptions
from jaxnh.analyses.orbits.entropy import topological_entropy
from jaxnh.analyses.orbits.measurement import STABILITIES, MeasuredCycles
from jaxnh.analyses.orbits.missing import missing_orbits
from jaxnh.analyses.orbits.search import Search
from jaxnh.analyses.orbits.symmetry import distinct
from jaxnh.analyses.table_arrays import real_and_imaginary
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.systems.readout import status
from jaxnh.systems.status import NOT_FINITE

AVERAGES = "cycle_escape_rate", "cycle_exponent", "cycle_return_time", "motion_exponent", "motion_return_time"
"""Names of averages: three by cycle expansion, and two in time."""

OWN_NAMES = (
    "orbit", "n", "multiplier", "part", "iterate", "period", "time", "time_error", "multipliers", "multipliers_error",
    "index", "stability", "met", "residual", "number", "missing", "missing_low", "missing_high", "entropy",
    "entropy_error", "rounds", "distance", "place", "least_period", "least_unstable", "carrier", "scenario", "image",
    "distinct", "status",
    *(f"{name}{ending}" for name in AVERAGES for ending in ("", "_error")),
)  # fmt: skip
"""Names of variables and dimensions that no parameter or coordinate may have."""

_LIKE = "of orbits that starts of this search may lead to; one that none can reach leaves no trace in it"
_REACHED = "missing: of orbits that the starts of the search may lead to"


class LaneOrbits(NamedTuple):
    """Orbits of the lanes of one batch.

    Attributes:
        numbers: of the lanes, in the order of the sweep, (lanes,).
        batch: the lanes.
        search: the orbits, and how often they were met.
        measured: their numbers, by number of returns.
        status: of the lanes after the transient, (lanes,).
    """

    numbers: Int[np.ndarray, " lanes"]
    batch: LaneBatch
    search: Search
    measured: Mapping[int, MeasuredCycles]
    status: Int[np.ndarray, " lanes"]


class OrbitRow(NamedTuple):
    """The rows of orbits of n returns of one batch: lane and place in it, (cycles,)."""

    part: LaneOrbits
    n: int
    lane: Int[np.ndarray, " cycles"]
    place: Int[np.ndarray, " cycles"]


def orbits_group(options: OrbitsOptions, lanes: LaneRunner, parts: Sequence[LaneOrbits], count: int) -> xr.Dataset:
    """Return the variables over (lane, orbit), by number of returns and then by time."""
    rows, limit = [row for part in parts for row in rows_of(part)], options.max_period

    def whole(values: Sequence[np.ndarray], empty: float = np.nan) -> np.ndarray:
        return gather(rows, values, count, empty)

    def column(name: str, empty: float = np.nan) -> np.ndarray:
        return whole([getattr(row.part.measured[row.n], name) for row in rows], empty)

    batch, dims = parts[0].batch, (LANE, "orbit")
    parts_of = [real_and_imaginary(row.part.measured[row.n].multipliers) for row in rows]
    errors = [row.part.measured[row.n].multipliers_error for row in rows]
    time, unit = {"units": batch.flow.readout.labels.units["t"]}, iterate_units(batch.system)
    period = whole([np.full(len(row.lane), row.n) for row in rows], 0).astype(np.int32)
    words = "primitive period of the orbit, in returns"
    d = batch.chart.dimension
    variables: dict[str, Entry] = {
        "period": number_variable(dims, period, words, ("none",), counted_in=unit),
        "time": variable(dims, column("time"), "period of the orbit in time", **time),
        "time_error": variable(dims, column("time_error"), "error of the period in time", **time),
        "multipliers": variable(
            (*dims, "multiplier", "part"),
            whole(parts_of) if rows else np.zeros((count, 0, d, 2)),
            "Floquet multipliers, real and imaginary part",
        ),
        "multipliers_error": variable(
            (*dims, "multiplier"),
            whole(errors) if rows else np.zeros((count, 0, d)),
            "error of the multipliers, in modulus",
        ),
        "index": variable(
            dims, column("fixed_point_index", 0).astype(np.int8), "fixed-point index, the sign of det(1 - DP^n)"
        ),
        "stability": flag(dims, column("stability", -1), "stability of the orbit", STABILITIES, -1),
        "met": variable(
            dims,
            whole([row.part.search.cycles[row.n].rounds for row in rows], 0).astype(np.int32),
            "number of rounds in which the orbit was met; of one known from a neighbour alone 0",
        ),
        "residual": variable(dims, column("residual"), "largest component of P(u) − u, in sizes of the motion"),
        **_image_variables(rows, whole),
        **_coordinates(lanes, rows, whole, limit),
        "status": _status(parts, count),
    }
    return xr.Dataset(variables, attrs=section_attrs(batch))


def _image_variables(rows: Sequence[OrbitRow], whole: Any) -> dict[str, Entry]:
    """Return the number of the image of every orbit in its lane, where a symmetry is given."""
    if not rows or rows[0].part.search.images is None:
        return {}
    numbers = [row.place[(row.part.search.images or {})[row.n]] + 1 for row in rows]
    words = "number of the orbit that a symmetry makes of it, in order of its lane; its own: it is symmetric"
    return {"image": number_variable((LANE, "orbit"), whole(numbers, 0).astype(np.int32), words, ("none",))}


def gather(rows: Sequence[OrbitRow], values: Sequence[np.ndarray], count: int, empty: float) -> np.ndarray:
    """Return numbers of orbits, an array for each row, over (lane, orbit, ...)."""
    most = max((int(row.place.max()) + 1 for row in rows if len(row.place)), default=0)
    made = np.full((count, most, *(values[0].shape[1:] if values else ())), empty)
    for row, value in zip(rows, values, strict=True):
        made[row.lane, row.place] = value
    return made


def rows_of(part: LaneOrbits) -> list[OrbitRow]:
    """Return where the orbits of a batch go: in each lane by number of returns, then by time and first coordinate."""
    rows, filled = list[OrbitRow](), np.zeros(part.batch.count, int)
    for n, measured in part.measured.items():
        lane = part.search.cycles[n].lane
        order = np.lexsort((measured.points[:, 0, 0], measured.time, lane))
        first = np.searchsorted(lane[order], np.arange(part.batch.count))
        place = np.empty(len(lane), int)
        place[order] = np.arange(len(lane)) - first[lane[order]] + filled[lane[order]]
        filled += np.bincount(lane, minlength=part.batch.count)
        rows.append(OrbitRow(part, n, part.numbers[lane], place))
    return rows


def counts_group(limit: int, parts: Sequence[LaneOrbits], count: int) -> xr.Dataset:
    """Return numbers of orbits and of those that are missing, over (lane, n), and their growth."""
    number, estimates = np.zeros((count, limit), np.int32), np.zeros((3, count, limit))
    growth, rounds = np.full((2, count), np.nan), np.zeros(count, np.int32)
    apart, related = np.zeros((count, limit), np.int32), any(part.search.images is not None for part in parts)
    for part in parts:
        for place, lane in enumerate(part.numbers):
            for n, cycles in part.search.cycles.items():
                met = cycles.rounds[cycles.lane == place]
                number[lane, n - 1] = len(met)
                if part.search.images is not None:
                    apart[lane, n - 1] = distinct(cycles, part.search.images[n], place)
                estimates[:, lane, n - 1] = missing_orbits(met, int(part.search.rounds[place]))
            growth[:, lane] = topological_entropy(number[lane].astype(float), estimates[2, lane])
            rounds[lane] = part.search.rounds[place]
    of_n = (LANE, "n")
    words = "of the 95 % interval of the number of missing orbits"
    variables = {
        "n": variable("n", np.arange(1, limit + 1), "number of returns"),
        "number": variable(of_n, number, "number of orbits of n returns that are known"),
        "missing": variable(
            of_n, estimates[0], "estimated number of orbits of n returns that are missing", comment=_LIKE
        ),
        "missing_low": variable(of_n, estimates[1], f"lower end {words}", comment=_LIKE),
        "missing_high": variable(of_n, estimates[2], f"upper end {words}", comment=_LIKE),
        **(
            {"distinct": variable(of_n, apart, "number of these of which none is the image of another")}
            if related
            else {}
        ),
        "entropy": variable(LANE, growth[0], "topological entropy per return, from the numbers of orbits"),
        "entropy_error": variable(LANE, growth[1], "error of the topological entropy"),
        "rounds": variable(LANE, rounds, "number of rounds of the search"),
        "status": _status(parts, count),
    }
    return xr.Dataset(variables)


def _status(parts: Sequence[LaneOrbits], count: int) -> Entry:
    """Return which lanes have failed: those whose motion is not finite, and for which no start has led to an orbit."""
    codes = np.zeros(count, int)
    for part in parts:
        some = np.zeros(part.batch.count, bool)
        for cycles in part.search.cycles.values():
            some[cycles.lane] = True
        why = np.where(part.status > 0, part.status, NOT_FINITE)
        codes[part.numbers] = np.where(~part.search.moving & ~some, why, 0)
    return as_variable(LANE, status(codes))


def _coordinates(lanes: LaneRunner, rows: Sequence[OrbitRow], whole: Any, limit: int) -> dict[str, Entry]:
    """Return coordinates of the first point of every orbit, and under NAME_points of all of them."""
    columns, said = dict[str, list[np.ndarray]](), dict[str, Any]()
    for row in rows:
        points = row.part.measured[row.n].points
        for name, output in coordinates_at(row.part.batch, lanes, points).items():
            said[name], filled = output, np.full((len(points), limit), np.nan)
            filled[:, : row.n] = output.data
            columns.setdefault(name, []).append(filled)
    variables = dict[str, Entry]()
    for name, values in columns.items():
        words, attrs, every = said[name].long_name, said[name].attrs, whole(values)
        variables[name] = variable((LANE, "orbit"), every[..., 0], f"{words} of the orbit's first point", **attrs)
        variables[f"{name}_points"] = variable(
            (LANE, "orbit", "iterate"), every, f"{words} of the orbit's points", **attrs
        )
    return variables


def counts_table(data: xr.Dataset) -> Table:
    """Return a row for each number of returns: orbits known and missing, of several lanes the least and the most."""
    number, low, high, missing = (
        data[name].transpose(..., "n").to_numpy().reshape(-1, data.sizes["n"])
        for name in ("number", "missing_low", "missing_high", "missing")
    )
    rows = []
    for k, n in enumerate(data["n"].to_numpy().tolist()):
        ends = f"{low[:, k].min():.3g} to {high[:, k].max():.3g}"
        rows.append((str(n), range_in_words(number[:, k]), range_in_words(missing[:, k]), ends))
    captions = [
        f"{words} {data[name].item():.6g} ± {data[f'{name}_error'].item():.1g}{unit}"
        for name, words, unit in (
            ("entropy", "topological entropy", " per return"),
            ("cycle_escape_rate", "by cycle expansion escape rate", ""),
            ("cycle_exponent", "by cycle expansion exponent", ""),
            ("motion_exponent", "in time exponent", ""),
        )
        if name in data and data[name].size == 1 and np.isfinite(data[name])
    ]
    return Table(
        "Periodic orbits", ("returns", "orbits", "missing", "95 %"), tuple(rows), "; ".join([_REACHED, *captions])
    )
