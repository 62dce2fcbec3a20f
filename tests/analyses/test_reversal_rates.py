"""Errors of exponents of attractors and repellers, against closed forms."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")


def two_points(mu=1.0, b=0.16, k=0.16):
    """ẋ = s (mu − x²), ż = −s x (z − b) (1 + k z²), with s = 1 + cos(2πt)/2 and R from x to −x.

    With ds the exponents at (√mu, b) are −2 √mu and −√mu (1 + k b²), and their opposites at (−√mu, b).
    """

    def rhs(y, t):
        x, z = y
        s = 1.0 + 0.5 * jnp.cos(2 * jnp.pi * t)
        return s * (mu - x * x), -s * x * (z - b) * (1.0 + k * z * z)

    return {"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0, "reversal": {"x": -1, "time": 0.0}}


def test_errors_of_exponents_have_those_of_the_steps():
    """Rates are the same in all periods, so that steps alone are to blame, which backwards nobody has looked at."""
    mu = np.linspace(0.3, 1.9, 8)
    session = jaxnh.Session(two_points, start={"x": 0.4, "z": 0.1}, target=1e-6)
    data = session.run(jaxnh.Reversal(transient=128, strobes=64, periods=64), mu=mu)
    exact = np.sqrt(mu)[:, None] * [1.0 + 0.16 * 0.16**2, 2.0]
    for name, known in (("exponents", -exact), ("repeller_exponents", exact)):
        error = data[f"{name}_error"].to_numpy()
        assert np.all(np.abs(data[name].to_numpy() - known) <= error)
        assert error.max() < 1e-3
    assert np.all(np.abs(data["exponent_sum"].to_numpy() + exact.sum(axis=1)) <= data["exponent_sum_error"].to_numpy())
