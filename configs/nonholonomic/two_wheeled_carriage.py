"""A two-wheeled carriage: a platform on one axle, whose two wheels roll without slipping, a motor on each.

Borisov, Kilin and Mamaev (Regul. Chaotic Dyn. 20 (2015) 752) prove that wheels do to a vehicle what skates do: the
carriage is Chaplygin's sleigh with more inertia, J / radius**2 a wheel at its place. The motors push backwards with a
constant torque, and one way and the other with an alternating one. The equations are derived from T and Q; the
parameters are chosen here.
"""

import jax.numpy as jnp


def system(
    mass=1.0, inertia=0.2, ahead=0.5, gauge=0.4, radius=0.2, wheel=0.004,
    push=0.8, swing=0.3, damping=0.3, turn_damping=0.3, omega=1.0,
):  # fmt: skip
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2], u[3], u[4]

    def T(q, u, t):  # of the platform, its centre of mass ahead of the axle, and of the wheels about the axle
        along, across, turn, left, right = u
        platform = mass * (along**2 + (across + ahead * turn) ** 2) + inertia * turn**2
        return 0.5 * (platform + wheel * (left**2 + right**2))

    def Q(q, u, t):  # torques of both motors, as forces on the road times the radius, and friction
        swung = swing * jnp.sin(omega * t)
        left, right = -0.5 * push - swung, -0.5 * push + swung
        return -damping * u[0], 0.0, -turn_damping * u[2], radius * left, radius * right

    def f(q, u, t):
        along, across, turn, left, right = u
        return across, along - gauge * turn - radius * left, along + gauge * turn - radius * right

    places, wheels = ("x", "y"), ("phi_left", "phi_right")
    angles = ("theta", *wheels)
    names = {"coordinates": (*places, *angles), "angles": angles, "ignorable": (*places, *wheels)}
    dependent = ("across", "left", "right")
    quasi = {"quasi_velocities": ("along", "across", "turn", "left", "right"), "dependent": dependent}
    return {"T": T, "Q": Q, "f": f, "rates": rates, "period": 2 * jnp.pi / omega, **quasi, **names}
