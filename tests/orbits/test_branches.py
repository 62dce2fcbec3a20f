"""Branches of orbits against a map whose orbits are known, and against scipy's integrator with a Newton of its own."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.continuation.families import orbit_family
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.continuation.arclength import Family, along_parameter, correct
from jaxnh.orbits.continuation.branches import follow_both_ways
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.paths import COLLAPSED, ENDS, RANGE, StepControl
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.flows.duffing_resonance import by_scipy, duffing
from tests.flows.logistic_map import LOGISTIC, logistic, logistic_orbit
from tests.helpers.batches import batch_of


def corrected_orbit(family, points, value):
    """The orbit near some points (n, d) at a value of the parameter."""
    points = np.asarray(points, float)[None]
    found = correct(family, points, np.array([value]), along_parameter(family, *points.shape[:2]), FINE)
    assert found.converged[0]
    return found


def test_branch_of_fixed_points():
    """x = 1 − 1/p with the multiplier 2 − p, over the whole range and on where it is unstable."""
    branch = follow_both_ways(LOGISTIC, corrected_orbit(LOGISTIC, logistic_orbit(1, 2.8), 2.8))[0]
    assert branch.ends == (RANGE, RANGE)
    assert sorted(branch.value[[0, -1]]) == [2.0, 3.9]
    rounding = 1e-11  # the square of Newton's last step, below 1e-6, and curvature of order one
    assert np.abs(branch.points[:, 0, 0] - (1 - 1 / branch.value)).max() < rounding
    assert np.abs(branch.multipliers[:, 0] - (2 - branch.value)).max() < 10 * rounding


def test_branch_turns_at_its_fold():
    """Period 3 is born at p = 1 + √8, and both of its orbits are followed from one; none is below."""
    branch = follow_both_ways(LOGISTIC, corrected_orbit(LOGISTIC, logistic_orbit(3, 3.835), 3.835))[0]
    assert branch.ends == (RANGE, RANGE)
    assert np.all(branch.value[[0, -1]] == 3.9)
    fold = 1 + np.sqrt(8)
    assert fold - 1e-11 < branch.value.min() < fold + 1e-2
    image = logistic(branch.points.reshape(-1, 1), np.repeat(branch.value, 3)).image.reshape(branch.points.shape)
    assert np.abs(image - np.roll(branch.points, -1, 1)).max() < 1e-11
    unstable, stable = branch.multipliers[[0, -1], 0].real[np.argsort(-branch.multipliers[[0, -1], 0].real)]
    assert unstable > 1 > stable


def test_branch_ends_where_it_was_born_in_a_doubling():
    """Period 2 from p = 3, where its two points (1 + 1/p ± √((1 − 3/p)(1 + 1/p)))/2 are one."""
    branch = follow_both_ways(LOGISTIC, corrected_orbit(LOGISTIC, logistic_orbit(2, 3.3), 3.3))[0]
    assert sorted(branch.ends) == sorted((COLLAPSED, RANGE))
    p = branch.value
    gap = np.sqrt((1 - 3 / p) * (1 + 1 / p))
    # The equations of a doubled orbit are as steep in the gap as its square: roundings of them are divided by that.
    rounding = 1e-10 + 2 * np.finfo(float).eps / gap**2
    assert np.all(np.abs(np.abs(branch.points[:, 0, 0] - branch.points[:, 1, 0]) - gap) < rounding)
    assert p.min() < 3.01


# ---- Duffing's resonance, in the phase of its forcing: its frequency is a parameter like others


@pytest.fixture(scope="module")
def resonance(lanes):
    """The family of its orbits over the frequency."""
    flow = first_order(duffing, {"omega": 1.0})
    # 96 steps of order nine: an error of some 1e-13 a period, the rounding of its states.
    scene = batch_of(flow, flow.start({"x": 0.0, "v": 0.0}), [0.6, 2.0], verner9, 96, name="omega")
    return orbit_family(scene, lanes, scene.strobe(), np.ones(2), (0.6, 2.0))


def test_resonance_of_duffing(resonance):
    """One branch over the frequency, folded twice; its orbits close and have their multipliers by scipy."""
    branch = follow_both_ways(resonance, corrected_orbit(resonance, [[0.0, 0.1]], 0.6))[0]
    assert {ENDS[end] for end in branch.ends} == {"range"}
    turns = np.flatnonzero(np.diff(np.sign(branch.way.value)))
    assert len(turns) == 2
    middle = (turns[0] + turns[1]) // 2
    for k in (len(branch.value) // 8, middle, -1):
        image, matrix = by_scipy(branch.value[k], branch.points[k, 0])
        assert np.abs(image - branch.points[k, 0]).max() < 1e-10  # Newton's last step squared, and scipy's tolerance
        exact = np.linalg.eigvals(matrix)
        assert np.abs(np.sort_complex(exact) - np.sort_complex(branch.multipliers[k])).max() < 1e-9
    assert np.abs(branch.multipliers[middle, 0]) > 1 > np.abs(branch.multipliers[0, 0])


# ---- an imperfect pitchfork


def imperfect(break_):
    """x → x + μ x − x³ + ε: its fixed points are μ = x² − ε/x, one curve for x > 0 and one for x < 0."""

    def period(u, mu):
        x = u[:, 0]
        slope = (1 + mu - 3 * x**2)[:, None, None]
        return Derivatives((x + mu * x - x**3 + break_)[:, None], slope, u)

    return Family(period, lambda gap: gap, np.ones(1), -0.5, 0.5)


@pytest.mark.parametrize("break_", [1e-4, 1e-6, 1e-8])
def test_branch_stays_on_its_side_of_an_imperfect_pitchfork(break_):
    """The curve of x > 0 comes as near as ε^(1/3) to where the others almost cross it, and goes on to small x."""
    family = imperfect(break_)
    for x in (np.sqrt(0.4), -np.sqrt(0.4)):
        branch = follow_both_ways(family, corrected_orbit(family, [[x]], 0.4), StepControl(0.05))[0]
        assert branch.ends == (RANGE, RANGE)
        followed = branch.points[:, 0, 0]
        assert np.all(np.sign(followed) == np.sign(x))
        # μ is known to rounding and to the square of Newton's last step, which the curve's slope in x enlarges.
        slope = np.abs(2 * followed + break_ / followed**2)
        assert np.all(np.abs(branch.value - (followed**2 - break_ / followed)) < 1e-11 * (1 + slope))
        assert sorted(np.sign(branch.value[[0, -1]])) == ([-1, 1] if x > 0 else [1, 1])
