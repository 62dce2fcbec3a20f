"""One verdict a lane from all criteria together: what kind of motion it is, or undecided, or failed.

The rule, with λ1 the largest exponent, ε its error bar of 95 % (`exponents.errors`), n the period by Newton (0:
none up to the limit), μ its largest multiplier, K the 0–1 test, T the strobe period and N the periods that λ1 was
averaged over:

- failed: the state is not finite.
- periodic: n > 0 and |μ| < 1; λ1 agrees with ln|μ|/(nT) within ε + 4/(NT), the second being what a finite average keeps
  of how the lane came to its orbit; and K < 0.5.
- chaotic: n = 0, (λ1 − ε) NT > 2 ln N, K > 0.5, and the motion still does not repeat itself in a run ten times as long.
- hyperchaotic: chaotic, and the second exponent passes the same test as the first (Roessler, Phys. Lett. A 71 (1979)
  155).
- quasiperiodic: n = 0, |λ1| ≤ ε with ε ≤ 0.005 · 2π/T, and K < 0.5, in a flow that knows the time; and smooth averages
  over four runs, one after the other, agree.
- equilibrium, limit_cycle: of a flow without a clock, what is at rest (`equilibria.detection`), or else periodic and
  not dying down.
- undecided: everything else, that is whenever the criteria disagree.

On a torus tangents grow in proportion to time, so that λ1 is positive in any finite average: ln N / NT, and twice that
allows for a shear of up to N. Chaos may be a transient: near a window it lasts thousands of periods. So lanes that look
chaotic are followed, by the map alone, for `longer` times as long as the criteria took, and then no lag of up to
512 periods may bring 512 points back to within 10⁻⁶ of the extent that the motion had in the beginning: chaos with
λ1 T > 0.05 parts points from 10⁻¹⁶ to more than that within as many periods.

Chaos may be weak: with λ1 T < 0.01, as in layers about the separatrices of conservative motion, λ1 is zero within an
honest error for thousands of periods, and K is small. Averages under a smooth window tell it from a torus (Das and
co-workers, Nonlinearity 30 (2017) 4111; Sander and Meiss, Physica D 411 (2020) 132569): over N periods of a torus they
converge faster than any power of N, of chaos no faster than N^(−1/2). So lanes that look quasiperiodic are followed by
the map alone for `longer` times as long as the criteria took, in four runs. The third difference of their averages,
which leaves out what grows like a polynomial (angles that turn on, energy that an integrator loses), has to be below
10⁻⁵ of the size of the motion.

On a section T is the mean time of a return, n counts crossings, and λ1 is the largest exponent across the flow: that
along it is zero.

Where all exponents are known `phase_volume` says if the motion keeps volume: conservative where their sum σ is zero
within its bar ε along the whole run, be the divergence zero everywhere or on the average, and ε is small: as above, and
of chaos also below λ1/10, so that less than a tenth of a dimension may be lost unseen (Kaplan and Yorke). Dissipative
where σ < −ε, expanding where σ > ε.

Where there is a clock, but the right-hand side is the same at all times, the strobe is no part of the motion: a limit
cycle, whose own period the strobe does not share, looks quasiperiodic on it. If there λ1 is zero as above and λ2
negative, by as much in the other direction, it is a limit cycle; else undecided.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Int8

from jaxnh.analyses.base import LANE, Analysis, as_variable, flag, kind_of_lanes, number_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.equilibria.detection import detect_equilibrium
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import VerdictOptions
from jaxnh.analyses.price import Price, map_alone
from jaxnh.analyses.section_points import points_and_end
from jaxnh.analyses.window_averages import average_window, extents
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.systems.chart import wrap_angle
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.readout import status
from jaxnh.systems.rows import select
from jaxnh.systems.state import State
from jaxnh.systems.status import NOT_FINITE

KINDS = (
    "periodic", "quasiperiodic", "chaotic", "undecided", "failed", "equilibrium", "limit_cycle", "hyperchaotic",
)  # fmt: skip
"""Meanings of the flags 0 to 7 of `kind`."""

VOLUMES = ("unknown", "conservative", "dissipative", "expanding")
"""Meanings of the flags 0 to 3 of `phase_volume`."""

_LOOKS = 5
_SMALL_ERROR = 0.005 * 2 * np.pi  # of an exponent a period
_SUPERSTABLE = 1e-6  # multiplier of an orbit of a map whose exponent is minus infinity, with what rounding leaves in it
_COMING = 4.0
_LONGEST = 512  # lags that a motion may repeat itself after, and points that have to come back
_BACK = 1e-6  # of the extent of the points
_PERIODIC, _QUASIPERIODIC, _CHAOTIC, _UNDECIDED, _FAILED, _EQUILIBRIUM, _LIMIT_CYCLE, _HYPERCHAOTIC = range(len(KINDS))
_RETURNS = 64  # over which the mean time of one is taken
_LOST = -2
_UNSEEN_LOSS = 0.1  # of a dimension of chaos
_STEADY = 1e-5  # of the size of what averages are taken of
_SHARE, _USUAL = 0.2, 1536  # of lanes that look chaotic, and how long their criteria took: for the expected work


def run(options: VerdictOptions, batch: LaneBatch, lanes: LaneRunner, done: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Return the verdict of every lane from the datasets `period`, `lyapunov` and `chaos01` of the same lanes."""
    period, lyapunov = done["period"], done["lyapunov"]
    exponents, errors = lyapunov["exponents"].to_numpy(), lyapunov["exponents_error"].to_numpy()
    span, n, clock = lyapunov["averaging_periods"].to_numpy(), period["period"].to_numpy(), not batch.flow.autonomous
    transient = max(int(done[name].attrs["transient"]) for name in ("period", "chaos01"))
    largest, error = (exponents[:, 0], errors[:, 0]) if clock else largest_across(exponents, errors)
    second, second_error = second_across(exponents, errors, clock)
    each = np.full(batch.count, batch.flow.period) if clock else _return_times(batch, lanes, n, transient)
    iterates = span * (batch.flow.period / each)
    kind = judge(
        n,
        period["multiplier"].to_numpy(),
        period["status"].to_numpy() > 0,
        largest,
        error,
        done["chaos01"]["k_median"].to_numpy(),
        each,
        iterates,
    )
    if clock:
        steady = find_timeless(batch, lanes, np.flatnonzero(kind == _QUASIPERIODIC))
        cycle = is_contracting(exponents[steady], errors[steady], batch.flow.period, span[steady])
        kind[steady] = np.where(cycle, _LIMIT_CYCLE, _UNDECIDED)
    else:
        others = np.flatnonzero(np.isin(kind, (_PERIODIC, _UNDECIDED, _FAILED)))
        kind[others] = _classify_without_clock(batch.take(others), lanes, kind[others], int(span.max()))
    unsteady = np.full(batch.count, np.nan)
    tori = np.flatnonzero(kind == _QUASIPERIODIC)
    if len(tori):
        taken = math.ceil(span[tori].max()) + transient
        unsteady[tori] = unsteadiness(
            batch.take(tori).without_section(), lanes, taken, max(options.confirmation_factor, 1) * taken
        )
        kind[tori[~(unsteady[tori] <= _STEADY)]] = _UNDECIDED
    again = np.full(batch.count, -1)
    chaotic = np.flatnonzero(kind == _CHAOTIC)
    if options.confirmation_factor and len(chaotic):
        taken = (span if clock else np.full(batch.count, math.ceil(iterates[chaotic].max())))[chaotic] + transient
        again[chaotic] = _recurrences(batch.take(chaotic), lanes, options.confirmation_factor * taken)
        kind[chaotic[again[chaotic] != 0]] = _UNDECIDED
    kind[(kind == _CHAOTIC) & exceeds_shear(second, second_error, iterates, each)] = _HYPERCHAOTIC
    volume = judge_volume(lyapunov, largest, error, each)
    return _dataset(options, batch, done, {"kind": kind, "volume": volume, "lag": again, "unsteady": unsteady})


def _dataset(
    options: VerdictOptions, batch: LaneBatch, done: Mapping[str, xr.Dataset], columns: Mapping[str, np.ndarray]
) -> xr.Dataset:
    """Return the variables of all lanes."""
    kind = columns["kind"]
    codes = np.max([done[name]["status"].to_numpy() for name in ANALYSIS.options.needs], axis=0)
    codes = np.where(kind == _FAILED, np.where(codes > 0, codes, NOT_FINITE), 0)
    words = f"lag, up to {_LONGEST}, after which a lane that had looked chaotic repeats itself"
    steady_words = "third difference of smooth averages, of the motion's size, where it looks quasiperiodic"
    variables = {
        "kind": flag(LANE, kind, "kind of motion from all criteria together", KINDS),
        "status": as_variable(LANE, status(codes)),
        "phase_volume": flag(LANE, columns["volume"], "what becomes of phase volume along the motion", VOLUMES),
        "recurrence_lag": number_variable(
            LANE, columns["lag"], words, ("lost", "not_followed", "none"), _LOST, counted_in=iterate_units(batch.system)
        ),
        "unsteadiness": variable(LANE, columns["unsteady"], steady_words),
    }
    return xr.Dataset(variables, attrs={"confirmation_factor": options.confirmation_factor})


def largest_across(
    exponents: Float[np.ndarray, "lanes k"], errors: Float[np.ndarray, "lanes k"]
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the largest exponent other than the zero one along the flow, and its error, both (lanes,).

    Where that is the only one, nothing is known of it.
    """
    known = (exponents == 0.0) & (errors == 0.0)
    known &= np.cumsum(known, axis=1) == 1
    best = np.argmin(known, axis=1)[:, None]  # the first other one: they are sorted
    none = known.all(axis=1)
    largest, error = (np.take_along_axis(values, best, axis=1)[:, 0] for values in (exponents, errors))
    return np.where(none, 0.0, largest), np.where(none, np.inf, error)


def second_across(
    exponents: Float[np.ndarray, "lanes k"], errors: Float[np.ndarray, "lanes k"], clock: bool
) -> tuple[Float[np.ndarray, " lanes"], Float[np.ndarray, " lanes"]]:
    """Return the second largest exponent, that along the flow aside, and its error, both (lanes,).

    Where it is not known it is zero, and the error infinite.
    """
    aside = np.zeros(exponents.shape, bool)
    if not clock:
        aside = (exponents == 0.0) & (errors == 0.0)
        aside &= np.cumsum(aside, axis=1) == 1
    counted = np.cumsum(~aside, axis=1)
    crossing = ~aside & (counted == 2)
    known, place = crossing.any(axis=1), np.argmax(crossing, axis=1)[:, None]
    second, error = (np.take_along_axis(values, place, axis=1)[:, 0] for values in (exponents, errors))
    return np.where(known, second, 0.0), np.where(known, error, np.inf)


def judge_volume(
    lyapunov: xr.Dataset,
    largest: Float[np.ndarray, " lanes"],
    error: Float[np.ndarray, " lanes"],
    each: Float[np.ndarray, " lanes"] | float,
) -> Int8[np.ndarray, " lanes"]:
    """Return the flags of `VOLUMES`, from the sum of all exponents and the largest one across the flow.

    Args:
        lyapunov: the dataset of the lanes; without `exponent_sum` nothing is known.
        each: time of an iterate.
    """
    if "exponent_sum" not in lyapunov:
        return np.zeros(len(largest), np.int8)
    total, bar = (lyapunov[name].to_numpy() for name in ("exponent_sum", "exponent_sum_error"))
    small = (bar * each <= _SMALL_ERROR) & ~((largest > error) & (bar > _UNSEEN_LOSS * largest))
    conditions = [(np.abs(total) <= bar) & small, total < -bar, (total > bar) & (total < np.inf)]
    return np.select(conditions, [1, 2, 3], 0).astype(np.int8)


def _return_times(
    batch: LaneBatch, lanes: LaneRunner, n: Int[np.ndarray, " lanes"], transient: int
) -> Float[np.ndarray, " lanes"]:
    """Return the mean time of a return to the section, for a periodic lane over whole turns of its orbit."""
    count = np.where(n > 0, n * -(-_RETURNS // np.maximum(n, 1)), _RETURNS)
    with lanes.stage(f"verdict: returns of {batch.count} lanes", float(np.sum(transient + count))):
        shared, each = (batch.strobe(), np.int32(transient)), (*batch.lanes, count.astype(np.int32))
        return lanes(_time_of_returns, shared, each, periods=transient + _RETURNS) / count


def _time_of_returns(strobe: ReturnMap, transient: ArrayLike, state: State, p: Parameters, count: Array) -> Array:
    """Return the time that `count` returns take after a transient, for one lane."""
    start = iterate(strobe, transient, state, p)
    return iterate(strobe, count, start, p).t - start.t


def _classify_without_clock(
    batch: LaneBatch, lanes: LaneRunner, kind: Int8[np.ndarray, " lanes"], units: int
) -> Int8[np.ndarray, " lanes"]:
    """Return the kinds of lanes of an autonomous flow that are neither chaotic nor quasiperiodic."""
    if not len(kind):
        return kind
    with lanes.stage(f"verdict: detecting equilibria of {batch.count} lanes", batch.count * units):
        rest = detect_equilibrium(batch, lanes, units)
        still, fading = rest.still, rest.fading
    cycle = np.where(fading, _UNDECIDED, _LIMIT_CYCLE)
    return np.where(still, _EQUILIBRIUM, np.where(kind == _PERIODIC, cycle, kind)).astype(np.int8)


def find_timeless(batch: LaneBatch, lanes: LaneRunner, which: Int[np.ndarray, " some"]) -> Int[np.ndarray, " timeless"]:
    """Return the lanes of a subset whose right-hand side is the same at all times; none of a map, which has none."""
    if not len(which) or not batch.flow.continuous:
        return which[:0]
    times = batch.flow.period * (np.arange(_LOOKS) + 0.3) / _LOOKS
    state, p = select(batch.lanes, which)
    states = lanes.record(batch.strobe(), _LOOKS, (state, p))
    return which[lanes(ignores_time, (batch.flow, times), (states, p))]


def _recurrences(batch: LaneBatch, lanes: LaneRunner, taken: Int[np.ndarray, " lanes"]) -> Int[np.ndarray, " lanes"]:
    """Return the `recurrence_lag` of lanes, each so many periods from its start."""
    lags = np.zeros(batch.count, int)
    with lanes.stage(f"verdict: following {batch.count} chaotic lanes", float(np.sum(taken + 3 * _LONGEST))):
        for count in np.unique(taken):
            group = np.flatnonzero(taken == count)
            lags[group] = recurrence_lags(batch.take(group), lanes, int(count))
    return lags


def unsteadiness(batch: LaneBatch, lanes: LaneRunner, start: int, count: int) -> Float[np.ndarray, " lanes"]:
    """Return the largest third difference of smooth averages over four runs of `count`/4 periods, in sizes.

    The first begins so many periods from the start. Averages are those of `window_averages`. Not a number where a lane
    is lost.
    """
    each = BLOCKS * max(count // (2 * BLOCKS), 1)
    with lanes.stage(f"verdict: following {batch.count} quasiperiodic lanes", batch.count * (start + 2 * each)):
        state = lanes.iterate(batch.strobe(), start, batch.lanes)
        first = average_window(batch, lanes, state, each)
        second = average_window(batch, lanes, first.state, each)
    low, high = np.minimum(first.low, second.low), np.maximum(first.high, second.high)
    runs = np.concatenate([first.halves, second.halves], axis=1)
    change = np.abs(runs[:, 0] - 3.0 * runs[:, 1] + 3.0 * runs[:, 2] - runs[:, 3])
    with np.errstate(invalid="ignore"):
        return np.max(change / extents(np.array(batch.flow.chart.angles), low, high), axis=1)


def recurrence_lags(batch: LaneBatch, lanes: LaneRunner, count: int) -> Int[np.ndarray, " lanes"]:
    """Return the least lag up to `_LONGEST` at which as many points, `count` periods from the start, recur; 0: none.

    Of a lane that does not come so far `_LOST`.
    """
    early = points_and_end(batch, lanes, batch.start, 0, _LONGEST)[0][:, _LONGEST // 2 :]
    points = points_and_end(batch, lanes, batch.start, count, 2 * _LONGEST)[0]
    near = _BACK * np.max(np.ptp(early, axis=1), axis=1)
    return lanes(_recurrence_lag, (), (points, near), static=(batch.chart.angles,))


def _recurrence_lag(points: Float[Array, "points d"], near: Array, angles: tuple[bool, ...]) -> Array:
    longest = len(points) // 2

    def back(lag: Array) -> Array:
        moved = lax.dynamic_slice_in_dim(points, lag, longest) - points[:longest]
        return jnp.max(jnp.abs(jnp.where(np.array(angles), wrap_angle(moved), moved))) <= near

    returns = lax.map(back, jnp.arange(1, longest + 1))
    lag = jnp.where(jnp.any(returns), 1 + jnp.argmax(returns), 0)
    return jnp.where(jnp.all(jnp.isfinite(points)), lag, _LOST)


def ignores_time(flow: Flow, times: Float[Array, " times"], states: State, p: Parameters) -> Array:
    """Return whether the right-hand side of a lane is the same at all times, to the bit, in some states."""

    def rates(t: Array) -> State:
        return jax.vmap(lambda y: flow.rhs(t, y, p))(states)

    same = [jnp.all(leaf == leaf[:1]) for leaf in jax.tree.leaves(jax.vmap(rates)(times))]
    return jnp.all(jnp.stack(same))


def is_contracting(
    exponents: Float[np.ndarray, "lanes k"],
    errors: Float[np.ndarray, "lanes k"],
    strobe_period: float,
    averaged: Int[np.ndarray, " lanes"],
) -> Bool[np.ndarray, " lanes"]:
    """Return whether the second exponent is known, and negative beyond what a torus leaves in a finite average."""
    if exponents.shape[1] < 2:
        return np.zeros(len(exponents), bool)
    return (exponents[:, 1] + errors[:, 1]) * averaged * strobe_period < -2.0 * np.log(averaged)


def exceeds_shear(
    largest: Float[np.ndarray, " lanes"],
    error: Float[np.ndarray, " lanes"],
    iterates: Float[np.ndarray, " lanes"] | Int[np.ndarray, " lanes"] | int,
    each: Float[np.ndarray, " lanes"] | float,
) -> Bool[np.ndarray, " lanes"]:
    """Return whether an exponent averaged over so many iterates is above what shear on a torus leaves in it."""
    return (largest - error) * (iterates * each) > 2.0 * np.log(iterates)


def nearly_zero(
    largest: Float[np.ndarray, " lanes"], error: Float[np.ndarray, " lanes"], each: Float[np.ndarray, " lanes"] | float
) -> Bool[np.ndarray, " lanes"]:
    """Return whether an exponent is zero within a small error, with the time of an iterate."""
    return (np.abs(largest) <= error) & (error * each <= _SMALL_ERROR)


def judge(
    period: Int[np.ndarray, " lanes"],
    multiplier: Float[np.ndarray, " lanes"],
    failed: Bool[np.ndarray, " lanes"],
    largest: Float[np.ndarray, " lanes"],
    error: Float[np.ndarray, " lanes"],
    k: Float[np.ndarray, " lanes"],
    each: Float[np.ndarray, " lanes"] | float,
    iterates: Float[np.ndarray, " lanes"] | Int[np.ndarray, " lanes"],
) -> Int8[np.ndarray, " lanes"]:
    """Apply the rule of this module: flags of `KINDS`, from the time of an iterate and how many were averaged."""
    with np.errstate(divide="ignore", invalid="ignore"):
        time = iterates * each
        expected = np.log(multiplier) / (np.maximum(period, 1) * each)
        agrees = np.abs(largest - np.maximum(expected, -1e3)) <= error + _COMING / time
    agrees |= (largest == -np.inf) & (multiplier < _SUPERSTABLE)
    regular = k < 0.5
    conditions = [
        failed | ~(largest < np.inf),
        (period > 0) & (multiplier < 1.0) & agrees & regular,
        (period == 0) & exceeds_shear(largest, error, iterates, each) & ~regular,
        (period == 0) & nearly_zero(largest, error, each) & regular,
    ]
    return np.select(conditions, [_FAILED, _PERIODIC, _CHAOTIC, _QUASIPERIODIC], _UNDECIDED).astype(np.int8)


def price(options: VerdictOptions, batch: LaneBatch) -> Price:
    """Return the price: the map alone, for lanes that look chaotic, whose number is not known beforehand."""
    return Price(None, map_alone(batch), "not measured: the map alone, for lanes that look chaotic")


ANALYSIS = Analysis(
    "verdict",
    VerdictOptions,
    lambda options, lanes: _SHARE * lanes * (options.confirmation_factor * _USUAL + 3 * _LONGEST),
    run,
    classes=kind_of_lanes,
    price=price,
)
