"""Maps and a flow with tori in closed form: a skew product, the normal form of a Neimark–Sacker bifurcation, a tube."""

from __future__ import annotations

import math

import jax.numpy as jnp

TURN = 2 * math.pi
GOLDEN = (math.sqrt(5) - 1) / 2


def turned(a, b, angle, grown):
    """A point turned by an angle about the origin, and its distance from there times a factor."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return grown * (c * a - s * b), grown * (s * a + c * b)


def skew(c=0.5, e=0.3, k=0.0):
    """x -> x + 2 pi g, and two coordinates that it drives: w = Im(exp(ix)/(exp(2 pi i g) - c)) is invariant for k = 0."""

    def image(y):
        x, w, z = y
        return x + TURN * GOLDEN, c * w + jnp.sin(x) + k * z * w, e * z + jnp.cos(2.0 * x)

    return {"map": image, "coordinates": ("x", "w", "z"), "angles": ("x",)}


def bent_circle(mu=0.1, beta=0.3, shear=0.4):
    """The normal form of a Neimark-Sacker bifurcation, r -> r (1 + mu - r^2), by 0.2345 + beta r^2 turns, and sheared."""

    def image(y):
        a, b = y[0], y[1] - shear * y[0] * y[0]
        square = a * a + b * b
        angle, grown = TURN * (0.2345 + beta * square), 1.0 + mu - square
        c, s = jnp.cos(angle), jnp.sin(angle)
        a, b = grown * (c * a - s * b), grown * (s * a + c * b)
        return a, b + shear * a * a

    return {"map": image, "coordinates": ("a", "b")}


def tube(mu=0.1, turns=0.3173):
    """A torus about the circle of radius 2: distance to it by a' = mu a - a^3 and a' turned, while it is gone round."""

    def rhs(y, t):
        x, z, h = y
        radius = jnp.sqrt(x * x + z * z)
        out, square = radius - 2.0, (radius - 2.0) ** 2 + h * h
        grown = mu - square
        outwards, up = grown * out - turns * h, turns * out + grown * h
        return (x * outwards / radius - z, z * outwards / radius + x, up)

    return {"rhs": rhs, "coordinates": ("x", "z", "h")}
