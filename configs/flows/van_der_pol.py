"""Van der Pol's oscillator x'' = mu (1 - x^2) x' - x + force cos(omega t), driven.

Without a drive, at mu = 1, the period of its limit cycle is 6.663286859323 (heyoka's Taylor integrator at 1e-18).
"""

import jax.numpy as jnp


def system(mu=1.0, force=1.2, omega=0.63):
    def rhs(y, t):
        x, v = y
        return v, mu * (1 - x**2) * v - x + force * jnp.cos(omega * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega}
