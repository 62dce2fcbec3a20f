"""Henon's map (Commun. Math. Phys. 50 (1976) 69), x' = 1 - a x^2 + y, y' = b x.

The exponents sum to ln |b|, exactly. Fixed points are born at a = -(1 - b)^2/4 and double at 3 (1 - b)^2/4.
"""


def system(a=1.4, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x**2 + y, b * x

    return {"map": image, "coordinates": ("x", "y")}
