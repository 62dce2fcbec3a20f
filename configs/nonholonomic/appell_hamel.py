"""The machine of Appell and Hamel, a nonlinear constraint: horizontal speed and vertical speed have a fixed ratio.

Appell (Rend. Circ. Mat. Palermo 32 (1911) 48); Hamel, Theoretische Mechanik (1949). Their mass falls freely, with
z'' = -g/(1 + ratio**2). Here it falls through air and a lattice of horizontal forces of period 2 pi, in a periodic
wind; these, and all values, are chosen here. The constraint is singular at rest, which a motion does not come to where
the horizontal forces are below gravity/ratio.
"""

import jax.numpy as jnp


def system(ratio=1.0, gravity=2.0, lattice=0.6, skew=0.9, damping=0.5, drive=0.4, omega=1.0):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)

    def Q(q, v, t):
        x = -lattice * jnp.sin(q[0]) - damping * v[0] + drive * jnp.sin(omega * t)
        return x, -skew * jnp.sin(q[1]) - damping * v[1], -gravity - damping * v[2]

    def f(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 - (ratio * v[2]) ** 2,)

    names = {"coordinates": ("x", "y", "z"), "angles": ("x", "y"), "ignorable": ("z",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi / omega, **names}
