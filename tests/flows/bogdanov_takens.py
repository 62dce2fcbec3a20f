"""Flows with Bogdanov–Takens points, and where the homoclinic orbits near them are: series, and shooting by DOP853."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from tests.flows import connections

A, B = 0.7, -1.3
"""Coefficients of `bent`."""


def normal_form(p=0.0, q=0.0, b=-1.0, origin=0.0, more=0.0):
    """w₀'' = p + q w₀' + w₀² + b w₀ w₀', w₀ from a place on whose last digits may be more than a double has."""

    def rhs(y, t):
        w0, w1 = y[0] - origin - more, y[1]
        return w1, p + q * w1 + w0 * w0 + b * w0 * w1

    return {"rhs": rhs, "coordinates": ("w0", "w1")}


def without_b(p=0.0, q=0.0):
    """w₀'' = p + q w₀' + w₀²: no loop but at q = 0."""

    def rhs(y, t):
        w0, w1 = y
        return w1, p + q * w1 + w0 * w0

    return {"rhs": rhs, "coordinates": ("w0", "w1")}


def bent(p=0.0, q=0.0):
    """The normal form with a = 0.7, b = −1.3 in other coordinates and parameters, beside a direction that attracts.

    w₀ = x + 0.3 v + 0.4 q, w₁ = v + 0.2 x², β₁ = p + 0.6 q + 0.5 q², β₂ = 0.9 q − 0.4 p.
    """

    def rhs(y, t):
        x, v, z = y
        w0, w1 = x + 0.3 * v + 0.4 * q, v + 0.2 * x * x
        push = p + 0.6 * q + 0.5 * q * q + (0.9 * q - 0.4 * p) * w1 + 0.7 * w0 * w0 - 1.3 * w0 * w1
        to_x = (w1 - 0.3 * push) / (1.0 - 0.12 * x)
        return to_x, push - 0.4 * x * to_x, x * x + 0.5 * w1 - z

    return {"rhs": rhs, "coordinates": ("x", "v", "z")}


def betas(values):
    """The parameters of the normal form from those of `bent`, (..., 2)."""
    p, q = np.moveaxis(np.asarray(values), -1, 0)
    return np.stack([p + 0.6 * q + 0.5 * q * q, 0.9 * q - 0.4 * p], axis=-1)


def second_term(beta, a, b):
    """ε, and the coefficient of (ε b / a)² in τ = 10/7 + …, of the homoclinic orbit at parameters of the normal form.

    It is 288/2401 up to a share ε² (Al-Hdaibat, Govaerts, Kuznetsov and Meijer, SIAM J. Appl. Dyn. Syst. 15 (2016) 952).
    """
    first, second = np.moveaxis(np.asarray(beta), -1, 0)
    eps = (-first * a / 4.0) ** 0.25
    return eps, (second * a / b / eps**2 - 10.0 / 7.0) * (a / (b * eps)) ** 2


def bazykin(alpha=0.4, delta=0.2, gamma=1.0, eps=0.01):
    """Prey and predators (Bazykin 1985; Kuznetsov, Elements of Applied Bifurcation Theory, 2004, 8.3)."""

    def rhs(y, t):
        x, v = y
        eaten = x * v / (1.0 + alpha * x)
        return x - eaten - eps * x * x, eaten - gamma * v - delta * v * v

    return {"rhs": rhs, "coordinates": ("x", "v")}


def lorenz84(f=2.0, t=0.04, alpha=0.25, g=0.25, gamma=0.987, delta=1.04):
    """The extended Lorenz-84 model, β = 1 (Kuznetsov, Meijer and van Veen, Int. J. Bifurcation Chaos 14 (2004) 2253)."""

    def rhs(state, time):
        x, y, z, u = state
        return (
            -y * y - z * z - alpha * x + alpha * f - gamma * u * u,
            x * y - x * z - y + g,
            x * y + x * z - z,
            -delta * u + gamma * u * x + t,
        )

    return {"rhs": rhs, "coordinates": ("x", "y", "z", "u")}


def side(define, names, values, saddle, path, duration):
    """The side on which the manifold of dimension one of a saddle goes past it, by DOP853.

    It is another one beyond a homoclinic orbit. Stable manifolds are followed back in time.

    Args:
        define: the flow.
        names: of both parameters.
        values: of both.
        saddle: nearly.
        path: of the orbit, (k, d).
        duration: time, at most.
    """
    rhs = define(**dict(zip(names, map(float, values), strict=True)))["rhs"]

    def field(y):
        return jnp.stack(rhs(y, 0.0))

    jacobian, state = jax.jacfwd(field), np.asarray(saddle, float)
    for _ in range(4):
        state = state - np.linalg.solve(np.asarray(jacobian(state)), np.asarray(field(state)))
    slopes = np.asarray(jacobian(state))
    ahead = 1.0 if np.sum(np.linalg.eigvals(slopes).real > 0.0) == 1 else -1.0
    rates, vectors = np.linalg.eig(ahead * slopes)
    vector = vectors[:, np.argmax(rates.real)].real
    largest = np.argmax(np.abs(vector))
    # The component that is the largest is to grow, of a manifold that goes along the path.
    turn = np.sign(vector[largest]) * np.sign(vector @ (path[10 if ahead > 0.0 else -11] - state))

    def moved(y, t):
        return turn * ahead * np.array(rhs((state + turn * np.asarray(y)).tolist(), t))

    return connections.side(moved, ahead * slopes, duration)
