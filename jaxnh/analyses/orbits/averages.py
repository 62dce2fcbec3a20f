"""Averages over the chaotic set of every lane: from its periodic orbits, and beside them in time along its motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from jaxnh.analyses.base import LANE, Entry, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, rate_attrs
from jaxnh.analyses.exponents.errors import Average, average_blocks
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.orbits.carriers import PLACES, Places
from jaxnh.analyses.orbits.cycle_expansion import UNKNOWN, CycleAverages, WeightedCycles, cycle_averages
from jaxnh.analyses.orbits.measurement import return_times
from jaxnh.analyses.orbits.search import map_of_lanes
from jaxnh.analyses.orbits.tables import AVERAGES, LaneOrbits
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.systems.rows import concatenate

_QUANTITIES = (
    "escape rate, minus the leading zero of the zeta function",
    "sum of the positive Lyapunov exponents",
    "mean time between returns",
)


def cycle_variables(
    parts: Sequence[LaneOrbits], places: Sequence[Mapping[int, Places] | None], counts: xr.Dataset
) -> dict[str, Entry]:
    """Return averages by cycle expansion over the lanes.

    Args:
        places: of the orbits of each batch, of which those outside the attractor are left out, or None.
        counts: the group `orbit_counts` of all lanes.
    """
    missing = counts["missing_high"].to_numpy()
    values = np.full((2, len(missing), 3), np.nan)
    for part, of_part in zip(parts, places, strict=True):
        for lane, number in enumerate(part.numbers):
            values[:, number] = _averages_of_lane(part, lane, of_part, missing[number])
    return _variables(parts[0].batch, values, "by cycle expansion")


class _Weights(NamedTuple):
    """Orbits of one lane that are not outside its attractor, and what is not known of them, (cycles,) each.

    Attributes:
        cycles: the orbits.
        time_error, growth_error: of their periods and of the logarithms of their growth.
        most: for how many orbits each stands where as many are missing as may be.
        unstable: whether the largest multiplier is beyond the unit circle, and the place known.
        doubtful: whether it may be outside: no point of the motion is as near as its own points are to each other.
    """

    cycles: WeightedCycles
    time_error: Float[np.ndarray, " cycles"]
    growth_error: Float[np.ndarray, " cycles"]
    most: Float[np.ndarray, " cycles"]
    unstable: Bool[np.ndarray, " cycles"]
    doubtful: Bool[np.ndarray, " cycles"]


def _averages_of_lane(
    part: LaneOrbits, lane: int, places: Mapping[int, Places] | None, missing: Float[np.ndarray, " n"]
) -> CycleAverages:
    """Return the averages of one lane, by its number in the batch; none where an orbit of it is not unstable.

    Their errors count orbits that may be missing, with the weights of those known, orbits that may be outside, and the
    errors of periods and multipliers.
    """
    parts = [_weights(part, lane, n, places, missing[n - 1]) for n in part.measured]
    if not parts:
        return UNKNOWN
    known = concatenate(parts)
    if not known.unstable.all():
        return UNKNOWN
    cycles = known.cycles
    others = [cycles._replace(time=cycles.time + known.time_error, growth=cycles.growth + known.growth_error)]
    if np.any(known.most > 1.0):
        others.append(cycles._replace(number=known.most))
    if np.any(known.doubtful):
        others.append(cycles._replace(number=np.where(known.doubtful, 0.0, 1.0)))
    return cycle_averages(cycles, len(missing), others)


def _weights(part: LaneOrbits, lane: int, n: int, places: Mapping[int, Places] | None, missing: float) -> _Weights:
    """Return the orbits of n returns, of which so many may be missing."""
    measured, of_lane = part.measured[n], part.search.cycles[n].lane == lane
    place, near = places[n][1:] if places else (np.full(len(of_lane), PLACES.index("inside")), of_lane)
    kept = of_lane & (place != PLACES.index("outside"))
    modulus, error = np.abs(measured.multipliers[kept]), measured.multipliers_error[kept]
    beyond, count = modulus > 1.0, int(kept.sum())
    growth = np.log(modulus, where=beyond, out=np.zeros_like(modulus)).sum(axis=1)
    growth_error = np.divide(error, modulus, where=beyond, out=np.zeros_like(modulus)).sum(axis=1)
    cycles = WeightedCycles(np.full(count, n), measured.time[kept], growth, np.ones(count))
    most = np.full(count, 1.0 + missing / max(count, 1))
    unstable = (modulus[:, 0] - error[:, 0] > 1.0) & (place[kept] != PLACES.index("unknown"))
    return _Weights(cycles, measured.time_error[kept], growth_error, most, unstable, ~near[kept])


def motion_variables(
    parts: Sequence[LaneOrbits], motions: Sequence[Float[np.ndarray, "lanes points d"]], lanes: LaneRunner, count: int
) -> dict[str, Entry]:
    """Return the averages in time over all lanes, along motions that have settled."""
    values = np.full((2, count, 2), np.nan)
    for part, motion in zip(parts, motions, strict=True):
        values[:, part.numbers] = _time_averages(part.batch, lanes, motion)
    return _variables(parts[0].batch, values, "averaged along the motion")


def _time_averages(batch: LaneBatch, lanes: LaneRunner, motion: Float[np.ndarray, "lanes points d"]) -> Average:
    """Return the sum of positive exponents and the time between returns, (lanes, 2), by means of blocks.

    Tangents turn into place along the first block, which is left out.
    """
    strobe = refined_maps(batch)[0]
    at, (count, points, d) = map_of_lanes(batch, lanes, strobe), motion.shape
    each, lane = points // BLOCKS, np.arange(count)
    frames = np.broadcast_to(np.linalg.qr(np.random.default_rng(0).normal(size=(d, d)))[0], (count, d, d))
    growth, time = np.zeros((count, BLOCKS, d)), np.zeros((count, BLOCKS))
    for block in range(BLOCKS):
        u = motion[:, block * each : (block + 1) * each]
        matrices = np.asarray(at(u.reshape(-1, d), np.repeat(lane, each)).monodromy).reshape(count, each, d, d)
        time[:, block] = return_times(batch, lanes, strobe, u, lane)
        for k in range(each):
            frames, triangles = np.linalg.qr(matrices[:, k] @ frames)
            with np.errstate(divide="ignore"):  # of a tangent that vanishes
                growth[:, block] += np.log(np.abs(np.diagonal(triangles, axis1=1, axis2=2)))
    positive = np.mean(growth[:, 1:], axis=1, keepdims=True) > 0.0
    total = np.sum(growth, axis=2, where=np.broadcast_to(positive, growth.shape))
    total = np.where(np.all(np.isfinite(motion), axis=(1, 2))[:, None], total, np.nan)
    return average_blocks(np.stack([total / time, time / each], axis=-1)[:, 1:])


def _variables(batch: LaneBatch, values: Float[np.ndarray, "2 lanes k"], how: str) -> dict[str, Entry]:
    """Return variables of all quantities, or of those but the escape rate, from averages and their errors."""
    rate, flow, k = rate_attrs(batch.flow), batch.flow, values.shape[2]
    time = {"units": flow.readout.labels.units["t"]} if flow.continuous else {"counted_in": "iterates"}
    variables = dict[str, Entry]()
    names = AVERAGES[:3] if k == 3 else AVERAGES[3:]
    for i, (name, words, attrs) in enumerate(zip(names, _QUANTITIES[-k:], (rate, rate, time)[-k:], strict=True)):
        variables[name] = variable(LANE, values[0, :, i], f"{words}, {how}", **attrs)
        variables[f"{name}_error"] = variable(LANE, values[1, :, i], f"error of the {words}, {how}, at 95 %", **attrs)
    return variables
