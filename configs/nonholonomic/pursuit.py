"""A pursuer of constant speed whose velocity keeps a given angle, the bearing, to the line of sight to its target.

At bearing zero this is the pursuit of Bouguer (Mem. Acad. Sci. (1732) 1). Of the two constraints, which determine the
pursuer's velocity, one is nonlinear. The target is a particle on a spring that a turning force pushes; nothing acts on
it from the pursuer. At bearing zero, two pursuers of one target come closer or keep their distance. The pursuer's two
exponents sum to the mean of -speed cos(bearing) / distance. The target's motion and all values are chosen here.
"""

import jax.numpy as jnp


def system(speed=0.6, bearing=0.0, stiffness=2.618, push=2.427, omega=1.0):
    def T(q, v, t):  # of the pursuer at x, y and the target at X, Y
        return 0.5 * sum(rate**2 for rate in v)

    def Q(q, v, t):
        return 0.0, 0.0, push * jnp.cos(omega * t) - stiffness * q[2], push * jnp.sin(omega * t) - stiffness * q[3]

    def f(q, v, t):
        c, s, x, y = jnp.cos(bearing), jnp.sin(bearing), q[2] - q[0], q[3] - q[1]
        return v[0] ** 2 + v[1] ** 2 - speed**2, v[0] * (s * x + c * y) - v[1] * (c * x - s * y)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y", "X", "Y"), "period": 2 * jnp.pi / omega}
