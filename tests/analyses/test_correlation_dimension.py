"""Correlation dimensions that are known: turns, generalised baker's maps, a singular density, Henon's map."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import jaxnh
from jaxnh.analyses.trajectories.correlation import correlation_dimension
from jaxnh.exceptions import InputError
from tests.flows.known_maps import henon

LEAST = 0.95 - 3 * np.sqrt(0.95 * 0.05 / 40)
"""Of 40 intervals of 95 %, the share that covers at least, but for one case in a thousand."""

SHARE, LEFT, RIGHT = 0.4, 0.35, 0.2


def turns(lanes, points, rates):
    """Points of rotations of a torus, which fill it evenly."""
    start = np.random.default_rng(1).random((lanes, 1, len(rates)))
    return 2 * np.pi * (start + np.arange(points)[:, None] * np.array(rates))


def bakers(lanes, points, shares, widths, begins):
    """Points of the contracting direction of generalised baker's maps: of two strips with shares of the measure."""
    left = np.random.default_rng(2).random((lanes, points + 64)) < shares
    x = np.zeros((lanes, points + 64))
    for k in range(points + 63):
        x[:, k + 1] = np.where(left[:, k], widths[0] * x[:, k], begins + widths[1] * x[:, k])
    return x[:, 64:, None]


def logistic(lanes, points):
    """Points of the logistic map at 4, by its closed form from independent phases: density 1/(π √(x (1 − x)))."""
    return np.sin(0.5 * np.pi * np.random.default_rng(3).random((lanes, points, 1))) ** 2


def covers(points, exact, angles=None):
    turning = np.zeros(points.shape[2], bool) if angles is None else np.array(angles)
    of = correlation_dimension(points, turning)
    return np.mean(np.abs(of.value - exact) <= of.error), of


def test_even_measures():
    """A circle and a torus, of dimensions 1 and 2."""
    for rates, exact in (((np.sqrt(2.0),), 1.0), ((np.sqrt(2.0), np.sqrt(3.0)), 2.0)):
        share, of = covers(turns(4, 2048, rates), exact, [True] * len(rates))
        assert share == 1.0
        assert np.abs(of.value - exact).max() < 0.05


def test_fractal_measures():
    """Of widths w and shares p of two strips Σ p² w^−D = 1 (Badii and Politi, J. Stat. Phys. 40 (1985) 725)."""
    cantor, of = covers(bakers(40, 512, 0.5, (1 / 3, 1 / 3), 2 / 3), np.log(2) / np.log(3))
    assert cantor >= LEAST
    assert np.abs(of.value - np.log(2) / np.log(3)).max() < 0.05
    exact = brentq(lambda d: SHARE**2 * LEFT**-d + (1 - SHARE) ** 2 * RIGHT**-d - 1.0, 0.01, 1.0)
    uneven, of = covers(bakers(40, 512, SHARE, (LEFT, RIGHT), 0.5), exact)
    assert uneven >= LEAST
    assert np.abs(of.value - exact).max() < 0.1


def test_a_singular_density():
    """Its slope comes to 1 as slowly as 1/ln r, and the error knows."""
    for points in (512, 1024):
        share, of = covers(logistic(40, points), 1.0)
        assert share >= LEAST
        assert of.value.max() < 0.95


def test_henons_map():
    """D = 1.220 ± 0.036 (Grassberger, Phys. Lett. A 97 (1983) 224), of lanes that differ in their start."""
    options = jaxnh.Poincare(transient=256, strobes=1024, correlation_dimension=True)
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(options, y=np.linspace(0.0, 0.1, 20))
    value, error = (data[f"correlation_dimension{ending}"].to_numpy() for ending in ("", "_error"))
    assert np.mean(np.abs(value - 1.220) <= error) == 1.0
    assert np.abs(value.mean() - 1.220) < 0.036
    assert error.max() < 0.5
    plain = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(jaxnh.Poincare(transient=256, strobes=256), y=[0.1])
    assert "correlation_dimension" not in plain


def test_orbits_have_dimension_zero_and_few_points_none():
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(
        jaxnh.Poincare(transient=512, strobes=256, correlation_dimension=True), a=[0.2, 0.9]
    )
    assert np.all(data["correlation_dimension"] == 0.0)
    assert np.all(data["correlation_dimension_error"] == 0.0)
    few = correlation_dimension(np.random.default_rng(4).random((1, 256, 3)), np.zeros(3, bool))
    assert np.isnan(few.value).all() or few.error > 0.5
    with pytest.raises(InputError, match="256 or more for a correlation dimension"):
        jaxnh.Poincare(strobes=128, correlation_dimension=True)


def test_pairs_in_turn_are_left_out():
    """A slow turn: neighbours in time are near, and the window leaves out a sixteenth of a turn at least."""
    share, of = covers(turns(2, 4096, (0.05 * (np.sqrt(5.0) - 2.0),)), 1.0, [True])
    assert share == 1.0
    assert np.abs(of.value - 1.0).max() < 0.1
