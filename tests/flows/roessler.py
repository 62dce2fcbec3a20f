"""Roessler's flow at a = b = 0.2, and its doublings over c by heyoka."""

from __future__ import annotations

import numpy as np

from tests.helpers import taylor
from tests.helpers.heyoka_newton import bifurcation, iterated, section_map


def roessler(x, y, z, c, t):
    """configs/flows/roessler.py at a = b = 0.2."""
    fifth = taylor.REAL(0.2)
    return -y - z, x + fifth * y, fifth + z * (x - c)


def doubling_of_roessler(near, n):
    """The value of c at which the orbit of n returns doubles, by Newton from where it attracts, just before it."""
    image = section_map(roessler, 3, 1, 0.0, 1)
    u, _ = iterated(image, 200)(near - 0.02, np.array([1.0, 0.0], taylor.REAL))
    exact, multipliers = bifurcation(iterated(image, n), "period_doubling", near, u)
    assert np.abs(multipliers + 1).min() < 1e-6
    return exact
