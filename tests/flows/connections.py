"""Flows with homoclinic and heteroclinic orbits, and where these are: closed forms, and shooting by DOP853."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

LORENZ = 13.926557407520
"""ρ of the homoclinic orbit of Lorenz's flow at σ = 10, β = 8/3."""


def pulse(a=0.0, b=0.5):
    """x″ = x − x² + (a + b x) x′: at a = b = 0 the pulse 3/2 sech²(t/2), beside it a = −6/7 b (Melnikov)."""

    def rhs(y, t):
        x, v = y
        return v, x - x * x + v * (a + b * x)

    return {"rhs": rhs, "coordinates": ("x", "v")}


def nagumo(c=0.3, a=0.3):
    """u″ = c u′ + u (u − 1)(u − a): its front from 0 to 1, 1/(1 + exp(−t/√2)), has c = (1 − 2a)/√2."""

    def rhs(y, t):
        u, v = y
        return v, c * v + u * (u - 1.0) * (u - a)

    return {"rhs": rhs, "coordinates": ("u", "v")}


def arneodo(a=0.6, b=0.7):
    """x‴ = −a x″ − b x′ + x − x² (Arneodo, Coullet and Tresser, Phys. Lett. A 79 (1980) 259), a saddle-focus at 0.

    Its real eigenvalue and the real part of the pair have no sum where that eigenvalue is a: b = (1 − 2a³)/a.
    """

    def rhs(y, t):
        x, v, w = y
        return v, w, -a * w - b * v + x - x * x

    return {"rhs": rhs, "coordinates": ("x", "v", "w")}


def fitzhugh(c=0.5, a=0.1, eps=0.005):
    """Travelling pulses of FitzHugh's and Nagumo's equations in their frame, of speed c."""

    def rhs(y, t):
        u, v, w = y
        return v, c * v + u * (u - a) * (u - 1.0) + w, eps * u / c

    return {"rhs": rhs, "coordinates": ("u", "v", "w")}


def side(rhs, jacobian, duration=100.0):
    """The side on which the unstable manifold of the origin leaves it after a return, or leaves all bounds.

    Where it is nearest to the origin in coordinates of eigenvectors; in front of that it goes away from it for long.

    Args:
        rhs: of the flow with its parameters.
        jacobian: the field's derivative at the origin, with one positive eigenvalue.
        duration: time, at most.
    """
    values, vectors = np.linalg.eig(np.asarray(jacobian, float))
    k, lefts = int(np.argmax(values.real)), np.linalg.inv(vectors)
    vector = vectors[:, k].real
    sign = np.sign(vector[np.argmax(np.abs(vector))])

    def leaves(t, y):
        return np.linalg.norm(y) - 100.0

    leaves.terminal = True
    options = {"rtol": 1e-13, "atol": 1e-17, "events": leaves}
    path = solve_ivp(lambda t, y: rhs(y, t), (0.0, duration), 1e-7 * sign * vector, "DOP853", **options)
    shares = lefts @ path.y
    distance, out = np.linalg.norm(shares, axis=0), sign * shares[k].real
    least = (distance[1:-1] < distance[:-2]) & (distance[1:-1] < distance[2:])
    least &= distance[1:-1] < 0.5 * np.maximum.accumulate(distance)[1:-1]
    return np.sign(out[1 + int(np.argmax(least))] if least.any() else out[-1])


def located(value_side, low, high, halvings=44):
    """The value between two where a side changes, by bisection."""
    first = value_side(low)
    assert value_side(high) != first
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if value_side(middle) == first else (low, middle)
    return 0.5 * (low + high)
