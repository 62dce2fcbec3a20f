"""Chaplygin's sleigh in two springs, turned to and fro by a motor: a blade at (x, y) that cannot slide sideways."""

import jax.numpy as jnp


def system(mass=1.0, inertia=0.2, length=0.3, stiffness=1.0, damping=0.3, drive=1.0, omega=1.0):
    def T(q, v, t):  # of the centre of mass, a length ahead of the blade, and of the turning about it
        u, w = v[0] - length * v[2] * jnp.sin(q[2]), v[1] + length * v[2] * jnp.cos(q[2])
        return 0.5 * mass * (u**2 + w**2) + 0.5 * inertia * v[2] ** 2

    def Q(q, v, t):
        torque = drive * jnp.sin(omega * t) - damping * v[2]
        return -stiffness * q[0] - damping * v[0], -2.0 * stiffness * q[1] - damping * v[1], torque

    def f(q, v, t):  # no velocity across the blade
        return (v[1] * jnp.cos(q[2]) - v[0] * jnp.sin(q[2]),)

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi / omega, **names}
