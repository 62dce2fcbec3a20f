"""The paper's equations written out: what jaxnh's flows of the particle are compared with."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np


def constrained_field(system, t, y, p):
    """Rates of y = (x1, x2, y1, y2) by (12)/(22) with (13)/(23), each of any shape (...,); no command integrates them.

    Ill-posed off the constraint: a speed error grows as exp(−2 ∫ n·F/s dt).
    """
    x1, x2, y1, y2 = y
    g, b = system.forcing(t), p.get("b", system.b)
    f1 = g * x1 * (system.a + x1 * x1) - b * y1
    f2 = g * y1 * (1.0 + system.a * (y1 * y1)) - b * x1
    squared_speed = system.c + system.d * jnp.sin(t)
    power = f1 * x2 + f2 * y2 + 0.5 * system.d * jnp.cos(t)
    return x2, -f1 + power * x2 / squared_speed, y2, -f2 + power * y2 / squared_speed


PARTICLE = """\
import jax.numpy as jnp

def system(a=0.5, b=5.9, c=1.0, d=0.1):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        g = 1.0 + jnp.sin(t)
        x, y = q
        return -(a * g * x + g * x**3 - b * y), -(g * y + a * g * y**3 - b * x)

    def f(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 - c - d * jnp.sin(t),)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y"), "period": 2 * jnp.pi}
"""


def free(t, y, b, a=0.5, forced=True):
    """Rates of (x1, x2, y1, y2) by equation (1)."""
    x, vx, z, vz = y
    g = 1.0 + forced * np.sin(t)
    return np.array([vx, -(a * g * x + g * x**3 - b * z) - a * vx, vz, -(g * z + a * g * z**3 - b * x) - a * vz])


def at_speed(t, y, b, a=0.5, c=1.0, d=0.1, forced=True):
    """Rates of (x1, y1, θ) at the squared speed c + d sin t: θ' = n⊥·F/s."""
    x, z, angle = y
    g, s = 1.0 + forced * np.sin(t), np.sqrt(c + d * np.sin(t))
    force = -(a * g * x + g * x**3 - b * z), -(g * z + a * g * z**3 - b * x)
    return np.array([s * np.cos(angle), s * np.sin(angle), (np.cos(angle) * force[1] - np.sin(angle) * force[0]) / s])
