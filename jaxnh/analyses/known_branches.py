"""Whether an orbit lies on a branch that is known. Host code: branches are cubics between their points."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.arclength import Family, Way, length
from jaxnh.orbits.branches import Branch

_SAME = 1e-4  # lengths; cubics between points are nearer to the branch than this, and where a branch begins is further
_HALVINGS = 40


def on_branch(family: Family, branches: Sequence[Branch], points: Float[np.ndarray, "n d"], value: float) -> bool:
    """Whether an orbit at a value of the parameter is on one of the branches, whichever of its points comes first."""
    return any(
        _apart(family, there, points) <= _SAME
        for branch in branches
        if branch.period == len(points)
        for there in orbits_at(family, branch, value)
    )


def orbits_at(family: Family, branch: Branch, value: float) -> Iterator[Float[np.ndarray, "n d"]]:
    """The orbits of a branch at a value of the parameter, nearly; where it turns between two points, perhaps two."""
    above, rate = branch.value - value, branch.way.value
    passes = (above[:-1] <= 0.0) != (above[1:] <= 0.0)
    for i in np.flatnonzero(passes | (np.sign(rate[:-1]) != np.sign(rate[1:]))).tolist():
        yield from _between(family, branch, i, value)
    for end in (0, -1):  # where it begins or ends at the value and lies below it
        if above[end] == 0.0:
            yield branch.points[end]


def same_orbit(family: Family, one: Float[np.ndarray, "n d"], other: Float[np.ndarray, "n d"], near: float) -> bool:
    """Whether two orbits are as near as this in lengths, whichever of their points comes first."""
    return len(one) == len(other) and _apart(family, one, other) <= near


def _between(family: Family, branch: Branch, i: int, value: float) -> Iterator[Float[np.ndarray, "n d"]]:
    """On the cubic between two points of a branch the orbits at a value that it passes there."""
    points, values = branch.points[i : i + 2], branch.value[i : i + 2]
    chord = Way(points[1:] - points[:1], values[1:] - values[:1])
    size = float(length(family, chord)[0])
    rates, ways = size * branch.way.value[i : i + 2], size * branch.way.points[i : i + 2]

    def cubic(s: float, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        left = 1.0 - s
        bent = s * s * (3.0 - 2.0 * s)
        return ends[0] + bent * (ends[1] - ends[0]) + s * left * left * slopes[0] - s * s * left * slopes[1]

    def rise(s: float) -> float:
        left = 1.0 - s
        whole = 6.0 * s * left * (values[1] - values[0])
        return float(whole + left * (1.0 - 3.0 * s) * rates[0] + s * (3.0 * s - 2.0) * rates[1])

    def above(s: float) -> float:
        return float(cubic(s, values, rates)) - value

    turn = [_zero(rise, 0.0, 1.0)] if rise(0.0) * rise(1.0) < 0.0 else []
    for low, high in itertools.pairwise([0.0, *turn, 1.0]):
        if (above(low) <= 0.0) != (above(high) <= 0.0):
            yield cubic(_zero(above, low, high), points, ways)


def _zero(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function changes sign, by halving."""
    positive = function(high) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if (function(middle) > 0.0) == positive:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def _apart(family: Family, one: Float[np.ndarray, "n d"], other: Float[np.ndarray, "n d"]) -> float:
    """Distance of two orbits in lengths, of all turns of one the least."""
    turned = np.stack([np.roll(other, m, 0) for m in range(len(other))])
    return float(length(family, Way(family.wrap(one - turned), np.zeros(len(other)))).min())
