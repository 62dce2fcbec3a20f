"""An autonomous electronic circuit with a torus bifurcation (Freire et al., Physica D 62 (1993) 230).

MatCont's `torBPC`, with the small term epsilon, and AUTO's demo `tor`, without it: then (x, y, z) -> -(x, y, z) is a
symmetry.
"""


def system(nu=-0.6, beta=0.5, gamma=-0.6, r=0.6, a3=0.32858, b3=0.93358, epsilon=0.001):
    def rhs(u, t):
        x, y, z = u
        bent = b3 * (y - x) ** 3
        return (
            (-(beta + nu) * x + beta * y - a3 * x**3 + bent) / r,
            beta * x - (beta + gamma) * y - z - bent,
            y + epsilon,
        )

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
