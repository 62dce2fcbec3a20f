"""Two points in the plane whose velocities stay parallel, a nonlinear constraint, each in an anharmonic well.

Nonlinear constraints as this are those of Benenti (Rend. Sem. Mat. Univ. Pol. Torino 54 (1996); SIGMA 3 (2007) 036).
The wells and their parameters are chosen here; no published values were found.
"""


def system(m1=1.0, m2=2.0, k1=1.0, k2=1.7, cubic=1.0, coupling=0.5):
    def T(q, v, t):
        return 0.5 * m1 * (v[0] ** 2 + v[1] ** 2) + 0.5 * m2 * (v[2] ** 2 + v[3] ** 2)

    def V(q):
        springs = k1 * (q[0] ** 2 + q[2] ** 2) + k2 * (q[1] ** 2 + q[3] ** 2)
        quartic = cubic * (q[0] ** 2 * q[1] ** 2 + q[2] ** 2 * q[3] ** 2)
        return 0.5 * springs + 0.5 * quartic + 0.5 * coupling * ((q[0] - q[2]) ** 2 + (q[1] - q[3]) ** 2)

    def Q(q, v, t):
        x, y, z, w = q
        return (
            -k1 * x - cubic * x * y**2 - coupling * (x - z),
            -k2 * y - cubic * y * x**2 - coupling * (y - w),
            -k1 * z - cubic * z * w**2 + coupling * (x - z),
            -k2 * w - cubic * w * z**2 + coupling * (y - w),
        )

    def f(q, v, t):
        return (v[0] * v[3] - v[1] * v[2],)

    integrals = {"energy": lambda q, v, t: T(q, v, t) + V(q)}
    return {"T": T, "Q": Q, "f": f, "coordinates": ("x1", "y1", "x2", "y2"), "integrals": integrals}
