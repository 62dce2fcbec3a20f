"""Bifurcations of states that rest, which have no size of their own: a pendulum in a moving pivot, a map with 0 fixed.

Most lanes of such a sweep settle on that state, and what is left of them is no size of a motion.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import jaxnh

DAMPING = 0.1


def shaken_pendulum(a=1.0, h=0.5):
    """q'' + 0.1 q' + (a + h cos 2t) sin q = 0, which rests at q = 0."""

    def rhs(y, t):
        q, v = y
        return v, -(a + h * jnp.cos(2 * t)) * jnp.sin(q) - 0.1 * v

    return {"rhs": rhs, "coordinates": ("q", "v"), "period": jnp.pi, "angles": ("q",)}


def degenerate_flip(m=0.1, s=0.5):
    """x → −(1 + m) x + s x³ − x⁵, which flips at m = 0, from above or below by the sign of s."""
    return {"map": lambda y: (-(1 + m) * y[0] + s * y[0] ** 3 - y[0] ** 5,), "coordinates": ("x",)}


def over_a_period(matrix, force):
    """Solution after π of y' = matrix(t) y + force(t, y), of the columns of the identity, or of one column."""

    def of(start):
        return solve_ivp(
            lambda t, y: matrix(t) @ y + force(t, y), (0, np.pi), start, method="DOP853", rtol=1e-13, atol=1e-15
        ).y[:, -1]

    return of


def flip_and_cubic_term(values):
    """det(M + 1), and the cubic coefficient of the flip by perturbation to the third order: both vanish there.

    With x = εx₁ + ε³x₃ the pendulum is x₁'' + 0.1x₁' + k(t)x₁ = 0 and x₃'' + 0.1x₃' + k(t)x₃ = k(t)x₁³/6.
    """
    a, h = values

    def k(t):
        return a + h * np.cos(2 * t)

    def linear(t):
        return np.array([[0.0, 1.0], [-k(t), -DAMPING]])

    plain = over_a_period(linear, lambda t, y: 0.0)
    whole = np.stack([plain(column) for column in np.eye(2)], axis=1)
    _, q = np.linalg.eig(whole)
    right = np.real(q[:, np.argmin(np.abs(np.linalg.eigvals(whole) + 1))])
    values_left, p = np.linalg.eig(whole.T)
    left = np.real(p[:, np.argmin(np.abs(values_left + 1))])
    third = over_a_period(
        lambda t: np.kron(np.eye(2), linear(t)), lambda t, y: np.array([0.0, 0.0, 0.0, k(t) * y[0] ** 3 / 6])
    )
    return [np.linalg.det(whole + np.eye(2)), left @ third([*right, 0.0, 0.0])[2:] / (left @ right)]


def test_generalised_doubling_of_a_pendulum_that_hangs_still():
    """The tongue of the hanging pendulum has one such point, where doublings turn from supercritical to subcritical."""
    session = jaxnh.Session(shaken_pendulum, {"q": 0.1, "v": 0.0}, 1e-8)
    data = session.run(jaxnh.Curves(max_period=1), a=np.linspace(0.8, 1.2, 5), h=np.linspace(0.1, 0.3, 3))
    expected = fsolve(flip_and_cubic_term, [1.0, 0.2], xtol=1e-12)
    assert data["codimension_two_kind"].to_numpy().tolist() == [1]
    for name, value in zip("ah", expected, strict=True):
        error = float(data[f"codimension_two_{name}_error"][0])
        assert error < 1e-8
        assert abs(data[f"codimension_two_{name}"].to_numpy()[0] - value) < error


def test_generalised_doubling_of_a_map_at_rest():
    """In closed form at m = s = 0, of lanes most of which have come to 0."""
    session = jaxnh.Session(degenerate_flip, {"x": 0.1})
    data = session.run(jaxnh.Curves(max_period=1), m=np.linspace(-0.6, 0.2, 5), s=np.linspace(-0.5, 0.7, 3))
    assert data["codimension_two_kind"].to_numpy().tolist() == [1]
    for name in "ms":
        error = data[f"codimension_two_{name}_error"].to_numpy()[0]
        assert error < 1e-6
        assert abs(data[f"codimension_two_{name}"].to_numpy()[0]) <= error + 1e-15
