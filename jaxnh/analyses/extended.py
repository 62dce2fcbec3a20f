"""Doublings of a cascade beyond float64, for `accuracy.precision: extended`, and the limit of δ that they give.

The map is that of float64, with the same kicks or steps: its cascade is moved by the error of a period, and δ of every
smooth map is the same. So digits of δ cost no steps, only arithmetic.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal, localcontext
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.cascade import Cascade
from jaxnh.analyses.locating import PERIOD_TILE, REFINEMENTS
from jaxnh.analyses.scene import LaneRunner, Scene
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.double_double import Double
from jaxnh.maps.extended_precision import carried
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.orbits.doubling_points import DoublingPoint
from jaxnh.orbits.extended_doublings import ExtendedPoint, Sum, extended_doubling

_DIGITS = 60  # of the arithmetic of limits, which loses some
_FEWEST = 9  # doublings that are extrapolated: shorter sequences then still have two columns of the table
_MAPS = 2  # the first of the refinements
_TILE = 128  # lanes: a double-double operation is some twenty kernels


class ExtendedDoublings(NamedTuple):
    """Doublings of maps with the steps that the accuracy asks for and with twice as many.

    Attributes:
        coarse, fine: as many as were found one after the other.
    """

    coarse: tuple[ExtendedPoint, ...]
    fine: tuple[ExtendedPoint, ...]


def see_that_it_can(scene: Scene) -> None:
    """See that extended precision knows all operations of the scene's map, before anything is computed.

    Raises:
        AccuracyError: it does not.
    """
    number, section = (jax.ShapeDtypeStruct(shape, np.float64) for shape in ((), (scene.system.dimension,)))
    u, p = Double(section, section), dict.fromkeys(scene.p, Double(number, number))
    try:
        jax.eval_shape(carried, scene.strobe().shortest(), np.int64(0), u, u, p)
    except NotImplementedError as error:
        raise AccuracyError(f"{error}, and the system has it: leave accuracy.precision out") from None


def extended_doublings(scene: Scene, lanes: LaneRunner, found: Cascade) -> ExtendedDoublings:
    """The doublings of a cascade in double-double precision, up to the first where Newton does not settle."""
    maps: list[tuple[ExtendedPoint, ...]] = []
    for number, refinement in enumerate(REFINEMENTS[:_MAPS]):
        points: list[ExtendedPoint] = []
        for level in found.found:
            at = level.refined[number]
            with lanes.stage(f"doubling: period {len(at.orbit)} in extended precision", 0):
                point = _located(scene, lanes, refinement, found, at)
            if point is None:
                break
            points.append(point)
        maps.append(tuple(points))
    return ExtendedDoublings(*maps)


def _located(
    scene: Scene, lanes: LaneRunner, refinement: int, found: Cascade, at: DoublingPoint
) -> ExtendedPoint | None:
    name = scene.line.name
    exact, plain = (replace(scene, compensated=sums).strobe(refinement) for sums in (True, False))
    plain = plain.shortest()

    def slopes(u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"]) -> Derivatives:
        lane = (u, scene.at(values).p)
        return lanes(derivatives, (exact, np.int32(1)), lane, tile=PERIOD_TILE, static=(name,))

    def period(u: Sum, w: Sum, value: tuple[float, float]) -> tuple[Sum, Sum]:
        n = len(u[0])
        p = {key: Double(np.asarray(own), np.zeros(n)) for key, own in scene.at(np.full(n, value[0])).p.items()}
        p[name] = p[name]._replace(lo=np.full(n, value[1]))
        moved = lanes(carried, (plain, np.int64(0)), (Double(*u), Double(*w), p), tile=_TILE)
        return tuple(moved.image), tuple(moved.vector)

    return extended_doubling(period, slopes, at, found.size, scene.system.wrap)


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
    """δ's limit and an error that covers it, of nine doublings or more; else NaN.

    Corrections to δ_k are sums of geometric sequences of unknown ratios, as many as there are; Wynn's epsilon algorithm
    (MTAC 10 (1956) 91) takes out one with every second level. Its error is the largest that leaving out the first,
    the last or both moves it by, and what errors of the doublings do.
    """
    with localcontext(prec=_DIGITS):
        values, errors = [_decimal(point) for point in points], [Decimal(point.error) for point in points]
        if len(values) < _FEWEST:
            return np.nan, np.nan
        limit = _extrapolated(values)
        moved = max(abs(limit - _extrapolated(fewer)) for fewer in (values[:-1], values[1:], values[1:-1]))
        rounding = Decimal(0)
        for k, error in enumerate(errors):
            rounding += abs(_extrapolated([*values[:k], values[k] + error, *values[k + 1 :]]) - limit)
        return float(limit), float(moved + rounding) + float(np.spacing(float(limit)))


def _decimal(point: ExtendedPoint) -> Decimal:
    return Decimal(point.value[0]) + Decimal(point.value[1])


def _ratios(values: Sequence[Decimal]) -> list[Decimal]:
    gaps = [after - before for before, after in itertools.pairwise(values)]
    return [before / after for before, after in itertools.pairwise(gaps)]


def _extrapolated(values: Sequence[Decimal]) -> Decimal:
    """The last entry of the last column of the epsilon table of δ that has a limit."""
    before, column = [Decimal(0)] * (len(values) - 1), _ratios(values)
    limit = column[-1]
    for order in range(1, len(column)):
        steps = [after - here for here, after in itertools.pairwise(column)]
        if not all(steps):
            break
        before, column = column, [old + 1 / step for old, step in zip(before[1:], steps, strict=False)]
        limit = column[-1] if order % 2 == 0 else limit
    return limit
