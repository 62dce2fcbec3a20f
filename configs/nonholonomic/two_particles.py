"""Two particles of the article's, each at a constant speed of its own, coupled by a spring.

Equation (12) of `Complete identification of chaos of nonlinear nonholonomic systems`, twice: without the spring each is
that. The spring is chosen here, and there is no published value with it.
"""

import jax.numpy as jnp


def system(a=0.5, b=5.3, c=1.0, coupling=0.1, omega=1.0):
    def T(q, v, t):
        return 0.5 * sum(rate**2 for rate in v)

    def Q(q, v, t):
        g = 1 + jnp.sin(omega * t)
        x1, y1, x2, y2 = q
        pull = coupling * (x2 - x1), coupling * (y2 - y1)

        def force(x, y):
            return b * y - a * g * x - g * x**3, b * x - g * y - a * g * y**3

        one, other = force(x1, y1), force(x2, y2)
        return (
            one[0] + pull[0] - a * v[0],
            one[1] + pull[1] - a * v[1],
            other[0] - pull[0] - a * v[2],
            other[1] - pull[1] - a * v[3],
        )

    def f(q, v, t):
        return v[0] ** 2 + v[1] ** 2 - c, v[2] ** 2 + v[3] ** 2 - c

    names = ("x1", "y1", "x2", "y2")
    return {"T": T, "Q": Q, "f": f, "coordinates": names, "period": 2 * jnp.pi / omega}
