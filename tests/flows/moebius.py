"""A vector that turns by half a turn a period, as files that a user would write, and as rates: its doubling in closed form.

In its frame ξ' = (μ − ν − ξ²) ξ and η' = −η. A period's map has the
fixed point 0 with multipliers −exp(2π(μ − ν)) and −exp(−2π), which doubles at μ = ν; beyond, ξ = ±√(μ − ν) is an orbit of
period 2 with exponents −2(μ − ν) and −1. In space it is the same about the circle r = 1. In its frame the half turn is a
jump (ξ, η) → −(ξ, η) a period, which may come at any ξ², as the motion between does not change with it. Its clock may be
a coordinate that another jump sets back. In u + 0.1 |v − 0.02| in place of u it has a corner.
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

MOEBIUS_WITH_A_CORNER = """\
import jax.numpy as jnp

def system(mu=0.1, nu=0.0):
    def rhs(y, t):
        x, v = y
        u = x - 0.1 * jnp.abs(v - 0.02)
        c, s = jnp.cos(t / 2), jnp.sin(t / 2)
        xi, eta = c * u + s * v, c * v - s * u
        d, e = (mu - nu - xi**2) * xi, -eta
        u_rate, v_rate = c * d - s * e - v / 2, s * d + c * e + u / 2
        return u_rate + 0.1 * jnp.where(v > 0.02, v_rate, -v_rate), v_rate

    return {"rhs": rhs, "coordinates": ("u", "v"), "period": 2 * jnp.pi}
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

MOEBIUS_WITH_JUMPS = """\
import jax.numpy as jnp

def system(mu=0.1, nu=0.0):
    def rhs(y, t):
        u, v = y
        return (mu - nu - u**2) * u, -v

    def wall(y, t):
        return jnp.sin(t - 1.0 - 0.3 * y[0] ** 2)

    def turn(y, t):
        return -y[0], -y[1]

    jumps = [{"when": wall, "direction": "up", "then": turn}]
    return {"rhs": rhs, "coordinates": ("u", "v"), "period": 2 * jnp.pi, "jumps": jumps}
"""

MOEBIUS_WITH_JUMPS_IN_TIME = """\
import jax.numpy as jnp

def system(mu=0.1, nu=0.0):
    def rhs(y, t):
        u, v, clock = y
        return (mu - nu - u**2) * u, -v, 1.0

    def wall(y, t):
        return y[2] - 1.0 - 0.3 * y[0] ** 2

    def turn(y, t):
        return -y[0], -y[1], y[2]

    def again(y, t):
        return y[0], y[1], y[2] - 2 * jnp.pi

    jumps = [{"when": wall, "then": turn}, {"when": lambda y, t: y[2] - 6.0, "then": again}]
    return {"rhs": rhs, "coordinates": ("u", "v", "clock"), "time_unit": 2 * jnp.pi, "jumps": jumps}
"""


def moebius(t, y, mu=0.1, nu=0.0, omega=1.0):
    """Rates of (u, v), from the complex number w = u + iv: in its frame ζ = w exp(−iωt/2)."""
    turn = np.exp(0.5j * omega * t)
    zeta = (y[0] + 1j * y[1]) / turn
    rate = (mu - nu - zeta.real**2) * zeta.real - 1j * zeta.imag + 0.5j * zeta
    w = omega * rate * turn
    return np.array([w.real, w.imag])


def moebius_with_a_corner(t, y, mu=0.1, nu=0.0):
    """Rates of (u + 0.1 |v − 0.02|, v)."""
    above = np.sign(y[1] - 0.02)
    u, v = moebius(t, [y[0] - 0.1 * above * (y[1] - 0.02), y[1]], mu, nu)
    return np.array([u + 0.1 * above * v, v])


def moebius_in_space(t, y, mu=0.1, nu=0.0):
    """Rates of (x, y, z): about the circle the plane of (r − 1, z), at the angle of (x, y) in place of time."""
    angle = np.arctan2(y[1], y[0])
    rho, z = moebius(angle, [np.hypot(y[0], y[1]) - 1.0, y[2]], mu, nu)
    return np.array([rho * np.cos(angle) - y[1], rho * np.sin(angle) + y[0], z])


def moebius_in_its_frame(t, y, mu=0.1, nu=0.0):
    """Rates of (ξ, η)."""
    return np.array([(mu - nu - y[0] ** 2) * y[0], -y[1]])
