"""The paper's particle by its place and the direction of its velocity, with b and d as parameters of a lane's own.

The velocity is s (cos θ, sin θ), s² = c + d sin t, equation (22); of the applied forces what is across it turns it.
"""

import jax.numpy as jnp


def system(a=0.5, b=5.5, c=1.0, d=0.0):
    def rhs(state, t):
        x1, y1, theta = state
        g, s = 1.0 + jnp.sin(t), jnp.sqrt(c + d * jnp.sin(t))
        f1 = a * g * x1 + g * x1**3 - b * y1
        f2 = g * y1 + a * g * y1**3 - b * x1
        cos, sin = jnp.cos(theta), jnp.sin(theta)
        return s * cos, s * sin, (sin * f1 - cos * f2) / s

    return {"rhs": rhs, "coordinates": ("x1", "y1", "theta"), "angles": ("theta",), "period": 2 * jnp.pi}
