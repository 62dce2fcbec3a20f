"""Attractors of a reversible flow and their images, the repellers: apart, the same set, or sets that meet.

A reversal R takes an attractor A to a repeller R(A) whose exponents are those of A with opposite signs. Where the sum
of the exponents is zero and A = R(A) the motion is conservative, where it is negative and A and R(A) are apart it is
dissipative; where it is negative and they meet without being the same there are mixed dynamics (Gonchenko and Turaev,
Proc. Steklov Inst. Math. 297 (2017) 116).

Strobes are taken at the instant t0/2, which R keeps, so that it takes the strobe points of A to those of R(A); on a
section R takes it to itself.

The rule, with σ the sum of the exponents and ε its bar of 95 %:

- sum: zero where |σ| ≤ ε and ε is small, negative or positive where |σ| > ε, else unresolved.
- sets: samples of one set are as near to each other as the halves of the record of A are (`sets`). The sets are the
  same where that holds of A and R(A), as far as numbers of points tell; apart where no point of A is as near to R(A)
  and the distance exceeds its error; overlapping where some are, and from quarters to halves of the record their share
  falls, if at all, by less than the square root of the spacing, beyond the intervals of both: that of sheets close to
  each other falls faster, and longer records may show them apart. Where the record drifts on, as on a torus near a
  resonance, they are the same or nothing is said.
- conservative: sum zero, sets the same. Dissipative: sum negative, sets apart. Mixed: sum negative, sets overlapping or
  the same. Irreversible: R is no reversal with the parameters of the lane. Undecided: everything else.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float, Int, Int8

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
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.intervals import binomial_interval
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.options.chaos import LyapunovOptions, ReversalOptions
from jaxnh.analyses.price import Price, map_alone
from jaxnh.analyses.reversal.involution import choose_reversal, image_points, images, is_reversible, reversal_of
from jaxnh.analyses.reversal.rates import Rates, of_attractor, of_repeller
from jaxnh.analyses.reversal.sets import WITHIN, SetComparison, compare_sets, overlap_interval
from jaxnh.analyses.reversal.symmetric_orbits import choose_symmetry, orbit_variables, symmetric_orbits
from jaxnh.analyses.section_points import points_at
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import reports
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.backward_motion import check_invertible
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.readout import status
from jaxnh.systems.reversal import declared_reversal, describe_reversal
from jaxnh.systems.rows import select

KINDS = ("conservative", "dissipative", "mixed", "undecided", "irreversible", "failed")
"""Meanings of the flags 0 to 5 of `kind`."""

SUMS = ("negative", "zero", "positive", "unresolved")
"""Meanings of the flags 0 to 3 of `sum_sign`."""

SETS = ("apart", "same", "overlapping", "unresolved")
"""Meanings of the flags 0 to 3 of `sets`."""

_SMALL_ERROR = 0.005 * 2 * np.pi  # of the sum a period: a bar beyond it says nothing of zero
_DEVIATIONS = 4.0  # of the number of points within the spacing, two as that is of a sample as well, and of pairs
_FINE = 0.05  # of the size: a record that drifts by less within its length shows the set
_TANGENTS = 3  # carried of most systems, for the expected work
_STAYS = 1e6  # periods that an error of the map is remembered at most on an orbit that attracts


def periods(options: ReversalOptions, lanes: int) -> float:
    """Return the lane-periods of a run; a period with tangents costs one and about two more for each."""
    settling = 2 * options.transient + options.strobes
    return float(lanes * (settling + 2 * options.periods * (1 + 2 * _TANGENTS)))


def check(options: ReversalOptions, setting: Setting) -> None:
    """Check that the flow can be followed backwards, and that what the system says of that can be read.

    Raises:
        InputError: what the system says is no reversal.
    """
    if not setting.flow.continuous:
        raise OptionError("a map is not followed backwards; a reversal is one of a flow")
    if isinstance(setting.flow, PiecewiseSmooth) and setting.flow.jumps:
        raise OptionError("whether a reversal takes jumps to jumps is not looked at: motions with jumps have none here")
    try:
        check_invertible(setting.flow)
    except TypeError as error:
        raise OptionError(str(error)) from None
    declared_reversal(setting.flow)
    if options.max_period and len(setting.axes) > 1:
        raise OptionError("symmetric orbits are looked for along one axis of a sweep", "max_period")
    shared = [axis.name for axis in setting.axes if axis.kind == "shared"]
    if options.max_period and shared:
        raise OptionError(f"symmetric orbits are of one clock, which {shared[0]} changes{setting.advice}", "max_period")


def choose(options: ReversalOptions, batch: LaneBatch, lanes: LaneRunner) -> dict[str, int]:
    """Choose the reversal, and how often tangents are orthonormalised, the same for all lanes of a sweep.

    Raises:
        OptionError: the flow has no reversal.
    """
    reversal = choose_reversal(batch)
    reversal_of(batch, reversal)  # where there is none, nothing is compiled to say so
    return {"reversal": reversal, **lyapunov.choose(_of_exponents(options, batch), batch, lanes)}


def _of_exponents(options: ReversalOptions, batch: LaneBatch) -> LyapunovOptions:
    return LyapunovOptions(transient=options.transient, periods=options.periods, exponents=batch.flow.exponents)


def run(options: ReversalOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return how the attractor of every lane lies to its image, exponents of both, and the verdict.

    Raises:
        OptionError: the flow has no reversal.
    """
    chosen = batch.chosen.get("reversal") or choose(options, batch, lanes)
    reversal = reversal_of(batch, chosen["reversal"])
    half = 0.5 * float(reversal.instant)
    reversible = is_reversible(batch, lanes, reversal)
    symmetry = choose_symmetry(batch) if options.max_period else None
    strobe, start, p = _strobe_from(batch, half), _start_at(batch, lanes, half), dict(batch.p)
    with lanes.stage(
        f"reversal: points of {batch.count} lanes", batch.count * float(options.transient + options.strobes)
    ):
        states = lanes.iterate(strobe, options.transient, (start, p))
        states = lanes.record(strobe, options.strobes, (states, p))
    points, mirrored = points_at(batch, lanes, states), image_points(batch, lanes, reversal, states)
    in_time = replace(batch.without_section(), steps=chosen.get("refinement", 1) * batch.steps)
    of_exponents, parts = _of_exponents(options, batch), chosen["parts"]
    forward = of_attractor(of_exponents, in_time, lanes, parts)
    last = images(batch, lanes, reversal, select(states, np.s_[:, -1]))
    backward = of_repeller(of_exponents, in_time, lanes, parts, last, half)
    compared = compare_sets(batch, lanes, points, mirrored, _resolution(batch, forward, options.strobes))
    ended = np.asarray(reports(batch.flow, states)["status"].data)
    variables = _variables(batch, forward, backward, compared, reversible, ended)
    if symmetry and options.max_period:
        size = np.where(batch.chart.angles, np.pi, np.max(np.abs(points), axis=1))
        size, instant = np.where(size > 0.0, size, 1.0), 0.5 * float(symmetry.reversal.instant)
        strobes = _strobe_from(batch, instant), _strobe_from(batch, instant, 2)
        with lanes.stage(f"reversal: symmetric orbits of {batch.count} lanes", 0):
            orbits = symmetric_orbits(batch, lanes, symmetry, strobes, size, options.max_period)
        variables |= orbit_variables(batch, lanes, orbits, symmetry)
    attrs = {"reversal": describe_reversal(batch.flow, reversal), "within": WITHIN, **section_attrs(batch)}
    if symmetry:
        attrs["orbit_reversal"] = describe_reversal(batch.flow, symmetry.reversal)
    return xr.Dataset(variables, attrs=attrs)


def _strobe_from(batch: LaneBatch, instant: float, refinement: int = 1) -> ReturnMap:
    """Return the map of a period from an instant of the clock on, with `refinement` times the steps."""
    if not instant:
        return batch.map(refinement)
    return _map_over(batch, (instant, instant + batch.flow.period), refinement)


def _map_over(batch: LaneBatch, span: tuple[float, float], refinement: int = 1) -> ReturnMap:
    steps = refinement * batch.steps
    made = make_return_map(batch.system, batch.solver, steps, compensated=batch.compensated, span=span)
    return in_precision(made, batch.precision)


def _start_at(batch: LaneBatch, lanes: LaneRunner, instant: float) -> Any:
    """Return the start states, brought to an instant of the clock."""
    if not instant:
        return batch.start
    return lanes(iterate, (_map_over(batch, (0.0, instant)), np.int32(1)), batch.lanes, periods=1)


def _resolution(batch: LaneBatch, rates: Rates, points: int) -> Float[np.ndarray, " lanes"]:
    """Return how far points of A and R(A) may be off by the errors of steps, in sizes of the motion.

    On an attracting orbit an error of the map is remembered for 1/(1 − e^λT) periods; where nothing attracts, errors
    add up over the record; a chaotic set is shadowed.
    """
    largest, error = rates.exponents[:, 0], rates.error[:, 0]
    with np.errstate(invalid="ignore", over="ignore"):
        kept = 1.0 / np.maximum(-np.expm1(np.minimum(largest * batch.flow.period, 0.0)), 1.0 / _STAYS)
    remembered = np.where(largest < -error, kept, np.where(largest > error, 1.0, float(points)))
    return 4.0 * batch.error_estimate * remembered


def judge_sum(rates: Rates, period: float) -> Int8[np.ndarray, " lanes"]:
    """Return the sign of the sum of the exponents, a number in `SUMS`."""
    total, error = rates.total, rates.total_error
    conditions = [total < -error, total > error, (np.abs(total) <= error) & (error * period <= _SMALL_ERROR)]
    return np.select(conditions, [0, 2, 1], 3).astype(np.int8)


def judge_sets(sets: SetComparison) -> Int8[np.ndarray, " lanes"]:
    """Return how A and R(A) lie, a number in `SETS`."""
    low, _ = binomial_interval(sets.within, sets.points)
    _, high = binomial_interval(sets.within_coarse, sets.points)
    least = sets.points * WITHIN - _DEVIATIONS * np.sqrt(sets.points * WITHIN * (1.0 - WITHIN))
    conditions = [
        ~(np.isfinite(sets.distance) & np.isfinite(sets.error)) | (sets.drifting & ~(sets.spacing < _FINE)),
        sets.within >= least,
        sets.drifting,
        (sets.within == 0) & (sets.distance > sets.error),
        low * np.sqrt(sets.coarse_spacing / sets.spacing) > high,
    ]
    return np.select(conditions, [3, 1, 3, 0, 2], 3).astype(np.int8)


def judge(sum_sign: Int8[np.ndarray, " lanes"], sets: Int8[np.ndarray, " lanes"]) -> Int8[np.ndarray, " lanes"]:
    """Apply the rule of this module: numbers in `KINDS` from those in `SUMS` and `SETS`."""
    negative, zero = sum_sign == SUMS.index("negative"), sum_sign == SUMS.index("zero")
    apart, same, overlapping = (sets == SETS.index(word) for word in ("apart", "same", "overlapping"))
    conditions = [zero & same, negative & apart, negative & (same | overlapping)]
    return np.select(conditions, [0, 1, 2], KINDS.index("undecided")).astype(np.int8)


def _variables(
    batch: LaneBatch,
    forward: Rates,
    backward: Rates,
    compared: SetComparison,
    reversible: np.ndarray,
    ended: Int[np.ndarray, " lanes"],
) -> dict[str, Entry]:
    """Return all variables; rates of the repeller are those of the flow, which are those backwards with other signs."""
    rate, each = rate_attrs(batch.flow), (LANE, "exponent")
    sum_sign, sets = judge_sum(forward, batch.flow.period), judge_sets(compared)
    kind = np.where(reversible, judge(sum_sign, sets), KINDS.index("irreversible"))
    kind = np.where(ended > 0, KINDS.index("failed"), kind)
    low, high = overlap_interval(compared)
    shares = (compared.within / compared.points, low, high)
    known = np.isfinite(compared.distance) & reversible
    overlap, low, high, distance, error, spacing = (
        np.where(known, values, np.nan) for values in (*shares, compared.distance, compared.error, compared.spacing)
    )
    sizes = "in sizes of the motion: the largest modulus of each coordinate, of an angle pi"
    words = "number of the exponent, that of the attractor largest first"
    exponents = forward.exponents.shape[1]
    return {
        "exponent": variable("exponent", np.arange(1, exponents + 1), words),
        "kind": flag(LANE, kind, "attractor and repeller together", KINDS),
        "sum_sign": flag(LANE, sum_sign, "sign of the sum of the exponents beyond its error", SUMS),
        "sets": flag(LANE, np.where(known, sets, 3), "how the attractor lies to its image under the reversal", SETS),
        "distance": variable(
            LANE,
            distance,
            "largest distance of a point of the attractor from its image under the reversal",
            comment=sizes,
        ),
        "distance_error": variable(
            LANE, error, "error of the distance, from the halves of the record and the steps", comment=sizes
        ),
        "overlap": variable(
            LANE, overlap, "share of the points of the attractor that are as near to its image as to itself"
        ),
        "overlap_low": variable(LANE, low, "lower end of the interval of 95 % of the overlap"),
        "overlap_high": variable(LANE, high, "upper end of the interval of 95 % of the overlap"),
        "spacing": variable(
            LANE, spacing, "distance of points of the attractor from another sample of it", comment=sizes
        ),
        "exponents": variable(each, forward.exponents, "Lyapunov exponents of the attractor", **rate),
        "exponents_error": variable(each, forward.error, "error of the exponents at 95 %", **rate),
        "repeller_exponents": variable(
            each, -backward.exponents, "Lyapunov exponents of the repeller, by integration backwards in time", **rate
        ),
        "repeller_exponents_error": variable(
            each, backward.error, "error of the exponents of the repeller at 95 %", **rate
        ),
        "exponent_sum": variable(LANE, forward.total, "sum of the exponents of the attractor", **rate),
        "exponent_sum_error": variable(LANE, forward.total_error, "error of the sum at 95 %", **rate),
        "status": as_variable(LANE, status(ended)),
    }


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return how many lanes are of each kind, and the range of their sums, distances and overlaps."""
    heads = {"sum of exponents": "exponent_sum", "distance": "distance", "overlap": "overlap"}
    columns = {head: data[name].to_numpy() for head, name in heads.items()}
    caption = f"reversal: {data.attrs.get('reversal', '')}"
    return table_of_kinds("Attractors and their images", data, KINDS, columns, caption)


def price(options: ReversalOptions, batch: LaneBatch) -> Price:
    """Return the price of the tangents, which are carried forward and as long backward."""
    k = lyapunov.tangents(_of_exponents(options, batch), batch)
    return Price(lyapunov.program(batch, k), map_alone(batch.without_section()), f"{k} tangents, forward and backward")


ANALYSIS = Analysis(
    "reversal",
    ReversalOptions,
    periods,
    run,
    independent=lambda options: not options.max_period,
    choose=choose,
    classes=kind_of_lanes,
    check=check,
    table=table,
    price=price,
    brief={"transient": 1, "strobes": 64, "periods": BLOCKS},
)
