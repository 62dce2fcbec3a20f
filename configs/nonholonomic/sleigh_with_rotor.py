"""Chaplygin's sleigh with a rotor whose angular momentum is a given function of time, without friction or with it.

Bizyaev, Borisov, Kozlov and Mamaev (Nonlinearity 32 (2019) 3209). At high speed the rotor turns the sleigh at the rate
-k'(t) / (mass length u), which drives it forwards by length w^2: u grows as (3 <k'^2> t / (mass^2 length))^(1/3).
"""

import jax.numpy as jnp


def system(mass=1.0, inertia=0.5, length=0.4, momentum=1.0, damping=0.0, turn_damping=0.0, omega=1.0):
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def T(q, u, t):  # the rotor adds its momentum to that of the turning
        along, across, turn = u
        platform = mass * (along**2 + (across + length * turn) ** 2) + inertia * turn**2
        return 0.5 * platform + momentum * jnp.sin(omega * t) * turn

    def Q(q, u, t):
        return -damping * u[0], 0.0, -turn_damping * u[2]

    def f(q, u, t):
        return (u[1],)

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",), "ignorable": ("x", "y")}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn"), "dependent": ("across",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi / omega, **quasi, **names}
