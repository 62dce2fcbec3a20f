"""A weight in a double well, shaken, and its governor: a slide that rises with the square of the weight's speed."""

import jax.numpy as jnp


def system(drive=0.8, damping=0.2, rate=0.5, level=0.5):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        return drive * jnp.sin(t) + q[0] - q[0] ** 3 - damping * v[0], -q[1] - damping * v[1]

    def f(q, v, t):  # the slide's velocity: up where the weight is faster than the level, else down
        return (v[1] - rate * (v[0] ** 2 - level),)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y"), "period": 2 * jnp.pi}
