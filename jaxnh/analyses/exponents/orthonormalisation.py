"""Number of orthonormalisations of tangents a period, and refinement of their steps: measured on sample lanes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.exponents.period_parts import cut_period, first_part, split_stack
from jaxnh.analyses.exponents.tangent_growth import LARGEST_LOSS, LARGEST_SEEN, TangentState, average, begin
from jaxnh.maps.protocol import ReturnMap
from jaxnh.solvers import AdaptiveMethod
from jaxnh.systems.rows import spread_indices
from jaxnh.systems.state import is_finite

_MOST_PARTS = 1024
_PILOT_LANES, _PILOT_PARTS, _PILOT_PERIODS = 64, 16, 4
_TANGENT_ERROR = 1e-4  # of the logarithm of a tangent's growth a period, and of its modulus where that is above one
_TANGENT_ERRORS = 100.0  # or so many times the error of the map, of a coarse target
_MOST_REFINED = 16
_AT_REST = math.log(1e-6)  # of a lane's speed: of less, the direction is soon rounding
_LOOKS = 64  # stretches of motion, at least, over which tangents of two numbers of steps are compared


def _pilots(batch: LaneBatch) -> LaneBatch:
    """Return a sample of lanes across a sweep."""
    return batch.take(spread_indices(batch.count, _PILOT_LANES))


def parts_needed(batch: LaneBatch, lanes: LaneRunner, k: int, *, spare_last: bool = False) -> tuple[int, TangentState]:
    """Return orthonormalisations a period, a power of two, so that no tangent is lost in another between them.

    Measured on lanes across the sweep: what one sixteenth of a period does to the spread of the tangents, at most,
    bounds what a longer part does; where that is all that rounding lets one see, or where a tangent underflows, a
    smaller part is looked at. One tangent alone is looked at over whole periods. Also these lanes some periods from
    their start.

    Args:
        spare_last: whether the last tangent may be lost as long as it does not vanish (`spares_last`).
    """
    few = _pilots(batch)
    parts, seen = (_PILOT_PARTS, LARGEST_SEEN) if k > 1 else (1, LARGEST_LOSS)  # in a whole period more drowns
    first, vanished = None, False
    while True:
        state, p = few.lanes
        growth = lanes(begin, (batch.system,), (state,), static=(k,))
        # The first number of parts one at a time, through the program of a whole period, which is needed anyway;
        # without a clock parts are equal, and `average` takes them so.
        single = parts == _PILOT_PARTS and not batch.flow.autonomous
        strobes = cut_period(batch, parts)
        loss, underflows = 0.0, False
        for strobe in split_stack(strobes, cut_period(batch, 1)) * _PILOT_PERIODS if single else (strobes,):
            growth, _ = average(lanes, strobe, growth, p, 1 if single else _PILOT_PERIODS)
            last = growth.loss[-2 if spare_last else -1]
            loss = float(np.max(last, initial=loss, where=np.isfinite(last)))
            underflows |= bool(np.any(np.isnan(growth.logs) & is_finite(growth.state)))
        first = first or (parts, loss)
        if (loss < seen and not underflows) or parts == _MOST_PARTS:
            break
        vanished |= underflows
        parts *= 4
    if underflows:  # however short the parts: tangents of a lane at rest have no direction across the flow
        parts, loss = first
    least = parts if spare_last and vanished and not underflows else 1
    return int(np.clip(2 ** math.ceil(math.log2(max(parts * loss / LARGEST_LOSS, 1.0))), least, _MOST_PARTS)), growth


def refine(batch: LaneBatch, parts: int, refinement: int) -> LaneBatch:
    """Return lanes with the steps that `refinement_needed` asks for between orthonormalisations.

    Where each lane has steps of its own, what follows the tangents is that each part is cut into so many at least.
    """
    solver = batch.solver
    if refinement > 1 and isinstance(solver, AdaptiveMethod):
        solver = solver.with_least(refinement * parts)
    return replace(batch, solver=solver, steps=refinement * batch.steps)


def spares_last(batch: LaneBatch, sums: int) -> bool:
    """Return whether the last tangent need not be followed: of steps of a lane's own, with others before it.

    Implicit ones are as long as the motion is slow, however it contracts; a tangent needs a step a factor e. Volume,
    whose rate is integrated, knows the exponent without it.
    """
    return isinstance(batch.solver, AdaptiveMethod) and sums > 1


def refinement_needed(
    batch: LaneBatch, lanes: LaneRunner, growth: TangentState, parts: int, *, spare_last: bool = False
) -> int:
    """Return the factor of the steps, a power of two, beyond which doubling it does not change tangents.

    Steps that meet the target in states may be far from it in tangents, where these contract by more in one step than
    its polynomial can follow. Measured on lanes across the sweep, part by part from one state each, so that paths that
    chaos parts do not count, nor does a lane while it is at rest; of a processed method period by period, as
    between its ends are states of another map.
    """
    if not batch.target:
        return 1
    few, room = _pilots(batch), cut_period(batch, 1)
    p, refinement, enough = dict(few.p), 1, max(_TANGENT_ERROR, _TANGENT_ERRORS * batch.error_estimate)
    periods, followed = max(1, _LOOKS // parts), len(growth.logs) - int(spare_last)

    def grown(now: TangentState, pieces: Sequence[ReturnMap], each: int) -> tuple[TangentState, np.ndarray, np.ndarray]:
        """Growth over some pieces, so many times each, and that of their moduli."""
        total, moduli = np.zeros((2, 1, 1))
        for piece in pieces:
            now, logs = average(lanes, piece, now, p, each)
            total, moduli = total + each * logs, moduli + each * np.abs(logs)
        return now, total, moduli

    while refinement < _MOST_REFINED:
        count = refinement * parts
        coarse, fine = (cut_period(batch, n, n // parts) for n in (count, 2 * count))
        if batch.flow.autonomous:  # pieces are equal: of many, several at a time
            each = max(1, count // _LOOKS)
            [few_steps], [many_steps] = (split_stack(first_part(stack), room) for stack in (coarse, fine))
            stretches = [([few_steps], [many_steps], each, 2 * each)] * (count // each)
        else:
            few_steps, many_steps = split_stack(coarse, room), split_stack(fine, room)
            span = count if batch.solver.processor[1] else 1
            stretches = [
                (few_steps[i : i + span], many_steps[2 * i : 2 * (i + span)], 1, 1) for i in range(0, count, span)
            ]
        now, apart, whole = growth, *np.zeros((2, 1, 1))
        fallen, moves = np.zeros(few.count), np.ones(few.count, bool)
        for once_through, twice_through, once_each, twice_each in stretches * periods:
            _, once, _ = grown(now, once_through, once_each)
            now, twice, moduli = grown(now, twice_through, twice_each)
            with np.errstate(invalid="ignore"):  # of a tangent that has vanished in both
                apart = apart + np.where(moves[:, None], once - twice, 0.0)
                whole = whole + np.where(moves[:, None], moduli, 0.0)
            if batch.flow.autonomous:  # the first is the growth along the flow
                fallen += np.nan_to_num(twice[:, 0])
                moves = fallen > _AT_REST
        apart, whole = (np.abs(values[:, :followed]) / periods for values in (apart, whole))
        short = apart > enough * np.maximum(whole, 1.0)
        if not np.any(short & np.isfinite(apart)):
            break
        refinement *= 2
    return refinement
