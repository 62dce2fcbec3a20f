"""Van der Pol's oscillator x'' = mu (1 - x^2) x' - x + force cos(omega t), driven and not.

Without a drive, at mu = 1, its period is 6.6632868593231301896996820305 (Amore, J. Math. Phys. 2018, by Taylor series)
and the exponents are 0 and -1.0594.
"""

import jax.numpy as jnp


def system(mu=1.0, force=1.2, omega=0.63):
    def rhs(y, t):
        x, v = y
        return v, mu * (1 - x**2) * v - x + force * jnp.cos(omega * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega}
