"""A thousand branches in one run: all that chaos holds of short periods, and none of it is lost."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.orbits.continuation.paths import StepControl
from tests.helpers.particle_branches import grow_particle_branches, lost_of_the_flow, none_is_lost, rough_scene

pytestmark = pytest.mark.case("A thousand branches")


@pytest.mark.slow
def test_a_thousand_branches_in_one_run(battery, lanes):
    """Of periods up to 8, begun in chaos, with all their bifurcations, errors, and the branches that are born there.

    In fifteen steps either way few reach an end of the range.
    """
    values, starts = ([4.62, 4.7, 4.78, 4.85, 4.92], 80) if battery.full else ([4.7, 4.92], 24)
    orbits, families, tree = grow_particle_branches(rough_scene(), lanes, values, starts, 8, StepControl(0.05, 15))
    branches, points = len(tree.branches), len(tree.bifurcations)
    assert min(branches, points) > (1000 if battery.full else 100)
    shown = f"{branches:,} branches of periods up to 8, {points:,} bifurcations"
    battery.row(shown, float(np.median([point.error for point in tree.bifurcations])), 1e-6, "median error of b")
    battery.row(f"{shown}, of a rough map", len(lost_of_the_flow(families, tree)), 0, "branches that are lost:")
    none_is_lost(orbits, families[0], tree)
