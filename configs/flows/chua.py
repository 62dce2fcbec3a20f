"""Chua's circuit with three straight pieces (Chua, Komuro and Matsumoto, IEEE Trans. Circuits Syst. 33 (1986) 1072).

At alpha = 9, beta = 100/7, a = -8/7, b = -5/7 the double scroll winds about (+-1.5, 0, -+1.5), exactly: at rest on the
outer pieces |x| (1 + b) = b - a. The divergence is -alpha (1 + a) - 1 where |x| < 1, and -alpha (1 + b) - 1 beyond.
"""

import jax.numpy as jnp


def system(alpha=9.0, beta=100 / 7, a=-8 / 7, b=-5 / 7):
    def rhs(y, t):
        x, y_, z = y
        current = b * x + 0.5 * (a - b) * (jnp.abs(x + 1) - jnp.abs(x - 1))
        return alpha * (y_ - x - current), x - y_ + z, -beta * y_

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
