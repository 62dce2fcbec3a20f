"""Doublings of a cascade beyond float64, for `accuracy.precision: extended`, and the limit of δ that they give.

The map is that of float64, with the same kicks or steps: its cascade is moved by the error of a period, and δ of every
smooth map is the same. So digits of δ cost no steps, only arithmetic. float64 finds the first doublings, and those that
follow are where the last two put them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from decimal import Decimal, localcontext
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.cascade.follow import Cascade
from jaxnh.analyses.periodic.location import REFINEMENTS, LocatedDoubling, refined_maps
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.double_double import Double
from jaxnh.maps.extended_precision import push_point
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.maps.protocol import ReturnMap
from jaxnh.orbits.bifurcations.doubling_points import DoublingPoint
from jaxnh.orbits.bifurcations.extended_doublings import (
    ExtendedPeriod,
    ExtendedPoint,
    Slopes,
    Sum,
    difference,
    extended_doubling,
    from_float64,
    next_doubling,
    predict_on_finer_map,
)
from jaxnh.systems.chart import Wrap

FLOAT64_LEVELS = 6
"""Doublings that float64 finds first: by then they have been seen to follow the law."""

_DIGITS = 60  # of the arithmetic of limits, which loses some
_FEWEST = 7  # ratios that are extrapolated: shorter sequences then still have two columns of the table
_ROUNDING = Decimal(2) ** -50  # of a width: of its norm, in float64
_MAPS = 2  # the first of the refinements
_TILE = 128  # lanes: a double-double operation is some twenty kernels
_SLOPES_TILE = 32  # lanes of derivatives: an orbit has few points


class ExtendedDoublings(NamedTuple):
    """Doublings of maps with the steps that the accuracy asks for and with twice as many.

    Attributes:
        coarse, fine: as many as were located one after the other.
    """

    coarse: tuple[ExtendedPoint, ...]
    fine: tuple[ExtendedPoint, ...]


def check_operations(batch: LaneBatch) -> None:
    """Check that extended precision has all operations of the batch's map, before anything is computed.

    Raises:
        AccuracyError: it does not.
    """
    number, section = (jax.ShapeDtypeStruct(shape, np.float64) for shape in ((), (batch.chart.dimension,)))
    u, p = Double(section, section), dict.fromkeys(batch.p, Double(number, number))
    try:
        jax.eval_shape(push_point, batch.map().as_loop(), np.int64(0), u, u, p)
    except NotImplementedError as error:
        raise AccuracyError(f"{error}, and the system has it: leave accuracy.precision out") from None


def extended_doublings(batch: LaneBatch, lanes: LaneRunner, cascade: Cascade, levels: int) -> ExtendedDoublings:
    """Locate doublings of a cascade in double-double precision, up to the first where Newton does not settle.

    Args:
        batch: lanes along the first axis.
        lanes: runs lanes.
        cascade: the first of them in float64.
        levels: how many are looked for.
    """
    maps = _maps(batch, lanes)
    known: list[tuple[ExtendedPoint, ...]] = []
    while len(known) < levels:
        with lanes.stage(f"doubling: period {cascade.period << len(known)} in extended precision", 0):
            located = _locate(maps, batch, cascade, known)
        if located is None:
            break
        known.append(located)
    return ExtendedDoublings(*zip(*known, strict=True)) if known else ExtendedDoublings((), ())


def append_extended(batch: LaneBatch, cascade: Cascade, extended: ExtendedDoublings, levels: int) -> Cascade:
    """The cascade with the doublings, rounded, that extended precision locates beyond those of float64.

    How far four times the steps move them is what they move the last one of float64 by: from one doubling to the next
    this changes by as much as they are apart, of which there is less and less.
    """
    count = len(cascade.doublings)
    pairs = [(_to_float64(coarse), _to_float64(fine)) for coarse, fine in zip(*extended, strict=True)][count:]
    shift = cascade.doublings[-1].refined[2].value - cascade.doublings[-1].refined[1].value if pairs else 0.0
    more = [LocatedDoubling((coarse, fine, fine._replace(value=fine.value + shift))) for coarse, fine in pairs]
    end = cascade.end
    if len(extended.fine) > count:
        n, last = cascade.period << len(extended.fine), extended.fine[-1].value[0]
        lost = f"{n} → {2 * n} was not located in extended precision beyond {batch.first_axis.name} = {last:.9g}"
        end = lost if len(extended.fine) < levels else ""
    low, high = batch.first_axis.values.min(), batch.first_axis.values.max()
    outside = cascade.outside or any(not low <= located.point.value <= high for located in more)
    return cascade._replace(doublings=(*cascade.doublings, *more), end=end, outside=outside)


class _Map(NamedTuple):
    """One map of a batch, a period of it.

    Attributes:
        period: in double-double precision.
        slopes: of it, in float64.
    """

    period: ExtendedPeriod
    slopes: Slopes


def _maps(batch: LaneBatch, lanes: LaneRunner) -> list[_Map]:
    """The maps, all through one program."""
    plain = [replace(batch, compensated=False).map(refinement).as_loop() for refinement in REFINEMENTS[:_MAPS]]
    exact = refined_maps(batch)[:_MAPS]
    return [_map(batch, lanes, coarse.padded_like(plain[-1]), same) for coarse, same in zip(plain, exact, strict=True)]


def _map(batch: LaneBatch, lanes: LaneRunner, plain: ReturnMap, exact: Maps) -> _Map:
    name = batch.first_axis.name

    def period(u: Sum, w: Sum, value: tuple[float, float]) -> tuple[Sum, Sum]:
        n = len(u[0])
        p = {key: Double(np.asarray(own), np.zeros(n)) for key, own in batch.at_values(np.full(n, value[0])).p.items()}
        p[name] = p[name]._replace(lo=np.full(n, value[1]))
        moved = lanes(push_point, (plain, np.int64(0)), (Double(*u), Double(*w), p), tile=_TILE)
        return tuple(moved.image), tuple(moved.vector)

    def slopes(u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"]) -> Derivatives:
        lane = (u, batch.at_values(values).p)
        return lanes(derivatives, (exact, np.int32(1)), lane, tile=_SLOPES_TILE, static=(name,))

    return _Map(period, slopes)


def _locate(
    maps: Sequence[_Map], batch: LaneBatch, cascade: Cascade, known: Sequence[tuple[ExtendedPoint, ...]]
) -> tuple[ExtendedPoint, ...] | None:
    """The doubling after those known, of each map."""
    size, wrap, level = cascade.size, batch.chart.wrap, len(known)
    points: list[ExtendedPoint | None] = []  # of the first maps, where the others start from them
    if level < len(cascade.doublings):
        starts = [from_float64(at.value, at.orbit, at.vector) for at in cascade.doublings[level].refined[:_MAPS]]
    elif level > 1 and (first := next_doubling(*maps[0], [known[0] for known in known], size, wrap)) is not None:
        points.append(first)
        starts = [predict_on_finer_map(first, known[-1][0], before, wrap) for before in known[-1][1:]]
    else:
        return None
    points += [
        extended_doubling(*family, start, size, wrap)
        for family, start in zip(maps[-len(starts) :], starts, strict=True)
    ]
    settled = tuple(point for point in points if point is not None)
    return settled if len(settled) == len(maps) else None


def _to_float64(point: ExtendedPoint) -> DoublingPoint:
    return DoublingPoint(point.value[0], point.orbit[0], point.vector[0], float(np.spacing(point.value[0])), np.nan)


def deltas(points: Sequence[ExtendedPoint]) -> tuple[list[float], list[float]]:
    """δ of the doublings but the first and the last, and what their errors make of it."""
    with localcontext(prec=_DIGITS):
        values = [_decimal(point) for point in points]
        ratios = _ratios(values)
        gaps = np.abs([float(after - before) for before, after in itertools.pairwise(values)])
    errors = np.array([point.error for point in points])
    relative = (errors[1:] + errors[:-1]) / gaps
    return [float(r) for r in ratios], [
        abs(float(r)) * (a + b) for r, a, b in zip(ratios, relative, relative[1:], strict=False)
    ]


def delta_limit(points: Sequence[ExtendedPoint]) -> tuple[float, float]:
    """δ's limit and an error that covers it, of nine doublings or more; else NaN."""
    with localcontext(prec=_DIGITS):
        values, errors = [_decimal(point) for point in points], [Decimal(point.error) for point in points]
        return _limit(values, errors, _ratios)


def alpha_limit(points: Sequence[ExtendedPoint], size: Float[np.ndarray, " d"], wrap: Wrap) -> tuple[float, float]:
    """α's limit and an error that covers it, of eight orbits of even period or more; else NaN.

    Widths are those of `doubling` in float64, of orbits known beyond it: the largest distance of two points that are
    half a period apart, in sizes of the motion, the one that falls by α a level.
    """
    with localcontext(prec=_DIGITS):
        even = [point.orbit for point in points if len(point.orbit[0]) % 2 == 0]
        apart = [difference((hi, lo), (_half_a_period_on(hi), _half_a_period_on(lo)), wrap) for hi, lo in even]
        widths = [Decimal(float(np.linalg.norm(each / size, axis=1).max())) for each in apart]
        return _limit(widths, [_ROUNDING * width for width in widths], _quotients)


def _half_a_period_on(points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    return np.roll(points, len(points) // 2, axis=0)


def _limit(
    sequence: Sequence[Decimal], errors: Sequence[Decimal], ratios: Callable[[Sequence[Decimal]], list[Decimal]]
) -> tuple[float, float]:
    """The limit of the ratios of a sequence, and an error that covers it; NaN where there are too few.

    Corrections to them are sums of geometric sequences of unknown ratios, as many as there are; the epsilon algorithm
    (Wynn, MTAC 10 (1956) 91) takes out one with every second term. The error is the most that leaving out the first,
    the last or both moves it by, and what errors of the sequence do.
    """
    if len(ratios(sequence)) < _FEWEST:
        return np.nan, np.nan

    def extrapolated(values: Sequence[Decimal]) -> Decimal:
        return _extrapolated(ratios(values))

    limit = extrapolated(sequence)
    moved = max(abs(limit - extrapolated(fewer)) for fewer in (sequence[:-1], sequence[1:], sequence[1:-1]))
    rounding = Decimal(0)
    for k, error in enumerate(errors):
        rounding += abs(extrapolated([*sequence[:k], sequence[k] + error, *sequence[k + 1 :]]) - limit)
    return float(limit), float(moved + rounding) + float(np.spacing(float(limit)))


def _decimal(point: ExtendedPoint) -> Decimal:
    return Decimal(point.value[0]) + Decimal(point.value[1])


def _ratios(values: Sequence[Decimal]) -> list[Decimal]:
    return _quotients([after - before for before, after in itertools.pairwise(values)])


def _quotients(values: Sequence[Decimal]) -> list[Decimal]:
    return [before / after for before, after in itertools.pairwise(values)]


def _extrapolated(column: list[Decimal]) -> Decimal:
    """The last entry of the last column of the epsilon table that has a limit."""
    before = [Decimal(0)] * (len(column) + 1)
    limit = column[-1]
    for order in range(1, len(column)):
        steps = [after - value for value, after in itertools.pairwise(column)]
        if not all(steps):
            break
        before, column = column, [old + 1 / step for old, step in zip(before[1:], steps, strict=False)]
        limit = column[-1] if order % 2 == 0 else limit
    return limit
