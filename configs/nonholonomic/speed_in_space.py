"""The forced particle at constant speed, in three dimensions: the article's forces, and a third of their kind.

In the plane z = 0 it is equation (12) of `Complete identification of chaos of nonlinear nonholonomic systems`. The
third force is chosen here, and out of the plane there is no published value.
"""

import jax.numpy as jnp


def system(a=0.5, b=1.0, c=1.0, tie=0.5, omega=1.0):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)

    def Q(q, v, t):
        x, y, z = q
        g = 1 + jnp.sin(omega * t)
        return (
            -(a * g * x + g * x**3 - b * y) - a * v[0],
            -(g * y + a * g * y**3 - b * x) - a * v[1],
            -(a * g * z + g * z**3) - tie * y * y * z - a * v[2],
        )

    def f(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 + v[2] ** 2 - c,)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y", "z"), "period": 2 * jnp.pi / omega}
