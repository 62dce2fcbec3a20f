"""Branches of the particle over b, of a rough map: of what many of them do to each other it says as much as an exact one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxnh.analyses.continuation.families import orbit_family
from jaxnh.analyses.continuation.family_tree import grow
from jaxnh.analyses.continuation.known_branches import KnownBranches
from jaxnh.analyses.continuation.seeds import random_wave
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed
from tests.helpers.batches import batch_of

START = ((0.1, 0.1), (0.1, float(np.sqrt(0.99))))
ENDS = (4.0, 6.0)
_STEP = 0.05  # lengths: the largest step along branches


def rough_scene():
    """Values of b over the range."""
    return batch_of(constant_speed(), START, np.linspace(*ENDS, 9), SPLITTINGS["blanes_moan6"], 60)


def none_is_lost(orbits, family, tree):
    """See that orbits that a search began with are on branches of their period."""
    for n in {len(orbit.points) for orbit in orbits}:
        known = KnownBranches(family, tree.branches, n)
        assert all(known.has(orbit.points, orbit.value) for orbit in orbits if len(orbit.points) == n)


def lost_of_the_flow(families, tree):
    """Changes of sign that led to no bifurcation, but for those of orbits on which the map is wrong by a step or more.

    Newton takes random starts to orbits that pass where sixty steps are far too few: of 1,059 branches three, on which
    the map and the one of twice the steps are 0.5 to 0.7 apart. These are orbits of the map alone, and of no flow.
    """
    kept = []
    for change in tree.lost:
        branch = tree.branches[change.branch]
        points, value = branch.points[change.place], np.full(branch.period, branch.value[change.place])
        images = [np.asarray(family.period(points, value).image) for family in families[:2]]
        if np.abs(families[0].wrap(images[1] - images[0])).max() < _STEP:
            kept.append(change)
    return kept


def grow_particle_branches(scene, lanes, values, starts, limit, steps):
    """The orbits of a search at some values of b, their families, and the tree of branches that they lead to."""
    values = np.array(values)
    here = replace(scene.take(np.arange(len(values))), p={"b": values}, axis=replace(scene.first_axis, values=values))
    orbits = random_wave(here, lanes, starts, 1, {"x1": (-4, 4), "y1": (-4, 4)}, limit, np.ones(3), 64)
    families = [orbit_family(scene, lanes, strobe, np.ones(3), ENDS) for strobe in refined_maps(scene)]
    return orbits, families, grow(families, [orbits], limit, steps)
