"""Maps as users write them, with answers in closed form; what is known of each stands beside it."""

from __future__ import annotations

LOGISTIC = """\
def system(r=3.2):
    def image(y):
        return r * y[0] * (1.0 - y[0])

    return {"map": image, "coordinates": "x"}
"""
"""Doublings at 3, 1 + sqrt(6), ...; superstable at 2 and 1 + sqrt(5); the exponent at 4 is ln 2."""

QUADRATIC = """\
def system(c=0.1):
    def image(y):
        (x,) = y
        return c + x**2

    return {"map": image, "coordinates": ("x",)}
"""
"""Fold at 1/4, doubling at -3/4; superstable at 0 and -1; the exponent at -2 is ln 2."""

HENON = """\
def system(a=1.4, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x**2 + y, b * x

    return {"map": image, "coordinates": ("x", "y")}
"""
"""Fold of fixed points at a = -(1 - b)^2/4, doubling at 3 (1 - b)^2/4; the exponents sum to ln b."""

STANDARD = """\
import jax.numpy as jnp

def system(k=1.0):
    def image(y):
        angle, momentum = y
        momentum = momentum + k * jnp.sin(angle)
        return jnp.stack([angle + momentum, momentum])

    return {"map": image, "coordinates": ("angle", "momentum"), "angles": ("angle", "momentum")}
"""
"""It keeps areas, so that the exponents sum to zero."""

IKEDA = """\
import jax.numpy as jnp

def system(u=0.9):
    def image(s):
        x, y = s
        t = 0.4 - 6.0 / (1.0 + x**2 + y**2)
        return 1.0 + u * (x * jnp.cos(t) - y * jnp.sin(t)), u * (x * jnp.sin(t) + y * jnp.cos(t))

    return {"map": image, "coordinates": ("x", "y")}
"""
"""A turn and a contraction by u: the exponents sum to 2 ln u."""

DELAYED = """\
def system(r=1.9):
    def image(s):
        x, y = s
        return r * x * (1.0 - y), x

    return {"map": image, "coordinates": ("x", "y")}
"""
"""Delayed logistic map: at r = 2 the fixed point has the multipliers exp(+-i pi/3), in a Neimark-Sacker bifurcation."""

CUBIC = """\
def system(mu=0.1):
    def image(s):
        u, v = s
        return -(1.0 + mu) * u + u**3, 0.5 * v

    return {"map": image, "coordinates": ("u", "v")}
"""
"""At 0 a fixed point of multipliers -(1 + mu) and 1/2; from mu = 0 on a cycle of two, u^2 = mu, of (1 - 2 mu)^2 and 1/4."""

TWO_WELLS = """\
def system(a=0.4):
    def image(y):
        return (1.0 + a) * y[0] - y[0] ** 3

    return {"map": image, "coordinates": ("x",)}
"""
"""Fixed points at +-sqrt(a) of multiplier 1 - 2 a."""


def henon(a=1.4, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x**2 + y, b * x

    def inverse(s):
        x, y = s
        return y / b, x - 1.0 + a * (y / b) ** 2

    return {"map": image, "inverse": inverse, "coordinates": ("x", "y")}
