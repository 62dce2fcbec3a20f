"""An unbalanced rubber disk: it rolls on its rim without slipping, and does not spin about the vertical.

Gonchenko, Gonchenko and Kazakov (Proc. Steklov Inst. Math. 308 (2020) 125). The parameters are chosen here.
"""

from jaxnh.mechanics import dot, ellipsoid, rolling_body


def system(mass=1.0, radius=1.0, gravity=1.0, i1=0.25, i2=0.3, i3=0.55, c1=0.2, c2=0.1, c3=0.15):
    inertia = (i1, 0.0, 0.0), (0.0, i2, 0.0), (0.0, 0.0, i3)
    surface = ellipsoid((radius, radius, 0.0), center=(c1, c2, c3))  # flat; its centre is seen from that of mass
    rolling = rolling_body(surface, mass, inertia, gravity)

    def f(q, u, t):
        return *rolling["f"](q, u, t), dot(q, u[:3])

    turned = dict.fromkeys(("w1", "w2", "w3", "V1", "V2", "V3"), -1)
    return {key: value for key, value in rolling.items() if key != "dependent"} | {"f": f, "reversal": turned}
