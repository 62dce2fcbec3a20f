"""The reference that errors of one period's map are measured against: refined until it changes no more, or enough."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.engine.accuracy.diagnostics import explain_motion, order_on_motion
from jaxnh.engine.accuracy.sample_maps import Image, SampleMaps, Samples, differences, gaps_between
from jaxnh.systems.rows import write_rows

MOST_KICKS = 1 << 20
"""Evaluations of the field a period, at most."""

_ROUNDING = 1e-12  # references nearer to each other than this are the same
_ROUGH = 1e-8  # references further apart than this say nothing: more steps may yet help
_STALLED = 2  # refinements in a row that do not halve the distance: what is left is rounding
_HOPELESS = 1 << 17  # kicks: what does not converge by now may have corners, and is given little more time
_PATIENT = 5  # refinements, as corners let the distance fall unevenly
_NEAR = 0.1  # of the target: nearer references are not needed, as the error is taken twice
_SUSPECT = 1 << 14  # kicks: where references still differ, the field may jump
_ENLARGED = 1 << 16  # kicks: where references come no nearer to each other by now, the motion enlarges everything
_HOPELESS_BY = 10.0  # times the target: about what the most steps would leave, where that is no use
_TABLES = 4  # that the rounding of plain sums is measured on

NO_MATTER = 0.01
"""Share of an error below which rounding in a table decides nothing; nor does that in others."""


class Reference(NamedTuple):
    """The finest map worth having.

    Attributes:
        image: of the samples.
        known: its distance from the one before in each sample, in units of the sizes.
        kicks: evaluations of the field that it takes a period.
        unresolved: whether a unit of time is so long that its motion enlarges everything, and a part of it should do.
    """

    image: Image
    known: Float[np.ndarray, " samples"]
    kicks: int
    unresolved: bool = False


def refine_reference(
    maps: SampleMaps,
    samples: Samples,
    sizes: Float[np.ndarray, " components"],
    target: float,
    largest_at: Callable[[Float[np.ndarray, " samples"]], int],
    pay: Callable[[int, Samples, int], None],
) -> Reference:
    """Refine the reference of each sample until rounding is all that is left, most of them a few times only.

    That is until twice in a row the distance is not half of the least so far. Once says little, as convergence begins
    unevenly in fast motion. Where the field jumps or has a corner on the motion that errs most, and the most steps
    there can be would not do, no more are tried.

    Args:
        target: the only one that will be asked for, as far as which references are refined; 0 where any may be.
        largest_at: the sample whose distance counts, of those of all samples.
        pay: called before each refinement with the evaluations of the field a period, the samples, and the number of
            that which errs most; may raise `TooDearError`.
    """
    solver, steps, near = maps.scheme.reference, maps.scheme.first_steps, max(_ROUNDING, _NEAR * target)
    order, unresolved = 0.0, False  # not known yet
    finest = maps.image(maps.of(solver, steps, compensated=True), samples)
    gaps, least = np.full((2, len(samples.row)), np.inf)
    stalled = np.zeros(len(gaps), int)
    while 1.5 * steps * solver.stages <= MOST_KICKS and 1.5 * steps <= solver.most_steps(MOST_KICKS) + 1:
        hopeless = steps * solver.stages > _HOPELESS and not maps.scheme.smooth  # fast smooth motion still converges
        patience = np.where(gaps > _ROUGH, _PATIENT if hopeless else np.inf, _STALLED)
        active = np.flatnonzero((gaps > _ROUNDING) & (stalled < patience))
        # One small distance may be chance, as where the corner of a field lies in a step: all of them are not.
        worst = largest_at(gaps)
        if not len(active) or gaps[worst] <= near:
            break
        kicks = steps * solver.stages
        pay(kicks, samples, worst)
        if target and kicks > _SUSPECT and gaps[worst] > _ROUGH and not maps.scheme.smooth:
            sample = samples.take_lanes(np.array([worst]))
            order = order or order_on_motion(maps, sample)
            if order < math.inf and gaps[worst] * (kicks / MOST_KICKS) ** order > _HOPELESS_BY * target:
                break
            enlarged = maps.may_be_cut and kicks > _ENLARGED and stalled[worst] >= _STALLED
            if enlarged and not explain_motion(maps, sample):
                unresolved = True
                break
        steps = steps * 3 // 2
        finer = maps.image(maps.of(solver, steps, compensated=True), samples.take_lanes(active))
        gaps[active] = gaps_between(differences([leaf[active] for leaf in finest], finer), sizes)
        stalled[active] = np.where(gaps[active] < 0.5 * least[active], 0, stalled[active] + 1)
        least = np.minimum(least, gaps)
        write_rows(finest, active, finer)
        most = gaps[largest_at(gaps)]
        maps.tell(f"with {steps * solver.stages:,} evaluations of the field a period, references differ by {most:.1e}")
    return Reference(finest, gaps, steps * solver.stages, unresolved)


def roundings_of_sums(
    maps: SampleMaps,
    samples: Samples,
    sizes: Float[np.ndarray, " components"],
    kicks: int,
    largest: Callable[[Float[np.ndarray, " samples"]], float],
) -> Iterator[float]:
    """Errors that plain sums cost the most sensitive samples, in each of a few tables.

    The roundings of one table may happen to be small in it; those of the lanes of the sweep will not all be. They are
    within a few times of each other, so that one far below what decides is enough (`NO_MATTER`).
    """
    solver = maps.scheme.reference
    for steps in (max(maps.scheme.first_steps, kicks // (2 * solver.stages)) + i for i in range(_TABLES)):
        plain, exact = (maps.image(maps.of(solver, steps, compensated=c), samples) for c in (False, True))
        gaps = gaps_between(differences(plain, exact), sizes)
        yield largest(np.where(np.isfinite(gaps), gaps, 0.0))
