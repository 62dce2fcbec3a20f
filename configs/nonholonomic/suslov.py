"""Suslov's top in gravity: a body with a fixed point that cannot turn about its own third axis.

Bizyaev, Borisov and Kazakov (Regul. Chaotic Dyn. 20 (2015) 605). The equations are derived from T and Q; the parameters
are not those of the article. Seen from the body: the upward vertical, and the angular velocity.
"""

from jaxnh.mechanics import cross, dot


def system(i1=2.0, i2=3.0, i3=4.0, i13=1.0, i23=0.6, b1=0.0, b2=0.0, b3=1.0):
    inertia = (i1, 0.0, i13), (0.0, i2, i23), (i13, i23, i3)
    centre = b1, b2, b3  # of mass, times the weight

    def rates(g, w, t):
        return cross(g, w)

    def T(g, w, t):
        return 0.5 * dot(w, [dot(row, w) for row in inertia])

    def Q(g, w, t):  # torque of the weight, which pulls down
        return cross(g, centre)

    def f(g, w, t):
        return (w[2],)

    g = ("g1", "g2", "g3")
    quasi = {"rates": rates, "quasi_velocities": ("w1", "w2", "w3"), "dependent": ("w3",)}
    integrals = {"energy": lambda g, w, t: T(g, w, t) + dot(centre, g)}
    return {"T": T, "Q": Q, "f": f, "coordinates": g, "norms": [g], "integrals": integrals, **quasi}
