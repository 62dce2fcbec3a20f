"""A rattleback of a paraboloid: its equations written anew, its cascade over the energy, its discrete Lorenz attractor."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.solvers import dopri8
from jaxnh.systems.level import off_level
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "always_few_lanes")
CONFIGS = ROOT / "configs/nonholonomic"
FEIGENBAUM = 4.669201609102990
"""Feigenbaum's constant δ (Briggs, Math. Comp. 57 (1991) 435)."""

RADII, HEIGHT, WEIGHT = np.array([9.0, 4.0]), 1.0, 100.0
ANGLE, ANGLE_OF_LORENZ = 0.75, 0.485


@functools.cache
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


def cross(a, b):
    """The vector product of two vectors: numpy's takes more than half of all time of the references."""
    return a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]


def rates(t, y, angle):
    """Of the vertical γ and of the moment M about the contact: γ̇ = γ × ω, Ṁ = M × ω + ṙ × (ω × r) + g r × γ.

    Borisov and Mamaev (Phys. Usp. 46 (2003) 393), with the mass one.
    """
    vertical, moment = y[:3], y[3:]
    r = contact(vertical)
    w = np.linalg.solve(about_contact(r, angle), moment)
    vertical_rate = cross(vertical, w)
    across = -RADII * (vertical_rate[:2] * vertical[2] - vertical[:2] * vertical_rate[2]) / vertical[2] ** 2
    r_rate = np.array([*across, np.sum(r[:2] * across / RADII)])
    turned = cross(moment, w) + cross(r_rate, cross(w, r)) + WEIGHT * cross(r, vertical)
    return np.concatenate([vertical_rate, turned])


def returns(y, count, angle):
    """The next states (count, 6), γ and M, at which γ1 passes zero upwards, and their times, by DOP853."""

    def crossing(t, y, angle):
        return y[0]

    crossing.direction, crossing.terminal = 1.0, count + 1  # the start is one
    span = (0.0, 5.0 * count)
    motion = solve_ivp(rates, span, y, "DOP853", rtol=1e-12, atol=1e-12, events=crossing, args=(angle,))
    later = motion.t_events[0] > 1e-6
    return motion.y_events[0][later][:count], motion.t_events[0][later][:count]


def on_section(x, energy, angle):
    """The state, γ and M, on γ1 = 0 and on a level of the energy: of the angle of γ and two of M's direction."""
    vertical = np.array([0.0, np.sin(x[0]), np.cos(x[0])])
    moment = np.array([np.cos(x[2]) * np.cos(x[1]), np.cos(x[2]) * np.sin(x[1]), np.sin(x[2])])
    r = contact(vertical)
    twice = moment @ np.linalg.solve(about_contact(r, angle), moment)
    return np.concatenate([vertical, moment * np.sqrt(2.0 * (energy + WEIGHT * r @ vertical) / twice)])


def in_section(y):
    """The angles of such a state."""
    return np.array([np.arctan2(y[1], y[2]), np.arctan2(y[4], y[3]), np.arcsin(y[5] / np.linalg.norm(y[3:]))])


def fixed_point(x, energy, angle):
    """A point of period one by Newton, and the derivative of the return map there.

    On the way to it the derivative is that of the start, by differences to order two. In the end differences of 1e-4 to
    order four: their error of some 1e-10 is below what returns by 1e-12 leave, divided by 1e-4.
    """

    def image(x):
        return in_section(returns(on_section(x, energy, angle), 1, angle)[0][0])

    step = 1e-4 * np.eye(3)
    near = np.stack([(image(x + h) - image(x - h)) / 2e-4 for h in step], axis=1)
    for _ in range(8):
        missed = image(x) - x
        if np.abs(missed).max() < 1e-10:
            columns = [(8 * (image(x + h) - image(x - h)) - image(x + 2 * h) + image(x - 2 * h)) / 12e-4 for h in step]
            return x, np.stack(columns, axis=1)
        x = x - np.linalg.solve(near - np.eye(3), missed)
    raise AssertionError("Newton has not converged")


STEPS = "accuracy={solver: verner9, steps: 160}"  # a return is 1e-9 off by them, and less
FEWER_STEPS = "accuracy={solver: verner9, steps: 100}"  # 1e-7, and less


def groups_of(name, *changes):
    made = jaxnh.load(CONFIGS / f"{name}.yaml", list(changes))
    return session_of(made).groups(dict.fromkeys(made.analyses.options()))


@pytest.mark.slow  # equations of rolling bodies are quick
@pytest.mark.parametrize(
    ("name", "angle", "energy"),
    [("celtic_stone", ANGLE, 690.0), ("discrete_lorenz", ANGLE_OF_LORENZ, 752.0)],
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
    """As the abstract says (Borisov et al. 2012): a cascade of Feigenbaum's class, from period 4; δ is within its bar.

    Steps leave 1e-7 of a return: the last doublings are 1e-3 of the first gap apart.
    """
    sweep = "sweep.energy={start: 700.0, stop: 714.0, count: 15}"
    data = groups_of("celtic_stone", sweep, FEWER_STEPS, "analyses={doubling: {levels: 5}}")["doubling"]
    assert data["period"].to_numpy().tolist() == [4, 8, 16, 32, 64]
    assert np.all(np.diff(data["energy"].to_numpy()) > 0.0)
    delta, error = float(data["delta_limit"]), float(data["delta_limit_error"])
    assert error < 0.2
    assert abs(delta - FEIGENBAUM) <= error


IN_SECTION = np.array([-0.6258, 5.7039 - 2.0 * np.pi, -0.5763])
"""Near the fixed point at the energy 752."""


@pytest.mark.slow
def test_the_saddle_of_a_discrete_lorenz_attractor():
    """Multipliers of the fixed point are those by DOP853: μ₁ < −1 < μ₃ < 0 < μ₂ < 1, |μ₁ μ₂| > 1.

    So A. Gonchenko and S. Gonchenko (2013) and Gonchenko, Gonchenko and Kazakov (Regul. Chaotic Dyn. 18 (2013) 521).
    """
    _, derivative = fixed_point(IN_SECTION, 752.0, ANGLE_OF_LORENZ)
    exact = np.linalg.eigvals(derivative)
    exact = exact[np.argsort(-np.abs(exact))]
    assert exact[0].real < -1.0 < exact[2].real < 0.0 < exact[1].real < 1.0
    options = "analyses={orbits: {max_period: 1, attractor: 2048, rounds: 4}}"
    orbits = groups_of("discrete_lorenz", "sweep.energy={values: [752.0]}", STEPS, options)["orbits"].isel(energy=0)
    multipliers = orbits["multipliers"].to_numpy()[:, :3, 0]
    saddle = int(np.argmin(np.abs(multipliers[:, 0] - exact[0].real)))
    assert np.abs(multipliers[saddle] - exact.real).max() < 1e-7


@pytest.mark.slow
def test_the_fixed_point_doubles_and_what_is_left_ends_at_a_torus():
    """By DOP853 a multiplier passes −1 within 1e-6 of the energy of the doubling; its determinant changes there by 1e-7."""
    box = "{g2: [-0.62, -0.58], w1: [5.5, 6.2], w3: [-4.3, -3.8]}"
    marks = groups_of(
        "discrete_lorenz",
        "sweep.energy={start: 746.0, stop: 752.0, count: 7}",
        STEPS,
        f"analyses={{branches: {{max_period: 2, n_starts: 8, n_values: 1, box: {box}}}}}",
    )["bifurcations"]
    assert [KINDS[kind] for kind in marks["kind"].to_numpy()] == ["period_doubling", "neimark_sacker"]
    assert marks["period"].to_numpy().tolist() == [1, 2]

    doubling, torus = marks["energy"].to_numpy()
    vertical, w = (np.array([float(marks[f"{v}{i}"][0]) for i in (1, 2, 3)]) for v in "gw")
    near = in_section(np.concatenate([vertical, about_contact(contact(vertical), ANGLE_OF_LORENZ) @ w]))
    beside = (fixed_point(near, energy, ANGLE_OF_LORENZ)[1] for energy in (doubling - 1e-6, doubling + 1e-6))
    before, after = (np.linalg.det(derivative + np.eye(3)) for derivative in beside)
    assert before * after < 0.0
    assert doubling + 1.0 < torus < 752.0


@pytest.mark.slow
def test_exponents_and_energy():
    """Exponents sum to the mean divergence; beyond the cascade one is positive. The energy stays for 1,000 units.

    Before it at 680: at 690 rounding decides whether the motion is on its cycle after 128 returns or chaotic for longer.
    Off the level steps of order eight and 1/512 lose less than 1e-10 of the energy.
    """
    options = "analyses={lyapunov: {transient: 128, periods: 256, exponents: %d}}"
    data = groups_of("celtic_stone", "sweep.energy={values: [680.0, 725.0]}", STEPS, options % 4)["lyapunov"]
    values, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    assert np.abs(data["sum_rule_residual"].to_numpy()).max() < 1e-8
    assert values[0, 1] < 0.0 < values[1, 0] - error[1, 0]
    made = jaxnh.load(CONFIGS / "celtic_stone.yaml", ["sweep.energy={values: [690.0, 725.0]}"])
    start = made.start({}, 2, own={"energy": np.array([690.0, 725.0])}).state  # on the section
    strobe = make_return_map(off_level(jaxnh.load(CONFIGS / "celtic_stone.yaml").flow()), dopri8, 512)
    end = lanes_with_kept_programs(tile=8)(iterate, (strobe, np.int32(1000)), (start, {}))
    for state in (start, end):
        vertical, w = np.stack(state.q), np.stack(state.v)[:3]
        r = contact(vertical)
        moving = np.sum(np.cross(w, r, axis=0) ** 2, axis=0) + np.einsum("is,ij,js->s", w, inertia(ANGLE), w)
        energy = 0.5 * moving - WEIGHT * np.sum(r * vertical, axis=0)
        assert np.abs(energy / [690.0, 725.0] - 1.0).max() < 1e-10
    assert np.abs(np.subtract(end.q, start.q)).max() > 0.1


@pytest.mark.slow
def test_two_kinds_of_chaos():
    """Of the return map of three dimensions: one positive exponent and two negative, or like moduli and one near zero.

    As the abstract says (Borisov et al. 2012). On a level of the energy there is the flow's zero besides.
    """
    sweep = "sweep={energy: {values: [386.0, 741.0]}, delta: {values: [0.3, 0.5]}}"
    options = "analyses={lyapunov: {transient: 512, periods: 1024, exponents: 4, method: averages}}"
    data = groups_of("celtic_chart", sweep, "accuracy.target=1.0e-7", options)["lyapunov"]
    values, error, total, total_error = (
        data[name].to_numpy()[[0, 1], [0, 1]]
        for name in ("exponents", "exponents_error", "exponent_sum", "exponent_sum_error")
    )
    conservative, strange = values
    # Signs and zeros are those beyond and within two of the bars that 1,024 returns leave, some tenth of the largest exponent.
    assert np.all(values[:, 0] > 2.0 * error[:, 0])
    assert np.all(np.abs(conservative[1:3]) <= 2.0 * error[0, 1:3])
    assert abs(conservative[0] + conservative[3]) <= 2.0 * (error[0, 0] + error[0, 3])
    assert abs(total[0]) <= 2.0 * total_error[0]
    assert abs(strange[1]) <= 2.0 * error[1, 1]
    assert np.all(strange[2:] < -2.0 * error[1, 2:])
    assert total[1] < -2.0 * total_error[1]
