"""The peroxidase-oxidase reaction of Steinmetz and Larter (J. Chem. Phys. 94 (1991) 1388).

Its cycles are an example of MatCont's and of BifurcationKit's: a fold and a Neimark-Sacker bifurcation over k8. km7 is
k with the index -7.
"""


def system(k1=0.1631021, k2=1250.0, k3=0.046875, k4=20.0, k5=1.104, k6=0.001, km7=0.1175, k7=1.5, k8=0.75):
    def rhs(u, t):
        a, b, x, y = u
        one, three = k1 * a * b * x, k3 * a * b * y
        return (
            -one - three + k7 - km7 * a,
            -one - three + k8,
            one - 2 * k2 * x**2 + 2 * three - k4 * x + k6,
            -three + 2 * k2 * x**2 - k5 * y,
        )

    return {"rhs": rhs, "coordinates": ("a", "b", "x", "y")}
