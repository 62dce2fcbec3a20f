"""The chaotic saddle, from motions that stay long: in the middle of their life they are near it.

A motion that stays for long has come near the saddle along its stable manifold, and leaves along the unstable one
(Lai and Tél, Transient Chaos, Springer 2011, section 1.2.2). Its middle has the natural measure of the saddle, and so
exponents are averages over it.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.exponents.dimension import kaplan_yorke
from jaxnh.analyses.exponents.estimates import step_error
from jaxnh.analyses.exponents.triangles import HIDDEN, complete_triangles, orthonormalise, rounding_of_growth
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.section_points import points_at
from jaxnh.maps.iterate import derivative_and_volume
from jaxnh.systems.chart import general_directions
from jaxnh.systems.state import LaneStates, State

MOTIONS = 32
"""Motions of each lane that stay longest."""

POINTS = 32
"""Points of each of them, at most."""

_ALIGNMENT = 4.0  # times the difference of two frames: how far either may be from that of the saddle
_SHORTEST = 9  # periods that all of them stay, at least: the middle third of that are three


class Saddle(NamedTuple):
    """A chaotic saddle in each lane; not numbers where too few motions stay long enough.

    Attributes:
        states: components (lanes, MOTIONS · POINTS), not numbers where there are fewer.
        exponents: Lyapunov exponents on it per period, largest first, (lanes, k).
        error: their errors at 95 %, from the scatter over motions and between two frames of each, (lanes, k).
        growth: mean growth of a tangent vector per period, along motions however short, (lanes,).
    """

    states: LaneStates
    exponents: Float[np.ndarray, "lanes k"]
    error: Float[np.ndarray, "lanes k"]
    growth: Float[np.ndarray, " lanes"]


def longest(periods: Int[np.ndarray, "lanes starts"], count: int) -> Int[np.ndarray, "lanes count"]:
    """Return the numbers among all starts of so many of each lane that stay longest."""
    starts = periods.shape[1]
    order = np.argsort(-periods, axis=1, kind="stable")[:, :count]
    return order + starts * np.arange(len(periods))[:, None]


def find_saddle(batch: LaneBatch, lanes: LaneRunner, periods: Int[np.ndarray, "lanes starts"]) -> Saddle:
    """Return the saddles that the motions of a batch, so many of each lane, stay near, from their lifetimes.

    Of the motions that stay longest the middle of the life counts, a third as long as the shortest of them stays. Where
    this stays too short for that, the whole life of each tells how tangent vectors grow, and no exponents.
    """
    count, starts = periods.shape
    motions = min(MOTIONS, starts)
    chosen = longest(periods, motions)
    life = periods.ravel()[chosen]
    least = life.min(axis=1, keepdims=True)
    width = np.where(least >= _SHORTEST, np.minimum(least - 2 * (least // 3), POINTS), 0)
    long = np.broadcast_to(width > 0, life.shape).ravel()
    first = np.where(width > 0, (life - width) // 2, 0).ravel()
    width = np.where(width > 0, width, life - 1).ravel()
    part = batch.take(chosen.ravel())
    states = lanes.record(part.strobe(), int((first + width).max()) + POINTS, (part.start, dict(part.p)))
    growth, rounding = _growth(part, lanes, states, first, width)
    growth = np.where(width[:, None, None] > 0, growth, np.nan).reshape(count, motions, *growth.shape[1:])
    rough = np.ma.masked_invalid(growth[..., 0, 0]).mean(axis=1).filled(np.nan)
    growth = np.where(long.reshape(count, motions)[..., None, None], growth, np.nan)
    mean, apart = growth[..., 0, :].mean(axis=1), np.abs(growth[..., 0, :] - growth[..., 1, :]).mean(axis=1)
    rounding = rounding.reshape(count, motions, -1).mean(axis=1)
    from scipy.special import stdtrit  # here, as it takes a tenth of a second to import

    error = stdtrit(motions - 1, 0.975) * growth[..., 0, :].std(axis=1, ddof=1) / np.sqrt(motions)
    error += _ALIGNMENT * apart + rounding + step_error(batch)
    hidden = rounding >= HIDDEN
    mean[hidden], error[hidden] = np.nan, np.nan
    place, inside = first[:, None] + np.arange(POINTS), (np.arange(POINTS) < width[:, None]) & long[:, None]
    near = jax.tree.map(
        lambda leaf: np.where(inside, np.take_along_axis(leaf, place, axis=1), np.nan).reshape(count, -1), states
    )
    return Saddle(near, mean, error, rough)


def saddle_dimension(
    rate: Float[np.ndarray, " lanes"], exponents: Float[np.ndarray, "lanes k"]
) -> Float[np.ndarray, " lanes"]:
    """Return the information dimension of saddles from their escape rates and exponents.

    The entropy, what is left of the sum of the positive exponents by the rate, fills the unstable directions from the
    one that grows least, and the stable ones from the one that shrinks least (Hunt, Ott and Yorke, Phys. Rev. E 54
    (1996) 4819). Of one unstable direction that is 1 − κ/λ (Kantz and Grassberger, Physica D 17 (1985) 75).
    """
    growing = exponents > 0.0
    entropy = np.maximum(np.sum(np.where(growing, exponents, 0.0), axis=1) - rate, 0.0)
    total = np.where(np.isfinite(exponents).all(axis=1), 0.0, np.nan)
    for side in (growing, ~growing):
        slowest_first = -np.sort(np.where(side, np.abs(exponents), np.inf), axis=1)
        total += kaplan_yorke(np.column_stack([entropy, slowest_first])) - 1.0
    return total


def _growth(
    batch: LaneBatch,
    lanes: LaneRunner,
    states: State,
    first: Int[np.ndarray, " motions"],
    width: Int[np.ndarray, " motions"],
) -> tuple[Float[np.ndarray, "motions 2 k"], Float[np.ndarray, "motions k"]]:
    """Return the mean growth of two frames a period, over a range of the states of each motion, and its rounding.

    Frames start with the motion, and turn to where they belong until the range begins.
    """
    points = points_at(batch, lanes, states)
    motions, _, d = points.shape
    count, k = int((first + width).max()), batch.flow.exponents - int(batch.on_section)
    needed = np.arange(count) < (first + width)[:, None]
    matrices, volumes = np.tile(np.eye(d), (motions, count, 1, 1)), np.ones((motions, count))
    if needed.any():  # else all have left at once
        sample = points[:, :count][needed], batch.parameters_of(np.nonzero(needed)[0])
        matrices[needed], volumes[needed] = lanes(derivative_and_volume, (batch.strobe(),), sample, tile=ORBIT_TILE)
    directions = np.array(general_directions(d, d)).reshape(d, d)
    frames = np.concatenate([np.tile(side[:k].T, (motions, 1, 1)) for side in (directions, directions[::-1])])
    total, rounding = np.zeros((2 * motions, k)), np.zeros((2 * motions, k))
    for i in range(count):
        inside = np.tile((i >= first) & (i < first + width), 2)[:, None]
        with np.errstate(all="ignore"):  # of matrices that fold or are not finite
            frames, triangles = orthonormalise(np.tile(matrices[:, i], (2, 1, 1)) @ frames)
            noise, known = np.zeros(2 * motions), np.zeros(2 * motions, bool)
            if k == d:  # with constraints volumes are those of other coordinates
                noise, known = complete_triangles(triangles, np.tile(volumes[:, i], 2))
            logs = np.log(np.diagonal(triangles, axis1=1, axis2=2))
            total += np.where(inside, logs, 0.0)
            rounding += np.where(inside, rounding_of_growth(triangles[None], noise[None], known[None])[0], 0.0)
    mean = total / np.maximum(np.tile(width, 2), 1)[:, None]
    rounding = rounding / np.maximum(np.tile(width, 2), 1)[:, None]
    return np.swapaxes(mean.reshape(2, motions, k), 0, 1), rounding[:motions]
