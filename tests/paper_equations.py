"""The paper's own four equations (12)/(22), which no command integrates: what jaxnh's flow is compared with."""

from __future__ import annotations

import jax.numpy as jnp


def constrained_field(system, t, y, p):
    """Rates of y = (x1, x2, y1, y2) by (12)/(22) with (13)/(23), each of any shape (...,).

    Ill-posed off the constraint: a speed error grows as exp(−2 ∫ n·F/s dt).
    """
    x1, x2, y1, y2 = y
    g, b = system.forcing(t), p.get("b", system.b)
    f1 = g * x1 * (system.a + x1 * x1) - b * y1
    f2 = g * y1 * (1.0 + system.a * (y1 * y1)) - b * x1
    squared_speed = system.c + system.d * jnp.sin(t)
    power = f1 * x2 + f2 * y2 + 0.5 * system.d * jnp.cos(t)
    return x2, -f1 + power * x2 / squared_speed, y2, -f2 + power * y2 / squared_speed
