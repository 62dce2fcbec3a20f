"""Chaplygin's sleigh with a mass inside that oscillates across the line of its blade, and friction.

Bizyaev, Borisov and Mamaev (Regul. Chaotic Dyn. 22 (2017) 955) without friction; Bizyaev, Borisov and Kuznetsov
(arXiv 1807.06340, 2018) with it. The equations are derived from T and Q; the parameters are not those of an article.
"""

import jax.numpy as jnp


def system(
    mass=1.0, inertia=0.1, length=0.1, inner=1.0, ahead=0.3, amplitude=1.0, damping=0.1, turn_damping=0.1, omega=1.0
):
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def T(q, u, t):  # of the platform, its centre of mass a length ahead of the blade, and of the mass inside
        along, across, turn = u
        side, to_the_side = amplitude * jnp.sin(omega * t), amplitude * omega * jnp.cos(omega * t)
        platform = mass * (along**2 + (across + length * turn) ** 2) + inertia * turn**2
        return 0.5 * platform + 0.5 * inner * ((along - side * turn) ** 2 + (across + ahead * turn + to_the_side) ** 2)

    def Q(q, u, t):
        return -damping * u[0], 0.0, -turn_damping * u[2]

    def f(q, u, t):
        return (u[1],)

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",), "ignorable": ("x", "y")}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn"), "dependent": ("across",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi / omega, **quasi, **names}
