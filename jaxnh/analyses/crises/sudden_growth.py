"""Sudden growth of chaotic attractors along a parameter, beyond their trend. Host code.

A chaotic attractor changes with the parameter, and is known by finitely many points: from one value to the next some of
it is always off what is known of it at the other. In a crisis it is off by more than from there to the values beside,
and by more than points of one and the same attractor are off each other. Attractors that a symmetry makes of each other
change together: what one of them shows alone is chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

_SHARE = 0.95  # of points, that are nearer than the reach
_POINTS = 1024  # of an attractor, at most
_JUMP = 3.0  # times the trend, or what points of one attractor are off each other
_ALIKE = 0.05  # of an exponent, that those of twins are apart at most: averages over a thousand periods
_FEWEST = 3  # values at which exponents are compared
_NO_TREND = 0.05  # sizes: what stands for the trend where there is none


def sudden_growths(
    clouds: Sequence[Float[np.ndarray, "points d"]], values: Float[np.ndarray, " clouds"]
) -> Bool[np.ndarray, " steps"]:
    """Return whether an attractor grows or shrinks suddenly from each value to the next, (clouds − 1,).

    Args:
        clouds: points of it at each value, in sizes of the motion.
        values: of the parameter, in order.
    """
    clouds = [cloud[:: -(-len(cloud) // _POINTS)] for cloud in clouds]
    own = np.array([_reach(cloud[::2], cloud[1::2]) for cloud in clouds])
    steps = np.array([max(_reach(a, b), _reach(b, a)) for a, b in pairwise(clouds)])
    rates = steps / np.abs(np.diff(values))
    sudden = np.zeros(len(steps), bool)
    for k, (step, rate) in enumerate(zip(steps.tolist(), rates.tolist(), strict=True)):
        beside = rates[[place for place in (k - 1, k + 1) if 0 <= place < len(rates)]]
        trend = step / rate * float(beside.max()) if len(beside) else _NO_TREND
        sudden[k] = step > _JUMP * max(trend, float(own[k : k + 2].max()))
    return sudden


def keep_common_growths(
    grown: Sequence[Bool[np.ndarray, " steps"]],
    places: Sequence[Sequence[int]],
    exponents: Sequence[Float[np.ndarray, " values"]],
) -> list[Bool[np.ndarray, " steps"]]:
    """Return the sudden growths of attractors, for twins by a symmetry only those common to all of them.

    Twins are there at the same values and have the same exponents, whatever the symmetry is, and whatever phase of the
    period it shifts; attractors that have not are hardly alike in them at every value.

    Args:
        grown: of each attractor, whether it is suddenly another from each of its values to the next.
        places: of each, the numbers of its values.
        exponents: of each, the largest at each value.
    """
    kept = list[np.ndarray]()
    for k, own in enumerate(exponents):
        twins = [i for i, other in enumerate(exponents) if i == k or _twins(places[k], own, places[i], other)]
        kept.append(np.all([grown[i] for i in twins], axis=0))
    return kept


def _twins(values: Sequence[int], own: np.ndarray, other_values: Sequence[int], other: np.ndarray) -> bool:
    """Return whether two attractors may be images of each other."""
    if list(values) != list(other_values) or len(values) < _FEWEST:
        return False
    return bool(np.all(np.abs(own - other) <= _ALIKE * np.maximum(np.abs(own), np.abs(other))))


def nearest_distances(
    points: Float[np.ndarray, "some d"], others: Float[np.ndarray, "others d"]
) -> Float[np.ndarray, " some"]:
    """Return the distances of points from the nearest of others."""
    square = np.zeros((len(points), len(others)))
    for mine, theirs in zip(points.T, others.T, strict=True):
        square += (mine[:, None] - theirs) ** 2
    return np.sqrt(square.min(axis=1))


def _reach(points: Float[np.ndarray, "some d"], others: Float[np.ndarray, "others d"]) -> float:
    """Return the distance from others that most points do not exceed."""
    return float(np.quantile(nearest_distances(points, others), _SHARE))
