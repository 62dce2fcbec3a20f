"""Verdicts on hyperbolicity, from angles between subspaces of covariant vectors along motions and their exponents.

Where stable and unstable subspaces are tangent somewhere on an attractor of a smooth map, motions come near the
tangency, and their angles have a density that does not vanish at zero (Kuptsov, Phys. Rev. E 85 (2012) 015203). Below
an eighth of the angle that one in twenty fall short of, an eighth of these are expected then. A good part of them is
what a tangency leaves. None at all, of many expected, bounds the angle away from zero, unless the smallest angle still
falls with the length of the run: where a tangency is in a part of the attractor that motions seldom visit, as near
the stable manifold of an equilibrium, few points are far below the others.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int8

from jaxnh.analyses.covariant.least_angles import LeastAngles

SPLITS = ("bounded", "tangent", "undecided")
"""Meanings of the flags 0 to 2 of `tangency`."""

KINDS = ("hyperbolic", "pseudohyperbolic", "tangent", "regular", "undecided", "failed")
"""Meanings of the flags 0 to 5 of `kind`."""

BOUNDED, TANGENT, UNDECIDED = range(len(SPLITS))

_SHARE, _NEARER = 0.05, 8.0  # of the angles, below whose largest they are counted; how much nearer to zero
_ENOUGH = 5.0  # expected angles: none of them is seen by chance once in 150 times
_GOOD_PART = 0.25
_HALF = 0.5
_TREND, _FURTHER = 16, 4  # the smallest angle beside that of so many times fewer points; times as far in ln(length)


def judge_splits(angles: Float[np.ndarray, "lanes splits points"]) -> Int8[np.ndarray, "lanes splits"]:
    """Return whether each angle is bounded away from zero, numbers in `SPLITS`.

    The smallest angle of so many times fewer points is about the 16th of all. If the smallest one goes on to fall as it
    does from there, in proportion to the logarithm of the length, it is above zero in a run 16⁴ times as long.
    """
    expected = _SHARE * angles.shape[-1] / _NEARER
    count = np.sum(angles < small_angles(angles)[..., None], axis=-1)
    lowest = np.partition(angles, (0, _TREND - 1), axis=-1)
    smallest, before = lowest[..., 0], lowest[..., _TREND - 1]
    stays = smallest > _FURTHER * (before - smallest)
    conditions = [
        (count == 0) & stays & (expected >= _ENOUGH),
        (count >= _GOOD_PART * expected) & (expected >= _ENOUGH),
    ]
    return np.select(conditions, [BOUNDED, TANGENT], UNDECIDED).astype(np.int8)


def exponents_alike(
    exponents: Float[np.ndarray, "lanes d"], error: Float[np.ndarray, "lanes d"]
) -> Bool[np.ndarray, "lanes splits"]:
    """Return where an exponent and the next may be equal, as at a focus: their directions are none of the motion's."""
    return ~(exponents[:, :-1] - exponents[:, 1:] > error[:, :-1] + error[:, 1:])


def small_angles(angles: Float[np.ndarray, "lanes splits points"]) -> Float[np.ndarray, "lanes splits"]:
    """Return an eighth of the angles that one in twenty fall short of."""
    return np.quantile(angles, _SHARE, axis=-1) / _NEARER


def judge_search(
    splits: Int8[np.ndarray, " lanes"], least: LeastAngles, smallest: Float[np.ndarray, " lanes"]
) -> Int8[np.ndarray, " lanes"]:
    """Return what is so of angles after a search beside the motions, numbers in `SPLITS`.

    A change of sign is a tangency. An angle that the motions say is bounded is not known to be, where the search
    comes to less than half of the smallest one of the motions, or if it would come to zero going on as in its second
    half for four times as long.

    Args:
        smallest: angle of the motions.
    """
    falls = least.angle <= _FURTHER * (least.before - least.angle)
    doubtful = (splits == BOUNDED) & (falls | (least.angle < _HALF * smallest))
    return np.select([least.crossed, doubtful], [TANGENT, UNDECIDED], splits).astype(np.int8)


def judge(
    splits: Int8[np.ndarray, "lanes splits"],
    exponents: Float[np.ndarray, "lanes d"],
    error: Float[np.ndarray, "lanes d"],
    sums: Float[np.ndarray, "lanes d"],
    sums_error: Float[np.ndarray, "lanes d"],
    neutral: int,
    vanishing: Bool[np.ndarray, "lanes d"],
) -> Int8[np.ndarray, " lanes"]:
    """Return the kind of each lane, a number in `KINDS`.

    Hyperbolic is what has no exponent that may be zero but those along the flow, some that are negative, and angles
    bounded away from zero on both sides of them. Of a map that grows in all directions angles do not say whether it
    does so everywhere. Pseudohyperbolic is what is not known to be so and has a split with an angle bounded away from
    zero, a gap of the exponents beyond their errors, and volumes that grow in its faster subspace (Turaev and
    Shilnikov, Sb. Math. 189 (1998) 291).

    Args:
        splits: of the angles (`judge_splits`).
        exponents, error: of the vectors, largest first, with errors at 95 %.
        sums, sums_error: of the first 1, …, d of them.
        neutral: number of exponents that are known to be zero.
        vanishing: whether volumes of the first 1, …, d vectors come to nothing near some points, as at the folds of a
            map that has no inverse, so that angles alone do not say that they grow.
    """
    positive, negative = exponents > error, exponents < -error
    growing, zero = positive.sum(axis=1), (~positive & ~negative).sum(axis=1)
    chaotic = growing > 0
    needed = [_at(splits, growing), _at(splits, growing + zero)]
    stretched = ~np.take_along_axis(vanishing, np.maximum(growing, 1)[:, None] - 1, axis=1)[:, 0]
    clear = (zero <= neutral) & negative.any(axis=1) & stretched
    gap = ~exponents_alike(exponents, error)
    expanding = sums[:, :-1] > sums_error[:, :-1]
    conditions = [
        ~np.isfinite(exponents).all(axis=1),
        ~chaotic & (exponents[:, 0] + error[:, 0] < 0.0),
        chaotic & clear & np.all([side == BOUNDED for side in needed], axis=0),
        chaotic & np.any((splits == BOUNDED) & gap & expanding & ~vanishing[:, :-1], axis=1),
        chaotic & np.any([side == TANGENT for side in needed], axis=0),
    ]
    return np.select(conditions, [5, 3, 0, 1, 2], KINDS.index("undecided")).astype(np.int8)


def _at(splits: Int8[np.ndarray, "lanes splits"], first: np.ndarray) -> np.ndarray:
    """Return the flag of the split after so many vectors; of none or of all there is nothing to be tangent to."""
    whole: Bool[np.ndarray, " lanes"] = (first == 0) | (first > splits.shape[1])
    return np.where(whole, BOUNDED, np.take_along_axis(splits, np.where(whole, 1, first)[:, None] - 1, axis=1)[:, 0])
