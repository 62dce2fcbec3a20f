"""Van der Pol's oscillator x'' = mu (1 - x^2) x' - x, left to itself.

At mu = 1 the period of its limit cycle is 6.663286859323 (heyoka's Taylor integrator at 1e-18). Its exponents are 0 and
the mean of the divergence mu (1 - x^2) over a period.
"""


def system(mu=1.0):
    def rhs(y, t):
        x, v = y
        return v, mu * (1 - x**2) * v - x

    return {"rhs": rhs, "coordinates": ("x", "v")}
