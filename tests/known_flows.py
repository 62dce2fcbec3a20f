"""Flows whose orbits, exponents and doublings are known in closed form, as files that a user would write, and as rates.

Möbius: a vector that turns by half a turn a period, in whose frame ξ' = (μ − ν − ξ²) ξ and η' = −η. A period's map has the
fixed point 0 with multipliers −exp(2π(μ − ν)) and −exp(−2π), which doubles at μ = ν; beyond, ξ = ±√(μ − ν) is an orbit of
period 2 with exponents −2(μ − ν) and −1. In space it is the same about the circle r = 1.
"""

from __future__ import annotations

import numpy as np

TURN = 2 * np.pi

MOEBIUS = """\
import jax.numpy as jnp

def system(mu=0.1, nu=0.0, omega=1.0):
    def rhs(y, t):
        u, v = y
        c, s = jnp.cos(omega * t / 2), jnp.sin(omega * t / 2)
        xi, eta = c * u + s * v, c * v - s * u
        d, e = (mu - nu - xi**2) * xi, -eta
        return omega * (c * d - s * e - v / 2), omega * (s * d + c * e + u / 2)

    return {"rhs": rhs, "coordinates": ("u", "v"), "period": 2 * jnp.pi / omega}
"""

MOEBIUS_IN_SPACE = """\
import jax.numpy as jnp

def system(mu=0.1, nu=0.0):
    def rhs(y, t):
        x, y, z = y
        r = jnp.sqrt(x * x + y * y)
        rho, cos, sin = r - 1.0, x / r, y / r
        cc, ss, cs = (1.0 + cos) / 2, (1.0 - cos) / 2, sin / 2
        k = mu - nu - (cc * rho**2 + 2 * cs * rho * z + ss * z**2)
        of_rho = k * (cc * rho + cs * z) - ss * rho + cs * z - z / 2
        of_z = k * (cs * rho + ss * z) + cs * rho - cc * z + rho / 2
        return of_rho * cos - y, of_rho * sin + x, of_z

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "time_unit": 2 * jnp.pi}
"""

SLIDE = """\
import jax.numpy as jnp

def system(drive=0.5, damping=0.2, rate=0.5, level=0.1):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):  # so that x'' = -x - 2 damping x' + drive cos t: the slide weighs as 1 + (2 rate x')^2
        weight = 1.0 + (2.0 * rate * v[0]) ** 2
        return weight * (-q[0] - 2.0 * damping * v[0] + drive * jnp.cos(t)), 0.0

    def f(q, v, t):
        return (v[1] - rate * (v[0] ** 2 - level),)

    names = {"coordinates": ("x", "y"), "ignorable": ("y",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi, **names}
"""

CYCLE = """\
import jax.numpy as jnp

def system(mu=0.5, slope=0.5):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):  # so that x'' = -x + (mu - x^2 - x'^2) x': a cycle of radius sqrt(mu)
        return (1.0 + slope**2) * (-q[0] + (mu - q[0] ** 2 - v[0] ** 2) * v[0]), 0.0

    def f(q, v, t):
        return (v[1] - slope * v[0],)

    names = {"coordinates": ("x", "y"), "ignorable": ("y",)}
    return {"T": T, "Q": Q, "f": f, "time_unit": 2 * jnp.pi, **names}
"""

PARTICLE = """\
import jax.numpy as jnp

def system(a=0.5, b=5.9, c=1.0, d=0.1):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        g = 1.0 + jnp.sin(t)
        x, y = q
        return -(a * g * x + g * x**3 - b * y), -(g * y + a * g * y**3 - b * x)

    def f(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 - c - d * jnp.sin(t),)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y"), "period": 2 * jnp.pi}
"""


def moebius(t, y, mu=0.1, nu=0.0, omega=1.0):
    """Rates of (u, v), from the complex number w = u + iv: in its frame ζ = w exp(−iωt/2)."""
    turn = np.exp(0.5j * omega * t)
    zeta = (y[0] + 1j * y[1]) / turn
    rate = (mu - nu - zeta.real**2) * zeta.real - 1j * zeta.imag + 0.5j * zeta
    w = omega * rate * turn
    return np.array([w.real, w.imag])


def moebius_in_space(t, y, mu=0.1, nu=0.0):
    """Rates of (x, y, z): about the circle the plane of (r − 1, z), at the angle of (x, y) in place of time."""
    angle = np.arctan2(y[1], y[0])
    rho, z = moebius(angle, [np.hypot(y[0], y[1]) - 1.0, y[2]], mu, nu)
    return np.array([rho * np.cos(angle) - y[1], rho * np.sin(angle) + y[0], z])


def slide(t, y, drive=0.5, damping=0.2, rate=0.5, level=0.1):
    """Rates of (x, x', y)."""
    return np.array([y[1], -y[0] - 2 * damping * y[1] + drive * np.cos(t), rate * (y[1] ** 2 - level)])


def cycle(t, y, mu=0.5, slope=0.5):
    """Rates of (x, x', y)."""
    return np.array([y[1], -y[0] + (mu - y[0] ** 2 - y[1] ** 2) * y[1], slope * y[1]])


def free(t, y, b, a=0.5, forced=True):
    """Rates of (x1, x2, y1, y2) by equation (1)."""
    x, vx, z, vz = y
    g = 1.0 + forced * np.sin(t)
    return np.array([vx, -(a * g * x + g * x**3 - b * z) - a * vx, vz, -(g * z + a * g * z**3 - b * x) - a * vz])


def at_speed(t, y, b, a=0.5, c=1.0, d=0.1, forced=True):
    """Rates of (x1, y1, θ) at the squared speed c + d sin t: θ' = n⊥·F/s."""
    x, z, angle = y
    g, s = 1.0 + forced * np.sin(t), np.sqrt(c + d * np.sin(t))
    force = -(a * g * x + g * x**3 - b * z), -(g * z + a * g * z**3 - b * x)
    return np.array([s * np.cos(angle), s * np.sin(angle), (np.cos(angle) * force[1] - np.sin(angle) * force[0]) / s])
