"""Duffing's oscillator x'' + delta x' + alpha x + beta x^3 = gamma cos t, in one well (alpha > 0) or two (alpha < 0).

Of the linear oscillator (beta = 0) the exponents are -delta/2 each; their sum is -delta, exactly, of every motion.
"""

import jax.numpy as jnp


def system(alpha=-1.0, beta=1.0, gamma=0.3, delta=0.2):
    def rhs(y, t):
        x, v = y
        return v, gamma * jnp.cos(t) - delta * v - alpha * x - beta * x**3

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi}
