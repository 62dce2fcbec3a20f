"""A snakeboard: a board on two pairs of wheels that turn to opposite sides, and a rotor on it, both moved periodically.

Ostrowski, Lewis, Murray and Burdick (Proc. IEEE Int. Conf. Robotics and Automation (1994) 2391), the drive gait, where
wheels and rotor swing with one period. Wheels do not slide across; friction along them brakes the board. The equations
are derived from T and Q; the parameters are chosen here.
"""

import jax.numpy as jnp


def system(
    mass=1.0, inertia=0.3, rotor=0.2, wheels=0.05, half=0.5, swing=1.0, steering=0.6, lag=0.5, damping=0.05, omega=1.0
):
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def angle(t):  # of the front wheels, and of the rear ones the opposite
        return steering * jnp.sin(omega * t + lag)

    def T(q, u, t):  # the wheels turn to opposite sides and drop out but for their sum
        along, across, turn = u
        spin = turn + swing * omega * jnp.cos(omega * t)
        board = mass * (along**2 + across**2) + (inertia + 2.0 * wheels) * turn**2
        return 0.5 * (board + rotor * spin**2)

    def Q(q, u, t):
        return -damping * u[0], -damping * u[1], -damping * half**2 * u[2]

    def f(q, u, t):  # across both pairs of wheels
        c, s = jnp.cos(angle(t)), jnp.sin(angle(t))
        front, rear = u[1] + half * u[2], u[1] - half * u[2]
        return front * c - u[0] * s, rear * c + u[0] * s

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",), "ignorable": ("x", "y")}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn"), "dependent": ("across", "turn")}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi / omega, **quasi, **names}
