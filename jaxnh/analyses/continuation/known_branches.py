"""Comparison of orbits with the branches that are known. Host code: branches are cubics between their points."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.orbits.continuation.arclength import Family, PathVector, length
from jaxnh.orbits.continuation.branches import Branch

SAME = 1e-4
"""Lengths: cubics between points are nearer to the branch than this, and other branches are further, mostly."""
_HALVINGS = 40


def is_on_branch(
    family: Family, branches: Sequence[Branch], points: Float[np.ndarray, "n d"], value: float, near: float = SAME
) -> bool:
    """Return whether an orbit at a parameter value is on one of the branches, whichever of its points comes first."""
    there = orbits_at(family, [branch for branch in branches if branch.period == len(points)], value)
    return bool(len(there) and _apart(family, there, points).min() <= near)


def orbits_at(family: Family, branches: Sequence[Branch], value: float) -> Float[np.ndarray, "some n d"]:
    """The orbits of branches of one period at a value of the parameter, nearly; where one turns, perhaps two."""
    candidates, stretches = list[np.ndarray](), list[tuple[Branch, int]]()
    for branch in branches:
        above, rate = branch.value - value, branch.way.value
        passes = (above[:-1] <= 0.0) != (above[1:] <= 0.0)
        turns = (rate[:-1] < 0.0) != (rate[1:] < 0.0)
        stretches += [(branch, i) for i in np.flatnonzero(passes | turns).tolist()]
        # where it begins or ends at the value and lies below it
        candidates += [branch.points[end][None] for end in (0, -1) if above[end] == 0.0]
    if stretches:
        candidates.append(_on_cubics(family, stretches, value))
    return np.concatenate(candidates) if candidates else np.zeros((0, 0, len(family.size)))


def same_orbit(family: Family, one: Float[np.ndarray, "n d"], other: Float[np.ndarray, "n d"], near: float) -> bool:
    """Return whether two orbits are as near as this in lengths, whichever of their points comes first."""
    return len(one) == len(other) and bool(_apart(family, one[None], other)[0] <= near)


def _on_cubics(family: Family, stretches: Sequence[tuple[Branch, int]], value: float) -> Float[np.ndarray, "some n d"]:
    """On cubics between a point of a branch and its next the orbits at a value that they pass there."""
    points, values, rates, ways = (
        np.stack([leaf(branch)[i : i + 2] for branch, i in stretches], axis=1)
        for leaf in (lambda b: b.points, lambda b: b.value, lambda b: b.way.value, lambda b: b.way.points)
    )
    size = length(family, PathVector(points[1] - points[0], values[1] - values[0]))
    rates, ways = size * rates, size[:, None, None] * ways

    def rise(s: np.ndarray) -> np.ndarray:
        left = 1.0 - s
        whole = 6.0 * s * left * (values[1] - values[0])
        return whole + left * (1.0 - 3.0 * s) * rates[0] + s * (3.0 * s - 2.0) * rates[1]

    def above(s: np.ndarray) -> np.ndarray:
        return _cubic(s, values, rates) - value

    zero, one = np.zeros(len(size)), np.ones(len(size))
    turn = np.where(rise(zero) * rise(one) < 0.0, _zeros(rise, zero, one), 0.0)
    orbits = list[np.ndarray]()
    for low, high in ((zero, turn), (turn, one)):
        passes = (above(low) <= 0.0) != (above(high) <= 0.0)
        orbits.append(_cubic(_zeros(above, low, high)[:, None, None], points, ways)[passes])
    return np.concatenate(orbits)


def _cubic(s: np.ndarray, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Hermite's polynomials from one end (s = 0) to the other (s = 1)."""
    left = 1.0 - s
    bent = s * s * (3.0 - 2.0 * s)
    return ends[0] + bent * (ends[1] - ends[0]) + s * left * left * slopes[0] - s * s * left * slopes[1]


def _zeros(
    function: Callable[[np.ndarray], np.ndarray], low: Float[np.ndarray, " some"], high: Float[np.ndarray, " some"]
) -> Float[np.ndarray, " some"]:
    """Bisect for the places where functions change sign."""
    positive: Bool[np.ndarray, " some"] = function(high) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        beyond = (function(middle) > 0.0) == positive
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return 0.5 * (low + high)


def _apart(
    family: Family, orbits: Float[np.ndarray, "orbits n d"], orbit: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, " orbits"]:
    """Distances of orbits from an orbit, in lengths, the least over its first points."""
    none = np.zeros(len(orbits))
    shifted = (np.roll(orbit, m, 0) for m in range(len(orbit)))
    return np.min([length(family, PathVector(family.wrap(orbits - start), none)) for start in shifted], axis=0)
