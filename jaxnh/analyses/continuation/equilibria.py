"""Branches of equilibria of a flow without a clock, from what Newton finds at random points of a box."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.families import equilibrium_family
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.analyses.continuation.tables import FollowedBranches
from jaxnh.analyses.equilibria.search import equilibria_from_starts
from jaxnh.analyses.random_starts import Box, random_start_batch
from jaxnh.orbits.continuation.core import StepControl

_FARTHEST = 100.0  # sizes of the box: equilibria further out are none of those looked for


def equilibria(
    batch: LaneBatch,
    lanes: LaneRunner,
    starts: int,
    seed: int,
    box: Box,
    ends: tuple[float, float],
    steps: StepControl,
    stage: Callable[[str], AbstractContextManager[object]],
) -> FollowedBranches:
    """All branches that equilibria lead to, with their folds, branch points and Hopf bifurcations.

    Args:
        batch: lanes along the first axis, at each of which Newton begins.
        lanes: runs lanes.
        starts, seed, box: points at each lane that Newton begins at.
        ends: of the range of the parameter.
        steps: how branches are followed.
        stage: shows what is done inside, by its label.
    """
    still = replace(batch.without_section(), axis=batch.first_axis)
    many, _ = random_start_batch(still, starts, seed, box)
    u, values = many.system.chart.host_points(many.start), np.repeat(batch.first_axis.values, starts)
    size = np.ptp(u, axis=0) / 2.0
    size = np.where(size > 0.0, size, size.max())
    with stage(f"equilibria from {starts} points at {batch.count} values of {batch.first_axis.name}"):
        zeros = equilibria_from_starts(many, lanes, u, np.tile(size, (len(u), 1)))
    with np.errstate(invalid="ignore"):
        near = zeros.exists & np.all(np.abs(zeros.u) < _FARTHEST * size, axis=1)
    waves = [
        [SeedOrbit(zeros.u[k : k + 1], value) for k in np.flatnonzero(near & (values == value))]
        for value in np.unique(values).tolist()
    ]
    family = equilibrium_family(batch, lanes, size, ends)
    tree = grow([family] * 3, waves, 1, steps, stage)  # a field has no steps that could be refined
    return FollowedBranches(tree, family, still)
