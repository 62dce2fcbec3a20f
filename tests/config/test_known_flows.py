"""The library of known flows in configs/flows: each user's file against equations written out here, and what it states.

The equations here share nothing with the package: scipy's DOP853 at 1e-13 integrates them, of systems by T, Q and f with
accelerations solved by hand.
"""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import jaxnh
from jaxnh.analyses.periodic.newton_on_lanes import orbits
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.section import Section
from jaxnh.solvers import dopri8, tsit5
from tests.helpers.cases import some_slow
from tests.helpers.paths import ROOT

FOLDER = ROOT / "configs/flows"
STEPS = 400  # a period or a unit of time


def lorenz(t, u, rho):
    x, y, z = u
    return 10 * (y - x), x * (rho - z) - y, x * y - 8 / 3 * z


def roessler(t, u, c):
    x, y, z = u
    return -y - z, x + 0.2 * y, 0.2 + z * (x - c)


def single_well(t, u, gamma):
    return u[1], gamma * math.cos(t) - 0.05 * u[1] - u[0] ** 3


def double_well(t, u, gamma):
    return u[1], gamma * math.cos(t) - 0.2 * u[1] + u[0] - u[0] ** 3


def pendulum(t, u, gamma):
    natural, drive = 3 * math.pi, 2 * math.pi
    return u[1], natural**2 * (gamma * math.cos(drive * t) - math.sin(u[0])) - natural / 2 * u[1]


def torque_pendulum(t, u, _):
    return u[1], 0.5 - 0.1 * u[1] - math.sin(u[0])


def van_der_pol(t, u, omega):
    return u[1], (1 - u[0] ** 2) * u[1] - u[0] + 1.2 * math.cos(omega * t)


def van_der_pol_free(t, u, mu):
    return u[1], mu * (1 - u[0] ** 2) * u[1] - u[0]


def chua(t, u, alpha):
    x, y, z = u
    bend = x if abs(x) < 1 else math.copysign(1.0, x)
    return alpha * (y - x + 5 / 7 * x + 3 / 7 * bend), x - y + z, -100 / 7 * y


def henon_heiles(t, u, _):
    x, y, v, w = u
    return v, w, -x - 2 * x * y, -y - x * x + y * y


def double_pendulum(t, u, ratio):
    a, b, v, w = u
    c, s = math.cos(a - b), math.sin(a - b)
    mass = np.array([[1 + ratio, ratio * c], [ratio * c, ratio]])
    force = [-ratio * s * w * w - (1 + ratio) * math.sin(a), ratio * s * v * v - ratio * math.sin(b)]
    return v, w, *np.linalg.solve(mass, force)


def circuit(t, u, nu):
    x, y, z = u
    cube = (y - x) ** 3
    first = -0.32858 * x**3 + 0.93358 * cube - (0.5 + nu) * x + 0.5 * y
    return first / 0.6, 0.5 * x + 0.1 * y - z - 0.93358 * cube, y + 0.001


def peroxidase(t, u, k8):
    a, b, x, y = u
    first, third, second = 0.1631021 * a * b * x, 0.046875 * a * b * y, 2500 * x * x
    return (
        1.5 - 0.1175 * a - first - third,
        k8 - first - third,
        0.001 + first + 2 * third - second - 20 * x,
        second - third - 1.104 * y,
    )


def rolling_disk(t, u, stiffness):
    """Without the angle of rolling: its rate alone moves the disk, by the spring's force along the track."""
    x, y, turn, _, _, roll, rate = u
    c, s = math.cos(turn), math.sin(turn)
    faster = -stiffness * (x * c + y * s) / 1.5  # mass and moment about the axle
    return roll * c, roll * s, rate, faster * c - roll * rate * s, faster * s + roll * rate * c, faster, 0.0


NAMES = {
    "lorenz": lorenz,
    "roessler": roessler,
    "duffing_single_well": single_well,
    "duffing_double_well": double_well,
    "pendulum": pendulum,
    "torque_pendulum": torque_pendulum,
    "van_der_pol": van_der_pol,
    "van_der_pol_free": van_der_pol_free,
    "chua": chua,
    "henon_heiles": henon_heiles,
    "double_pendulum": double_pendulum,
    "circuit": circuit,
    "peroxidase": peroxidase,
    "rolling_disk": rolling_disk,
}
MECHANICS = ("henon_heiles", "double_pendulum", "rolling_disk")


@functools.cache
def loaded(name):
    return jaxnh.load(FOLDER / f"{name}.yaml")


def test_every_flow_is_tested():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == set(NAMES)


def flow_and_lanes(name):
    """The flow in continuous time, start states and parameters of three lanes of a config, and their values of its axis."""
    experiment = loaded(name)
    flow, axis = experiment.flow(), experiment.axes[0]
    values = axis.values[[0, len(axis.values) // 2, -1]]
    if axis.kind == "shared":
        values = np.repeat(axis.values[:1], 3)
    start = experiment.start({axis.name: values} if axis.kind == "start" else {}, 3)
    state = start.state if experiment.sectioned else start
    return flow, state, {axis.name: values} if axis.kind == "lane" else {}, values


LANES = LaneExecutor()


def ends(name, periods):
    """Section coordinates of three lanes some periods, or units of time, after the start of their config."""
    flow, state, p, values = flow_and_lanes(name)
    # Mechanics are slow to compile and smooth: six stages in place of twelve are enough.
    strobe = make_return_map(flow, tsit5 if name in MECHANICS else dopri8, STEPS)
    end = LANES(iterate, (strobe, np.int32(periods)), (state, p), tile=4)
    return flow.chart.host_points(state), flow.chart.host_points(end), flow.period * periods, values


@pytest.mark.parametrize(
    "name",
    some_slow({name: name for name in NAMES}, "lorenz", "duffing_single_well", "duffing_double_well", "pendulum"),
)
def test_flow_against_equations_written_out(name):
    """Two periods or units of time: of the size of the motion, tolerances of 1e-13 times what chaos makes of them."""
    start, end, duration, values = ends(name, 2)
    for u, found, value in zip(start, end, values, strict=True):
        fine = {"max_step": 2e-3} if name == "chua" else {}  # no step may leap over a corner and back
        exact = scipy.integrate.solve_ivp(
            NAMES[name], (0.0, duration), u, "DOP853", args=(value,), rtol=3e-14, atol=1e-14, **fine
        ).y[:, -1]
        tolerance = 1e-5 if name == "chua" else 1e-9  # a corner within a step costs a method its order: h² is left
        assert np.abs(found - exact).max() < tolerance * (1.0 + np.abs(exact).max())


# ---- what the files state


def test_double_scroll_is_at_rest_where_the_file_says():
    """At ±(1.5, 0, −1.5); and the divergence is that of the two kinds of pieces."""
    flow, _, _, _ = flow_and_lanes("chua")
    for sign in (1.0, -1.0):
        rate = flow.rhs(0.0, flow.chart.state(jnp.array([sign * 1.5, 0.0, sign * -1.5])), {"alpha": 9.0})
        assert np.abs(np.array(rate.y)).max() < 1e-14
    for x, slope in ((0.5, -8 / 7), (2.0, -5 / 7)):
        found = flow.divergence(0.0, flow.chart.state(jnp.asarray([x, 0.0, 0.0])), {"alpha": 9.0})
        assert float(found) == pytest.approx(-9.0 * (1 + slope) - 1, abs=1e-14)


def test_energy_of_henon_and_heiles_is_kept():
    """Over a hundred units of time, by steps whose error is below 1e-13 a unit; energies as the config says."""
    start, end, _, _ = ends("henon_heiles", 100)

    def energy(u):
        x, y, v, w = u.T
        return 0.5 * (v * v + w * w + x * x + y * y) + x * x * y - y**3 / 3

    assert np.abs(energy(end) - energy(start)).max() < 1e-10
    assert 0.0496 < energy(start).min() < energy(start).max() < 1 / 6


@pytest.mark.slow
def test_modes_of_the_double_pendulum():
    """Small angles along a mode, lower = ±√((1 + ratio)/ratio) upper: they swing at w, but for the cube of the angle."""
    flow, _, _, _ = flow_and_lanes("double_pendulum")
    ratio, size, sign = np.array([0.5, 0.5, 2.0, 2.0]), 1e-4, np.array([1.0, -1.0, 1.0, -1.0])
    shape = sign * np.sqrt((1 + ratio) / ratio)
    zero = np.zeros(4)
    state = flow.start({"upper": zero + size, "lower": size * shape, "upper_dot": zero, "lower_dot": zero})
    end = LANES(iterate, (make_return_map(flow, tsit5, STEPS), np.int32(2)), (state, {"ratio": ratio}), tile=4)
    square = (1 + ratio) * (1 - sign * np.sqrt(ratio / (1 + ratio)))
    assert np.abs(end.q[0] - size * np.cos(2 * np.sqrt(square))).max() < 50 * size**3


@pytest.mark.slow
@pytest.mark.slow
def test_disk_without_its_spring_rolls_in_a_circle():
    """Its centre is one radius of the circle to the left of the motion; the constraint is kept."""
    flow, state, _, _ = flow_and_lanes("rolling_disk")
    end = LANES(
        iterate, (make_return_map(flow, tsit5, STEPS), np.int32(2)), (state, {"stiffness": np.zeros(3)}), tile=4
    )
    angle, radius = 0.7 * 2, 1 / 0.7
    exact = [0.5 + radius * math.sin(angle), radius * (1 - math.cos(angle)), 2.0, angle]
    assert np.abs(np.stack(end.q, axis=-1) - exact).max() < 1e-10
    assert np.abs(np.stack(end.v, axis=-1) - [math.cos(angle), math.sin(angle), 1.0, 0.7]).max() < 1e-10


@pytest.mark.slow  # derivatives to a crossing take half a minute to compile
def test_limit_cycle_of_van_der_pol():
    """Its period at mu = 1, and its multiplier: e to the divergence around it, by DOP853 and its events."""
    section = loaded("van_der_pol_free").dynamics()
    strobe, p = make_return_map(section, dopri8, 64), {"mu": np.ones(1)}
    orbit = orbits(LANES, strobe, np.array([[2.17]]), p, 1)
    state = jax.vmap(section.chart.state)(jnp.asarray(orbit.u))
    assert float(LANES(iterate, (strobe, np.int32(1)), (state, p), tile=4).t[0]) == pytest.approx(
        6.663286859323, abs=2e-11
    )

    def with_divergence(t, u):
        return *van_der_pol_free(t, u[:2], 1.0), 1 - u[0] ** 2

    exact = scipy.integrate.solve_ivp(
        with_divergence, (0, 6.663286859323), [0.0, float(orbit.u[0, 0]), 0.0], "DOP853", rtol=3e-14, atol=1e-14
    ).y[:, -1]
    assert np.abs(exact[:2] - [0.0, float(orbit.u[0, 0])]).max() < 1e-10
    assert float(orbit.monodromy[0, 0, 0]) == pytest.approx(math.exp(exact[2]), rel=1e-8)


@pytest.mark.slow
def test_shortest_orbit_of_roessler():
    """At c = 5.7, where x passes zero: as listed with ChaosBook (extras, Roessler's model), and closed by DOP853.

    The list has 1.000000003 for the multiplier one: it is known to 3e-9, in z, which falls at a rate of 7 there, to 2e-8.
    """
    flow = Section(loaded("roessler").flow(), "x", 0, 0.0, "down")
    strobe, p = make_return_map(flow, dopri8, 256), {"c": np.array([5.7])}
    orbit = orbits(LANES, strobe, np.array([[6.0, 1.3]]), p, 1)
    assert np.abs(orbit.u[0] - [6.09176831742, 1.29973195919]).max() < 5e-8
    state = jax.vmap(flow.chart.state)(jnp.asarray(orbit.u))
    duration = float(LANES(iterate, (strobe, np.int32(1)), (state, p), tile=4).t[0])
    assert duration == pytest.approx(5.88108845586, abs=1e-8)
    assert np.linalg.eigvals(orbit.monodromy[0]).real.min() == pytest.approx(-2.403953527, abs=1e-7)
    start = [0.0, *orbit.u[0]]
    end = scipy.integrate.solve_ivp(roessler, (0.0, duration), start, "DOP853", args=(5.7,), rtol=3e-14, atol=1e-14)
    assert np.abs(end.y[:, -1] - start).max() < 1e-10
