"""Oscillators of two coordinates under a constraint on velocities, or of length one, as files that a user would write, and as rates."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

SLIDE = """\
import jax.numpy as jnp

def system(drive=0.5, damping=0.2, rate=0.5, level=0.1):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):  # so that x'' = -x - 2 damping x' + drive cos t: the slide weighs as 1 + (2 rate x')^2
        weight = 1.0 + (2.0 * rate * v[0]) ** 2
        return weight * (-q[0] - 2.0 * damping * v[0] + drive * jnp.cos(t)), 0.0

    def f(q, v, t):
        return (v[1] - rate * (v[0] ** 2 - level),)

    names = {"coordinates": ("x", "y"), "ignorable": ("y",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi, **names}
"""

CYCLE = """\
import jax.numpy as jnp

def system(mu=0.5, slope=0.5):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):  # so that x'' = -x + (mu - x^2 - x'^2) x': a cycle of radius sqrt(mu)
        return (1.0 + slope**2) * (-q[0] + (mu - q[0] ** 2 - v[0] ** 2) * v[0]), 0.0

    def f(q, v, t):
        return (v[1] - slope * v[0],)

    names = {"coordinates": ("x", "y"), "ignorable": ("y",)}
    return {"T": T, "Q": Q, "f": f, "time_unit": 2 * jnp.pi, **names}
"""

NEEDLE = """\
import jax.numpy as jnp

def system(drive=0.2, damping=0.2, slope=0.5):
    def T(q, u, t):
        return 0.5 * (u[0] ** 2 + u[1] ** 2)

    def Q(q, u, t):  # so that its angle has angle'' = -2 sin angle - 2 damping angle' + drive cos t
        return (1.0 + slope**2) * (-2.0 * q[1] - 2.0 * damping * u[0] + drive * jnp.cos(t)), 0.0

    def f(q, u, t):
        return (u[1] - slope * u[0],)

    def rates(q, u, t):
        return -q[1] * u[0], q[0] * u[0]

    names = {"coordinates": ("c", "s"), "quasi_velocities": ("w", "V"), "dependent": ("V",), "norms": [("c", "s")]}
    constants = [[[0.0, 0.0]] * 2] * 2  # what V moves is not followed
    return {"T": T, "Q": Q, "f": f, "rates": rates, "structure_constants": constants, "period": 2 * jnp.pi, **names}
"""

CLAMPED = """\
import jax.numpy as jnp

def system(mu=0.1):
    def T(q, v, t):
        return 0.5 * v[0] ** 2

    def Q(q, v, t):
        return -(1.0 + mu**2) * q[0] + 2.0 * mu * v[0] - v[0] ** 3

    def clamp(q, v, t):
        return v[0]

    def closed(q, v, t):  # in the second half of a period
        return -jnp.sin(t)

    return {"T": T, "Q": Q, "f": [{"constraint": clamp, "when": closed}], "coordinates": "x", "period": 2 * jnp.pi}
"""


def slide(t, y, drive=0.5, damping=0.2, rate=0.5, level=0.1):
    """Rates of (x, x', y)."""
    return np.array([y[1], -y[0] - 2 * damping * y[1] + drive * np.cos(t), rate * (y[1] ** 2 - level)])


def cycle(t, y, mu=0.5, slope=0.5):
    """Rates of (x, x', y)."""
    return np.array([y[1], -y[0] + (mu - y[0] ** 2 - y[1] ** 2) * y[1], slope * y[1]])


def needle(t, y, drive=0.2, damping=0.2):
    """Rates of (cos, sin, rate) of an angle."""
    return np.array([-y[1] * y[2], y[0] * y[2], -2 * y[1] - 2 * damping * y[2] + drive * np.cos(t)])


def clamped(t0, t1, y, mu):
    """(x, x') at t1 from that at t0, a multiple of 2π: free for half a period, then held where it is.

    The half period takes x to −exp(π mu) x near 0, where two periods become one orbit at mu = 0.
    """
    y = np.array(y, float)
    while t1 - t0 > 1e-9:
        free = min(t1 - t0, np.pi)
        rates = lambda t, y: np.array([y[1], -(1 + mu**2) * y[0] + 2 * mu * y[1] - y[1] ** 3])  # noqa: E731
        y = solve_ivp(rates, (0.0, free), y, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        if t1 - t0 > np.pi + 1e-9:
            y[1] = 0.0
        t0 += 2 * np.pi
    return y
