"""Three flows as a stranger would write them, with the exponents that another integration gives.

Those are means of eight starts, by the classical method of order 4 with 2,000 steps a unit of time and tangents
orthonormalised a hundred times in it, over 1,000 units after 300; their errors are two standard errors of the starts.
"""

from __future__ import annotations

from typing import NamedTuple


class Stranger(NamedTuple):
    """A system file, its config, and its exponents, 1/time, with their errors."""

    system: str
    config: str
    exponents: tuple[float, ...]
    errors: tuple[float, ...]


_CONFIG = """\
system: {{file: own.py}}
initial: {{{start}}}
sweep: {{a: {{values: [{value}]}}}}
accuracy: {{target: 1.0e-8}}
analyses:
  lyapunov: {{transient: 256, periods: 1024, exponents: {count}}}
"""
_CHECK = """\
import sys
import jaxnh

found = jaxnh.open_result("results/own.h5")["lyapunov"].to_dataset()
ours, errors = (found[name].to_numpy()[0] for name in ("exponents", "exponents_error"))
for value, error, known, within in zip(ours, errors, {exponents}, {known}):
    if abs(value - known) > 1.5 * (error + within):
        sys.exit(f"an exponent is {{value}} +- {{error}}, and known as {{known}} +- {{within}}")
"""


def check_of(flow: Stranger) -> str:
    """A script that holds the result against the known exponents.

    Of ten exponents in all, each with two errors at 95 %, one may well be a little outside both: half as much more is
    allowed, three standard errors.
    """
    return _CHECK.format(exponents=flow.exponents, known=flow.errors)


FLOWS = {
    "a double convection (Rucklidge 1992)": Stranger(
        """\
def system(a=2.0, b=6.7):
    def rhs(state, t):
        u, v, w = state
        return b * v - a * u - v * w, u, v * v - w

    return {"rhs": rhs, "coordinates": ("u", "v", "w"), "time_unit": 6.0721}
""",
        _CONFIG.format(start="u: 1.93, v: 3.19, w: 5.78", value=2.0, count=3),
        (0.19104, 0.00007, -3.19111),
        (0.00075, 0.00013, 0.00078),
    ),
    "a cyclically symmetric flow (Thomas 1999)": Stranger(
        """\
from jax.numpy import sin

def system(a=1.85, b=10.0):
    def rhs(state, t):
        u, v, w = state
        return b * sin(v) - a * u, b * sin(w) - a * v, b * sin(u) - a * w

    return {"rhs": rhs, "coordinates": ("u", "v", "w"), "time_unit": 0.7}
""",
        _CONFIG.format(start="u: 3.0, v: 2.9, w: 3.3", value=1.85, count=3),
        (0.49243, -0.00003, -6.04240),
        (0.0087, 0.00015, 0.0087),
    ),
    "hyperchaos in four equations": Stranger(
        """\
def system(a=10.0, b=2.667, c=28.0, d=1.1):
    def rhs(state, t):
        u, v, w, s = state
        return a * (v - u) + s, c * u - v - u * w, u * v - b * w, d * s - u * w

    return {"rhs": rhs, "coordinates": ("u", "v", "w", "s"), "time_unit": 1.2775}
""",
        _CONFIG.format(start="u: -9.2, v: -0.7, w: 16.4, s: -145.0", value=10.0, count=4),
        (0.25853, 0.09341, 0.00110, -12.92004),
        (0.011, 0.014, 0.0011, 0.0079),
    ),
}
