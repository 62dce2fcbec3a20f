"""A rattleback of a paraboloid: its equations written anew, its cascade over the energy, and what its motion keeps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import dopri8
from jaxnh.systems.level import off_level
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT

CONFIGS = ROOT / "configs/nonholonomic"
FEIGENBAUM = 4.669201609102990
"""Feigenbaum's constant δ (Briggs, Math. Comp. 57 (1991) 435)."""

RADII, HEIGHT, WEIGHT = np.array([9.0, 4.0]), 1.0, 100.0
ANGLE, ANGLE_OF_LORENZ = 0.75, 0.485


def inertia(angle):
    """The tensor of inertia about the centre of mass, its axes turned by an angle against those of the surface."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return turn @ np.diag([2.0, 6.0, 7.0]) @ turn.T


def contact(vertical):
    """The point r of contact, at which the surface r3 = −h + (r1²/a1 + r2²/a2)/2 is level, from components (3, ...)."""
    across = -RADII.reshape(2, *[1] * (np.ndim(vertical) - 1)) * vertical[:2] / vertical[2]
    lift = 0.5 * (across[0] ** 2 / RADII[0] + across[1] ** 2 / RADII[1])
    return np.stack([across[0], across[1], lift - HEIGHT])


def about_contact(r, angle):
    """The tensor of inertia about the point of contact."""
    return inertia(angle) + r @ r * np.eye(3) - np.outer(r, r)


def rates(t, y, angle):
    """Of the vertical γ and of the moment M about the contact: γ̇ = γ × ω, Ṁ = M × ω + ṙ × (ω × r) + g r × γ.

    Borisov and Mamaev (Phys. Usp. 46 (2003) 393), with the mass one.
    """
    vertical, moment = y[:3], y[3:]
    r = contact(vertical)
    w = np.linalg.solve(about_contact(r, angle), moment)
    vertical_rate = np.cross(vertical, w)
    across = -RADII * (vertical_rate[:2] * vertical[2] - vertical[:2] * vertical_rate[2]) / vertical[2] ** 2
    r_rate = np.array([*across, np.sum(r[:2] * across / RADII)])
    turned = np.cross(moment, w) + np.cross(r_rate, np.cross(w, r)) + WEIGHT * np.cross(r, vertical)
    return np.concatenate([vertical_rate, turned])


def returns(y, count, angle):
    """The next states (count, 6), γ and M, at which γ1 passes zero upwards, and their times, by DOP853."""

    def crossing(t, y, angle):
        return y[0]

    crossing.direction = 1.0
    span = (0.0, 5.0 * count)
    motion = solve_ivp(rates, span, y, "DOP853", rtol=1e-12, atol=1e-12, events=crossing, args=(angle,))
    later = motion.t_events[0] > 1e-6
    return motion.y_events[0][later][:count], motion.t_events[0][later][:count]


def groups_of(name, *changes):
    made = jaxnh.load(CONFIGS / f"{name}.yaml", list(changes))
    return session_of(made).groups(dict.fromkeys(made.analyses.options()))


@pytest.mark.parametrize(
    ("name", "angle", "energy"), [("celtic_stone", ANGLE, 690.0), ("discrete_lorenz", ANGLE_OF_LORENZ, 752.0)]
)
def test_returns_beside_equations_written_anew(name, angle, energy):
    """Four returns before the motion has settled, each 1e-9 off by steps and less by rounding."""
    groups = groups_of(
        name,
        f"sweep.energy={{values: [{energy}]}}",
        "accuracy={solver: verner9, steps: 400}",
        "analyses={diagram: {transient: 1, strobes: 5}}",
    )
    data = groups["diagram"].squeeze()
    points = np.stack([data[name].to_numpy() for name in ("g1", "g2", "g3")], axis=1)
    w = np.array([float(data[name][0]) for name in ("w1", "w2", "w3")])
    start = np.concatenate([points[0], about_contact(contact(points[0]), angle) @ w])
    assert np.abs(returns(start, 4, angle)[0][:, :3] - points[1:]).max() < 1e-8


@pytest.mark.slow
def test_periods_double_for_ever():
    """As the abstract says (Borisov et al. 2012): a cascade of Feigenbaum's class, from period 4; δ is within its bar."""
    sweep = "sweep.energy={start: 700.0, stop: 714.0, count: 15}"
    data = groups_of("celtic_stone", sweep, "analyses={doubling: {levels: 6}}")["doubling"]
    assert data["period"].to_numpy().tolist() == [4, 8, 16, 32, 64, 128]
    assert np.all(np.diff(data["energy"].to_numpy()) > 0.0)
    delta, error = float(data["delta_limit"]), float(data["delta_limit_error"])
    assert error < 0.2
    assert abs(delta - FEIGENBAUM) <= error


@pytest.mark.slow
def test_exponents_and_energy():
    """Exponents sum to the mean divergence; beyond the cascade one is positive. The energy stays for 1,000 units.

    Off the level steps of order eight and 1/512 lose less than 1e-10 of the energy.
    """
    options = "analyses={lyapunov: {transient: 256, periods: 1024, exponents: %d}}"
    data = groups_of("celtic_stone", "sweep.energy={values: [690.0, 725.0]}", options % 4)["lyapunov"]
    values, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    assert np.abs(data["sum_rule_residual"].to_numpy()).max() < 1e-8
    assert values[0, 1] < 0.0 < values[1, 0] - error[1, 0]
    made = jaxnh.load(CONFIGS / "celtic_stone.yaml", ["sweep.energy={values: [690.0, 725.0]}"])
    start = made.start({}, 2, own={"energy": np.array([690.0, 725.0])}).state  # on the section
    strobe = make_return_map(off_level(jaxnh.load(CONFIGS / "celtic_stone.yaml").flow()), dopri8, 512)
    end = lanes_with_kept_programs()(iterate, (strobe, np.int32(1000)), (start, {}))
    for state in (start, end):
        vertical, w = np.stack(state.q), np.stack(state.v)[:3]
        r = contact(vertical)
        moving = np.sum(np.cross(w, r, axis=0) ** 2, axis=0) + np.einsum("is,ij,js->s", w, inertia(ANGLE), w)
        energy = 0.5 * moving - WEIGHT * np.sum(r * vertical, axis=0)
        assert np.abs(energy / [690.0, 725.0] - 1.0).max() < 1e-10
    assert np.abs(np.subtract(end.q, start.q)).max() > 0.1
