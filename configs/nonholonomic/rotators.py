"""Rotators whose cosines sum to zero: geodesic flow on a curved manifold, chaos of three, hyperchaos of four and five.

Kuznetsov (Vestn. Udmurtsk. Univ. Mat. Mekh. Komp. Nauki 28 (2018) 565; arXiv 1810.08002). The constraint is written
for the velocities; the start says that the sum is zero, which then stays.
"""

import jax.numpy as jnp


def system(inertia=1.0):
    def T(q, v, t):
        return 0.5 * (inertia * v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + v[3] ** 2)

    def Q(q, v, t):
        return 0.0, 0.0, 0.0, 0.0

    def f(q, v, t):
        return (sum(jnp.sin(angle) * rate for angle, rate in zip(q, v, strict=True)),)

    names = ("q1", "q2", "q3", "q4")
    return {"T": T, "Q": Q, "f": f, "coordinates": names, "angles": names}
