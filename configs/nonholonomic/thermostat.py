"""Two coupled particles whose kinetic energy together is kept: Gauss's isokinetic thermostat as a constraint.

Hoover, Ladd and Moran (Phys. Rev. Lett. 48 (1982) 1818); Evans (J. Chem. Phys. 78 (1983) 3297). Exponents come in pairs
of the same sum where the forces have a potential (Dettmann and Morriss, Phys. Rev. E 53 (1996) R5545), but for those
of the flow and of the kinetic energy. This potential, a slope and a lattice of period 2 pi, is chosen here.
"""

import jax.numpy as jnp


def system(kinetic=1.0, slope=0.5, lattice=1.0, coupling=0.6):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + v[3] ** 2)

    def Q(q, v, t):  # of V = lattice (cos x cos y + cos z cos w) - coupling cos(x - z) cos(y - w) - slope (x - z / 2)
        x, y, z, w = q
        pull = coupling * jnp.sin(x - z) * jnp.cos(y - w), coupling * jnp.cos(x - z) * jnp.sin(y - w)
        return (
            lattice * jnp.sin(x) * jnp.cos(y) - pull[0] + slope,
            lattice * jnp.cos(x) * jnp.sin(y) - pull[1],
            lattice * jnp.sin(z) * jnp.cos(w) + pull[0] - 0.5 * slope,
            lattice * jnp.cos(z) * jnp.sin(w) + pull[1],
        )

    def f(q, v, t):
        return (T(q, v, t) - kinetic,)

    names = ("x1", "y1", "x2", "y2")
    return {"T": T, "Q": Q, "f": f, "coordinates": names, "angles": names}
