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


def level(mu=0.1, a=0.5):
    """x″ = x − x² with a force that keeps the level H = 0 of the pulse at μ = 0.2 a², where the trace at 0 vanishes.

    Beyond it paths reach infinity in finite time, and their decay on the way is ever faster.
    """

    def rhs(state, time):
        x, y = state
        height = y * y / 2 - x * x / 2 + x**3 / 3
        return y, x - x * x + (mu - 0.2 * a * a) * y - a * height * y

    return {"rhs": rhs, "coordinates": ("x", "y")}


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


SANDSTEDE = {"mt": 0.0, "a": 0.0, "b": 1.0, "c": -2.0, "alpha": 1.0, "beta": 1.0, "gamma": 0.0}


def sandstede(mt=0.0, a=0.0, b=1.0, c=-2.0, alpha=1.0, beta=1.0, gamma=0.0, mu=0.0):
    """Sandstede's flow (J. Dynam. Differential Equations 9 (1997) 269): at mt = mu = 0, |a| < b, the loop x²(1 − x) = y²
    in z = 0 is homoclinic to the origin, whose eigenvalues are a + b, a − b and c."""

    def rhs(state, time):
        x, y, z = state
        push = mt - alpha * z
        return (
            a * x + b * y - a * x * x + push * x * (2.0 - 3.0 * x),
            b * x + a * y - 1.5 * b * x * x - 1.5 * a * x * y - 2.0 * push * y,
            c * z + mu * x + gamma * x * z + alpha * beta * (x * x * (1.0 - x) - y * y),
        )

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def loop(mt=0.0, a=-0.3):
    """Sandstede's flow at z = 0, b = 1: the loop x²(1 − x) = y² at mt = 0 and every a, with eigenvalues a ± 1; cycles
    inside it are born in a Hopf bifurcation near mt = −a/12."""

    def rhs(state, time):
        x, y = state
        return a * x + y - a * x * x + mt * x * (
            2.0 - 3.0 * x
        ), x + a * y - 1.5 * x * x - 1.5 * a * x * y - 2.0 * mt * y

    return {"rhs": rhs, "coordinates": ("x", "y")}


def flips(a=0.0, q=1.0, kappa=0.5, drive=1.0, feed=0.0, sign=1.0):
    """The pulse x″ = x − x² with a third direction of rate κ < 1: the orbit flips at q = 1/(1 − κ²) where the pulse drives
    it (drive, no feed), the inclination at q = 2/(1 − κ²) where it feeds the pulse.

    With x = 3/2 sech²(t/2), z ~ e^(−κt) ∫ e^(κt) (x − q x²), and ψ_z ~ e^(κt) ∫ e^(−κt) (1 − q x) x′ of the adjoint
    solution (−x″, x′, ψ_z); x² = x − x″ leaves ∫ e^(κt) x alone. With sign −1 time goes back.
    """

    def rhs(y, t):
        x, v, z = y
        return (
            sign * v,
            sign * (x - x * x + feed * (1.0 - q * x) * z) + a * v,
            sign * (drive * (x - q * x * x) - kappa * z),
        )

    return {"rhs": rhs, "coordinates": ("x", "v", "z")}


def fitzhugh(c=0.5, a=0.1, eps=0.005):
    """Travelling pulses of FitzHugh's and Nagumo's equations in their frame, of speed c."""

    def rhs(y, t):
        u, v, w = y
        return v, c * v + u * (u - a) * (u - 1.0) + w, eps * u / c

    return {"rhs": rhs, "coordinates": ("u", "v", "w")}


FITZHUGH = 0.517493141087285
"""c of the fast pulse at a = 0.1, ε = 0.005, by bisection of where the unstable manifold goes, by DOP853."""


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
