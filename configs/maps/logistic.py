"""The logistic map x' = r x (1 - x) (May, Nature 261 (1976) 459).

It doubles at r = 3, at 1 + sqrt(6), ... up to 3.5699456718709; period 3 is born at 1 + sqrt(8), and at r = 4 the
exponent is ln 2.
"""


def system(r=3.5):
    def image(y):
        (x,) = y
        return r * x * (1.0 - x)

    return {"map": image, "coordinates": "x"}
