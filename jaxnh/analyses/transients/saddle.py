"""The chaotic saddle, from motions that stay long: in the middle of their life they are near it.

A motion that stays for long has come near the saddle along its stable manifold, and leaves along the unstable one
(Lai and Tél, Transient Chaos, Springer 2011, section 1.2.2).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.newton_on_lanes import images
from jaxnh.analyses.section_points import points_at
from jaxnh.systems.chart import general_directions
from jaxnh.systems.state import State

MOTIONS = 32
"""Motions of each lane that stay longest."""

POINTS = 32
"""Points of each of them, at most."""

_ALIGNMENT = 4.0  # times the difference of two tangents: how far either may be from the unstable direction
_SHORTEST = 9  # periods that all of them stay, at least: the middle third of that are three


class Saddle(NamedTuple):
    """A chaotic saddle in each lane; not numbers where too few motions stay long enough.

    Attributes:
        states: components (lanes, MOTIONS · POINTS), not numbers where there are fewer.
        exponent: largest Lyapunov exponent on it per period, (lanes,).
        error: its error at 95 %, from the scatter over motions and between two tangents of each, (lanes,).
    """

    states: State
    exponent: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]


def find_saddle(batch: LaneBatch, lanes: LaneRunner, periods: Int[np.ndarray, "lanes starts"]) -> Saddle:
    """Return the saddles that the motions of a batch, so many of each lane, stay near, from their lifetimes.

    Of the motions that stay longest the middle of the life counts, a third as long as the shortest of them stays.
    """
    count, starts = periods.shape
    motions = min(MOTIONS, starts)
    longest = np.argsort(-periods, axis=1, kind="stable")[:, :motions]
    life = np.take_along_axis(periods, longest, axis=1)
    least = life.min(axis=1, keepdims=True)
    width = np.where(least >= _SHORTEST, np.minimum(least - 2 * (least // 3), POINTS), 0)
    first, width = ((life - width) // 2).ravel(), np.broadcast_to(width, life.shape).ravel()
    part = batch.take((longest + starts * np.arange(count)[:, None]).ravel())
    states = lanes.record(part.strobe(), int((first + width).max()) + POINTS, (part.start, dict(part.p)))
    growth = _growth(part, lanes, states, first, width)
    growth = np.where(width[:, None] > 0, growth, np.nan).reshape(count, motions, 2)
    mean, apart = growth[..., 0].mean(axis=1), np.abs(growth[..., 0] - growth[..., 1]).mean(axis=1)
    from scipy.special import stdtrit  # here, as it takes a tenth of a second to import

    error = stdtrit(motions - 1, 0.975) * growth[..., 0].std(axis=1, ddof=1) / np.sqrt(motions) + _ALIGNMENT * apart
    place, inside = first[:, None] + np.arange(POINTS), np.arange(POINTS) < width[:, None]
    near = jax.tree.map(
        lambda leaf: np.where(inside, np.take_along_axis(leaf, place, axis=1), np.nan).reshape(count, -1), states
    )
    return Saddle(near, mean, error)


def _growth(
    batch: LaneBatch,
    lanes: LaneRunner,
    states: State,
    first: Int[np.ndarray, " motions"],
    width: Int[np.ndarray, " motions"],
) -> Float[np.ndarray, "motions 2"]:
    """Return the mean logarithm of the growth of two tangents a period, over a range of the states of each motion.

    The tangents start with the motion, and turn into the unstable direction until the range begins.
    """
    points = points_at(batch, lanes, states)
    motions, _, d = points.shape
    count = int((first + width).max())
    needed = np.arange(count) < (first + width)[:, None]
    at = images(lanes, batch.strobe(), dict(batch.p), np.ones(motions, np.int32))
    matrices = np.zeros((motions, count, d, d))
    if needed.any():  # else all have left at once
        matrices[needed] = np.asarray(at(points[:, :count][needed], np.nonzero(needed)[0]).monodromy)
    tangents = np.tile(np.array(general_directions(d, 2)).reshape(-1, d).T[:, [0, -1]], (motions, 1, 1))
    total = np.zeros((motions, 2))
    with np.errstate(all="ignore"):  # beyond the range there are no matrices
        for k in range(count):
            tangents = matrices[:, k] @ tangents
            length = np.linalg.norm(tangents, axis=1)
            tangents = tangents / length[:, None]
            inside = (k >= first) & (k < first + width)
            total += np.where(inside[:, None], np.log(length), 0.0)
    return total / np.maximum(width, 1)[:, None]
