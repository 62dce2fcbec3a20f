"""The Brusselator (Prigogine and Lefever, J. Chem. Phys. 48 (1968) 1695), by u = x − a, so that u = 0 at rest."""


def system(a=1.0, b=2.0):
    def rhs(state, t):
        u, y = state
        x = u + a
        return a - (b + 1.0) * x + x * x * y, b * x - x * x * y

    return {"rhs": rhs, "coordinates": ("u", "y")}
