"""A damped linear oscillator under a harmonic force, x″ = −x − 2γ x′ + F cos ωt, over F: closed form."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxnh.systems.first_order import Point, first_order
from tests.flows.known_flow import KnownFlow
from tests.helpers.batches import broadcast_start

DAMPING, OMEGA = 0.1, 1.3


def oscillator(drive=1.0):
    def rhs(y, t):
        x, v = y
        return v, -x - 2 * DAMPING * v + drive * jnp.cos(OMEGA * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi / OMEGA}


def motion(x, v, drive, t):
    """Position and velocity at a time, of the state at t = 0: the forced oscillation and one that dies away."""
    stiff, loss = 1 - OMEGA**2, 2 * DAMPING * OMEGA
    cos, sin = drive * np.array([stiff, loss]) / (stiff**2 + loss**2)
    beta = np.sqrt(1 - DAMPING**2)
    free = (x - cos) + 1j * (OMEGA * sin - DAMPING * (x - cos) - v) / beta
    forced = cos - 1j * sin
    rates = np.array([-DAMPING + 1j * beta, 1j * OMEGA])
    waves = np.array([free, forced]) * np.exp(rates * t)
    return waves.sum().real, (rates * waves).sum().real


def known_flow():
    drive, start = np.array([0.5, 1.0]), (0.4, -0.3)
    flow = first_order(oscillator, {"drive": 1.0}, ("drive",))
    exact = np.array([motion(*start, value, flow.period) for value in drive])
    return KnownFlow(flow, broadcast_start(Point(start), 2), exact, flow.chart.host_points, {"drive": drive})
