"""Attractors and their images: against closed forms, scipy's DOP853, and sets whose overlap is known."""

from __future__ import annotations

import functools
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.stats import binom

import jaxnh
from jaxnh.analyses.intervals import binomial_interval
from jaxnh.analyses.reversal import reversal as rules
from jaxnh.analyses.reversal.sets import compare_sets, overlap_interval
from jaxnh.analyses.reversal.symmetric_orbits import Symmetry, symmetric_orbits
from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import InputError
from jaxnh.solvers import tsit5
from jaxnh.systems.discrete_map import discrete_map
from jaxnh.systems.first_order import first_order
from jaxnh.systems.reversal import Reversal
from tests.flows.constrained_oscillators import NEEDLE
from tests.flows.paper_equations import at_speed
from tests.helpers.batches import batch_of
from tests.helpers.kept_calibrations import calibrating_by, unless_given
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT
from tests.helpers.taylor import REAL, integrator
from tests.helpers.taylor import Parameters as TaylorParameters

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")

TURN = 2 * np.pi


def kinds(data):
    """Words of the verdicts."""
    return [data["kind"].attrs["flag_meanings"].split()[k] for k in data["kind"].to_numpy().ravel()]


def pair_of_points(strength=0.3):
    """ẋ = (1 − x²)(1 + strength cos t), ẏ = −x (1 + strength cos t) y.

    It has the attractor (1, 0) and the repeller (−1, 0); R changes the sign of x and of t. With ds = (1 + strength cos t)
    dt the exponents at (1, 0) are −2 and −1.
    """

    def rhs(y, t):
        x, z = y
        g = 1.0 + strength * jnp.cos(t)
        return (1.0 - x * x) * g, -x * z * g

    return {"rhs": rhs, "coordinates": ("x", "y"), "period": TURN}


def drag_that_averages_to_zero(drag=0.3, rate=0.7):
    """ẍ + rate² x = −drag sin t ẋ, which (x, ẋ, t) → (x, −ẋ, −t) takes to itself; the exponents are zero."""

    def rhs(y, t):
        x, v = y
        return v, -rate * rate * x - drag * jnp.sin(t) * v

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": TURN}


def steps_up_and_down(strength=0.3):
    """The same with g = 1 ± strength, up in the quarters of a period about its ends, and a corner at x = 0 that R keeps."""

    def rhs(y, t):
        x, z = y
        g = 1.0 + strength * jnp.sign(jnp.cos(t)) + 0.1 * jnp.abs(x)
        return (1.0 - x * x) * g, -x * z * g

    return {"rhs": rhs, "coordinates": ("x", "y"), "period": TURN}


@pytest.mark.parametrize(("define", "rate"), [(pair_of_points, 1.0), (steps_up_and_down, 1.1)])
def test_an_attractor_and_a_repeller_that_are_points(define, rate):
    """Distance two, in sizes of x, exponents −1 and −2 in units of the mean of g there, and those of the repeller 1 and 2."""
    session = jaxnh.Session(define, start={"x": 0.3, "y": 0.2}, target=1e-8)
    data = session.run(jaxnh.Reversal(transient=64, strobes=64, periods=64), strength=[0.0, 0.5])
    check_pair(data, rate)


def check_pair(data, rate):
    assert kinds(data) == ["dissipative"] * 2
    assert data.attrs["reversal"] == "x -> -x, t -> -t"
    np.testing.assert_array_less(np.abs(data["distance"] - 2.0), data["distance_error"])
    np.testing.assert_array_less(np.abs(data["exponents"] - [-rate, -2.0 * rate]), data["exponents_error"] + 1e-7)
    np.testing.assert_array_less(
        np.abs(data["repeller_exponents"] - [rate, 2.0 * rate]), data["repeller_exponents_error"]
    )
    np.testing.assert_array_less(np.abs(data["exponent_sum"] + 3.0 * rate), data["exponent_sum_error"])
    assert not data["overlap"].to_numpy().any()


@pytest.mark.slow  # the needle and the pendulum have conservative motions in quick tests
def test_drag_that_a_reversal_keeps():
    """The strobe points of a linear flow are on an ellipse, which is its own image; with friction beside there is none."""
    session = jaxnh.Session(drag_that_averages_to_zero, start={"x": 0.4, "v": 0.2}, target=1e-8)
    data = session.run(jaxnh.Reversal(transient=16, strobes=1024, periods=256), drag=[0.1, 0.3])
    assert kinds(data) == ["conservative"] * 2
    monodromy = [one_turn(drag) for drag in (0.1, 0.3)]
    assert np.all(np.abs(np.abs(np.linalg.eigvals(monodromy)) - 1.0) < 1e-10)
    assert np.all(np.abs(data["exponent_sum"]) <= data["exponent_sum_error"])
    assert np.all(np.abs(data["exponents"]) <= data["exponents_error"])


def one_turn(drag, rate=0.7):
    """The matrix of a period, by DOP853."""

    def rates(t, y):
        x, v = y.reshape(2, 2)
        return np.concatenate([v, -rate * rate * x - drag * np.sin(t) * v])

    return solve_ivp(rates, (0.0, TURN), np.eye(2).ravel(), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(2, 2)


def strobes_at_the_fixed_instant(b, d, count, transient):
    """Points (x1, y1, θ) of the paper's particle at t = π/2 + 2πn, by DOP853; of its image θ is the opposite direction."""
    start = [0.1, 0.1, np.arctan2(np.sqrt(1.0 - 0.01), 0.1)]
    times = TURN * np.arange(transient, transient + count) + np.pi / 2
    path = solve_ivp(at_speed, (0.0, times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-11, args=(b, 0.5, 1.0, d))
    return path.y.T


def distance_of_images(points):
    """Largest distance of a point from the nearest image, each coordinate relative to its largest modulus or π."""
    images = points + np.array([0.0, 0.0, np.pi])
    gap = points[:, None] - images[None]
    gap[..., 2] = (gap[..., 2] + np.pi) % TURN - np.pi
    sizes = np.append(np.abs(points[:, :2]).max(axis=0), np.pi)
    return np.max(np.min(np.max(np.abs(gap) / sizes, axis=-1), axis=1))


@pytest.mark.slow  # the matrix has the particle, and points in closed form are quick
def test_periodic_attractors_of_the_particle():
    """At b = 3 and 4 the attractor is an orbit: its distance to its image is that of DOP853 within the bar."""
    content = {"system": {"constraint": "disturbed_speed"}, "sweep": {"b": {"values": [3.0, 4.0]}}}
    content |= {"accuracy": {"solver": "kahan_li8", "steps": 240}, "analyses": {"poincare": {}}}
    # Of 141 steps the error of a period is 2e-9 (against a Taylor integrator at 1e-18), and it falls at the order 8.
    with calibrating_by(functools.partial(unless_given, error=1e-10)):
        data = session_of(Experiment.from_dict(content)).run(jaxnh.Reversal(transient=64, strobes=64, periods=64))
    assert kinds(data) == ["dissipative"] * 2
    for lane, b in enumerate((3.0, 4.0)):
        exact = distance_of_images(strobes_at_the_fixed_instant(b, 0.1, 4, 60))
        assert abs(data["distance"][lane] - exact) < data["distance_error"][lane] + 1e-8
    gap = np.abs(data["exponents"] + data["repeller_exponents"])
    assert np.all(gap <= data["exponents_error"] + data["repeller_exponents_error"])


@pytest.mark.slow
def test_the_chaotic_attractor_of_the_particle():
    """At b = 5.3 the distance is that of another record, by DOP853, within both errors; exponents have opposite signs."""
    session = jaxnh.Session(jaxnh.disturbed_speed(d=0.1), target=1e-6)
    data = session.run(jaxnh.Reversal(transient=256, strobes=1024, periods=1024), b=[5.3])
    other = distance_of_images(strobes_at_the_fixed_instant(5.3, 0.1, 1024, 64))
    assert abs(data["distance"][0] - other) < 2 * data["distance_error"][0]
    gap = np.abs(data["exponents"] + data["repeller_exponents"])
    assert np.all(gap <= data["exponents_error"] + data["repeller_exponents_error"])
    assert kinds(data)[0] in ("dissipative", "undecided")


def pendulum(drive=0.7):
    """q̈ = −(1 + drive cos t) sin q, without damping: divergence zero."""

    def T(q, v, t):
        return 0.5 * v[0] ** 2

    def Q(q, v, t):
        return (-jnp.sin(q[0]) * (1.0 + drive * jnp.cos(t)),)

    return {"T": T, "Q": Q, "coordinates": ("q",), "angles": ("q",), "period": TURN}


@pytest.mark.slow  # its symmetric orbits and another conservative flow are quick
def test_the_driven_pendulum_is_conservative():
    session = jaxnh.Session(pendulum, start={"q": 0.3, "q_dot": 0.4}, target=1e-7)
    data = session.run(jaxnh.Reversal(transient=16, strobes=1024, periods=128), drive=[0.3])
    assert kinds(data) == ["conservative"]
    assert abs(float(data["exponent_sum"][0])) <= float(data["exponent_sum_error"][0])


def henon_heiles(friction=0.0):
    """The potential of Hénon and Heiles, with friction along x."""

    def rhs(y, t):
        x, z, u, v = y
        return u, v, -x - 2 * x * z - friction * u, -z - x * x + z * z

    return {"rhs": rhs, "coordinates": ("x", "y", "u", "v")}


@pytest.mark.slow  # the matrix has sections, with friction and without
def test_on_a_section_of_henon_and_heiles():
    """The reversal is the one of two that keeps the section; a lane with friction has none, and the others go on."""
    session = jaxnh.Session(henon_heiles, start={"x": 0.0, "y": 0.1, "u": 0.45, "v": 0.05}, target=1e-7)
    data = session.on(coordinate="x", value=0.0, direction="up").run(
        jaxnh.Reversal(transient=16, strobes=256, periods=128), friction=[0.0, 0.1]
    )
    assert kinds(data) == ["conservative", "irreversible"]
    assert data.attrs["reversal"] == "x -> -x, v -> -v, t -> -t"
    assert abs(float(data["exponent_sum"][1]) + 0.1) <= float(data["exponent_sum_error"][1])


@pytest.mark.slow  # the matrix has reversals of quasi-velocities
def test_quasi_velocities_have_signs_of_their_own():
    """A needle in a field that shakes, its angle by cosine and sine: w -> -w, t -> -t, but for friction."""
    config = (
        "system: {file: own.py}\ninitial: {c: 0.8, s: 0.6, w: 0.1}\nsweep: {damping: {values: [0.0, 0.2]}}\n"
        "accuracy: {solver: dopri8, steps: 40}\nanalyses: {reversal: {transient: 16, strobes: 1024, periods: 128}}"
    )
    with calibrating_by(unless_given):
        data = session_of(Experiment.from_text(config, NEEDLE)).groups({"reversal": None})["reversal"]
    assert data.attrs["reversal"] == "w -> -w, t -> -t"
    assert kinds(data) == ["conservative", "irreversible"]
    assert abs(float(data["exponent_sum"][1]) + 0.4) <= float(data["exponent_sum_error"][1])


@pytest.mark.slow
def test_suslov_s_top_between_conservative_and_dissipative():
    """As its abstract says, by the energy (Bizyaev, Borisov and Kazakov 2015): a torus is its own image, a cycle is not.

    On a level of the energy there are three exponents. The reversal turns the angular velocity around.
    """
    made = jaxnh.load(ROOT / "configs/nonholonomic/suslov.yaml", SUSLOV)
    data = session_of(made).groups({"reversal": None})["reversal"]
    assert data.attrs["reversal"] == "w1 -> -w1, w2 -> -w2, t -> -t"
    assert kinds(data) == ["conservative", "dissipative"]
    assert data["exponents"].shape == (2, 3)
    gap = np.abs(data["exponents"] + data["repeller_exponents"])
    assert np.all(gap <= data["exponents_error"] + data["repeller_exponents_error"])


SUSLOV = [
    "sweep.energy={values: [-0.7, 0.2]}",
    "section.direction=both",
    "accuracy.target=1.0e-8",
    "analyses={reversal: {transient: 1024, strobes: 1024, periods: 2048}}",
]


# ---- symmetric periodic orbits


def standard(k=0.8):
    """The standard map on the torus. (θ, p) → (−θ, p + k sin θ) takes it to its inverse, and keeps θ = 0 and π."""

    def image(y):
        momentum = y[1] + k * jnp.sin(y[0])
        return y[0] + momentum, momentum

    def reversal(y):
        return -y[0], y[1] + k * jnp.sin(y[0])

    names = ("angle", "momentum")
    return {"map": image, "coordinates": names, "angles": names, "reversal": reversal}


def test_symmetric_orbits_of_the_standard_map():
    """Fixed points (0, 0) and (π, 0) of traces 2 ± k; of two returns one through (0, π), of trace 2 − k², and another.

    With θ'' − 2 θ' + θ = k sin θ' that has θ' = −θ, 4 θ + k sin θ = 2π and the trace (2 + k cos θ)² − 2. Orbits of three
    returns have twins of opposite momentum. Newton's residual of 1e-8 and less is of rounding, but for its last step.
    """
    values = np.array([0.5, 0.8])
    flow = discrete_map(standard, {"k": 0.8})
    batch = batch_of(flow, flow.start({"angle": 0.3, "momentum": 0.2}), values, tsit5, 1, name="k")
    runner, size = lanes_with_kept_programs(), np.full((2, 2), np.pi)
    symmetry = Symmetry(Reversal(None, 0.0), None)
    ours = symmetric_orbits(batch, runner, symmetry, (batch.map(), batch.map(2)), size, 3)
    for k, orbits in zip(values, ours, strict=True):
        of_each = [[orbit.multipliers.sum().real for orbit in orbits if len(orbit.points) == n] for n in (1, 2, 3)]
        fixed, two, three = map(sorted, of_each)
        angle = brentq(lambda x, k=k: k * np.sin(x) + 4 * x - TURN, 1.0, 2.0, xtol=1e-14)
        assert fixed == pytest.approx([2 - k, 2 + k], abs=1e-9)
        assert two == pytest.approx([2 - k**2, (2 + k * np.cos(angle)) ** 2 - 2], abs=1e-9)
        assert three[::2] == pytest.approx(three[1::2], abs=1e-9)
        assert max(orbit.pairing for orbit in orbits) < 1e-9
        assert max(orbit.residual for orbit in orbits) < 1e-9


def rotation(b=2.0):
    """θ → θ + b, which θ → −θ takes to its inverse; it keeps two points, one unknown fewer than half of the dimension."""
    return {"map": lambda y: (y[0] + b,), "coordinates": ("angle",), "angles": ("angle",)}


def test_symmetric_orbits_at_isolated_values_of_a_parameter():
    """Orbits of two returns at b = π, of three at 2π/3, each in the lane of the nearest b; the multiplier is one."""
    flow = discrete_map(rotation, {"b": 2.0})
    batch = batch_of(flow, flow.start({"angle": 0.3}), np.array([1.0, 2.0, 3.0]), tsit5, 1, name="b")
    symmetry = Symmetry(Reversal((-1.0,), 0.0), "b")
    strobes = batch.map(), batch.map()
    ours = symmetric_orbits(batch, lanes_with_kept_programs(), symmetry, strobes, np.full((3, 1), np.pi), 3)
    assert [{len(orbit.points) for orbit in orbits} for orbits in ours] == [set(), {3}, {2}]
    for orbit in (orbit for orbits in ours for orbit in orbits):
        assert abs(orbit.value - TURN / len(orbit.points)) <= orbit.value_error  # of a map without steps it is rounding
        assert 0.0 < orbit.value_error < 1e-9
        assert orbit.multipliers == pytest.approx([1.0], abs=1e-9)


def hill(drive, at):
    """The trace of a period of the driven pendulum's linear equation at rest, by DOP853."""

    def rates(t, y):
        x, v = y.reshape(2, 2)
        return np.concatenate([v, -np.cos(at) * (1.0 + drive * np.cos(t)) * x])

    return np.trace(
        solve_ivp(rates, (0.0, TURN), np.eye(2).ravel(), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(2, 2)
    )


@pytest.mark.slow  # orbits are quick in `test_orbits`
def test_symmetric_orbits_of_the_driven_pendulum():
    """At rest below and above multipliers are those of Hill's equation; all come in pairs, within what steps leave."""
    session = jaxnh.Session(pendulum, start={"q": 0.3, "q_dot": 0.4}, target=1e-9)
    options = jaxnh.Reversal(transient=16, strobes=64, periods=16, max_period=1)
    data = session.run(options, drive=[0.3, 0.5])
    traces = data["orbit_multipliers"].isel(part=0).sum("multiplier").to_numpy()
    period, q, v = (data[name].to_numpy() for name in ("orbit_period", "q_points", "q_dot_points"))
    assert np.all((data["orbit_pairing"].to_numpy() < 1e-7) | (period == 0))
    for lane, drive in enumerate((0.3, 0.5)):
        for at in (0.0, np.pi):
            here = (period[lane] == 1) & (np.abs(np.sin(0.5 * (q[lane] - at))) < 1e-7) & (np.abs(v[lane]) < 1e-7)
            assert here.sum() == 1
            assert traces[lane, here] == pytest.approx(hill(drive, at), rel=1e-6)


def moved_from(par, b, state, instant, duration):
    """The state (3,) and its derivatives in (x, y, θ, b), (3, 4), so long after another one; by heyoka."""
    ta, at_zero = integrator(par.equations, 1, REAL, float(np.finfo(REAL).eps))
    ta.pars[:], ta.state[:], ta.time = [REAL(b), par.a, par.c, par.d, par.omega], at_zero, REAL(instant)
    ta.state[:3] = state
    ta.propagate_until(REAL(instant) + REAL(duration))
    return ta.state[:3].copy(), ta.state[3:].reshape(3, 4).copy()


def symmetric_by_heyoka(par, b, angle, instant, n):
    """The b, the angle and the multipliers of an orbit that leaves x = y = 0 and is there again after half of n periods."""
    for _ in range(8):
        state, first = moved_from(par, b, [0.0, 0.0, angle], instant, n * np.pi)
        step = np.linalg.solve(first[:2, 2:].astype(float), -state[:2].astype(float))
        angle, b = angle + step[0], b + step[1]
    assert np.abs(step).max() < 1e-14
    return b, angle, np.linalg.eigvals(moved_from(par, b, [0.0, 0.0, angle], instant, n * TURN)[1][:, :3].astype(float))


@pytest.mark.slow
def test_symmetric_orbits_of_the_particle():
    """Of orbits of two, four and six returns at more than twenty values of b: each is that of heyoka within its bar.

    They are at isolated b, and pass x1 = y1 = 0 when the forcing is largest or least, or both. The reversal turns the
    velocity around and keeps no point; after the symmetry (x1, y1, n) -> (-x1, -y1, -n) it keeps a line, x1 = y1 = 0.
    Orbits whose first point is not there are half a period later, when the forcing is least. The one that is left of
    three multipliers is one: looked at of short orbits, as errors grow with the multipliers of long ones.
    """
    session, par = jaxnh.Session(jaxnh.disturbed_speed(d=0.1), target=1e-8), TaylorParameters(d=0.1)
    data = session.run(jaxnh.Reversal(transient=1, strobes=64, periods=16, max_period=6), b=np.linspace(0.1, 0.6, 6))
    assert data.attrs["orbit_reversal"].startswith("x1 -> -x1, y1 -> -y1, velocities opposite, t -> 3.14159")
    exact, covered, short = list[tuple[int, float]](), list[bool](), 0
    for lane, number in np.argwhere(data["orbit_period"].to_numpy() > 0):
        ours = data.isel(b=lane, orbit=number)
        n, value, error = int(ours["orbit_period"]), float(ours["orbit_b"]), float(ours["orbit_b_error"])
        x, y, u, v = (float(ours[f"{name}_points"]) for name in ("x1", "y1", "x2", "y2"))
        state, instant = (x, y, np.arctan2(v, u)), np.pi / 2
        at_once = max(abs(x), abs(y)) <= 1e-6
        if not at_once:
            state, instant = moved_from(par, value, state, instant, np.pi)[0], 3 * np.pi / 2
        b, angle, values = symmetric_by_heyoka(par, value + 1e-9, float(state[2]) + 1e-9, instant, n)
        exact.append((n, round(float(b), 9)))
        covered.append(abs(b - value) <= error)
        if at_once and n <= 2:
            short += 1
            assert error < 1e-6
            assert abs(angle - state[2]) < 1e-6
            mine = ours["orbit_multipliers"].to_numpy() @ [1.0, 1.0j]
            assert np.sort(np.abs(mine)) == pytest.approx(np.sort(np.abs(values)), rel=1e-4)
            assert np.abs(values - 1.0).min() < 1e-6
    assert {n for n, _ in exact} == {2, 4, 6}
    assert len(set(exact)) >= 20
    assert short > 0
    assert np.mean(covered) >= 0.95


COUPLED_ROTATORS = """
import jax.numpy as jnp

def system(coupling=0.3):
    def rhs(y, t):  # the middle one of three phase differences by its cosine c and its sine s
        psi1, psi3, c, s = y
        rate = 1 - 2 * coupling * s + coupling * (jnp.sin(psi1) + jnp.sin(psi3))
        return 1 - 2 * coupling * jnp.sin(psi1) + coupling * s, 1 - 2 * coupling * jnp.sin(psi3) + coupling * s, -s * rate, c * rate

    def reversal(y):
        return jnp.pi - y[1], jnp.pi - y[0], -y[2], y[3]

    names = ("psi1", "psi3", "c", "s")
    return {"rhs": rhs, "coordinates": names, "angles": names[:2], "reversal": reversal}
"""


def mean_divergence(coupling, duration, count=64):
    """The mean of the divergence −2ε Σ cos ψ of count motions from random starts, with its bar, by Runge and Kutta."""

    def rates(psi):
        s = np.sin(psi)
        return 1 - 2 * coupling * s + coupling * np.array([s[1], s[0] + s[2], s[1]])

    psi, h, sums = np.random.default_rng(3).uniform(-np.pi, np.pi, (3, count)), 0.05, np.zeros(count)
    steps, wait = round(duration / h), round(500 / h)
    for i in range(wait + steps):
        a = rates(psi)
        b = rates(psi + 0.5 * h * a)
        c = rates(psi + 0.5 * h * b)
        psi = psi + h / 6 * (a + 2 * b + 2 * c + rates(psi + h * c))
        sums += (i >= wait) * -2 * coupling * np.cos(psi).sum(axis=0)
    means = sums / steps
    return means.mean(), 2.0 * means.std(ddof=1) / np.sqrt(count)


@pytest.mark.slow
def test_mixed_dynamics_of_coupled_rotators():
    """Attractor and repeller meet and differ over a wide range of the coupling; at small ones the flow looks conservative.

    Gonchenko, Gonchenko, Kazakov and Turaev (Physica D 350 (2017) 45; arXiv 1604.02417), abstract and introduction, of
    four coupled rotators (Topaj and Pikovsky, Physica D 170 (2002) 118).
    """
    config = (
        "system: {file: own.py}\ninitial: {psi1: 0.5, psi3: 1.8, c: 1.0, s: 0.0}\n"
        "sweep: {coupling: {values: [0.1, 0.3, 0.5, 0.55, 0.7]}}\naccuracy: {target: 1.0e-8}\n"
        "section: {coordinate: c, value: 0.0, direction: down}\n"
        "analyses: {reversal: {transient: 2048, strobes: 2048, periods: 65536}}"
    )
    data = session_of(Experiment.from_text(config, COUPLED_ROTATORS)).groups({"reversal": None})["reversal"]
    assert kinds(data) == ["conservative", "conservative", "mixed", "mixed", "dissipative"]
    known, bar = mean_divergence(0.55, 4000.0)
    ours, error = float(data["exponent_sum"][3]), float(data["exponent_sum_error"][3])
    assert known + bar < 0.0
    assert abs(ours - known) <= error + bar
    assert float(data["overlap"][2:4].min()) > 0.9
    gap = np.abs(data["exponents"] + data["repeller_exponents"])
    assert np.all(gap <= data["exponents_error"] + data["repeller_exponents_error"])


# ---- refusals


def test_what_is_no_reversal_is_refused_with_the_place():
    """The image of the rate of v is g(x) + friction v, the rate at the image −g(x) + friction v: both stand in the line."""

    def system(friction=0.1):
        def rhs(y, t):
            x, v = y
            return v, -x - friction * v

        return {"rhs": rhs, "coordinates": ("x", "v"), "reversal": {"v": -1}}

    session = jaxnh.Session(system, start={"x": 0.3, "v": 0.1}, target=1e-6).on(coordinate="x", direction="both")
    assert session.plan.error_estimate <= 1e-6
    compiled = len(session._lanes.programs)
    with pytest.raises(InputError) as refused:
        session.run(jaxnh.Reversal(transient=16, strobes=64, periods=16), friction=[0.1, 0.2])
    assert len(session._lanes.programs) == compiled
    line = str(refused.value)
    assert "the system's reversal is none: at x = " in line
    numbers = [
        float(word.strip(",;")) for word in line.split() if word.strip(",;").lstrip("-").replace(".", "").isdigit()
    ]
    x, v, ours, theirs = numbers[-4:]
    assert abs(ours - (x + 0.1 * v)) < 1e-3  # of numbers of four digits
    assert abs(theirs - (-x + 0.1 * v)) < 1e-3


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"w": -1}, "reversal has 'w'; known are x, v and time"),
        ({"v": -2}, "reversal of v must be 1 or -1, not -2"),
        ({"v": -1, "time": "noon"}, "the time of a reversal must be a number t0"),
        (3.0, "reversal must be signs of coordinates"),
    ],
)
def test_what_a_system_says_of_its_reversal_is_read(said, words):
    """Before anything is calibrated."""

    def system(rate=1.0):
        def rhs(y, t):
            x, v = y
            return v, -rate * x

        return {"rhs": rhs, "coordinates": ("x", "v"), "reversal": said}

    session = jaxnh.Session(system, start={"x": 0.3, "v": 0.1}, target=1e-6).on(coordinate="x", direction="both")
    calibrated = mock.patch("jaxnh.engine.plan.calibrate", side_effect=AssertionError)
    with calibrated, pytest.raises(InputError, match=words):
        session.run(jaxnh.Reversal(transient=16, strobes=64, periods=16), rate=[1.0, 1.2])


# ---- sets of which all is known


def compare(points, images):
    """How sets of lanes in the plane lie, and how many points of a lane there are."""
    flow = first_order(drag_that_averages_to_zero, {"drag": 0.3, "rate": 0.7})
    batch = batch_of(flow, flow.start({"x": 0.1, "v": 0.1}), np.full(len(points), 0.3), tsit5, 8, name="drag")
    lanes = lanes_with_kept_programs(tile=len(points) // 2)  # of two devices: no lane is padding
    return compare_sets(batch, lanes, points, images, np.full(len(points), 1e-9))


@pytest.mark.slow  # two points are quick
def test_sets_whose_overlap_is_known():
    """Of squares that are shifted by half of them half the points overlap; of equal ones all, of distant ones none."""
    draws = np.random.default_rng(0)
    points, images = draws.uniform(0.0, 1.0, (2, 64, 512, 2))
    words = np.array(rules.SETS)
    same = compare(points, images)
    assert np.mean(words[rules.judge_sets(same)] == "same") >= 0.95
    assert np.mean(same.distance <= same.error) >= 0.5  # two draws of one number: which is larger is chance
    shifted = compare(points, images + np.array([0.5, 0.0]))
    # At an edge the share falls with the spacing, so that nothing is said, or rightly that they overlap.
    assert set(words[rules.judge_sets(shifted)]) <= {"overlapping", "unresolved"}
    low, high = binomial_interval(shifted.within, 512)
    sizes = 1.5
    reach = shifted.spacing * sizes  # points that far beyond the edge of the image are near it as well
    assert np.mean((low <= 0.5 + reach) & (high >= 0.95 * 0.5)) >= 0.95
    assert np.mean(np.abs(shifted.distance - 0.5 / sizes) <= shifted.error) >= 0.95
    distant = compare(points, images + np.array([1.5, 0.0]))
    assert set(words[rules.judge_sets(distant)]) == {"apart"}
    assert np.mean(np.abs(distant.distance - 1.5 / 2.5) <= distant.error) >= 0.95


def test_sets_that_share_a_part():
    """Half of the points of either are in one square, the others in squares of their own: the share is a half."""
    draws = np.random.default_rng(1)
    points, images = draws.uniform(0.0, 1.0, (2, 4, 1024, 2))
    points[:, ::2, 0] += 3.0
    images[:, ::2, 1] += 3.0
    compared = compare(points, images)
    assert np.mean(np.array(rules.SETS)[rules.judge_sets(compared)] == "overlapping") == 1.0
    assert np.all(np.abs(compared.within / 1024 - 0.5) < 0.05)


def reflected_walks(draws, lanes, count, stride):
    """Points of reflected walks in x from −1/2 to 1, uniform in y; a third of them is beyond x → −x of all."""
    x, path = draws.uniform(-0.5, 1.0, lanes), []
    for step in draws.normal(size=(count, lanes)) * stride:
        x = x + step
        x = np.abs((x + 0.5) % 3.0 - 1.5)
        x = 1.0 - x
        path.append(x)
    return np.stack([np.stack(path, axis=1), draws.uniform(-1.0, 1.0, (lanes, count))], axis=2)


@pytest.mark.parametrize("stride", [0.3, 30.0])
def test_intervals_of_overlaps_cover_the_share_of_other_records(stride):
    """Of 64 records of 256 points that are independent or stay where they are for some time: the mean of all shares.

    The interval of as many independent points covers 0.53 of walks whose steps are a fifth of the width, and 0.89 of independent points.
    """
    points = reflected_walks(np.random.default_rng(2), 64, 256, stride)
    compared = compare(points, points * np.array([-1.0, 1.0]))
    low, high = overlap_interval(compared)
    mean = np.mean(compared.within / 256)
    assert np.mean((low <= mean) & (mean <= high)) >= 0.95
    assert np.all(compared.independent <= 128)
    low, high = (0, 64) if stride < 1.0 else (90, 128)
    assert low < np.median(compared.independent) <= high


def test_the_rule():
    """Every cell of the table of signs and sets."""
    sums, sets = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
    kind = rules.judge(sums.ravel().astype(np.int8), sets.ravel().astype(np.int8)).reshape(4, 4)
    words = np.array(rules.KINDS)[kind]
    assert words[0].tolist() == ["dissipative", "mixed", "mixed", "undecided"]
    assert words[1].tolist() == ["undecided", "conservative", "undecided", "undecided"]
    assert set(words[2:].ravel()) == {"undecided"}


def test_the_interval_of_a_share():
    """The ends are where a binomial count as far out has a chance of 2.5 %: of 0 in n draws 1 − 0.025^(1/n)."""
    low, high = binomial_interval(np.array([0, 50, 100]), 100)
    assert low[0] == 0.0
    assert high[2] == 1.0
    np.testing.assert_allclose(high[0], 1.0 - 0.025 ** (1 / 100), rtol=1e-12)
    np.testing.assert_allclose(low[2], 0.025 ** (1 / 100), rtol=1e-12)
    np.testing.assert_allclose([low[1], high[1]], [binom_end(50, 100), 1.0 - binom_end(50, 100)], rtol=1e-9)


def binom_end(count, total):
    """The share at which so many or more have the chance 2.5 %."""
    return brentq(lambda share: binom.sf(count - 1, total, share) - 0.025, 1e-6, 1.0 - 1e-6, xtol=1e-14)


PAIR_OF_POINTS = """\
import jax.numpy as jnp


def system(strength=0.3):
    def rhs(y, t):
        x, z = y
        g = 1.0 + strength * jnp.cos(t)
        return (1.0 - x * x) * g, -x * z * g

    return {"rhs": rhs, "coordinates": ("x", "y"), "period": 2 * jnp.pi}
"""


def test_by_steps_of_a_lanes_own(tmp_path):
    (tmp_path / "pair.py").write_text(PAIR_OF_POINTS)
    content = {"system": {"file": str(tmp_path / "pair.py")}, "initial": {"x": 0.3, "y": 0.2}}
    content |= {"sweep": {"strength": {"values": [0.0, 0.5]}}, "analyses": {"poincare": {}}}
    content |= {"accuracy": {"target": 1e-8, "solver": "adaptive_tsitouras_papakostas8"}}
    session = session_of(Experiment.from_dict(content))
    check_pair(session.run(jaxnh.Reversal(transient=64, strobes=64, periods=64)), 1.0)
