"""Sleighs whose blade is lifted and lowered, as a user would write them, and from event to event by DOP853."""

from __future__ import annotations

import functools

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from jaxnh.systems.switched_mechanics import switched_mechanics
from jaxnh.systems.user_functions import with_events

TURN = 2 * np.pi
INERTIA = np.array([1.0, 1.0, 0.2])


def flow_of(function, **p):
    """The flow of a user's function."""
    return switched_mechanics(lambda **p: with_events(function(**p), "T"), p)


def by_clock(a=0.3, drive=1.0, phase=0.0):
    """The blade is down for half a period."""
    return sleigh(a, drive, lambda q, v, t: jnp.sin(t - phase)) | {"ignorable": ("x", "y"), "period": TURN}


def by_place(a=0.3, drive=1.0):
    """The blade grips in stripes of the plane; nothing drives it but a torque."""
    return sleigh(a, drive, lambda q, v, t: jnp.sin(2.0 * q[0]) + 0.2) | {"ignorable": ("y",), "period": TURN}


def sleigh(a, drive, lowered):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + 0.2 * v[2] ** 2)

    def Q(q, v, t):
        return -0.1 * v[0], -0.1 * v[1], drive * jnp.sin(t) - 0.1 * v[2]

    def blade(q, v, t):
        return v[1] * jnp.cos(q[2]) - v[0] * jnp.sin(q[2]) - a * v[2]

    return {"T": T, "Q": Q, "f": [{"constraint": blade, "when": lowered}], "coordinates": ("x", "y", "theta")}


HEIGHTS = {by_clock: lambda t, y, phase=0.0: np.sin(t - phase), by_place: lambda t, y: np.sin(2.0 * y[0]) + 0.2}


def row(y, a):
    """∂f/∂v at (x, y, θ, velocities)."""
    return np.array([-np.sin(y[2]), np.cos(y[2]), -a])


def lowered(y, a):
    """The state where the blade has come down, and the energy lost."""
    way = row(y, a) / INERTIA
    change = -way * (row(y, a) @ y[3:]) / (row(y, a) @ way)
    return np.r_[y[:3], y[3:] + change], 0.5 * change @ (INERTIA * change)


def rates(t, y, a=0.3, drive=1.0, down=False):
    """Rates of (x, y, θ, velocities)."""
    v = y[3:]
    force = np.array([-0.1 * v[0], -0.1 * v[1], drive * np.sin(t) - 0.1 * v[2]])
    if down:
        turning = -v[2] * (np.cos(y[2]) * v[0] + np.sin(y[2]) * v[1])
        way = row(y, a) / INERTIA
        force = force - row(y, a) * (row(y, a) @ (force / INERTIA) + turning) / (row(y, a) @ way)
    return np.r_[v, force / INERTIA]


def period(kind, y, a=0.3, drive=1.0, **height):
    """The state a period after one at t = 0, the energy lost, and how often the blade has come down.

    At the end as well: what falls on it is of this period.
    """
    when = lambda t, y: HEIGHTS[kind](t, y, **height)  # noqa: E731
    t, y, lost, count = 0.0, np.array(y, float), 0.0, 0
    slope = (when(1e-7, y + 1e-7 * rates(0.0, y)) - when(0.0, y)) / 1e-7
    down = when(t, y) > 1e-9 or (abs(when(t, y)) <= 1e-9 and slope > 0)
    if down:
        y, lost = lowered(y, a)
    while t < TURN - 1e-12:
        event = lambda t, y: when(t, y)  # noqa: E731
        event.terminal, event.direction = True, -1.0 if down else 1.0
        path = solve_ivp(
            functools.partial(rates, a=a, drive=drive, down=down), (t, TURN), y, "DOP853", rtol=1e-13, atol=1e-14, events=event,
            max_step=0.05,
        )  # fmt: skip
        t, y = path.t[-1], path.y[:, -1]
        if t < TURN - 1e-9 or abs(when(t, y)) <= 1e-9:
            down = not down
            if down:
                y, more = lowered(y, a)
                lost, count = lost + more, count + 1
    return y, lost, count
