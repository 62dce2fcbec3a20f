"""The damped pendulum under a constant torque: theta'' = -damping theta' + torque - sin theta.

At damping 0.1 and torque 0.5 it comes to rest at arcsin 0.5 (exponent -damping/2, as its eigenvalues are complex) or
rotates for ever (exponent -damping, the divergence). Its basins are the example of Menck and co-workers, Nature Physics
9 (2013) 89, and a benchmark of bSTAB and pybasin.
"""

import jax.numpy as jnp


def system(damping=0.1, torque=0.5):
    def rhs(y, t):
        theta, rate = y
        return rate, torque - damping * rate - jnp.sin(theta)

    return {"rhs": rhs, "coordinates": ("theta", "rate"), "angles": ("theta",)}
