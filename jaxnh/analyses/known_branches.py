"""Whether an orbit lies on a branch that is known. Host code: branches are cubics between their points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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
    """The orbits of a branch at a value of the parameter, nearly."""
    above = branch.value - value
    for i in np.flatnonzero((above[:-1] <= 0.0) != (above[1:] <= 0.0)).tolist():
        yield _between(family, branch, i, value)
    if above[-1] == 0.0:
        yield branch.points[-1]


def same_orbit(family: Family, one: Float[np.ndarray, "n d"], other: Float[np.ndarray, "n d"], near: float) -> bool:
    """Whether two orbits are as near as this in lengths, whichever of their points comes first."""
    return len(one) == len(other) and _apart(family, one, other) <= near


def _between(family: Family, branch: Branch, i: int, value: float) -> Float[np.ndarray, "n d"]:
    """On the cubic between two points of a branch the orbit at a value that it passes there."""
    points, values = branch.points[i : i + 2], branch.value[i : i + 2]
    chord = Way(points[1:] - points[:1], values[1:] - values[:1])
    size = float(length(family, chord)[0])
    rates, ways = size * branch.way.value[i : i + 2], size * branch.way.points[i : i + 2]

    def cubic(s: float, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        left = 1.0 - s
        bent = s * s * (3.0 - 2.0 * s)
        return ends[0] + bent * (ends[1] - ends[0]) + s * left * left * slopes[0] - s * s * left * slopes[1]

    low, high, rising = 0.0, 1.0, values[1] > values[0]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if (cubic(middle, values, rates) < value) == rising:
            low = middle
        else:
            high = middle
    return cubic(0.5 * (low + high), points, ways)


def _apart(family: Family, one: Float[np.ndarray, "n d"], other: Float[np.ndarray, "n d"]) -> float:
    """Distance of two orbits in lengths, of all turns of one the least."""
    turned = np.stack([np.roll(other, m, 0) for m in range(len(other))])
    return float(length(family, Way(family.wrap(one - turned), np.zeros(len(other)))).min())
