"""Henon and Heiles (Astron. J. 69 (1964) 73): V = (x^2 + y^2)/2 + x^2 y - y^3/3, a parameter at the cubic terms.

The energy is kept, and motions of an energy below 1/6 stay. Exponents come in pairs of opposite signs, two are zero.
"""


def system(cubic=1.0):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        x, y = q
        return -x - 2 * cubic * x * y, -y - cubic * (x**2 - y**2)

    return {"T": T, "Q": Q, "coordinates": ("x", "y")}
