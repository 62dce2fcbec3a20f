"""Chaplygin's top: a ball that rolls without slipping, its centre of mass beside its own centre, on no axis of inertia.

Borisov, Kazakov and Sataev (Regul. Chaotic Dyn. 19 (2014) 718). The parameters are chosen here.
"""

import jax.numpy as jnp

from jaxnh.mechanics import ellipsoid, rolling_body


def system(mass=1.0, radius=1.0, gravity=1.0, i1=0.22, i2=0.67, i3=0.78, offset=0.85, tilt=0.5):
    inertia = (i1, 0.0, 0.0), (0.0, i2, 0.0), (0.0, 0.0, i3)
    aside, along = offset * jnp.sin(tilt), offset * jnp.cos(tilt)  # of the third axis; aside between the others
    surface = ellipsoid((radius, radius, radius), center=(0.6 * aside, 0.8 * aside, along))
    return rolling_body(surface, mass, inertia, gravity)
