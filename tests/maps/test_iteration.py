"""Iterates of maps: images, tangents in phase and parameter space, and growth of areas, against derivatives by hand."""

from __future__ import annotations

import math
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxnh.jobs.attributes import ITERATION
from jaxnh.maps.build import cut_strobe, make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.protocol import Tangent
from jaxnh.solvers import NAMED, SOLVERS, iteration
from jaxnh.systems.discrete_map import discrete_map
from jaxnh.systems.first_order import Point
from jaxnh.systems.user_file import UserFile
from tests.flows import known_maps

A, B = 1.3, 0.25
START = np.array([0.4, -0.2])


def henon(u, a=A, b=B):
    x, y = u
    return np.array([1.0 - a * x**2 + y, b * x])


def henon_jacobian(u):
    return np.array([[-2.0 * A * u[0], 1.0], [B, 0.0]])


@pytest.fixture
def strobe():
    system = UserFile(Path("henon.py"), known_maps.HENON).flow({"a": A, "b": B}, ("a", "b"))
    return make_return_map(system, iteration, 1)


def test_iterates(strobe):
    exact = START
    for _ in range(5):
        exact = henon(exact)
    state = iterate(strobe, 5, Point(tuple(START)), {})
    np.testing.assert_allclose(np.stack(state.y), exact, rtol=1e-14)


def test_derivatives(strobe):
    """Of two iterates, in the state and in both parameters, by the chain rule."""
    first, second = START, henon(START)
    by_parameters = [np.array([[-(u[0] ** 2), 0.0], [0.0, u[0]]]) for u in (first, second)]
    monodromy = henon_jacobian(second) @ henon_jacobian(first)
    by_p = henon_jacobian(second) @ by_parameters[0] + by_parameters[1]
    ours = derivatives(strobe, 2, START, {"a": A, "b": B}, ("a", "b"))
    np.testing.assert_allclose(ours.image, henon(second), rtol=1e-15)
    np.testing.assert_allclose(ours.monodromy, monodromy, rtol=1e-14)
    np.testing.assert_allclose(ours.by_parameter, by_p, rtol=1e-14)


def test_growth_of_area(strobe):
    """The modulus of the determinant, −b: the map turns areas over."""
    tangents = (Tangent(Point((1.0, 0.0))), Tangent(Point((0.0, 1.0))))
    pushed = strobe.pushforward(Point(tuple(START)), {}, tangents)
    assert math.exp(pushed.log_volume) == pytest.approx(B, rel=1e-15)
    columns = np.stack([np.stack(t.state.y) for t in pushed.tangents], axis=-1)
    np.testing.assert_allclose(columns, henon_jacobian(START), rtol=1e-15)


def test_a_map_has_one_part():
    """Also without parameters, where it has no numbers of its own to stack."""

    def define():
        return {"map": lambda y: (2.0 * y[0], y[1] - 1.0), "coordinates": ("x", "y")}

    stack = cut_strobe(discrete_map(define, {}), iteration, 1, 16)
    state, _ = jax.lax.scan(lambda z, strobe: (strobe(z, {}), None), Point((3.0, 5.0)), stack)
    assert [float(leaf) for leaf in state.y] == [6.0, 4.0]


def test_no_config_names_it():
    assert iteration.name == ITERATION
    assert NAMED.keys() - SOLVERS.keys() == {ITERATION}
