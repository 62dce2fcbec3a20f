"""The phase of a path on n bands that are visited in turn, as far as its own points tell. Host code.

On disjoint bands the place of a point tells its phase, the number of iterates modulo n. Bands meet at an unstable orbit
that bounds them: beyond the crisis a path sometimes crosses the stable manifold of that orbit and goes on in the place
of another band (a band merging, of bands born in a doubling) or leaves all of them for a while (an interior crisis, of
bands born in a fold). Either way the phase is lost, and the points that follow lie among earlier ones of another phase,
or far from all. Neither the unstable orbit nor a shape of the bands is needed to see that.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.analyses.crises.sudden_growth import nearest_distances

REFERENCE = 16
"""Turns around the bands, at the beginning of a path, that the next ones are compared with."""

_CLEAR = 4.0  # times nearer to another band than to its own, or the reverse: else a point tells nothing
_IN, _OUT = (
    -0.5,
    3.0,
)  # logarithms of how much likelier a point in its own band is, or one in another, without the phase
_ALARM = 24.0  # their sum after which the phase is lost: eight points more in other bands than chance would have
_LAGS = 512  # iterates, of which one is the period of a path that has become periodic
_SAME = 1e-7  # sizes: points this near, all around the orbit, are of one that repeats itself
_REPEATS = 8  # turns


def turns_in_phase(path: Float[np.ndarray, "points d"], bands: int) -> int:
    """Return the turns around the bands until a path loses its phase, all of its turns where it never does.

    Points are compared with those of the turns before, which are twice as many from time to time: first with
    `REFERENCE` of them, so that a phase lost before is seen to be lost then.

    Args:
        path: points in sizes of the motion, in order, the first on the first band (`embed_points`).
        bands: number of bands, at least two.
    """
    count = len(path) // bands
    turns = path[: count * bands].reshape(count, bands, -1)
    votes, known = np.zeros(count), min(REFERENCE, count)
    while known < count:
        new = turns[known : 2 * known, 0]
        own, others = turns[:known, 0], turns[:known, 1:].reshape(-1, path.shape[1])
        to_own, to_others = nearest_distances(new, own), nearest_distances(new, others)
        widest = np.linalg.norm(np.ptp(own, axis=0))
        out = (_CLEAR * to_others < to_own) | (to_own > widest)
        inside = (_CLEAR * to_own < to_others) & ~out
        votes[known : 2 * known] = np.where(out, _OUT, np.where(inside, _IN, 0.0))
        lost = _first_alarm(votes[: 2 * known])
        if lost is not None:
            return lost
        known *= 2
    return count


def _first_alarm(votes: Float[np.ndarray, " turns"]) -> int | None:
    """Return where the first excursion of the sum of votes to the alarm begins (Page, Biometrika 41 (1954) 100)."""
    total = np.concatenate([[0.0], np.cumsum(votes)])
    above = total - np.minimum.accumulate(total)
    if not np.any(above >= _ALARM):
        return None
    end = int(np.argmax(above >= _ALARM))
    return int(np.flatnonzero(above[:end] <= 0.0)[-1])


def is_periodic(path: Float[np.ndarray, "points d"], bands: int) -> bool:
    """Return whether a path has become periodic, as in a window: it then tells nothing of the bands there."""
    last = min(_REPEATS * bands, len(path) // 2)
    tail = path[-last:]
    most = min(_LAGS, len(path) - last)
    again = np.abs(path[-1 - most : -1][::-1] - path[-1]).max(axis=1) <= _SAME  # the last point, by the lag
    return any(np.abs(path[-last - lag : -lag] - tail).max() <= _SAME for lag in (1 + np.flatnonzero(again)).tolist())


def embed_points(
    path: Float[np.ndarray, "... d"], turning: Bool[np.ndarray, " d"], size: Float[np.ndarray, " d"]
) -> Float[np.ndarray, "... k"]:
    """Return points of paths in sizes of the motion, with an angle as its cosine and sine."""
    plain = path[..., ~turning] / size[~turning]
    return np.concatenate([plain, np.cos(path[..., turning]), np.sin(path[..., turning])], axis=-1)
