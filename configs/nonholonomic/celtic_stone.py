"""A rattleback: an elliptic paraboloid that rolls without slipping, its axes of inertia turned against its surface's.

Borisov, Jalnine, Kuznetsov, Sataev and Sedova (Regul. Chaotic Dyn. 17 (2012) 512) and Gonchenko, Gonchenko and Kazakov
(Regul. Chaotic Dyn. 18 (2013) 521) study it over its energy and the angle delta. The texts were not at hand: sizes and
moments are those of the second as commonly quoted, with its angle 0.485; the angle 0.75 is of a scan.
"""

import jax.numpy as jnp

from jaxnh.mechanics import rolling_body


def system(mass=1.0, i1=2.0, i2=6.0, i3=7.0, a1=9.0, a2=4.0, height=1.0, delta=0.75, gravity=100.0):
    def support(
        n,
    ):  # a1 and a2 are the radii of curvature at the vertex, which is below the centre of mass by the height
        return -height * n[2] - (a1 * n[0] ** 2 + a2 * n[1] ** 2) / (2.0 * n[2])

    c, s = jnp.cos(delta), jnp.sin(delta)
    product = (i1 - i2) * c * s
    inertia = (i1 * c * c + i2 * s * s, product, 0.0), (product, i1 * s * s + i2 * c * c, 0.0), (0.0, 0.0, i3)
    return rolling_body(support, mass, inertia, gravity)
