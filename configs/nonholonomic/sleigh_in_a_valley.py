"""Chaplygin's sleigh in a straight valley, the force at its centre of mass: no friction, and yet attractors.

Kuznetsov (Rus. J. Nonlin. Dyn. 15 (2019), arXiv 1909.01130), a one-dimensional quadratic potential. The equations are
derived from T and Q; the parameters are not those of the article.
"""

import jax.numpy as jnp


def system(mass=1.0, inertia=0.2, length=0.5, stiffness=1.0):
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def T(q, u, t):
        return 0.5 * mass * (u[0] ** 2 + (u[1] + length * u[2]) ** 2) + 0.5 * inertia * u[2] ** 2

    def V(q):
        return 0.5 * stiffness * (q[0] + length * jnp.cos(q[2])) ** 2

    def Q(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        force = -stiffness * (q[0] + length * c)
        return force * c, -force * s, -force * length * s

    def f(q, u, t):
        return (u[1],)

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",), "ignorable": ("y",)}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn"), "dependent": ("across",)}
    integrals = {"energy": lambda q, u, t: T(q, u, t) + V(q)}
    return {"T": T, "Q": Q, "f": f, "integrals": integrals, **quasi, **names}
