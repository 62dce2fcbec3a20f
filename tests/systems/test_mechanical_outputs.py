"""Outputs of mechanics on request against closed forms, Newton's law by differences, and the balance of powers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import InputError
from jaxnh.mechanics import rolling_body
from jaxnh.systems.mechanical_outputs import evaluate_outputs, output_names
from jaxnh.systems.user_file import UserFile
from tests.flows import switched_sleighs
from tests.flows.switched_sleighs import flow_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("shared_programs")
SAMPLES = 64


def at(flow, start, *names, t=0.3):
    """Outputs of one state."""
    y = jax.tree.map(jnp.asarray, flow.start({**dict.fromkeys(flow.coordinates, 0.0), **start}))
    return [float(value) for value in evaluate_outputs(flow, t, y, {}, names)]


def bead(mass=1.3, gravity=2.0):
    """A bead on a circle of radius 1, in Cartesian coordinates."""
    return {
        "T": lambda q, v, t: 0.5 * mass * (v[0] ** 2 + v[1] ** 2),
        "Q": lambda q, v, t: (0.0, -mass * gravity),
        "f": lambda q, v, t: (q[0] * v[0] + q[1] * v[1],),
        "coordinates": ("x", "y"),
        "integrals": {"energy": lambda q, v, t: 0.5 * mass * (v[0] ** 2 + v[1] ** 2) + mass * gravity * q[1]},
    }


def governor(drive=0.8, rate=0.5):
    """A slide that rises with the square of a speed."""
    return {
        "T": lambda q, v, t: 0.5 * (v[0] ** 2 + (1.0 + 0.3 * q[0] ** 2) * v[1] ** 2),
        "Q": lambda q, v, t: (drive * jnp.sin(t) + q[0] - q[0] ** 3 - 0.2 * v[0], -q[1] - 0.2 * v[1]),
        "f": lambda q, v, t: (v[1] - rate * (v[0] ** 2 - 0.5),),
        "coordinates": ("x", "y"),
        "period": 2 * np.pi,
    }


def by_differences(values, step):
    """The derivative of samples by differences of sixth order, at all but three at each end."""
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60 / step
    return np.convolve(values, weights[::-1], mode="valid")


def test_a_bead_on_a_wire():
    """The multiplier is the radial force over the radius, m (g y − v²)."""
    flow = jaxnh.lagrangian(bead, {"mass": 1.3, "gravity": 2.0})
    state = {"x": 0.8, "y": -0.6, "x_dot": 0.9, "y_dot": 1.2}
    energy, rate, power, lost, radial = at(
        flow, state, "energy", "energy_rate", "power", "constraint_power", "lambda_1"
    )
    assert radial == pytest.approx(1.3 * (2.0 * -0.6 - 2.25), rel=1e-14)
    assert energy == pytest.approx(0.5 * 1.3 * 2.25 - 0.6 * 2.6, rel=1e-14)
    assert power == pytest.approx(-1.3 * 2.0 * 1.2, rel=1e-14)
    assert (rate, lost) == pytest.approx((0.0, 0.0), abs=1e-14)


def test_energy_is_kept_and_named_where_it_is_asked_for():
    """A portrait with the energy, and one without: of a conservative system it stays within the target."""
    session = jaxnh.Session(
        bead, start={"x": 0.8, "y": -0.6, "x_dot": 0.9, "y_dot": 1.2}, target=1e-9, parameters={"mass": 1.0}
    )
    options = {"transient": 0, "periods": 20, "samples": 4}
    data = session.run(jaxnh.Portrait(**options, outputs=["energy", "multipliers"]))
    energy = data["energy"].to_numpy().ravel()
    assert np.abs(energy - energy[0]).max() < 20 * 1e-9 * 10
    speed = data["x_dot"] ** 2 + data["y_dot"] ** 2
    assert np.abs(data["lambda_1"] - (2.0 * data["y"] - speed)).max() < 1e-7
    assert not {"energy", "lambda_1"} & set(session.run(jaxnh.Portrait(**options)))


@pytest.mark.slow  # those of trajectories are quick
def test_outputs_at_crossings_and_strobes():
    """On a section the energy is the start's, and at strobes of random starts each lane's own."""
    start = {"x": 0.8, "y": -0.6, "x_dot": 0.9, "y_dot": 1.2}
    section = jaxnh.Session(bead, start=start, target=1e-9).on(coordinate="x", value=0.0, direction="up")
    data = section.run(jaxnh.Poincare(transient=1, strobes=3, outputs=["energy"]), gravity=[2.0, 3.0])
    known = 0.5 * 1.3 * 2.25 - 1.3 * 0.6 * data["gravity"]
    assert np.abs(data["energy"] - known).max() < 1e-7
    data = section.run(jaxnh.Diagram(transient=1, strobes=2, outputs=["energy"], statistics=True), gravity=[2.0, 3.0])
    assert np.abs(data["energy_max"] - known).max() < 1e-7


@pytest.mark.slow  # those of a bead in closed form are quick
def test_powers_are_the_rate_of_the_kinetic_energy():
    """Of Q and of a constraint that is nonlinear: the sum at every sample, and the rate by differences."""
    session = jaxnh.Session(governor, start={"x": 0.5, "y_dot": -0.25}, target=1e-10)
    names = ["kinetic_energy", "kinetic_energy_rate", "power", "constraint_power"]
    data = session.run(jaxnh.Portrait(transient=3, periods=1, samples=4 * SAMPLES, outputs=names))
    energy, rate, power, of_constraint = (data[name].to_numpy().ravel() for name in names)
    assert np.abs(power + of_constraint - rate).max() < 1e-12
    assert np.abs(by_differences(energy, 2 * np.pi / (4 * SAMPLES)) - rate[3:-3]).max() < 1e-6
    assert np.abs(of_constraint).max() > 0.01


def test_the_lateral_force_of_a_sleigh():
    """Without forces λ = m u w I / (I + m a²), as the centre of mass has the lateral acceleration u w + a w'."""
    values = {"mass": 1.4, "inertia": 0.3, "length": 0.35, "stiffness": 0.0, "damping": 0.0, "drive": 0.0, "omega": 1.0}
    flow = UserFile(ROOT / "configs/nonholonomic/sleigh.py").flow(values)
    (force,) = at(flow, {"along": 0.7, "turn": -1.1, "theta": 0.4}, "lambda_1")
    assert force == pytest.approx(1.4 * 0.7 * -1.1 * 0.3 / (0.3 + 1.4 * 0.35**2), rel=1e-13)


def disk(gravity=1.0):
    """A thin disk of radius 1 and mass 2 that rolls."""

    def rim(n):
        return jnp.sqrt(n[0] ** 2 + n[1] ** 2)

    return rolling_body(rim, 2.0, ((0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0)), gravity)


@pytest.mark.slow  # the lateral force of a sleigh and that of a bead on a wire are quick
def test_the_contact_force_of_a_rolling_disk():
    """Newton's law with the height and the velocity of its centre, by differences: N = m (g + ḧ), and the friction."""
    start = {"g1": np.sin(1.1), "g3": np.cos(1.1), "w1": 0.2, "w2": -0.3, "w3": 1.5}
    session = jaxnh.Session(disk, start=start, target=1e-11)
    data = session.run(
        jaxnh.Portrait(transient=0, periods=1, samples=SAMPLES, outputs=["normal_force", "friction_ratio"])
    )
    g, w = (np.array([data[f"{name}{i}"].to_numpy().ravel() for i in (1, 2, 3)]) for name in "gw")
    step, size = 1.0 / SAMPLES, np.hypot(g[0], g[1])
    rim = -np.array([g[0] / size, g[1] / size, 0.0 * size])
    velocity = -np.cross(w.T, rim.T).T
    rate = np.array([by_differences(v, step) for v in velocity])
    w, velocity, g = w[:, 3:-3], velocity[:, 3:-3], g[:, 3:-3]
    force = 2.0 * (rate + np.cross(w.T, velocity.T).T) + 2.0 * g
    normal = (force * g).sum(axis=0)
    ratio = np.sqrt(((force - normal * g) ** 2).sum(axis=0)) / normal
    upwards = by_differences((g * velocity).sum(axis=0), step)
    assert np.abs(2.0 * (1.0 + upwards) - normal[3:-3]).max() < 1e-6
    assert np.abs(data["normal_force"].to_numpy().ravel()[3:-3] - normal).max() < 1e-6
    assert np.abs(data["friction_ratio"].to_numpy().ravel()[3:-3] - ratio).max() < 1e-6


def test_a_constraint_that_does_not_hold_has_no_force():
    """The lateral force of a blade while it is down, and none while it is up."""
    flow = flow_of(switched_sleighs.by_clock, a=0.3, drive=0.0)
    state = {"x_dot": 0.3, "y_dot": 0.4, "theta": np.arctan2(4, 3), "theta_dot": 0.0}
    up, down = (at(flow, {**state, "x": 1.0}, "lambda_1", t=t)[0] for t in (4.0, 1.0))
    assert up == 0.0
    assert down == pytest.approx(0.0, abs=1e-15)  # friction brakes it along the blade alone
    turning = {**state, "theta_dot": 0.5, "x_dot": 0.3 - 0.15 * 0.8, "y_dot": 0.4 + 0.15 * 0.6}
    force, along = at(flow, turning, "lambda_1", t=1.0)[0], 0.5
    # m aₙ = λ − c vₙ, I w' = −a λ − c w, and the rate of f: −w u + aₙ − a w' = 0 in the frame of the blade
    across, c, a = 0.15, 0.1, 0.3
    known = (0.5 * along + c * across - a * c * 0.5 / 0.2) / (1 + a * a / 0.2)
    assert force == pytest.approx(known, rel=1e-12)


def test_names():
    known = output_names(jaxnh.lagrangian(bead, {"mass": 1.3, "gravity": 2.0}))
    assert known["multipliers"] == ("lambda_1",)
    assert {"energy", "energy_rate", "kinetic_energy", "power", "constraint_power"} <= set(known)


def test_wrong_names():
    session = jaxnh.Session(bead, start={"x": 0.8, "y": -0.6, "x_dot": 0.9, "y_dot": 1.2}, target=1e-6)
    with pytest.raises(
        InputError, match=r"there is no output enrgy \(did you mean energy\?\); there are kinetic_energy"
    ):
        session.run(jaxnh.Portrait(transient=0, periods=1, samples=2, outputs=["enrgy"]))
