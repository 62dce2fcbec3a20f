"""Cubic coefficients of flips in closed form, and how often their bars cover, with derivatives right to so many digits."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.normal_forms import cubic
from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector
from jaxnh.orbits.continuation.kinds import DOUBLING

COUNT = 4000


@pytest.mark.parametrize("strength", [1.0, 30.0])
@pytest.mark.parametrize("noise", [0.0, 1e-16, 1e-14, 1e-12])
def test_bars_of_cubic_coefficients_cover(noise, strength):
    """Of x → −x + Σ c_j x^j it is −(c₂² + c₃): the second iterate is x − 2 (c₂² + c₃) x³ + …"""
    rng = np.random.default_rng(0)
    powers = np.arange(2, 7)
    c = rng.normal(size=(COUNT, 5)) * strength ** (powers - 2) / 3

    def period(u, number):
        own, x = c[number.astype(int)], u
        slope = -1 + np.sum(own * powers * x ** (powers - 1), axis=1)
        slope *= 1 + noise * rng.normal(size=slope.shape)
        return Derivatives(-x + np.sum(own * x**powers, axis=1, keepdims=True), slope[:, None, None], None)

    none = np.zeros(COUNT)
    way, blocks = PathVector(np.zeros((COUNT, 1, 1)), none), np.full((COUNT, 1, 1, 1), -1.0)
    number = np.arange(COUNT, dtype=float)
    orbits = CurveOrbits(np.zeros((COUNT, 1, 1)), number, way, blocks, none, none, none, np.ones(COUNT, bool), way)
    family = Family(period, lambda gap: gap, np.ones(1), 0.0, float(COUNT))
    known = cubic(family, orbits, np.full(COUNT, DOUBLING))
    exact = -(c[:, 0] ** 2 + c[:, 1])
    assert np.mean(np.abs(known.coefficient - exact) <= known.error) >= 0.95
    sure = known.criticality != 0
    assert sure.mean() > 0.9
    assert np.array_equal(known.criticality[sure], -np.sign(exact[sure]))
