"""How thoroughly random starts have searched: how many of them led to each branch. Host code.

If k of m branches were met by one of N starts alone, one start more leads to about k/N unknown branches in the mean, by
I. J. Good's estimate (Biometrika 40, 237, 1953); a start may lead to several. Branches that begin at
bifurcations of others, or that a lane of the sweep has settled on, would be known without any start, and tell nothing
of what is missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.continuation.known_branches import is_on_branch
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.paths import START


class SearchEvidence(NamedTuple):
    """What random starts led to.

    Attributes:
        starts: number of them that led to an orbit of each branch.
        total: number of all starts.
        met: number of branches that are known by random starts only.
        alone: number of these that a single start led to.
    """

    starts: list[int]
    total: int
    met: int
    alone: int


def search_evidence(
    family: Family, branches: Sequence[Branch], waves: Sequence[Sequence[SeedOrbit]], total: int
) -> SearchEvidence:
    """Count the starts that led to each branch.

    Args:
        family: the map.
        branches: that are known.
        waves: orbits that they were begun with, those that random starts led to among them.
        total: number of all random starts.
    """

    def on(branch: Branch, orbits: Sequence[SeedOrbit]) -> list[SeedOrbit]:
        same = [orbit for orbit in orbits if len(orbit.points) == branch.period]
        return [orbit for orbit in same if is_on_branch(family, [branch], orbit.points, orbit.value)]

    every = [orbit for wave in waves for orbit in wave]
    random, others = [orbit for orbit in every if orbit.starts], [orbit for orbit in every if not orbit.starts]
    starts = [len({start for orbit in on(branch, random) for start in orbit.starts}) for branch in branches]
    own = [
        count
        for branch, count in zip(branches, starts, strict=True)
        if count and START not in branch.ends and not on(branch, others)
    ]
    return SearchEvidence(starts, total, len(own), own.count(1))
