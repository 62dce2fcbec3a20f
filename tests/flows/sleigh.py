"""Chaplygin's sleigh: a blade that does not slide sideways, the centre of mass a length ahead of it, without forces.

u = U tanh τ along the blade and θ′ = U/k sech τ with τ = lUt/k² + φ, k² = l² + I/m (Chaplygin 1911). The angle is (k/l)
times the Gudermannian of τ. The sleigh turns round once and runs away along its stable way.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxnh.systems.lagrangian import Motion, lagrangian
from tests.flows.known_flow import KnownFlow

PARAMETERS = {"mass": 1.3, "inertia": 0.4, "length": 0.6}
SPEED = 1.5


def sleigh(mass=1.0, inertia=0.4, length=0.6):
    """Its blade at (x, y)."""

    def kinetic(q, v, t):
        theta, (x_dot, y_dot, turn) = q[2], v
        u, w = x_dot - length * turn * jnp.sin(theta), y_dot + length * turn * jnp.cos(theta)
        return 0.5 * mass * (u**2 + w**2) + 0.5 * inertia * turn**2

    def forces(q, v, t):
        return 0.0, 0.0, 0.0

    def blade(q, v, t):
        return (v[1] * jnp.cos(q[2]) - v[0] * jnp.sin(q[2]),)

    return {"T": kinetic, "Q": forces, "f": blade, "coordinates": ("x", "y", "theta"), "period": 1.0}


def motion(phase, t, mass, inertia, length):
    """θ, the velocity u along the blade, and θ′ at a time, from θ = 0 at t = 0."""
    k = np.sqrt(length**2 + inertia / mass)
    tau = length * SPEED * t / k**2 + phase
    theta = k / length * (2 * np.arctan(np.tanh(tau / 2)) - 2 * np.arctan(np.tanh(phase / 2)))
    return np.stack([theta, SPEED * np.tanh(tau), SPEED / k / np.cosh(tau)], axis=-1)


def start(phase):
    """The state at the origin that points along x."""
    _, u, turn = np.moveaxis(motion(phase, 0.0, **PARAMETERS), -1, 0)
    zero = np.zeros_like(u)
    return Motion((zero, zero, zero), (u, zero, turn), (zero, zero))


def numbers(state):
    """The same numbers of a state."""
    theta = state.q[2]
    return np.stack([theta, state.v[0] * np.cos(theta) + state.v[1] * np.sin(theta), state.v[2]], axis=-1)


def known_flow():
    phase = np.array([-1.0, -0.4])
    flow = lagrangian(sleigh, PARAMETERS)
    return KnownFlow(flow, start(phase), motion(phase, flow.period, **PARAMETERS), numbers, evaluations=70)
