"""Branches of equilibria of a flow without a clock, from what Newton finds at random points of a box."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.base import OptionError, Setting
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.families import equilibrium_family
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.analyses.continuation.tables import FollowedBranches
from jaxnh.analyses.equilibria.search import equilibria_from_starts
from jaxnh.analyses.random_starts import Box, random_start_batch
from jaxnh.maps.section import Section
from jaxnh.orbits.bifurcations.hopf_cycles import SectionPlane, first_cycles, hopf_points
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.kinds import HOPF
from jaxnh.orbits.continuation.paths import StepControl

AMPLITUDES = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Amplitudes of cycles at Hopf points that are tried, in sizes of the box."""

_FARTHEST = 100.0  # sizes of the box: equilibria further out are none of those looked for


def check_equilibria(setting: Setting) -> None:
    """Check that a flow has isolated equilibria."""
    if not setting.autonomous:
        what = "a flow with a clock" if setting.flow.continuous else "a map has orbits of period 1, and"
        raise OptionError(f"{what} has no equilibria; leave it out", "equilibria")
    if setting.flow.chart.dimension > setting.flow.exponents:
        raise OptionError("equilibria of a flow with constraints are not isolated; leave it out", "equilibria")


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
    with stage(f"equilibria from {starts} points at {batch.count} values of {batch.first_axis.name}"):
        u, values, size = equilibria_in_a_box(still, lanes, starts, seed, box)
    waves = [
        [SeedOrbit(u[k : k + 1], value) for k in np.flatnonzero(values == value)]
        for value in np.unique(values).tolist()
    ]
    family = equilibrium_family(batch, lanes, size, ends)
    tree = grow([family] * 3, waves, 1, steps, stage)  # a field has no steps that could be refined
    return FollowedBranches(tree, family, still)


def equilibria_in_a_box(
    still: LaneBatch, lanes: LaneRunner, starts: int, seed: int, box: Box
) -> tuple[Float[np.ndarray, "some d"], Float[np.ndarray, " some"], Float[np.ndarray, " d"]]:
    """Equilibria by Newton from random points at each lane of a batch without a section, along the first axis.

    Returns:
        Equilibria, many of them again and again; their values of the parameter; and the sizes of the box.
    """
    many, _ = random_start_batch(still, starts, seed, box)
    u, values = many.system.chart.host_points(many.start), np.repeat(still.first_axis.values, starts)
    low, high = np.min(u, axis=0), np.max(u, axis=0)
    size = (high - low) / 2.0
    size = np.where(size > 0.0, size, size.max())
    zeros = equilibria_from_starts(many, lanes, u, np.tile(size, (len(u), 1)))
    with np.errstate(invalid="ignore"):
        near = zeros.exists & np.all(np.abs(zeros.u - (low + high) / 2.0) < _FARTHEST * size, axis=1)
    return zeros.u[near], values[near], size


def cycles_at_hopf_points(followed: FollowedBranches, family: Family, section: Section) -> list[SeedOrbit]:
    """The first cycles on the branches that Hopf points begin, where these cross the section.

    Args:
        followed: equilibria with their bifurcations.
        family: cycles of the section's map over the same parameter.
        section: of the flow.
    """
    hopf = [point for point in followed.tree.bifurcations if point.kind == HOPF]
    if not hopf:
        return []
    plane = section_plane(section)
    points, value = np.array([point.points for point in hopf]), np.array([point.value for point in hopf])
    cycles = first_cycles(family, hopf_points(followed.family, points, value), plane, AMPLITUDES)
    return [SeedOrbit(cycle.points[0], float(cycle.value[0])) for cycle in cycles]


def section_plane(section: Section) -> SectionPlane:
    """The plane of a section, by all coordinates."""
    weights = np.zeros(section.flow.chart.dimension)
    weights[: len(section.normal or ())] = section.normal or ()
    if section.normal is None:
        weights[section.number] = 1.0
    return SectionPlane(weights, section.value, section.direction, section.number)
