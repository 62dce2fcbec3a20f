"""Right-hand sides as flows: against closed forms, exact divergences, and the same system by T and Q."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.build import cut_strobe, make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import dopri8
from jaxnh.systems.first_order import Point, first_order
from jaxnh.systems.lagrangian import Motion, lagrangian
from tests.flows import lorenz
from tests.helpers.batches import broadcast_start


def pendulum(drive=0.9, damping=0.3):
    def rhs(y, t):
        return y[1], drive * jnp.cos(t) - jnp.sin(y[0]) - damping * y[1]

    return {"rhs": rhs, "coordinates": ("phi", "rate"), "angles": ("phi",), "period": 2 * np.pi}


def pendulum_by_t_and_q(drive=0.9, damping=0.3):
    def Q(q, v, t):
        return (drive * jnp.cos(t) - jnp.sin(q[0]) - damping * v[0],)

    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2,
        "Q": Q,
        "coordinates": ("phi",),
        "angles": ("phi",),
        "period": 2 * np.pi,
    }


PENDULUM = {"drive": 0.9, "damping": 0.3}


def test_volume_of_lorenz_is_exact(lanes):
    """The divergence −(σ + 1 + β) is a constant, and its integral over a unit of time is that number."""
    flow = first_order(lorenz.lorenz, lorenz.PARAMETERS, ("rho",))
    start = broadcast_start(Point((1.0, 1.0, 20.0)), 2)
    strobe = make_return_map(flow, dopri8, 64)
    volume = lanes(volume_of, (strobe,), (start, {"rho": np.array([28.0, 60.0])}))
    assert np.abs(np.log(volume) + 10.0 + 1.0 + 8 / 3).max() < 1e-13


def volume_of(strobe, state, p):
    return jnp.exp(strobe.pushforward(state, p, ()).log_volume)


@pytest.mark.slow
def test_pendulum_is_the_one_by_t_and_q(lanes):
    """The same equations of motion by other ways: states and slopes in state and drive, to rounding."""
    drive = np.array([0.9, 1.1])
    first, second = first_order(pendulum, PENDULUM, ("drive",)), lagrangian(pendulum_by_t_and_q, PENDULUM, ("drive",))
    u = np.array([[0.3, 0.1], [2.0, -1.0]])
    found = [
        lanes(derivatives, (make_return_map(flow, dopri8, 100), np.int32(2)), (u, {"drive": drive}), static=("drive",))
        for flow in (first, second)
    ]
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() < 1e-12


def test_parameter_of_the_flow_is_that_of_a_lane(lanes):
    """The drive in the table of times, where all lanes have one value, or with each lane."""
    start = broadcast_start(Point((0.3, 0.1)), 2)
    one = make_return_map(first_order(pendulum, PENDULUM, ("damping",)), dopri8, 100)
    other = make_return_map(first_order(pendulum, PENDULUM), dopri8, 100)
    p = {"damping": np.array([0.3, 0.4])}
    ends = [lanes(iterate, (strobe, np.int32(1)), (start, p)) for strobe in (one, other)]
    for x, y in zip(ends[0].y, ends[1].y, strict=True):
        assert np.abs(x - y).max() < 1e-13


def test_parts_of_a_period_are_the_period(lanes):
    flow = first_order(pendulum, PENDULUM, ("drive",))
    start, p = broadcast_start(Point((0.3, 0.1)), 2), {"drive": np.array([0.9, 1.1])}
    whole = lanes(iterate, (make_return_map(flow, dopri8, 96), np.int32(1)), (start, p))
    parts = lanes(in_turn, (cut_strobe(flow, dopri8, 96, 8),), (start, p))
    for one, other in zip(whole.y, parts.y, strict=True):
        assert np.abs(one - other).max() < 1e-13


def in_turn(strobes, state, p):
    from jax import lax

    return lax.scan(lambda z, strobe: (strobe(z, p), None), state, strobes)[0]


def test_circle_on_a_plane(lanes):
    """Uniform motion on a circle meets the plane x = y at 45°, upward in x − y once a turn of 2π: a closed form."""

    def circle(omega=1.0):
        return {"rhs": lambda y, t: (-omega * y[1], omega * y[0], -y[2]), "coordinates": ("x", "y", "z")}

    flow = first_order(circle, {"omega": 1.0}, ("omega",))
    plane = Section(flow, "x", 0, 0.0, "up", (1.0, -1.0, 0.0))
    omega = np.array([1.0, 2.0])
    start = begin(plane, flow.start({"x": np.full(2, 1.0), "y": np.zeros(2), "z": np.ones(2)}))
    strobe = make_return_map(plane, dopri8, 40)
    crossing = lanes(iterate, (strobe, np.int32(2)), (start, {"omega": omega}))
    # From (1, 0) the angle is 5π/4 at the first passage upward of x − y, and 2π more at the second.
    assert np.abs(crossing.t - (5 * np.pi / 4 + 2 * np.pi) / omega).max() < 1e-9
    x, y, z = crossing.state.y
    assert np.abs(x + np.sqrt(0.5)).max() < 1e-9
    assert np.abs(x - y).max() < 1e-12
    assert np.abs(z - np.exp(-crossing.t)).max() < 1e-9


def test_states_that_are_not_finite_are_reported():
    flow = first_order(lorenz.lorenz, lorenz.PARAMETERS)
    states = Point(tuple(np.array([[1.0, 2.0], [1.0, np.nan]]) for _ in range(3)))
    report = flow.readout.reports(states)["status"]
    assert report.data.tolist() == [0, 3]
    assert report.attrs["flag_meanings"].split()[3] == "not_finite"


def test_names_of_states(lanes):
    flow = first_order(pendulum, PENDULUM)
    state = flow.start({"phi": 4.0, "rate": 1.0})
    outputs = flow.readout.coordinates(state, np.zeros(1))
    assert outputs["phi"].data == pytest.approx(4.0 - 2 * np.pi, abs=1e-15)
    assert outputs["phi"].long_name == "angle phi"
    assert flow.readout.labels.planes[0] == ("phi", "rate")
    assert isinstance(lagrangian(pendulum_by_t_and_q, PENDULUM).start({"phi": 0.0, "phi_dot": 0.0}), Motion)


def test_what_decides_the_clock():
    """A period that is the same one further, one by plain numbers alone, and parameters that have no part in it."""

    def define(tilt=0.1, pace=2.0, size=1.0):
        period = 2 * np.pi / (1.5 + jnp.cos(2 * np.pi * tilt))
        return {"rhs": lambda y, t: (size * jnp.cos(t),), "coordinates": ("x",), "period": period * math.sqrt(4.0)}

    flow = first_order(define, {"tilt": 0.1, "pace": 2.0, "size": 1.0})
    assert [name for name in flow.parameters if flow.roles.is_shared(name)] == ["tilt"]

    def plainly(pace=2.0, size=1.0):
        return {"rhs": lambda y, t: (size * jnp.cos(t),), "coordinates": ("x",), "period": math.sqrt(pace)}

    flow = first_order(plainly, {"pace": 2.0, "size": 1.0})
    assert [name for name in flow.parameters if flow.roles.is_shared(name)] == ["pace"]
