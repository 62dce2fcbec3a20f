"""Locking of motions whose rotation number is near a fraction p/q: the search for a zero of F^q(x) − x − p.

Just beyond the end of a tongue there is none, but a motion passes its place slowly: over a run that is no longer than
the passage its average is the fraction's, within a bar of the two halves. Arrays on the host, angles in turns.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

_SPANS = 3  # of equal length, between four points of the last half of a run
_ULPS = 4 * np.finfo(float).eps  # of a place, which is a sum
_LITTLE = 0.5  # of a gap between points, that a motion goes round
_UNEVEN = 1.2  # the largest displacement over the least, beyond which they are far from equal
_APPROACH = 1 / 3 - 0.01  # AC/(B(A + B + C)) of these spans; at a double zero of F^q(x) − x − p it is 1/3


def is_locked(
    turns: Float[np.ndarray, "lanes iterates"],
    numerator: Int[np.ndarray, " lanes"],
    denominator: Int[np.ndarray, " lanes"],
    error: Float[np.ndarray, " lanes"],
) -> Bool[np.ndarray, " lanes"]:
    """Return whether the motions of lanes show an orbit of the fraction p/q; False where the denominator is 0.

    The displacement D = F^q(x) − x − p of successive points has one sign where a map of a circle has no such orbit. One
    is shown by displacements of both signs, or none but errors, in the last half of a run; else by a motion that comes
    to it: displacements fall, and four points at equal times are those of x' = a x² + b x + c with two zeros
    and not with none. Its solutions are Möbius functions of an exponential or of a tangent, which the cross-ratio of
    the points tells apart: with the spans A, B, C between them it is 1 + AC/(B(A + B + C)), which is
    (1 + κ)²/(1 + κ + κ²) < 4/3 where spans shrink by κ at the end, and 4/3 at a double zero.

    Args:
        turns: advances.
        numerator, denominator: of the fraction of each lane; the denominator is 0 without one.
        error: of an advance.
    """
    locked, places = np.zeros(len(turns), bool), np.cumsum(turns, axis=1)
    for q in np.unique(denominator[denominator > 0]):
        lanes = np.flatnonzero(denominator == q)
        locked[lanes] = _locked_to(places[lanes], numerator[lanes], int(q), error[lanes])
    return locked


def passed_fraction(
    turns: Float[np.ndarray, "lanes iterates"],
    value: Float[np.ndarray, " lanes"],
    error: Float[np.ndarray, " lanes"],
    largest: int,
) -> Int[np.ndarray, " lanes"]:
    """Return the least denominator q of a fraction whose place each motion is passing, 0 where there is none.

    With respect to p/q a motion of N iterates goes round q N |ρ − p/q| of the q gaps between successive points. Where
    that is less than a half, and displacements of q iterates have one sign but are far from equal, it has spent the run
    near the place of an orbit, and has not seen how fast it goes elsewhere.

    Args:
        turns: advances.
        value: their average; not a number for a lane that is left out.
        error: of an advance.
        largest: of the denominators.
    """
    passed, count = np.zeros(len(value), np.int64), turns.shape[1]
    places = np.cumsum(turns, axis=1)
    for q in range(1, min(largest, count // 2) + 1):
        p = np.rint(q * np.nan_to_num(value))
        lanes = np.flatnonzero((passed == 0) & (np.abs(q * value - p) * count < _LITTLE))
        moved = places[lanes, q:] - places[lanes, :-q] - p[lanes, None]
        low, high = np.min(moved, axis=1), np.max(moved, axis=1)
        least, most = (pick(np.abs(low), np.abs(high)) for pick in (np.minimum, np.maximum))
        passed[lanes[(low * high > 0) & (least > q * error[lanes]) & (most > _UNEVEN * least)]] = q
    return passed


def _locked_to(
    places: Float[np.ndarray, "lanes iterates"],
    p: Int[np.ndarray, " lanes"],
    q: int,
    error: Float[np.ndarray, " lanes"],
) -> Bool[np.ndarray, " lanes"]:
    """Return whether motions through these places, whole turns kept, are locked to p/q."""
    half = max(places.shape[1] // 2, q + 1)
    last, rounding = places[:, -half:], (q * error + _ULPS * np.max(np.abs(places), axis=1))[:, None]
    moved = last[:, q:] - last[:, :-q] - p[:, None]
    both = (np.max(moved, axis=1) > 0) & (np.min(moved, axis=1) < 0)
    shown = both | np.any(np.abs(moved) <= rounding, axis=1)
    cycles = (half - 1) // (_SPANS * q)
    if not cycles:
        return shown
    spans = np.diff(last[:, -1 - _SPANS * cycles * q :: cycles * q], axis=1) - cycles * p[:, None]
    first, middle, end = spans.T
    with np.errstate(divide="ignore", invalid="ignore"):
        approaches = first * end / (middle * spans.sum(axis=1)) < _APPROACH
    size = np.abs(moved)
    falls = np.all(size[:, q:] - size[:, :-q] <= 2.0 * rounding, axis=1)
    return shown | (falls & approaches)
