"""A block on a spring that a belt takes along, with friction: sticks and slips are in closed form."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq


def belt(mu=1.0, c=0.3, u=0.5):
    """x'' + x = friction of a belt at speed u, which falls with the relative speed: μ − c |v − u| against it."""
    return {
        "rhs": lambda y, t, side: (y[1], -y[0] - mu * side[0] + c * (y[1] - u)),
        "coordinates": ("x", "v"),
        "switches": ({"on": lambda y, t: y[1] - u, "sliding": True},),
    }


def slip(s, mu=1.0, c=0.3, u=0.5):
    """The state of the block a time s after it has left the belt, at x = μ: an arc of a growing spiral."""
    w, centre = np.sqrt(1 - c * c / 4), mu - c * u
    x = mu - centre
    b = (u - c / 2 * x) / w
    cos, sin, e = np.cos(w * s), np.sin(w * s), np.exp(c / 2 * s)
    off = e * (x * cos + b * sin)
    return np.array([centre + off, c / 2 * off + e * w * (b * cos - x * sin)])


def stick_slip(mu=1.0, c=0.3, u=0.5):
    """Durations of slip and stick, and where the block is caught."""
    duration = brentq(lambda s: slip(s, mu, c, u)[1] - u, 4.0, 6.0, xtol=1e-15)
    caught = slip(duration, mu, c, u)[0]
    return duration, (mu - caught) / u, caught
