"""Branches: curves of periodic orbits or equilibria over a parameter, followed by arclength (`core`). Host code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.continuation import paths
from jaxnh.orbits.continuation.arclength import (
    CurveOrbits,
    CycleEquations,
    Family,
    PathVector,
    orbits_of,
    solution_of,
)
from jaxnh.orbits.continuation.kinds import eigenvalues, test_functions
from jaxnh.orbits.continuation.paths import STEPS, StepControl, Track

Wanted = Callable[[Sequence["Branch"], int], bool]
"""Decides whether the orbit of a number is still to be followed, with the branches that are whole by now."""


@dataclass(frozen=True)
class Branch:
    """A branch, point by point.

    Attributes:
        points: of its orbits, section coordinates with angles that go on, (k, n, d).
        value: of the parameter, (k,).
        way: direction of the curve, (k, n, d) and (k,).
        tests: test functions of the kinds of the family, (k, kinds).
        multipliers: (k, d).
        residual: largest component of P(u_i) − u_{i+1} in sizes of the motion, (k,).
        ends: why it ends where it begins, and at its end, numbers in `paths.ENDS`. A collapsed one goes on to a point
            beyond.
        errors: of the multipliers, (k, d), where they are known.
        step_change: largest distance of the map from one of twice the steps on some of the orbits, in sizes of the
            motion; NaN where it is not known, as of cycles by collocation and of what has no steps.
    """

    points: Float[np.ndarray, "k n d"]
    value: Float[np.ndarray, " k"]
    way: PathVector
    tests: Float[np.ndarray, "k kinds"]
    multipliers: Complex[np.ndarray, "k d"]
    residual: Float[np.ndarray, " k"]
    ends: tuple[int, int]
    errors: Float[np.ndarray, "k d"] | None = None
    step_change: float = np.nan

    @property
    def period(self) -> int:
        """Points of an orbit."""
        return self.points.shape[1]


def follow_both_ways(
    family: Family,
    start: CurveOrbits,
    steps: StepControl = STEPS,
    wanted: Wanted | None = None,
    at_once: int | None = None,
) -> dict[int, Branch]:
    """The branches through orbits, from one end to the other, by the orbits' numbers; of a closed one the loop.

    Args:
        family: the map.
        start: orbits, with the directions in which branches are followed first.
        steps: how branches are followed.
        wanted: asked for each orbit as its turn comes, with the branches that have come to both of their ends and the
            orbit's number; by default all are.
        at_once: how many are followed at a time, by default all.
    """
    branches = dict[int, Branch]()

    def is_wanted(tracks: Mapping[int, Track], k: int) -> bool:
        branches.update({i: _branch(family, track) for i, track in tracks.items() if i not in branches})
        return wanted is None or wanted(list(branches.values()), k)

    equations = CycleEquations(family, start.points.shape[1])
    tracks = paths.follow_both_ways(equations, solution_of(start), steps, is_wanted, at_once)
    return {k: branches[k] if k in branches else _branch(family, track) for k, track in tracks.items()}


def _branch(family: Family, track: Track) -> Branch:
    orbits = orbits_of(family, track.points)
    tests, multipliers = test_functions(family, orbits), eigenvalues(family, orbits)
    return Branch(orbits.points, orbits.value, orbits.way, tests, multipliers, orbits.residual, track.ends)
