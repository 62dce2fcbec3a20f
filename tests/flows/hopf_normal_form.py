"""Hopf's normal form r′ = (μ − r²) r, θ′ = ω on the section y = 0 upward: the radius and the time of a turn."""

from __future__ import annotations

import numpy as np

from jaxnh.maps.section import Section, begin
from jaxnh.systems.first_order import first_order
from tests.flows.known_flow import KnownFlow

OMEGA = 2.0


def hopf(mu=0.1):
    def rhs(y, t):
        x, y_ = y
        growth = mu - x * x - y_ * y_
        return growth * x - OMEGA * y_, growth * y_ + OMEGA * x

    return {"rhs": rhs, "coordinates": ("x", "y")}


def radius(mu, start, t):
    """r² = μ/(1 + (μ/r₀² − 1) exp(−2μt))."""
    return np.sqrt(mu / (1 + (mu / start**2 - 1) * np.exp(-2 * mu * t)))


def known_flow():
    mu, start, turn = np.array([0.1, 0.4]), 0.8, 2 * np.pi / OMEGA
    section = Section(first_order(hopf, {"mu": 0.1}, ("mu",)), "y", 1, 0.0, "up")
    state = begin(section, section.flow.start({"x": np.full(2, start), "y": np.zeros(2)}))
    exact = np.array([[radius(value, start, turn), turn] for value in mu])
    return KnownFlow(
        section, state, exact, lambda end: np.stack([end.state.y[0], end.t], -1), {"mu": mu}, evaluations=70
    )
