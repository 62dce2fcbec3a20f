"""A rattleback of a paraboloid: its equations written anew, and its cascade over the energy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "quick_compiling")

CONFIG = ROOT / "configs/nonholonomic/celtic_stone.yaml"
FEIGENBAUM = 4.669201609102990
"""Feigenbaum's constant δ (Briggs, Math. Comp. 57 (1991) 435)."""

RADII, HEIGHT, WEIGHT = np.array([9.0, 4.0]), 1.0, 100.0
COS, SIN = np.cos(0.75), np.sin(0.75)
TURN = np.array([[COS, -SIN, 0.0], [SIN, COS, 0.0], [0.0, 0.0, 1.0]])
INERTIA = TURN @ np.diag([2.0, 6.0, 7.0]) @ TURN.T


def contact(vertical):
    """The point r of contact, at which the surface r3 = −h + (r1²/a1 + r2²/a2)/2 is level, from components (3, ...)."""
    across = -RADII.reshape(2, *[1] * (np.ndim(vertical) - 1)) * vertical[:2] / vertical[2]
    lift = 0.5 * (across[0] ** 2 / RADII[0] + across[1] ** 2 / RADII[1])
    return np.stack([across[0], across[1], lift - HEIGHT])


def about_contact(r):
    """The tensor of inertia about the point of contact."""
    return INERTIA + r @ r * np.eye(3) - np.outer(r, r)


def rates(t, y):
    """Of the vertical γ and of the moment M about the contact: γ̇ = γ × ω, Ṁ = M × ω + ṙ × (ω × r) + g r × γ.

    Borisov and Mamaev (Phys. Usp. 46 (2003) 393), with the mass one.
    """
    vertical, moment = y[:3], y[3:]
    r = contact(vertical)
    w = np.linalg.solve(about_contact(r), moment)
    vertical_rate = np.cross(vertical, w)
    across = -RADII * (vertical_rate[:2] * vertical[2] - vertical[:2] * vertical_rate[2]) / vertical[2] ** 2
    r_rate = np.array([*across, np.sum(r[:2] * across / RADII)])
    turned = np.cross(moment, w) + np.cross(r_rate, np.cross(w, r)) + WEIGHT * np.cross(r, vertical)
    return np.concatenate([vertical_rate, turned])


def returns(vertical, w, count):
    """The next points (count, 3) at which γ1 passes zero upwards, by DOP853."""

    def crossing(t, y):
        return y[0]

    crossing.direction, crossing.terminal = 1.0, count + 1  # and the start
    start = np.concatenate([vertical, about_contact(contact(vertical)) @ w])
    motion = solve_ivp(rates, (0.0, 5.0 * count), start, "DOP853", rtol=1e-12, atol=1e-12, events=crossing)
    points = motion.y_events[0][motion.t_events[0] > 1e-6, :3]
    return points[:count]


def groups_of(*changes):
    made = jaxnh.load(CONFIG, list(changes))
    return session_of(made).groups(dict.fromkeys(made.analyses.options()))


def test_returns_beside_equations_written_anew():
    """Four returns before the motion has settled, each 1e-9 off by steps and less by rounding."""
    groups = groups_of(
        "sweep.energy={values: [690.0]}",
        "accuracy={solver: verner9, steps: 400}",
        "analyses={diagram: {transient: 1, strobes: 5}}",
    )
    data = groups["diagram"].squeeze()
    points = np.stack([data[name].to_numpy() for name in ("g1", "g2", "g3")], axis=1)
    w = np.array([float(data[name][0]) for name in ("w1", "w2", "w3")])
    assert np.abs(returns(points[0], w, 4) - points[1:]).max() < 1e-8


@pytest.mark.slow
def test_periods_double_for_ever():
    """As the abstract says (Borisov et al. 2012): a cascade of Feigenbaum's class, from period 4; δ is within its bar."""
    data = groups_of("sweep.energy={start: 700.0, stop: 714.0, count: 15}", "analyses={doubling: {levels: 6}}")[
        "doubling"
    ]
    assert data["period"].to_numpy().tolist() == [4, 8, 16, 32, 64, 128]
    assert np.all(np.diff(data["energy"].to_numpy()) > 0.0)
    delta, error = float(data["delta_limit"]), float(data["delta_limit_error"])
    assert error < 0.2
    assert abs(delta - FEIGENBAUM) <= error
