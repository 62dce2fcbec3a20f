"""Lyapunov spectrum of the flow, with error bars and exact checks.

Where a lane has settled on a stable periodic orbit, exponents are those of the orbit's multipliers, and where it has
come to rest without a clock, those of the equilibrium's eigenvalues. Elsewhere they are averages of the growth of
tangents: smooth ones where the motion is regular and they converge faster, else plain ones with the scatter of block
means. `exponents_method` says which. Most lanes on an orbit are known early, and leave out the rest of their transient;
all that are end after a sixteenth of their averages. Where motions become one in finite time, by sliding or at rest on
a wall, tangents vanish: their exponents are −∞, without error.

Without a clock the flow carries its own direction along, whose exponent is zero unless the motion comes to rest: the
tangents are those across it, one fewer, and no section is needed.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool, Int

from jaxnh.analyses.base import Analysis, OptionError, Setting
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.equilibria.detection import detect_equilibrium
from jaxnh.analyses.exponents.errors import (
    Average,
    average_blocks,
    average_windows,
    change,
    smooth_parts,
    unseen_bursts,
    widen_by_drift,
    widen_to_zero,
)
from jaxnh.analyses.exponents.estimates import (
    SOURCES,
    Averages,
    Spectrum,
    area_growth,
    exponent_sum,
    step_error,
    widen_plain_by_drift,
)
from jaxnh.analyses.exponents.from_orbits import early_orbits, find_orbits, no_orbits, orbit_exponents
from jaxnh.analyses.exponents.orthonormalisation import parts_needed, refine, refinement_needed, spares_last
from jaxnh.analyses.exponents.period_parts import cut_period, period_parts
from jaxnh.analyses.exponents.tables import dataset
from jaxnh.analyses.exponents.tangent_growth import (
    advance,
    average,
    averages_in_turn,
    begin,
    quadrature,
)
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import LyapunovOptions
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.smooth_window import DEGREE
from jaxnh.systems.rows import concatenate, select, write_rows
from jaxnh.systems.state import is_finite

_ALIGNING = 8  # of this many parts of the transient, the last also turns the tangents into place
_COMPARED = (4, 8, 12, 16)  # periods over which regular growth is held against that with twice the steps
_AT_ONCE = (0.0,) * len(_COMPARED)  # of them as many times the first
_BRIEF = 1e-4  # of what is lost in them, below which the series 1 − (1 − e^−x)/x = x/2 − … has one term
_PRICED_PARTS = 4  # orthonormalisations a period in the program that is priced


def periods(options: LyapunovOptions, lanes: int) -> float:
    """Return the lane-periods of a run; each costs one and about two more for every tangent."""
    return float(lanes * (options.transient + options.periods * (1 + 2 * options.exponents)))


def check(options: LyapunovOptions, setting: Setting) -> None:
    """Check that there is an exponent across the flow, and no more are asked for than there are.

    The default is cut down to them.
    """
    most = setting.flow.exponents
    if most - int(setting.flow.autonomous) < 1:
        raise OptionError("a flow of one coordinate without a clock has no exponent but that along it; take portrait")
    if "exponents" in options.model_fields_set and options.exponents > most:
        raise OptionError(f"must be at most {most}, not {options.exponents}", "exponents")


def choose(options: LyapunovOptions, batch: LaneBatch, lanes: LaneRunner) -> dict[str, int]:
    """Choose how many times a period tangents are orthonormalised, the same for all lanes of a sweep.

    Also choose the refinement of the steps, where tangents need more of them than states.
    """
    batch, k = batch.without_section(), tangents(options, batch.without_section())
    if not batch.flow.continuous:
        return {"parts": 1}
    spared = every_exponent(options, batch) and spares_last(batch, k + int(batch.flow.autonomous))
    parts, growth = parts_needed(batch, lanes, k, spare_last=spared)
    if parts == k == 1:
        return {"parts": 1}
    refinement = refinement_needed(batch, lanes, growth, parts, spare_last=spared)
    if refinement > 1:  # steps that do not follow tangents do not show how fast these are lost in another either
        fine, growth = parts_needed(refine(batch, parts, refinement), lanes, k, spare_last=spared)
        if fine > parts:
            parts, refinement = fine, refinement_needed(batch, lanes, growth, fine, spare_last=spared)
    return {"parts": parts} | ({"refinement": refinement} if refinement > 1 else {})


def run(options: LyapunovOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Compute the `exponents` largest exponents of every lane, their errors, and the sum rule where all are known."""
    batch = batch.without_section()
    chosen = batch.chosen.get("lyapunov") or choose(options, batch, lanes)
    parts, refinement = chosen["parts"], chosen.get("refinement", 1)
    batch = refine(batch, parts, refinement)
    blocks = averages(options, batch, lanes, parts)
    exponents, area, total = spectrum(options, batch, lanes, blocks, parts), np.zeros(batch.count), None
    if every_exponent(options, batch):
        aligned, block = options.transient // _ALIGNING, options.periods // BLOCKS
        area = area_growth(batch, lanes, blocks)
        total = exponent_sum(batch, blocks, exponents, options.transient, aligned, block)
    data = dataset(options, batch, blocks, exponents, total, area).assign_attrs(orthonormalisations_per_period=parts)
    return data if refinement == 1 else data.assign_attrs(refinement_for_tangents=refinement)


def averages(
    options: LyapunovOptions, batch: LaneBatch, lanes: LaneRunner, parts: int, *, to_the_end: bool = False
) -> Averages:
    """Average the growth of all lanes in blocks, after the transient.

    Lanes whose errors are small enough stop early, and so do those that are on a stable orbit after the first block,
    which gives their exponents at once, unless all averages are to go on `to_the_end`.
    """
    count, k, lead = batch.count, tangents(options, batch), int(batch.flow.autonomous)
    strobes = period_parts(batch, parts)
    nodes = quadrature(batch) if batch.flow.readout.contraction and every_exponent(options, batch) else None
    aligning = options.transient // _ALIGNING
    settling = options.transient - aligning
    block = options.periods // BLOCKS
    state, p = batch.lanes
    early = early_orbits(batch, lanes, options.transient) if not to_the_end and _has_orbits(options, batch) else None
    state, before = (early.state, early.periods) if early else (jax.tree.map(np.array, state), 0)
    others = _other_lanes(np.arange(count), early.settled, count) if early else np.arange(count)
    with lanes.stage(f"lyapunov: transient of {len(others)} lanes", len(others) * (options.transient - before)):
        left = max(settling - before, 0)
        if len(others):
            write_rows(state, others, lanes.iterate(batch.strobe(), left, select((state, p), others)))
        growth = lanes(begin, (batch.system,), (state,), static=(k,))
        if len(others):
            part, part_p = select((growth, p), others)
            write_rows(growth, others, average(lanes, strobes, part, part_p, aligning)[0])
    start = jax.tree.map(np.array, growth.state)
    growth = growth._replace(loss=tuple(np.zeros((lead + k, count))))  # of what is averaged alone
    rates = np.full((count, BLOCKS, lead + k + 2), np.nan)
    smooth = np.zeros((count, 3 + DEGREE, lead + k + 1))
    done = np.zeros(count, int)
    running = np.arange(count)
    settled = no_orbits(lead + k)
    with lanes.stage(f"lyapunov: averages of {count} lanes", count * options.periods):
        for stretch in _stretches(options):
            (part, part_p), shares, i = select((growth, p), running), [k / BLOCKS for k in stretch], stretch[-1]
            in_turn = averages_in_turn(lanes, strobes, part, part_p, block, shares, nodes)
            rows = running if len(running) < count else np.s_[:]  # of all lanes in half the time
            for number, (after, rate) in zip(stretch, in_turn, strict=True):
                rates[rows, number] = rate
                smooth[rows] += smooth_parts(after, block, number)
            write_rows(growth, running, in_turn[-1][0])
            done[running] += len(stretch)
            if i == 0 and not to_the_end and _has_orbits(options, batch):
                if early:
                    orbits = select(early.survey, early.settled)
                    settled = orbit_exponents(batch, lanes, growth, early.settled, orbits, parts)
                # A chaotic lane whose tangent shrinks in this block is looked at as well, and goes on.
                candidates = others[~(rates[others, 0, lead] > 0.0)]
                more = find_orbits(batch, lanes, growth, candidates, parts, options.periods)
                settled = concatenate([settled, more])
                running = _other_lanes(running, settled.lanes, count)
            if options.error and i + 1 >= BLOCKS // 4:
                plain = average_blocks(rates[running, : i + 1, lead : lead + k])
                error = widen_to_zero(plain, aligning, (i + 1) * block).error / batch.flow.period
                running = running[~(np.max(error, axis=1) < options.error)]
            if not len(running):
                break
    return Averages(start, growth, rates, smooth, np.stack(growth.loss, axis=-1), done, settled)


def _stretches(options: LyapunovOptions) -> list[range]:
    """Numbers of the blocks between which it is decided which lanes go on: after the first, and for an error each."""
    if options.error:
        return [range(number, number + 1) for number in range(BLOCKS)]
    return [range(1), range(1, BLOCKS)]


def _other_lanes(
    lanes: Int[np.ndarray, " some"], others: Int[np.ndarray, " others"], count: int
) -> Int[np.ndarray, " rest"]:
    """The lanes that are not among others, of so many in all, in their order."""
    among = np.zeros(count, bool)
    among[others] = True
    return lanes[~among[lanes]]


def spectrum(options: LyapunovOptions, batch: LaneBatch, lanes: LaneRunner, averages: Averages, parts: int) -> Spectrum:
    """Return the best estimate for every lane: its orbit, a smooth average or a plain one."""
    lead, k = int(batch.flow.autonomous), tangents(options, batch)
    aligned, block = options.transient // _ALIGNING, options.periods // BLOCKS
    mean, error = np.full((2, batch.count, lead + k), np.nan)
    on_orbit = np.isin(np.arange(batch.count), averages.settled.lanes)
    for blocks in np.unique(averages.blocks[~on_orbit]):
        chosen = (averages.blocks == blocks) & ~on_orbit
        plain = average_blocks(averages.rates[chosen, :blocks, : lead + k])
        mean[chosen], error[chosen] = widen_to_zero(plain, aligned, blocks * block)
    source, vanished = np.zeros(batch.count, np.int8), np.isneginf(mean)
    steps = batch.error_estimate * block * BLOCKS
    others = np.flatnonzero(~on_orbit)
    drift = widen_plain_by_drift(Average(mean[others], error[others]), averages, others, np.s_[: lead + k], steps)
    widened = error.copy()
    widened[others] = drift.error
    number, ran = np.arange(BLOCKS), averages.blocks
    late = (number < ran[:, None]) & (number >= (ran - np.maximum(ran // 4, 1))[:, None])
    last = np.mean(averages.rates[:, :, lead], axis=1, where=late)
    undecided = ~(mean[:, lead] - error[:, lead] > 0.0) | ~(last > 0.0)
    unknown = np.any(np.isnan(mean), axis=1)
    undecided &= ~unknown
    if options.method == "averages":
        estimate = Spectrum(mean, widened, source, np.zeros(batch.count))
        return _with_step_errors(options, batch, lanes, averages, estimate, undecided, parts)
    whole = np.flatnonzero(undecided & (averages.blocks == BLOCKS))
    windows = np.where(vanished[whole, None], 0.0, averages.smooth[whole, :, : lead + k])
    smooth = average_windows(windows, aligned, BLOCKS * block)
    smooth = widen_to_zero(smooth, aligned, BLOCKS * block)
    better = smooth.error[:, lead] < error[whole, lead]
    regular = whole[better]
    source[regular] = SOURCES.index("smooth_average")
    smooth, error = widen_by_drift(smooth, windows, steps=steps), widened
    mean[regular] = smooth.mean[better]
    error[regular] = smooth.error[better]
    plain = whole[~better]
    error[plain] += unseen_bursts(averages.rates[plain, :, lead : lead + 1], BLOCKS * block)[:, None]
    mean[vanished], error[vanished] = -np.inf, 0.0
    candidates = np.flatnonzero(undecided)
    orbits = [averages.settled]
    if len(candidates) and _has_orbits(options, batch):
        orbits.append(find_orbits(batch, lanes, averages.growth, candidates, parts, BLOCKS * block))
    for settled in orbits:
        source[settled.lanes] = SOURCES.index("orbit")
        mean[settled.lanes], error[settled.lanes] = settled.logs, settled.error
    # At rest from the start the flow has no direction, and nothing else has a growth across it.
    candidates = np.flatnonzero(undecided | (unknown & is_finite(averages.growth.state)))
    if len(candidates) and lead:
        rest = detect_equilibrium(batch.take(candidates), lanes, options.transient + options.periods)
        still, exponents, bound = rest.still | rest.vanished, rest.exponents, rest.error
        still &= ~np.any(vanished[candidates], axis=1)  # what comes to rest in finite time has no linearisation there
        resting = candidates[still]
        source[resting] = SOURCES.index("equilibrium")
        complete = exponents.shape[1] == batch.flow.exponents  # else some eigenvalues are those of constraints
        for values, of_equilibrium in ((mean, exponents), (error, bound)):
            values[resting] = of_equilibrium[still, : lead + k] * batch.flow.period if complete else np.nan
    estimate = Spectrum(mean, error, source, np.zeros(batch.count))
    return _with_step_errors(options, batch, lanes, averages, estimate, undecided, parts)


def _has_orbits(options: LyapunovOptions, batch: LaneBatch) -> bool:
    """Return whether orbits of lanes are searched for: of a strobe map, whose multipliers are right to rounding."""
    return options.method != "averages" and not batch.flow.autonomous and batch.precision == "float64"


def _with_step_errors(
    options: LyapunovOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    averages: Averages,
    estimate: Spectrum,
    regular: Bool[np.ndarray, " lanes"],
    parts: int,
) -> Spectrum:
    """Return a spectrum with twice the change by twice the steps in the growth of averages of regular motions.

    Both motions begin at one state, and over a few periods T part by what is not yet lost of the way to another
    attractor: of a motion that comes to it like e^−λt they have seen 1 − (1 − e^−λT)/(λT) of the change. A torus has an
    exponent zero along itself; where another may be zero, the motion may come to the torus as slowly as the run is
    long. Phases part too, which may hide the change at one time and not at another: the largest over 4, 8, 12 and 16
    periods counts. In plain averages whose scatter is larger than what steps can do, as they are chosen for tangents as
    well (`refinement_needed`), it is not looked for, unless the sum of all exponents, which scatters less, is.
    """
    small = (np.min(estimate.error, axis=1) < step_error(batch)) | every_exponent(options, batch)
    plain = (estimate.source == SOURCES.index("average")) & regular & small
    subset = np.flatnonzero(plain | (estimate.source == SOURCES.index("smooth_average")))
    k, errors = estimate.mean.shape[1], np.zeros((batch.count, estimate.mean.shape[1] + 1))
    if not len(subset):
        return estimate
    growth, p = select((averages.growth, dict(batch.p)), subset)
    grown = [
        np.cumsum(
            [rate[:, : k + 1] for _, rate in averages_in_turn(lanes, strobes, growth, p, _COMPARED[0], _AT_ONCE)], 0
        )
        for strobes in (period_parts(batch, parts, refinement) for refinement in (1, 2))
    ]
    number = np.arange(1.0, 1.0 + len(_COMPARED))[:, None, None]
    mean, error = estimate.mean[subset], estimate.error[subset]
    slowest = np.min(np.where(mean < -error, -mean, np.inf), axis=1, keepdims=True)
    maybe_zero = np.abs(mean) <= error
    slow = np.sum(maybe_zero[:, int(batch.flow.autonomous) :], axis=1, keepdims=True) > 1
    slowest = np.where(slow, 1.0 / (options.transient + options.periods), slowest)
    lost = slowest * np.array(_COMPARED, float)[:, None, None]
    seen = np.where(lost < _BRIEF, 0.5 * lost, 1.0 + np.expm1(-lost) / lost)
    errors[subset] = 2.0 * np.max(change(*grown) / number / seen, axis=0)
    return estimate._replace(error=estimate.error + errors[:, :k], of_sum=errors[:, k])


def every_exponent(options: LyapunovOptions, batch: LaneBatch) -> bool:
    """Return whether all exponents are asked for, so that there is a sum rule."""
    return options.exponents >= batch.flow.exponents


def tangents(options: LyapunovOptions, batch: LaneBatch) -> int:
    """Return how many tangents are carried: one for each exponent that is wanted and not known."""
    return min(options.exponents, batch.flow.exponents - int(batch.flow.autonomous))


def program(batch: LaneBatch, k: int) -> PricedProgram:
    """Return the program of a period of k tangents, orthonormalised `_PRICED_PARTS` times; for none the map alone."""
    batch = batch.without_section()
    if not k:
        return map_alone(batch)
    state, p = batch.lanes
    state = jax.tree.map(jnp.asarray, state)
    start = jax.vmap(lambda z: begin(batch.flow, z, k))(state)
    strobes = cut_period(batch, _PRICED_PARTS)
    shared = (strobes, None, np.int32(1), np.float64(0.0))
    trips = 1.0, float(_PRICED_PARTS), *strobes.trip_counts
    return PricedProgram(advance, shared, (jax.tree.map(np.asarray, start), p), trips)


def price(options: LyapunovOptions, batch: LaneBatch) -> Price:
    """Return the price of all tangents against the map alone."""
    k = tangents(options, batch)
    return Price(program(batch, k), program(batch, 0), f"{k} tangent{'s' if k > 1 else ''}")


def classes(data: xr.Dataset) -> Int[np.ndarray, ...]:
    """Return the sign of the largest exponent, 0 where its bar covers zero, 2 where there is no exponent."""
    largest, error = (data[name].to_numpy()[..., 0] for name in ("exponents", "exponents_error"))
    sign = np.where(np.abs(largest) > error, np.sign(largest), 0.0)
    return np.where(largest < np.inf, sign, 2.0).astype(int)


ANALYSIS = Analysis(
    "lyapunov",
    LyapunovOptions,
    periods,
    run,
    stackable=True,
    choose=choose,
    classes=classes,
    smooth=("exponents", "exponents_error"),
    check=check,
    price=price,
    brief={"transient": 1, "periods": BLOCKS},
)
