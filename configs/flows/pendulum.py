"""The driven damped pendulum of Taylor's Classical Mechanics (2005), chapter 12: phi'' + 2 beta phi' + w0^2 sin phi =
gamma w0^2 cos(2 pi t), with w0 = 1.5 times the frequency of the drive and beta = w0/4.

From phi = -pi/2 at rest the book has period doublings at gamma = 1.0663, 1.0793, 1.0821 and 1.0827.
"""

import jax.numpy as jnp

DRIVE = 2 * jnp.pi
NATURAL = 1.5 * DRIVE


def system(gamma=1.06, damping=0.25):
    def rhs(y, t):
        phi, rate = y
        force = gamma * jnp.cos(DRIVE * t) - jnp.sin(phi)
        return rate, NATURAL**2 * force - 2 * damping * NATURAL * rate

    return {"rhs": rhs, "coordinates": ("phi", "phi_rate"), "angles": ("phi",), "period": 1.0}
