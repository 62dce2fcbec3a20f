"""A sleigh that one of three feet bears at a time, by an edge aimed along the foot's velocity as it comes down.

The edge stays so in the sleigh's frame until the next foot comes down. A foot is at (c1, c2) from the centre of mass,
and its edge at an angle alpha from the first axis: these three numbers jump, and the constraint with them, but no
velocity does.
"""

import jax.numpy as jnp


def system(mass=1.0, inertia=1.4, radius=1.0, ahead=0.03, interval=2.0):
    period = 3.0 * interval

    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2], 0.0, 0.0, 0.0

    def T(q, u, t):
        return 0.5 * mass * (u[0] ** 2 + u[1] ** 2) + 0.5 * inertia * u[2] ** 2

    def Q(q, u, t):
        return 0.0, 0.0, 0.0

    def foot_velocity(c1, c2, u):
        return u[0] - u[2] * c2, u[1] + u[2] * c1

    def f(q, u, t):  # across the edge
        along, across = foot_velocity(q[3], q[4], u)
        return across * jnp.cos(q[5]) - along * jnp.sin(q[5])

    def steps(q, u, t):  # up at a sixth, a half and five sixths of a period
        return -jnp.sin(6.0 * jnp.pi * t / period)

    def next_foot(q, u, t):  # at thirds of a circle
        angle = 2.0 * jnp.pi * t / period - jnp.pi / 3.0
        c1, c2 = ahead + radius * jnp.cos(angle), radius * jnp.sin(angle)
        along, across = foot_velocity(c1, c2, u)
        return (*q[:3], c1, c2, jnp.arctan2(across, along)), u

    names = {"coordinates": ("x", "y", "theta", "c1", "c2", "alpha"), "ignorable": ("x", "y", "theta")}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn")}
    jumps = [{"when": steps, "then": next_foot}]
    return {"T": T, "Q": Q, "f": f, "jumps": jumps, "integrals": {"energy": T}, "period": period, **quasi, **names}
