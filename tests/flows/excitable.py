"""Excitable and bursting flows, written once for JAX and heyoka; their spectra by integrators outside of the package.

Right-hand sides are functions of a state and of a module that has `exp` and `cos`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import stdtrit


class ExcitableFlow(NamedTuple):
    """A flow.

    Attributes:
        rhs: (y, module) to the rates.
        coordinates: their names.
        start: a state.
        unit: unit of time.
    """

    rhs: Callable
    coordinates: tuple[str, ...]
    start: tuple[float, ...]
    unit: float

    def define(self):
        """The system as a user gives it."""
        return {"rhs": lambda y, t: self.rhs(y, jnp), "coordinates": self.coordinates, "time_unit": self.unit}

    @property
    def begun(self):
        """The start state by name."""
        return dict(zip(self.coordinates, self.start, strict=True))


def hodgkin_huxley(y, f):
    """Hodgkin and Huxley (J. Physiol. 117 (1952) 500), rest at −65 mV, in mV and ms, under 10 µA/cm²."""
    v, m, h, n = y
    rising_m, rising_n = ((v + shift) / 10.0 / (1.0 - f.exp(-(v + shift) / 10.0)) for shift in (40.0, 55.0))
    open_m, closed_m = rising_m, 4.0 * f.exp(-(v + 65.0) / 18.0)
    open_h, closed_h = 0.07 * f.exp(-(v + 65.0) / 20.0), 1.0 / (1.0 + f.exp(-(v + 35.0) / 10.0))
    open_n, closed_n = 0.1 * rising_n, 0.125 * f.exp(-(v + 65.0) / 80.0)
    ions = 120.0 * m**3 * h * (v - 50.0) + 36.0 * n**4 * (v + 77.0) + 0.3 * (v + 54.387)
    gates = [
        opening * (1.0 - gate) - closing * gate
        for gate, opening, closing in ((m, open_m, closed_m), (h, open_h, closed_h), (n, open_n, closed_n))
    ]
    return 10.0 - ions, *gates


def hindmarsh_rose(y, f):
    """Hindmarsh and Rose (Proc. R. Soc. B 221 (1984) 87) where spikes come in bursts, irregularly."""
    x, v, z = y
    return v - x * x * x + 3.0 * x * x - z + 3.25, 1.0 - 5.0 * x * x - v, 0.006 * (4.0 * (x + 1.6) - z)


def excitable_cell(y, f):
    """Chay's cell (Physica D 16 (1985) 233), at the values of dysts."""
    v, n, c = y
    open_m, closed_m = 0.1 * (25.0 + v) / (1.0 - f.exp(-0.1 * v - 2.5)), 4.0 * f.exp(-v / 18.0 - 2.5 / 0.9)
    open_h, closed_h = 0.07 * f.exp(-0.05 * v - 2.5), 1.0 / (1.0 + f.exp(-0.1 * v - 2.0))
    open_n, closed_n = 0.01 * (20.0 + v) / (1.0 - f.exp(-0.1 * v - 2.0)), 0.125 * f.exp(-0.0125 * v - 0.375)
    m, h = open_m / (open_m + closed_m), open_h / (open_h + closed_h)
    inward = m * m * m * h * (100.0 - v)
    potassium = (1700.0 * n * n * n * n + 11.0 * c / (1.0 + c)) * (-75.0 - v)
    rate_n = 230.0 * (open_n - (open_n + closed_n) * n)
    return 1800.0 * inward + potassium + 7.0 * (-40.0 - v), rate_n, 0.27 * (inward - 0.183333 * c)


def isothermal_chemical(y, f):
    """Three variables of an isothermal autocatalysis (Petrov, Scott, Showalter 1992), at the values of dysts."""
    a, b, c = y
    return 0.29786 * (2.5 + c) - a * b * b - a, (a * b * b + a - b) / 0.013, b - c


def circadian_rhythm(y, f):
    """Leloup, Gonze and Goldbeter (J. Biol. Rhythms 14 (1999) 433) with a day as a coordinate, at the values of dysts."""
    m, c, s, n, angle = y
    light = 2.5 * (1.5 + 0.5 * f.cos(angle)) * 3.7
    made = light / (1.0 + n * n * n * n) - 0.7 * m / (0.4 + m)
    moved = 0.3 * c - 0.15 * n
    return (
        made,
        m - moved - 0.5 * c,
        0.5 * c - 6.0 * s / (1.4 + s),
        moved - 1.5 * n / (0.4 + n),
        2.0 * np.pi / 24.0 + 0.0 * angle,
    )


FLOWS = {
    "hodgkin_huxley": ExcitableFlow(hodgkin_huxley, ("v", "m", "h", "n"), (0.0, 0.5, 0.3, 0.5), 10.0),
    "hindmarsh_rose": ExcitableFlow(hindmarsh_rose, ("x", "y", "z"), (-1.0, -4.0, 3.2), 10.0),
    "excitable_cell": ExcitableFlow(excitable_cell, ("v", "n", "c"), (-44.5778, 0.131216, 0.465853), 1.0),
    "isothermal_chemical": ExcitableFlow(isothermal_chemical, ("a", "b", "c"), (0.51415, 0.99843, 1.00618), 0.73028),
    "circadian_rhythm": ExcitableFlow(
        circadian_rhythm, ("m", "c", "s", "n", "angle"), (1.54012, 5.37079, 41.05427, 11.61907, 0.0), 24.0
    ),
}


# ---- variational equations


def rates_with_tangents(name):
    """(t, z) to the rates of a state, of its tangents and of the integral of the divergence, (d + d² + 1,), for scipy."""
    flow = FLOWS[name]
    d = len(flow.start)

    def rhs(y):
        return jnp.stack(flow.rhs(tuple(y), jnp))

    @jax.jit
    def rates(z):
        slopes = jax.jacfwd(rhs)(z[:d])
        return jnp.concatenate([rhs(z[:d]), (slopes @ z[d:-1].reshape(d, d)).ravel(), jnp.trace(slopes)[None]])

    return lambda t, z: np.asarray(rates(z))


def by_heyoka(name):
    """(y, length of time) to the state later and its derivative, by Taylor steps."""
    flow = FLOWS[name]
    d, variables = len(flow.start), hy.make_vars(*flow.coordinates)
    equations = hy.var_ode_sys(list(zip(variables, flow.rhs(variables, hy), strict=True)), variables, order=1)
    taylor = hy.taylor_adaptive(equations, list(flow.start), tol=1e-15, compact_mode=True)
    unit = taylor.state[d:].copy()

    def push(y, length):
        taylor.state[:d], taylor.state[d:], taylor.time = y, unit, 0.0
        assert taylor.propagate_until(length)[0] == hy.taylor_outcome.time_limit
        return taylor.state[:d].copy(), taylor.state[d:].reshape(d, d).copy()

    return push


def by_scipy(name):
    """The same by DOP853, where rates have removable singularities, at which Taylor series lose all digits."""
    d, rates = len(FLOWS[name].start), rates_with_tangents(name)

    def push(y, length):
        begun = np.concatenate([y, np.eye(d).ravel(), [0.0]])
        end = solve_ivp(rates, (0.0, length), begun, "DOP853", rtol=1e-9, atol=1e-10).y[:, -1]
        return end[:d], end[d:-1].reshape(d, d)

    return push


def spectrum(name, push, transient, units, parts):
    """Exponents of a flow and their errors at 95 %, (d,) each: averages over units of time, of `parts` QR each.

    Parts are so short that no tangent shrinks below the rounding of another one in them.

    Errors are of the means of sixteen blocks.
    """
    flow = FLOWS[name]
    y, q, logs = np.array(flow.start), np.eye(len(flow.start)), np.zeros((units, len(flow.start)))
    for number in range(-transient, units):
        for _ in range(parts):
            y, slopes = push(y, flow.unit / parts)
            q, r = np.linalg.qr(slopes @ q)
            if number >= 0:
                logs[number] += np.log(np.abs(np.diag(r)))
    blocks = logs.reshape(16, -1, logs.shape[1]).mean(axis=1) / flow.unit
    order = np.argsort(-blocks.mean(axis=0))
    return blocks.mean(axis=0)[order], stdtrit(15, 0.975) * blocks.std(axis=0, ddof=1)[order] / 4.0
