"""Flows of second order: which are seen to be, and their maps against Taylor series, closed forms and other solvers."""

from __future__ import annotations

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import cut_strobe, make_return_map
from jaxnh.maps.iterate import derivatives, iterate, section_map
from jaxnh.maps.nystrom import NystromStrobe
from jaxnh.maps.second_order import second_order
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import nystrom8, verner9
from jaxnh.systems.first_order import Point, first_order
from jaxnh.systems.lagrangian import Motion, lagrangian
from tests.helpers.batches import broadcast_start

PERIOD = 2 * np.pi


def oscillators(drive=0.3, damping=0.2, other=0.5):
    """Two driven wells, coupled, of unlike damping; positions first."""

    def rhs(y, t):
        x, y_, v, w = y
        return v, w, drive * jnp.cos(t) + x - x**3 - damping * v + 0.1 * y_, 0.1 * x - jnp.sin(y_) - other * w

    return {"rhs": rhs, "coordinates": ("x", "y", "v", "w"), "period": PERIOD}


def by_t_and_q(drive=0.3, damping=0.2, other=0.5):
    """The same by T and Q."""

    def Q(q, v, t):
        x, y = q
        return drive * jnp.cos(t) + x - x**3 - damping * v[0] + 0.1 * y, 0.1 * x - jnp.sin(y) - other * v[1]

    return {"T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2), "Q": Q, "coordinates": ("x", "y"), "period": PERIOD}


VALUES = {"drive": 0.3, "damping": 0.2, "other": 0.5}
DRIVES = np.array([0.2, 0.3, 0.45])
START = (0.5, -1.0, 0.1, 0.7)


def flow_of(rhs, period=PERIOD, **parameters):
    """A flow of (x, v), and of (x, y, v, w) where the field takes four, of its parameters; none of lanes' own."""

    def define(**values):
        count = 4 if "four" in rhs.__name__ else 2
        clock = {"period": period} if period else {}
        return {"rhs": lambda y, t: rhs(y, t, **values), "coordinates": tuple("xyvw"[:count]), **clock}

    return first_order(define, parameters, ())


# ---- which flows are seen to be of second order


def test_two_oscillators_are():
    """Positions and velocities in any order of the state, and the damping of each from the parameters of the flow."""
    for flow in (first_order(oscillators, VALUES, ("drive",)), lagrangian(by_t_and_q, VALUES, ("drive",))):
        order = second_order(flow)
        assert order is not None
        x, v = order.halves.parts(flow.start({name: k for k, name in enumerate(flow.coordinates)}))
        names = [flow.coordinates[int(k)] for k in (*x, *v)]
        assert names in (["x", "y", "v", "w"], ["x", "y", "x_dot", "y_dot"])
        np.testing.assert_array_equal(order.damping(flow), [0.2, 0.5])


def drag_of_position(y, t):
    return y[1], -y[0] - y[0] ** 2 * y[1]


def drag_of_speed(y, t):
    return y[1], -y[0] - y[1] * jnp.abs(y[1])


def drag_of_time(y, t):
    return y[1], -y[0] - 0.1 * jnp.cos(t) * y[1]


def twice_the_velocity(y, t):
    return 2.0 * y[1], -y[0]


def wind(y, t):
    return y[1] + 0.5, -y[0]


def wind_of_time(y, t):
    return y[1] + 0.1 * jnp.sin(t), -y[0]


def four_gyroscope(y, t):
    return y[2], y[3], -y[0] + 0.3 * y[3], -y[1] - 0.3 * y[2]


@pytest.mark.parametrize(
    "rhs", [drag_of_position, drag_of_speed, drag_of_time, twice_the_velocity, wind, wind_of_time, four_gyroscope]
)
def test_others_are_not(rhs):
    assert second_order(flow_of(rhs)) is None


def test_damping_of_a_lane_is_not_in_a_table():
    assert second_order(first_order(oscillators, VALUES, ("damping",))) is None
    assert second_order(first_order(oscillators, VALUES, ("drive",))) is not None


def test_without_a_clock_damping_has_no_table():
    """Steps onto a section are of any length."""

    def spring(y, t, gamma):
        return y[1], -y[0] - gamma * y[1]

    def free_spring(y, t):
        return y[1], -y[0]

    assert second_order(flow_of(spring, None, gamma=0.1)) is None
    assert second_order(flow_of(spring, gamma=0.1)) is not None
    assert second_order(flow_of(free_spring, None)) is not None


def test_solver_for_others_says_what_it_is_for():
    with pytest.raises(AccuracyError, match="nystrom8 is for flows"):
        make_return_map(flow_of(wind), nystrom8, 20)


# ---- their maps


def by_heyoka(values):
    x, y, v, w = hy.make_vars("x", "y", "v", "w")
    drive = hy.par[0]
    motion = [
        (x, v),
        (y, w),
        (v, drive * hy.cos(hy.time) + x - x * x * x - 0.2 * v + 0.1 * y),
        (w, 0.1 * x - hy.sin(y) - 0.5 * w),
    ]
    integrator = hy.taylor_adaptive(motion, list(START), pars=[0.0], tol=1e-18)
    found = []
    for value in values:
        integrator.pars[0], integrator.time, integrator.state[:] = value, 0.0, START
        integrator.propagate_until(PERIOD)
        found.append(integrator.state.copy())
    return np.array(found)


def test_map_comes_to_taylor_at_order_eight(lanes):
    flow, p = first_order(oscillators, VALUES, ("drive",)), {"drive": DRIVES}
    exact, start = by_heyoka(DRIVES), broadcast_start(Point(START), 3)
    errors = [
        np.abs(
            flow.chart.host_points(lanes(iterate, (make_return_map(flow, nystrom8, n), np.int32(1)), (start, p)))
            - exact
        )
        for n in (24, 48, 200)
    ]
    assert errors[1].max() < 2.0**-7 * errors[0].max() < 1e-6
    assert errors[2].max() < 1e-13  # rounding of 200 steps of states near one


def test_damped_motion_without_force_is_exact(lanes):
    """x″ = −γ x′: the exponentials of the table are the whole motion, and of γ²/4 u the order leaves h⁹."""

    def glide(y, t, gamma):
        return y[1], -gamma * y[1]

    flow = flow_of(glide, gamma=0.3)
    end = lanes(
        iterate, (make_return_map(flow, nystrom8, 16), np.int32(1)), (broadcast_start(Point((0.4, 1.1)), 1), {})
    )
    left = np.exp(-0.3 * PERIOD)
    assert abs(end.y[1][0] - 1.1 * left) < 1e-14
    assert abs(end.y[0][0] - (0.4 + 1.1 * (1.0 - left) / 0.3)) < 1e-13


@pytest.mark.parametrize(
    ("make", "system"), [(first_order, oscillators), (lagrangian, by_t_and_q)], ids=["field", "T and Q"]
)
@pytest.mark.slow
def test_tangents_are_derivatives_of_the_map(lanes, make, system):
    """By the linearisation of the force, of state and drive, against jacfwd; the volume is their determinant."""
    flow = make(system, VALUES, ("drive",))
    strobe = make_return_map(flow, nystrom8, 40)
    assert isinstance(strobe, NystromStrobe)
    u, p = np.tile(START, (3, 1)), {"drive": DRIVES}
    found = lanes(derivatives, (strobe, np.int32(1)), (u, p), static=("drive",))
    by_state, by_p = lanes(jacobians, (strobe,), (u, p))
    assert np.abs(found.monodromy - by_state).max() < 1e-12
    assert np.abs(found.by_parameter - by_p["drive"]).max() < 1e-12
    start = jax.tree.map(np.asarray, jax.vmap(flow.chart.state)(jnp.asarray(u)))
    volume = lanes(volume_of, (strobe,), (start, p))
    assert np.abs(np.log(volume) + 0.7 * PERIOD).max() < 1e-13
    assert np.abs(np.linalg.det(found.monodromy) / volume - 1.0).max() < 1e-8  # as the map has it, of order eight


def jacobians(strobe, u, p):
    return jax.jacfwd(lambda u, p: section_map(strobe, 1, u, p), argnums=(0, 1))(u, p)


def volume_of(strobe, state, p):
    return jnp.exp(strobe.pushforward(state, p, ()).log_volume)


def test_parts_of_a_period_are_the_period(lanes):
    flow, p = first_order(oscillators, VALUES, ("drive",)), {"drive": DRIVES}
    start = broadcast_start(Point(START), 3)
    whole = lanes(iterate, (make_return_map(flow, nystrom8, 48), np.int32(1)), (start, p))
    parts = lanes(in_turn, (cut_strobe(flow, nystrom8, 48, 8),), (start, p))
    for one, other in zip(whole.y, parts.y, strict=True):
        assert np.abs(one - other).max() < 1e-13


def in_turn(strobes, state, p):
    return jax.lax.scan(lambda z, strobe: (strobe(z, p), None), state, strobes)[0]


@pytest.mark.slow
def test_crossings_of_a_flow_that_keeps_its_energy(lanes):
    """Hénon and Heiles on y = 0 upward: returns, and tangents with the time of each, are those of another method."""

    def wells(cubic=1.0):
        def rhs(y, t):
            x, y_, v, w = y
            return v, w, -x - 2 * cubic * x * y_, -y_ - cubic * (x**2 - y_**2)

        return {"rhs": rhs, "coordinates": ("x", "y", "v", "w")}

    flow = first_order(wells, {"cubic": 1.0}, ("cubic",))
    section = Section(flow, "y", 1, 0.0, "up")
    p = {"cubic": np.array([0.9, 1.0])}
    begun = {"x": np.array([0.1, 0.2]), "y": np.zeros(2), "v": np.full(2, 0.2), "w": np.full(2, 0.3)}
    start = begin(section, flow.start(begun))
    u = section.chart.host_points(start)
    ends = [lanes(derivatives, (make_return_map(section, s, 24), np.int32(2)), (u, p)) for s in (nystrom8, verner9)]
    assert np.abs(ends[0].image - ends[1].image).max() < 1e-9
    assert np.abs(ends[0].monodromy - ends[1].monodromy).max() < 1e-8


def test_damping_that_is_not_there_costs_nothing(lanes):
    """No exponentials in the table, and fewer operations in the program than with γ."""

    def wells(y, t, gamma=0.0):
        return y[1], jnp.cos(t) + y[0] - y[0] ** 3 - gamma * y[1]

    plain, damped = (
        make_return_map(flow_of(wells), nystrom8, 20),
        make_return_map(flow_of(wells, gamma=0.2), nystrom8, 20),
    )
    assert len(plain.values) == 1
    assert len(damped.values) == 3
    counts = [
        sum(line.count(" mul ") for line in str(jax.make_jaxpr(strobe)(Point((0.1, 0.2)), {})).splitlines())
        for strobe in (plain, damped)
    ]
    assert counts[0] + 3 * nystrom8.stages <= counts[1]


def test_lanes_by_t_and_q_are_those_of_the_field(lanes):
    """The same motion through states that report, projected (there is nothing to project on)."""
    p, n = {"drive": DRIVES}, np.int32(2)
    one = first_order(oscillators, VALUES, ("drive",))
    two = lagrangian(by_t_and_q, VALUES, ("drive",))
    first = lanes(iterate, (make_return_map(one, nystrom8, 40), n), (broadcast_start(Point(START), 3), p))
    motion = Motion(START[:2], START[2:], (0.0, 0.0))
    second = lanes(iterate, (make_return_map(two, nystrom8, 40), n), (broadcast_start(motion, 3), p))
    assert np.abs(one.chart.host_points(first) - two.chart.host_points(second)).max() < 1e-12
