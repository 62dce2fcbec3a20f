"""Exponents where motions contract so much that a volume, or a tangent, underflows within a unit of time."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh


def cycle(rate=5000.0):
    """r' = κ r (1 − r²), θ' = 1: exponents 0 and −2κ."""

    def rhs(y, t):
        x, z = y
        inwards = rate * (1 - x * x - z * z)
        return inwards * x - z, inwards * z + x

    return {"rhs": rhs, "coordinates": ("x", "z")}


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
