"""The Roessler system (Phys. Lett. A 57 (1976) 397).

Exponents at a = b = 0.2, c = 5.7: 0.0714, 0, -5.3943 (Sprott, Chaos and Time-Series Analysis, 2003).
"""


def system(a=0.2, b=0.2, c=5.7):
    def rhs(y, t):
        x, y_, z = y
        return -y_ - z, x + a * y_, b + z * (x - c)

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
