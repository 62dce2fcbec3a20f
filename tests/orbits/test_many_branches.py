"""Many branches of the particle in one run: none is lost or changed by the others. And where they are begun: a search."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from jaxnh.analyses.continuation.families import orbit_family
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.analyses.continuation.seeds import random_wave
from jaxnh.maps.section import Section, begin
from jaxnh.orbits.continuation.arclength import along_parameter, correct
from jaxnh.orbits.continuation.branches import follow_both_ways
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.paths import StepControl
from jaxnh.solvers import dopri8
from jaxnh.systems.first_order import first_order
from tests.flows.logistic_map import LOGISTIC
from tests.helpers.batches import batch_of
from tests.helpers.particle_branches import ENDS, none_is_lost, rough_scene


@pytest.fixture(scope="module")
def scene():
    return rough_scene()


def searched(scene, lanes, values, starts, limit):
    """Orbits of all periods up to a limit at some of the values, none twice."""
    some = scene.take(np.array(values))
    return random_wave(some, lanes, starts, 1, {"x1": (-4, 4), "y1": (-4, 4)}, limit, np.ones(3), 64)


def begun_at(family, orbits, n):
    """Those of a period, as branches begin with them."""
    mine = [orbit for orbit in orbits if len(orbit.points) == n]
    points, value = np.stack([orbit.points for orbit in mine]), np.array([orbit.value for orbit in mine])
    begun = correct(family, points, value, along_parameter(family, len(mine), n), FINE)
    return begun.take(begun.converged)


def agree(family, begun, steps, branches, alone):
    """See that some branches are, bit for bit, what they are where each is followed by itself."""
    for k in list(branches)[::alone]:
        single, together = follow_both_ways(family, begun.take(slice(k, k + 1)), steps)[0], branches[k]
        assert single.ends == together.ends
        whole = (together.points, together.value, together.way, together.tests, together.multipliers)
        one = (single.points, single.value, single.way, single.tests, single.multipliers)
        assert all(map(np.array_equal, jax.tree.leaves(whole), jax.tree.leaves(one)))


def all_agree(scene, lanes, orbits, steps, alone):
    """As `agree`, of the branches through all orbits."""
    family = orbit_family(scene, lanes, scene.strobe(), np.ones(3), ENDS)
    for n in sorted({len(orbit.points) for orbit in orbits}):
        begun = begun_at(family, orbits, n)
        together = follow_both_ways(family, begun, steps)
        assert len(together) == len(begun.value)
        agree(family, begun, steps, together, alone)


def test_search_finds_what_attracts_and_what_does_not(scene, lanes):
    """At b = 6 both twins that attract, (x1, y1) → −(x1, y1); at b = 5 orbits, all of which repel."""
    found = searched(scene, lanes, [4, 8], 8, 3)
    twins = [orbit.points[0] for orbit in found if orbit.value == 6.0 and len(orbit.points) == 1]
    assert any(np.abs(one[:2] + other[:2]).max() < 1e-6 for one in twins for other in twins)
    names = [(orbit.value, len(orbit.points), *np.round(orbit.points[0], 4)) for orbit in found]
    assert len(set(names)) == len(names)
    strobe = scene.strobe()
    for orbit in found:
        image = orbit_family(scene, lanes, strobe, np.ones(3), ENDS).period(
            orbit.points, np.full(len(orbit.points), orbit.value)
        )
        gap = scene.chart.wrap(np.asarray(image.image) - np.roll(orbit.points, -1, 0))
        assert np.abs(gap).max() < 1e-8  # Newton's last step, below 1e-9 of its size, times the expansion of a period


def test_branches_do_not_feel_each_other(scene, lanes):
    """As many as are found at two values, for the first of their points."""
    orbits = searched(scene, lanes, [6, 8], 4, 2)
    assert len(orbits) >= 4
    all_agree(scene, lanes, orbits, StepControl(max_steps=10), 1)


@pytest.mark.slow
def test_many_branches_of_periods_up_to_eight(scene, lanes):
    """All that a search at three values finds, for their first points; every eighth of a period by itself as well."""
    orbits = searched(scene, lanes, [0, 4, 8], 16, 8)
    assert max(len(orbit.points) for orbit in orbits) == 8
    all_agree(scene, lanes, orbits, StepControl(max_steps=30), 8)


@pytest.mark.slow
def test_few_lanes_on_a_section(lanes):
    """Another program serves few lanes there: of each lane its bits are those that it has among many."""

    def roessler(c=3.0):
        return {"rhs": lambda y, t: (-y[1] - y[2], y[0] + 0.2 * y[1], 0.2 + y[2] * (y[0] - c)), "coordinates": "xyz"}

    flow = Section(first_order(roessler, {"c": 3.0}), "y", 1, 0.0, "up")
    scene = batch_of(
        flow, begin(flow, flow.flow.start({"x": 2.0, "y": 0.0, "z": 0.1})), [2.9, 3.1], dopri8, 24, name="c"
    )
    family = orbit_family(scene, lanes, scene.strobe(), np.ones(2), (2.0, 4.0))
    rng = np.random.default_rng(0)
    u, c = np.array([2.0, 0.1]) + 0.1 * rng.uniform(size=(20, 2)), rng.uniform(2.5, 3.5, 20)
    many, few = family.period(u, c), family.period(u[:3], c[:3])
    assert np.isfinite(many.monodromy).all()
    assert all(np.array_equal(a[:3], b) for a, b in zip(many, few, strict=True))


def test_an_orbit_that_only_a_dropped_branch_has_passed():
    """Of three orbits on one branch two are followed side by side, and the second is dropped, but has passed the third."""
    family = LOGISTIC._replace(at_once=2)
    orbits = [SeedOrbit(np.array([[1.0 - 1.0 / r]]), r) for r in (2.4, 2.42, 2.44)]
    tree = grow([family] * 3, [orbits], 1, StepControl(0.05, 3))
    assert [2.4 < branch.value.max() < 2.44 for branch in tree.branches] == [True, False]
    none_is_lost(orbits, family, tree)
