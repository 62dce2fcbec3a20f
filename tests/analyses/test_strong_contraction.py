"""Exponents where motions contract so much that a volume, or a tangent, underflows within a unit of time."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ive

import jaxnh
from jaxnh.analyses.exponents.errors import Average
from jaxnh.analyses.exponents.estimates import know_lost


def cycle(rate=5000.0):
    """r' = κ r (1 − r²), θ' = 1: exponents 0 and −2κ."""

    def rhs(y, t):
        x, z = y
        inwards = rate * (1 - x * x - z * z)
        return inwards * x - z, inwards * z + x

    return {"rhs": rhs, "coordinates": ("x", "z")}


def spiking(rate=3000.0):
    """As `cycle`, with κ = 5 + β e^(40 cos(θ − 5) − 40) for a rate β: the second exponent is −2(5 + β e^−40 I₀(40))."""

    def rhs(y, t):
        x, z = y
        squared = x * x + z * z
        near = (x * jnp.cos(5.0) + z * jnp.sin(5.0)) / jnp.sqrt(squared)
        inwards = (5.0 + rate * jnp.exp(40.0 * (near - 1.0))) * (1 - squared)
        return inwards * x - z, inwards * z + x

    return {"rhs": rhs, "coordinates": ("x", "z"), "time_unit": 1.0}


def forced(rate=1e4):
    """All directions contract alike: both exponents are −κ."""

    def rhs(y, t):
        x, z = y
        return -rate * (x - jnp.cos(2 * jnp.pi * t)), -rate * z

    return {"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0}


def exponents_of(system, rates):
    session = jaxnh.Session(system, start={"x": 0.8, "z": 0.1}, target=1e-6)
    options = jaxnh.Lyapunov(transient=8, periods=16, exponents=2, method="averages")
    return session.run(options, rate=rates)


def test_the_smallest_exponent_is_what_volume_says_where_its_tangent_was_lost():
    """Tangents come across the spike after those times from which the number of orthonormalisations is chosen."""
    rates = np.array([60.0, 300.0])
    session = jaxnh.Session(spiking, start={"x": 0.9, "z": 0.1}, target=1e-5)
    data = session.run(jaxnh.Lyapunov(transient=8, periods=64, exponents=2, method="averages"), rate=rates)
    exact = -2.0 * (5.0 + rates * ive(0, 40.0))
    assert np.all(np.abs(data["exponents"][:, 1] - exact) <= data["exponents_error"][:, 1])
    np.testing.assert_allclose(data["exponents"][:, 1], exact, rtol=0.1)  # 64 is ten turns and a fifth
    assert np.all(np.isnan(data["sum_rule_residual"]))


def test_lost_tangents_without_a_sum_are_not_known():
    mean, error = np.array([[0.5, -1.0, -9.0]] * 3), np.full((3, 3), 0.25)
    lost = np.array([[False, False, True], [False, True, True], [False, False, False]])
    know_lost(mean, error, lost, np.array([True, False, False]), Average(np.full(3, -40.0), np.full(3, 0.125)))
    np.testing.assert_array_equal(mean[:, 2], [-39.5, -9.0, -9.0])
    np.testing.assert_array_equal(error, [[0.25, 0.25, 0.625], [0.25, np.inf, np.inf], [0.25, 0.25, 0.25]])
    know_lost(mean, error, lost, np.zeros(3, bool), None)
    assert np.isinf(error[0, 2])


def brusselator(rate=20.0):
    """A = 1 and B the rate."""
    rhs = lambda z, t: (1.0 - (rate + 1.0) * z[0] + z[0] ** 2 * z[1], rate * z[0] - z[0] ** 2 * z[1])  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "y")}


def van_der_pol(rate=100.0):
    """The rate is μ."""
    return {"rhs": lambda z, t: (z[1], rate * (1.0 - z[0] ** 2) * z[1] - z[0]), "coordinates": ("x", "y")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "start", "transient", "exact"),
    [(brusselator, (1.0, 21.0), 64, -67.5403), (van_der_pol, (2.0, 0.0), 256, -178.07977)],
)
def test_relaxation_oscillators(system, start, transient, exact):
    """The mean divergence along the cycle, by LSODA at 1e-11 between its crossings and Gauss's rule in each step."""
    session = jaxnh.Session(system, start=dict(zip("xy", start, strict=True)), target=1e-8)
    data = session.run(jaxnh.Lyapunov(transient=transient, periods=512))
    missed, error = abs(float(data["exponents"][1]) - exact), float(data["exponents_error"][1])
    assert missed <= error < 0.25 * abs(exact)


@pytest.mark.slow
def test_a_cycle_that_attracts_by_ten_thousand_a_unit():
    """The sum had been minus infinity without an error to speak of, and the second exponent a tenth of what it is."""
    rates = np.array([5.0, 5000.0])
    data = exponents_of(cycle, rates)
    assert np.all(np.abs(data["exponents"][:, 1] + 2 * rates) <= data["exponents_error"][:, 1])
    assert np.all(np.abs(data["exponent_sum"] + 2 * rates) <= data["exponent_sum_error"])
    assert np.all(data["exponents_error"][:, 1] < 1e-5 * rates)
    assert np.all(data["exponent_sum_error"] < 1e-3)


@pytest.mark.slow
def test_all_directions_contract_alike():
    """Tangents of equal length shrink below what numbers hold; a flow that contracts little has one part a period."""
    data = exponents_of(forced, [1e3])
    assert np.all(np.abs(data["exponents"] + 1e3) <= data["exponents_error"])
    assert np.all(data["exponents_error"] < 0.01)
    assert np.all(np.abs(data["exponent_sum"] + 2e3) <= data["exponent_sum_error"])
    assert data.attrs["orthonormalisations_per_period"] >= 4
    assert exponents_of(forced, [1.0]).attrs["orthonormalisations_per_period"] == 1
