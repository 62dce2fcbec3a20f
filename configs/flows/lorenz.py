"""The Lorenz system (J. Atmos. Sci. 20 (1963) 130).

Exponents at sigma = 10, rho = 28, beta = 8/3: 0.9056, 0, -14.5723 (Sprott, Chaos and Time-Series Analysis, 2003).
Their sum is -(sigma + 1 + beta), exactly, at any rho.
"""


def system(sigma=10.0, rho=28.0, beta=8 / 3):
    def rhs(y, t):
        x, y_, z = y
        return sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
