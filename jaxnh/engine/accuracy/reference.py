"""The reference that errors of one period's map are measured against: refined until it changes no more, or enough."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.engine.accuracy.sample_maps import Image, SampleMaps, Samples, differences, gaps_between

REFERENCE_STEPS = 96
"""Steps of the first reference."""

MOST_KICKS = 1 << 20
"""Evaluations of the field a period, at most."""

_ROUNDING = 1e-12  # references nearer to each other than this are the same
_ROUGH = 1e-8  # references further apart than this say nothing: more steps may yet help
_STALLED = 2  # refinements in a row that do not halve the distance: what is left is rounding
_HOPELESS = 1 << 17  # kicks: what does not converge by now may have corners, and is given little more time
_PATIENT = 5  # refinements, as corners let the distance fall unevenly
_TABLES = 4  # that the rounding of plain sums is measured on


class Reference(NamedTuple):
    """The finest map worth having.

    Attributes:
        image: of the samples.
        known: its distance from the one before in each sample, in units of the sizes.
        kicks: evaluations of the field that it takes a period.
    """

    image: Image
    known: Float[np.ndarray, " samples"]
    kicks: int


def refine_reference(
    maps: SampleMaps,
    samples: Samples,
    sizes: Float[np.ndarray, " components"],
    near: float,
    largest: Callable[[Float[np.ndarray, " samples"]], float],
) -> Reference:
    """Refine the reference of each sample until rounding is all that is left, most of them a few times only.

    That is until twice in a row the distance is not half of the least so far. Once says little, as convergence begins
    unevenly in fast motion.

    Args:
        near: of a single target what references need not be nearer to each other than.
        largest: the distance that counts, of those of all samples.
    """
    solver, steps, near = maps.scheme.reference, REFERENCE_STEPS, max(_ROUNDING, near)
    finest = maps.image(maps.of(solver, steps, compensated=True), samples)
    gaps, least = np.full((2, len(samples.row)), np.inf)
    stalled = np.zeros(len(gaps), int)
    while 1.5 * steps * solver.stages <= MOST_KICKS:
        hopeless = steps * solver.stages > _HOPELESS and not maps.scheme.smooth  # fast smooth motion still converges
        patience = np.where(gaps > _ROUGH, _PATIENT if hopeless else np.inf, _STALLED)
        open_ = np.flatnonzero((gaps > _ROUNDING) & (stalled < patience))
        # One small distance may be chance, as where the corner of a field lies in a step: all of them are not.
        if not len(open_) or largest(gaps) <= near:
            break
        steps = steps * 3 // 2
        finer = maps.image(maps.of(solver, steps, compensated=True), samples.take_lanes(open_))
        gaps[open_] = gaps_between(differences([leaf[open_] for leaf in finest], finer), sizes)
        stalled[open_] = np.where(gaps[open_] < 0.5 * least[open_], 0, stalled[open_] + 1)
        least = np.minimum(least, gaps)
        for leaf, new in zip(finest, finer, strict=True):
            leaf[open_] = new
        maps.tell(f"with {steps * solver.stages:,} kicks a period, references differ by {largest(gaps):.1e}")
    return Reference(finest, gaps, steps * solver.stages)


def rounding_of_sums(
    maps: SampleMaps,
    samples: Samples,
    sizes: Float[np.ndarray, " components"],
    kicks: int,
    largest: Callable[[Float[np.ndarray, " samples"]], float],
) -> float:
    """Error that plain sums cost the most sensitive samples, in the worst of a few tables.

    The roundings of one table may happen to be small in it; those of the lanes of the sweep will not all be.
    """
    solver, worst = maps.scheme.reference, 0.0
    for steps in (max(REFERENCE_STEPS, kicks // (2 * solver.stages)) + i for i in range(_TABLES)):
        plain, exact = (maps.image(maps.of(solver, steps, compensated=c), samples) for c in (False, True))
        gaps = gaps_between(differences(plain, exact), sizes)
        worst = max(worst, largest(np.where(np.isfinite(gaps), gaps, 0.0)))
    return worst
