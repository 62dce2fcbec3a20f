"""Circuits with corners or jumps as a user writes them; and as branches between surfaces, by scipy from event to event.

Chua, Komuro and Matsumoto, IEEE Trans. Circuits Syst. 33 (1986) 1072; Yalcin, Suykens and Vandewalle, Int. J.
Bifurcation Chaos 10 (2000) 1859; Arena, Caponetto, Fortuna and Porto, Int. J. Bifurcation Chaos 8 (1998) 1527; Kennedy,
IEEE Trans. Circuits Syst. I 41 (1994) 771; Sprott, Phys. Lett. A 378 (2014) 1361.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp


class Circuit(NamedTuple):
    """A circuit of three coordinates.

    Attributes:
        rhs: (y, t) by |x|, sign and the like.
        branch: (y, signs) of the surfaces.
        heights: y to the heights of the surfaces.
        start: a state.
    """

    rhs: Callable
    branch: Callable
    heights: Callable
    start: tuple[float, float, float]

    def define(self, scale=1.0):
        return {
            "rhs": lambda y, t: tuple(scale * rate for rate in self.rhs(y, t)),
            "coordinates": ("x", "y", "z"),
        }

    def follow(self, end, value=None):
        """The state at a time; with a value the times and states at which y passes it upward up to then."""
        y, t, met = np.array(self.start), 0.0, []
        signs = np.where(np.array(self.heights(y)) >= 0.0, 1.0, -1.0)
        while t < end:
            events = [lambda t, y, k=k: self.heights(y)[k] for k in range(len(signs))]
            for event, sign in zip(events, signs, strict=True):
                event.terminal, event.direction = True, -sign
            if value is not None:
                events.append(lambda t, y: y[1] - value)
                events[-1].direction = 1.0
            path = solve_ivp(
                lambda t, y, s=signs: self.branch(y, s), (t, end), y, "DOP853", events=events,
                rtol=1e-13, atol=1e-14, max_step=0.02,
            )  # fmt: skip
            if value is not None:
                met += [*zip(path.t_events[-1], path.y_events[-1], strict=True)]
            t, y = path.t[-1], path.y[:, -1]
            passed = [k for k in range(len(signs)) if len(path.t_events[k])]
            signs[passed] *= -1.0
        return y if value is None else met


def _chua(y, saturated):
    return 9.0 * (y[1] - y[0] + 5 / 7 * y[0] + 3 / 14 * saturated), y[0] - y[1] + y[2], -100 / 7 * y[1]


_BREAKS = np.array([1.0, 2.15, 3.6, 8.2, 13.0])
_SLOPES = np.array([-1.0, 2.0, -4.0, 2.0, -4.0, 2.0]) / 7


def _scrolls(y, bends):
    current = _SLOPES[-1] * y[0] + sum(0.5 * a * b for a, b in zip(-np.diff(_SLOPES), bends, strict=True))
    return 9.0 * (y[1] - current), y[0] - y[1] + y[2], -14.286 * y[1]


def _cells(y, f):
    return (
        -y[0] + 1.24 * f[0] - 3.21 * f[1] - 3.21 * f[2],
        -y[1] - 3.21 * f[0] + 1.1 * f[1] - 4.4 * f[2],
        -y[2] - 3.21 * f[0] + 4.4 * f[1] + f[2],
    )


def _colpitts(y, exceeding):
    return y[1] + 30.0 * exceeding, 20.0 - y[0] - 0.8 * y[1] - y[2], y[1] - 0.08 * y[2]


def _sprott(y, sign, exp):
    return y[1], -y[0] - sign * y[1], y[1] ** 2 - exp(-(y[0] ** 2))


CIRCUITS = {
    "chua": Circuit(
        lambda y, t: _chua(y, jnp.abs(y[0] + 1.0) - jnp.abs(y[0] - 1.0)),
        lambda y, s: _chua(y, s[0] * (y[0] + 1.0) - s[1] * (y[0] - 1.0)),
        lambda y: (y[0] + 1.0, y[0] - 1.0),
        (0.7, 0.1, -0.2),
    ),
    "many scrolls": Circuit(
        lambda y, t: _scrolls(y, [jnp.abs(y[0] + c) - jnp.abs(y[0] - c) for c in _BREAKS]),
        lambda y, s: _scrolls(y, [s[i] * (y[0] + c) - s[i + 5] * (y[0] - c) for i, c in enumerate(_BREAKS)]),
        lambda y: (*(y[0] + _BREAKS), *(y[0] - _BREAKS)),
        (0.1, 0.2, -0.3),
    ),
    "cellular network": Circuit(
        lambda y, t: _cells(y, [jnp.clip(x, -1.0, 1.0) for x in y]),
        lambda y, s: _cells(y, [0.5 * (s[i] * (y[i] + 1.0) - s[i + 3] * (y[i] - 1.0)) for i in range(3)]),
        lambda y: (y[0] + 1.0, y[1] + 1.0, y[2] + 1.0, y[0] - 1.0, y[1] - 1.0, y[2] - 1.0),
        (-0.27, -0.37, -0.07),
    ),
    "colpitts": Circuit(
        lambda y, t: _colpitts(y, (y[2] - 9.0) * (1.0 - jnp.heaviside(y[2] - 9.0, 0.0))),
        lambda y, s: _colpitts(y, (y[2] - 9.0) * (1.0 - s[0]) / 2),
        lambda y: (y[2] - 9.0,),
        (8.9, 0.65, 8.8),
    ),
    "sprott": Circuit(
        lambda y, t: _sprott(y, jnp.sign(y[2]), jnp.exp),
        lambda y, s: _sprott(y, s[0], np.exp),
        lambda y: (y[2],),
        (-1.3, -0.2, 0.3),
    ),
}
