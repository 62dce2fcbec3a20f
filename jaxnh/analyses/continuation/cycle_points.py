"""Cycles by collocation in the records of branches: their points on the section, or at strobes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.continuation.family_tree import Bifurcation, SignChange, Tree
from jaxnh.analyses.periodic.flow_cycles import passages
from jaxnh.maps.section import Section
from jaxnh.orbits.collocation.bifurcations import CycleBifurcation
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.following import CycleBranch
from jaxnh.orbits.collocation.paths import values_at
from jaxnh.orbits.continuation.arclength import PathVector
from jaxnh.orbits.continuation.branches import Branch


class FollowedCycles(NamedTuple):
    """A branch of cycles with its bifurcations, in both directions from where it was begun.

    Attributes:
        returns: of its cycles to the section, or periods of a clock.
        lift: of the end of an orbit over its beginning.
        branch: from one end to the other.
        bifurcations: on it, with places of that order.
        lost: places and kinds of the changes of sign of test functions that led to none.
    """

    returns: int
    lift: Float[np.ndarray, " d"]
    branch: CycleBranch
    bifurcations: list[CycleBifurcation]
    lost: list[tuple[int, int]]


def tree_of_cycles(batch: LaneBatch, followed: Sequence[FollowedCycles]) -> Tree:
    """Branches and bifurcations as those of return maps; a cycle that misses the section has no numbers there."""
    branches, points = list[Branch](), list[Bifurcation]()
    for number, known in enumerate(followed):
        solutions = [point.solution for point in known.branch.points]
        orbits = np.stack([cycle_points(batch, solution, known.returns) for solution in solutions])
        still = PathVector(np.zeros_like(orbits), np.zeros(len(orbits)))
        multipliers = np.stack([point.multipliers for point in known.branch.points])
        errors = np.stack([point.errors for point in known.branch.points])
        residual = np.array([point.residual for point in known.branch.points])
        none = np.zeros((len(orbits), 0))
        values, ends = known.branch.value, known.branch.ends
        branches.append(Branch(orbits, values, still, none, multipliers, residual, ends, errors))
        for bifurcation in known.bifurcations:
            at = cycle_points(batch, bifurcation.point.solution, known.returns)
            value = bifurcation.point.value
            points.append(
                Bifurcation(
                    bifurcation.kind,
                    value,
                    bifurcation.error,
                    number,
                    bifurcation.place,
                    at,
                    bifurcation.point.multipliers,
                    np.nan,
                    0,
                )
            )
    lost = [SignChange(number, *each) for number, known in enumerate(followed) for each in known.lost]
    return Tree(branches, points, lost)


def durations(followed: Sequence[FollowedCycles]) -> list[Float[np.ndarray, " k"]]:
    """Durations of the cycles of branches."""
    return [np.array([float(p.solution.duration[0]) for p in known.branch.points]) for known in followed]


def cycle_points(batch: LaneBatch, solution: BoundarySolution, returns: int) -> Float[np.ndarray, "returns d"]:
    """Points of a cycle on the section of a batch in the order of time, or at the strobes of its clock.

    Where it passes the section less often than `returns` times, the rest are not numbers; of more the first are taken.
    """
    path, system = solution.path, batch.system
    if not isinstance(system, Section):
        return values_at(path, np.arange(returns)[None] / returns)[0]
    places = passages(system, path)[:returns]
    points = values_at(path, places[None])[0]
    points = np.delete(points, system.number, axis=1)
    return np.concatenate([points, np.full((returns - len(points), points.shape[1]), np.nan)])
