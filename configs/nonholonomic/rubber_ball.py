"""A rubber ball: it rolls without slipping and without spinning about the vertical, its centre of mass beside its own.

Kazakov (Regul. Chaotic Dyn. 18 (2013) 508). The parameters are chosen here.
"""

import jax.numpy as jnp

from jaxnh.mechanics import dot, ellipsoid, rolling_body


def system(mass=1.0, radius=1.0, gravity=1.0, i1=0.22, i2=0.67, i3=0.78, offset=0.5, tilt=0.5):
    inertia = (i1, 0.0, 0.0), (0.0, i2, 0.0), (0.0, 0.0, i3)
    aside, along = offset * jnp.sin(tilt), offset * jnp.cos(tilt)  # of the third axis; aside between the others
    surface = ellipsoid((radius, radius, radius), center=(0.6 * aside, 0.8 * aside, along))
    rolling = rolling_body(surface, mass, inertia, gravity)

    def f(q, u, t):
        return *rolling["f"](q, u, t), dot(q, u[:3])

    return {key: value for key, value in rolling.items() if key != "dependent"} | {"f": f}
