"""Chaplygin's sleigh of `configs/sleigh.py` in velocities of its own frame: along the blade, across it, and turning.

The blade gives the velocity across, which is no part of the state.
"""

import jax.numpy as jnp


def system(mass=1.0, inertia=0.2, length=0.3, stiffness=1.0, damping=0.3, drive=1.0, omega=1.0):
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def T(q, u, t):  # of the centre of mass, a length ahead of the blade, and of the turning about it
        return 0.5 * mass * (u[0] ** 2 + (u[1] + length * u[2]) ** 2) + 0.5 * inertia * u[2] ** 2

    def Q(q, u, t):  # springs to the origin, in the sleigh's frame; friction along the blade and of the turning
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        x, y = -stiffness * q[0], -2.0 * stiffness * q[1]
        torque = drive * jnp.sin(omega * t) - damping * u[2]
        return x * c + y * s - damping * u[0], -x * s + y * c - damping * u[1], torque

    def f(q, u, t):
        return (u[1],)

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",)}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn"), "dependent": ("across",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi / omega, **quasi, **names}
