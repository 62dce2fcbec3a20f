"""An upright disk that rolls without slipping (Bloch, Nonholonomic Mechanics and Control, 2003), held by a spring.

Its radius is 1. Without the spring it rolls at constant rates u of `roll` and w of `turn`, on a circle of radius |u/w|.
With the spring the energy is kept, and so is w: nothing turns the disk about its upright.
"""

import jax.numpy as jnp


def system(stiffness=1.0, mass=1.0, along=0.5, upright=0.25):
    def T(q, v, t):  # `along` and `upright`: moments of inertia about the axle and about the vertical
        return 0.5 * mass * (v[0] ** 2 + v[1] ** 2) + 0.5 * along * v[2] ** 2 + 0.5 * upright * v[3] ** 2

    def Q(q, v, t):
        return -stiffness * q[0], -stiffness * q[1], 0.0, 0.0

    def f(q, v, t):  # the point of contact is at rest
        return v[0] - v[2] * jnp.cos(q[3]), v[1] - v[2] * jnp.sin(q[3])

    names = {"coordinates": ("x", "y", "roll", "turn"), "angles": ("roll", "turn"), "ignorable": ("roll",)}
    return {"T": T, "Q": Q, "f": f, **names}
