"""Lifetimes of motions from random starts in a region, and the rate at which they leave it.

On a chaotic saddle as many of the motions that are left leave in each period, so that lifetimes become geometric. Of
motions that are still there in the end it is known that they live longer, no more: their periods count, their escape
does not (Kaplan and Meier, J. Am. Stat. Assoc. 53 (1958) 457, with a hazard that is constant).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.intervals import binomial_interval
from jaxnh.analyses.random_starts import Box
from jaxnh.maps.section import outputs
from jaxnh.systems.rows import select
from jaxnh.systems.state import State

_FIRST, _AT_ONCE = 8, 64  # periods of the first call, and of later ones at most: most motions leave early
_DIFFERS = 3.0  # standard deviations of the escapes in a stretch from those that the rate afterwards lets expect
_FEWEST = 16  # escapes afterwards, that a stretch is left out for


class Lifetimes(NamedTuple):
    """Lifetimes of motions.

    Attributes:
        periods: until a motion was out of the region for the first time, or was followed no longer, (motions,).
        escaped: whether it was out, (motions,).
    """

    periods: Int[np.ndarray, " motions"]
    escaped: Bool[np.ndarray, " motions"]


class EscapeRate(NamedTuple):
    """Rate per period and mean lifetime in periods, with the ends of their 95 % intervals, (3, lanes) each.

    Attributes:
        rate: −ln of the share that stays for another period.
        mean: of the periods that motions have before them, one over the share that leaves.
        escapes: number of motions that they are known from, (lanes,).
        transient: periods after which escapes are counted, (lanes,).
    """

    rate: Float[np.ndarray, "3 lanes"]
    mean: Float[np.ndarray, "3 lanes"]
    escapes: Int[np.ndarray, " lanes"]
    transient: Int[np.ndarray, " lanes"]


def lifetimes(batch: LaneBatch, lanes: LaneRunner, region: Box, most: int) -> Lifetimes:
    """Return how long the motions of a batch stay in a region, followed for so many periods at most."""
    periods, escaped = np.full(batch.count, most), np.zeros(batch.count, bool)
    left, state, done = np.arange(batch.count), batch.start, 0
    while len(left) and done < most:
        part, count = batch.take(left), min(max(_FIRST, done), _AT_ONCE, most - done)
        states = lanes.record(part.strobe(), count, (state, dict(part.p)))
        out = ~is_inside(part, region, states)
        gone = out.any(axis=1)
        periods[left[gone]], escaped[left[gone]] = done + 1 + np.argmax(out[gone], axis=1), True
        state = select(states, (~gone, -1))
        left, done = left[~gone], done + count
    return Lifetimes(periods, escaped)


def is_inside(batch: LaneBatch, region: Box, states: State) -> Bool[np.ndarray, "motions points"]:
    """Return whether states are in a region; those that are not finite are in none."""
    named = outputs(batch.flow, states, np.zeros(1))
    within = np.ones(np.shape(jax.tree.leaves(states)[0]), bool)
    with np.errstate(invalid="ignore"):
        for component in jax.tree.leaves(states):
            within &= np.isfinite(component)
        for name, (low, high) in region.items():
            values = np.asarray(named[name].data)
            within &= (values >= low) & (values <= high)
    return within


def escape_rate(
    periods: Int[np.ndarray, "lanes starts"], escaped: Bool[np.ndarray, "lanes starts"], transient: int
) -> EscapeRate:
    """Return the rate from lifetimes beyond a transient; not numbers of a lane that has none.

    The share that leaves in a period is a binomial share of the periods of all motions (`binomial_interval`), where it
    is the same in all of them: motions that start beside the saddle leave sooner or later than those on it, and the
    transient is longer where they are seen to (`_steady_after`).
    """
    begin = _steady_after(periods, escaped, transient)
    at_risk, escapes = _exposure(periods, escaped, begin[:, None], np.inf)
    known = at_risk > 0
    total = np.maximum(at_risk, 1)
    share = np.stack([escapes / total, *binomial_interval(escapes, total)])
    share = np.where(known, share, np.nan)
    with np.errstate(divide="ignore"):
        return EscapeRate(-np.log1p(-share), 1.0 / share[[0, 2, 1]], escapes, begin)


def _steady_after(
    periods: Int[np.ndarray, "lanes starts"], escaped: Bool[np.ndarray, "lanes starts"], transient: int
) -> Int[np.ndarray, " lanes"]:
    """Return the end of the last stretch of time, each twice as long, whose rate differs from that afterwards."""
    steady, begin, length = np.full(len(periods), transient), transient, max(transient, 1)
    while begin < periods.max(initial=0):
        end = begin + length
        (at_risk, escapes), (later, left) = (
            _exposure(periods, escaped, *ends) for ends in ((begin, end), (end, np.inf))
        )
        share = at_risk / np.maximum(at_risk + later, 1)
        expected, deviation = share * (escapes + left), np.sqrt(share * (1.0 - share) * (escapes + left))
        steady[(np.abs(escapes - expected) > _DIFFERS * deviation) & (left >= _FEWEST)] = end
        begin, length = end, 2 * length
    return steady


def _exposure(
    periods: Int[np.ndarray, "lanes starts"], escaped: Bool[np.ndarray, "lanes starts"], begin: Any, end: float
) -> tuple[Int[np.ndarray, " lanes"], Int[np.ndarray, " lanes"]]:
    """Return the periods of all motions between two times, and how many leave in them."""
    at_risk = np.sum(np.clip(np.minimum(periods, end) - begin, 0, None), axis=1).astype(int)
    return at_risk, np.sum(escaped & (periods > begin) & (periods <= end), axis=1)


def region_of(box: Box, region: Mapping[str, tuple[float, float]]) -> Box:
    """Return the region that motions leave: that asked for, or the box that they start in."""
    return region or box
