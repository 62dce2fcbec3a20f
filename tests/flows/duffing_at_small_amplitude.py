"""Duffing's oscillator x″ = −x − x³ at small amplitudes A: x = A cn(Ωt, m), Ω² = 1 + A², m = A²/(2Ω²)."""

from __future__ import annotations

import numpy as np
import scipy.special

from jaxnh.systems.first_order import Point, first_order
from tests.flows.known_flow import KnownFlow

TIME = 6.0


def duffing():
    def rhs(y, t):
        x, v = y
        return v, -x - x**3

    return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": TIME}


def motion(amplitude, t):
    """Position and velocity a time after the turning point, (2,) or (2, lanes)."""
    omega = np.sqrt(1 + amplitude**2)
    sn, cn, dn, _ = scipy.special.ellipj(omega * t, amplitude**2 / (2 * omega**2))
    return amplitude * np.array([cn, -omega * sn * dn])


def known_flow():
    amplitude = np.array([0.1, 0.3])
    flow = first_order(duffing, {})
    return KnownFlow(
        flow, Point((amplitude, np.zeros(2))), motion(amplitude, TIME).T, flow.chart.host_points, evaluations=120
    )
