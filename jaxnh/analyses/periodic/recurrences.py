"""Periods that the strobe points of a lane may have: those after which points recur. Newton decides which it has.

On the host lanes are sorted out as they go; on a card, beside which the host is slow, one program looks at all periods
of each lane. Both say the same.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.periodic.newton_on_lanes import section_distance
from jaxnh.systems.chart import Chart

CLOSE = 0.03
"""Sizes of the motion: strobe points nearer than this may be one point of a slowly converging orbit."""


class Recurrence(NamedTuple):
    """The periods that are looked for.

    Attributes:
        limit: the longest.
        only_doublings: whether multiples of the least recurring period are possible only by factors of two.
    """

    limit: int
    only_doublings: bool


def recurrences(
    chart: Chart,
    lanes: LaneRunner,
    points: Float[np.ndarray, "lanes points d"],
    size: Float[np.ndarray, "lanes d"],
    sought: Recurrence,
) -> Bool[np.ndarray, "periods lanes"]:
    """Return which n up to a limit may be the period of a lane: multiples of the least after which points recur.

    Newton decides: points that nearly recur do so too where a lane is still on its way. Just after a doubling an orbit
    and its daughter cannot be told apart; points of other multiples of the least are apart from each other, and recur
    twice as near after the whole period. Bands of chaos do so after no multiple.

    Args:
        points: section coordinates after each period, twice as many as the longest period that is looked for.
        size: of the motion in each.
    """
    if lanes.on_card:
        return lanes(recurs_after, (chart,), (points, size), static=(sought,)).T
    possible = np.zeros((sought.limit + 1, len(points)), np.bool_)
    base, nearest = np.zeros(len(points), int), np.zeros(len(points))
    for n in range(1, sought.limit + 1):
        subset = np.flatnonzero((base == 0) | (n % np.maximum(base, 1) == 0))
        near = section_distance(chart, points[subset, n], points[subset, 0], size[subset]) < CLOSE
        subset = subset[near]  # most do not recur
        if not len(subset):
            continue
        ahead, behind = points[subset, n : n + sought.limit], points[subset, : sought.limit]
        distance = np.max(section_distance(chart, ahead, behind, size[subset, None]), axis=1)
        subset, distance = subset[distance < CLOSE], distance[distance < CLOSE]
        first = base[subset] == 0
        base[subset[first]], nearest[subset[first]] = n, distance[first]
        ratio = n // base[subset]
        doubled = ratio & (ratio - 1) == 0
        nearer = distance < 0.5 * nearest[subset]
        possible[n, subset] = doubled | (nearer & (not sought.only_doublings))
    return possible


def recurs_after(
    chart: Chart, points: Float[Array, "points d"], size: Float[Array, " d"], sought: Recurrence
) -> Bool[Array, " periods"]:
    """Return the same of one lane, in a program: of each period from 0 to the limit."""
    limit, only_doublings = sought

    def look(known: tuple[Array, Array], n: Array) -> tuple[tuple[Array, Array], Array]:
        base, nearest = known
        gap = jnp.abs(chart.wrap(lax.dynamic_slice_in_dim(points, n, limit) - points[:limit]))
        gap = gap[:, : chart.positions] if chart.dimensionless else gap / size[None]
        furthest = jnp.where(jnp.all(gap < CLOSE), jnp.max(gap), CLOSE)  # of a lane that is lost, too
        multiple = (base == 0) | (n % jnp.maximum(base, 1) == 0)
        recurs = multiple & (furthest < CLOSE)
        first = recurs & (base == 0)
        base, nearest = jnp.where(first, n, base), jnp.where(first, furthest, nearest)
        ratio = n // jnp.maximum(base, 1)
        doubled = ratio & (ratio - 1) == 0
        return (base, nearest), recurs & (doubled | (furthest < 0.5 * nearest) & (not only_doublings))

    start = jnp.zeros((), jnp.int32), jnp.zeros(())
    possible = lax.scan(look, start, jnp.arange(1, limit + 1, dtype=jnp.int32))[1]
    return jnp.concatenate([jnp.zeros(1, bool), possible])
