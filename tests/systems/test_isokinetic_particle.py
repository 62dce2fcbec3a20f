"""The systems against the paper's equations written out here, exact identities, and integrals in closed form."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ellipeinc

from jaxnh.systems.particle import CHART, constant_speed, disturbed_speed
from jaxnh.systems.particle_parameters import strobe_period
from tests.flows.paper_equations import constrained_field
from tests.flows.particle import SYSTEMS, twin
from tests.helpers.measurement import UNIT, largest_difference

MOMENTS = 200
RNG = np.random.default_rng(11)
T, B = RNG.uniform(0, 20, MOMENTS), RNG.uniform(0.01, 6, MOMENTS)
X, Y, THETA = RNG.uniform(-2, 2, MOMENTS), RNG.uniform(-2, 2, MOMENTS), RNG.uniform(-np.pi, np.pi, MOMENTS)
N = np.cos(THETA), np.sin(THETA)
A = RNG.uniform(0.1, 1, MOMENTS)
P = {"b": B}
# Sums of some thirty products, each of them below 200: the forces are below 40, the speed is below 1.5.
ROUNDOFF = 30 * UNIT * 200

systems = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)


def squared_speed(system):
    return system.c + system.d * np.sin(T)


def newton(system, sign):
    """Accelerations from (17), (18) with damping, and λ from (21) with −d cos t/2 as printed or +; dampings too."""
    a, g, squared = system.a, 1 + np.sin(system.omega * T), squared_speed(system)
    x2, y2 = (np.sqrt(squared) * n for n in N)
    f1 = a * g * X + g * X**3 - B * Y
    f2 = g * Y + a * g * Y**3 - B * X
    multiplier = a / 2 + (f1 * x2 + f2 * y2 + sign * system.d * np.cos(T) / 2) / (2 * squared)
    return (x2, y2), (-f1 - a * x2 + 2 * multiplier * x2, -f2 - a * y2 + 2 * multiplier * y2)


@systems
def test_damping_drops_out(system):
    """The four equations of the code have no damping and are the damped ones with their multiplier, (21) with +."""
    (x2, y2), (ax, ay) = newton(system, +1)
    rates = constrained_field(system, T, (X, x2, Y, y2), P)
    for rate, expected in zip(rates, (x2, ax, y2, ay), strict=True):
        assert np.abs(np.asarray(rate) - expected).max() < ROUNDOFF


@systems
def test_sign_of_21(system):
    """d(x2² + y2²)/dt is d cos t with + in (21) and in the code; as printed, with −, it is −d cos t."""
    for sign in (+1, -1):
        (x2, y2), (ax, ay) = newton(system, sign)
        assert np.abs(2 * (x2 * ax + y2 * ay) - sign * system.d * np.cos(T)).max() < 3 * ROUNDOFF
    rates = [np.asarray(rate) for rate in constrained_field(system, T, (X, x2, Y, y2), P)]
    assert np.abs(2 * (x2 * rates[1] + y2 * rates[3]) - system.d * np.cos(T)).max() < 3 * ROUNDOFF


@systems
def test_isokinetic_field_is_the_field_on_the_constraint(system):
    """With velocity s n: (s n)' = s' n + s n' is the acceleration of (12), (22), with s' = d cos t/(2 s)."""
    velocity, rates = system.rhs(T, ((X, Y), N), P)
    s = np.sqrt(squared_speed(system))
    x2, y2 = (s * n for n in N)
    _, ax, _, ay = (np.asarray(rate) for rate in constrained_field(system, T, (X, x2, Y, y2), P))
    stretch = system.d * np.cos(T) / (2 * s)
    for moved, n, rate, v, acceleration in zip(velocity, N, rates, (x2, y2), (ax, ay), strict=True):
        assert np.abs(np.asarray(moved) - v).max() < 4 * UNIT
        assert np.abs(stretch * n + s * np.asarray(rate) - acceleration).max() < ROUNDOFF
    assert np.abs(sum(n * np.asarray(rate) for n, rate in zip(N, rates, strict=True))).max() < ROUNDOFF


@systems
def test_symmetry(system):
    """(x, y, n) → (−x, −y, −n) turns every rate around, bit for bit."""
    state = (X, Y), N
    rates = system.rhs(T, state, P)
    mirrored = system.rhs(T, jax.tree.map(np.negative, state), P)
    for one, other in zip(jax.tree.leaves(rates), jax.tree.leaves(mirrored), strict=True):
        np.testing.assert_array_equal(one, -other)


@systems
def test_velocity_meets_the_constraint(system):
    """x2² + y2² = c + d sin t, to the roundings of a root and two squares."""
    x2, y2 = (np.asarray(v) for v in system.velocity(T, ((X, Y), N)))
    assert np.abs(x2**2 + y2**2 - squared_speed(system)).max() < 16 * UNIT


def arc(c, d, t0, t1):
    """∫ √(c + d sin t) dt in closed form: with t = π/2 − 2u an incomplete elliptic integral of the second kind."""
    u0, u1 = (math.pi / 2 - t0) / 2, (math.pi / 2 - t1) / 2
    m = 2 * d / (c + d)
    return 2 * math.sqrt(c + d) * (ellipeinc(u0, m) - ellipeinc(u1, m))


def gauss_bound(c, d, length):
    """Error of twelve Gauss–Legendre nodes (Trefethen, SIAM Review 50 (2008) 67, theorem 4.5).

    √(c + d sin t) is analytic up to the imaginary part arccosh(c/d), and there below √(2c).
    """
    if d == 0:
        return 0.0
    y = math.acosh(c / d) / (length / 2)
    rho = y + math.hypot(1, y)
    return length / 2 * 64 / 15 * math.sqrt(2 * c) * rho**-24 / (1 - rho**-2)


@pytest.mark.parametrize("length", [1e-3, 0.1, 0.5, 2.0, 6.0])
@pytest.mark.parametrize(("c", "d"), [(1.0, 0.0), (1.0, 0.1), (1.7, 0.2), (1.0, 0.5), (1.0, 0.95)])
def test_path_length(c, d, length):
    """Against elliptic integrals and adaptive quadrature; forwards and backwards, from any moment of the period."""
    system = disturbed_speed(c=c, d=d)
    t0 = np.linspace(-5, 5, 21)
    ways = system.path_length(t0, t0 + length)
    back = system.path_length(t0 + length, t0)
    bound = gauss_bound(c, d, length) + 32 * UNIT * (1 + length)  # of t, and of a sum of twelve
    for way, returned, t in zip(ways, back, t0, strict=True):
        assert abs(way - arc(c, d, t, t + length)) < bound + 32 * UNIT * math.sqrt(c + d) * 5  # E is up to 5 here
        by_quadrature, error = quad(lambda t: math.sqrt(c + d * math.sin(t)), t, t + length, epsabs=1e-14, epsrel=1e-13)
        assert abs(way - by_quadrature) < bound + error
        assert abs(way + returned) < 32 * UNIT * (1 + length)


@pytest.mark.parametrize("d", [0.0, 0.1])
def test_path_length_with_jax_is_that_with_numpy(d):
    system = disturbed_speed(d=d)
    t0, t1 = np.linspace(0, 6, 25), np.linspace(0.1, 6.5, 25)
    traced = jax.jit(jax.vmap(system.path_length))(t0, t1)
    assert np.abs(np.asarray(traced) - system.path_length(t0, t1)).max() < 32 * UNIT


# ---- the strobe period


@settings(deadline=None)
@given(st.integers(1, 300), st.integers(1, 64))
def test_common_period_of_a_ratio(p, q):
    """For ω = p/q in lowest terms the least common period of sin t and sin ωt is 2πq; undisturbed it is 2π/ω."""
    ratio = Fraction(p, q)
    assert strobe_period(p / q, disturbed=True) == 2 * math.pi * ratio.denominator
    assert strobe_period(p / q, disturbed=False) == 2 * math.pi / (p / q)


@pytest.mark.parametrize("omega", [math.sqrt(2), math.pi, 1 / 65, 1 + 1e-9, 1e-3])
def test_no_common_period(omega):
    with pytest.raises(ValueError, match="have no common period to strobe at"):
        strobe_period(omega, disturbed=True)


def test_period_of_a_system_is_disturbed_only_by_a_disturbance():
    assert constant_speed(omega=math.sqrt(2)).period == 2 * math.pi / math.sqrt(2)
    assert disturbed_speed(d=0.0, omega=3.0).period == 2 * math.pi / 3
    assert disturbed_speed(d=0.1, omega=3.0).period == 2 * math.pi
    assert disturbed_speed(d=0.1, omega=2 / 3).period == 6 * math.pi


@systems
@pytest.mark.parametrize("without", [(), ("coupling",), ("cubic_stiffness",), ("forcing", "cubic_stiffness")])
def test_force_pullback(system, without):
    """m ∂F/∂(x1, y1, b, a) in closed form is the reverse-mode derivative of the force, whatever is left out."""
    system = dataclasses.replace(system, without=system.without | set(without))
    q, m, weight, p = (X, Y), N, np.full(MOMENTS, 0.7), {"b": B, "a": A}
    g = system.forcing(T) * weight
    by_q, by_p = jax.vjp(lambda q, p: system.force(q, g, weight, p), q, p)[1](m)
    named = ("a",) if "coupling" in without else ("b", "a")
    rows = system.force_pullback(q, g, weight, p, m, named)
    np.testing.assert_allclose(
        np.array(rows), np.array([*by_q, *(by_p[name] for name in named)]), atol=ROUNDOFF, rtol=0
    )
    assert len(system.force_pullback(q, g, weight, p, m)) == 2


# ---- lanes of their own parameters


@systems
def test_parameters_of_a_lane_replace_those_of_the_flow(system):
    """a and b in p, or in the flow, or one in either: the same rates, bit for bit."""
    a, b, state, t = 0.37, 4.2, ((X[0], Y[0]), (N[0][0], N[1][0])), T[0]
    ways = [
        (dataclasses.replace(system, a=0.9, b=1.1), {"a": a, "b": b}),
        (dataclasses.replace(system, a=a, b=None), {"b": b}),
        (dataclasses.replace(system, a=0.9, b=b), {"a": a}),
        (dataclasses.replace(system, a=a, b=b), {}),
    ]
    rates = [jax.tree.leaves((flow.rhs(t, state, p), flow.divergence(t, state, p))) for flow, p in ways]
    for found in rates[1:]:
        np.testing.assert_array_equal(np.array(found), np.array(rates[0]))


@systems
def test_tabulated_flow_is_the_force_alone(system):
    """Speed and clock are no part of it: flows that differ in c, d and ω are one, and their forces those of the flow."""
    table = dataclasses.replace(system, b=2.0).tabulated()
    assert (table.c, table.d, table.omega) == (None, None, None)
    assert table == dataclasses.replace(system, b=2.0, c=7.0, d=0.01, omega=3.0).tabulated()
    g, weight = system.forcing(T), np.ones(MOMENTS)
    for one, other in zip(table.force((X, Y), g, weight, P), system.force((X, Y), g, weight, P), strict=True):
        np.testing.assert_array_equal(one, other)


# ---- names, start states, section points


@systems
def test_names(system):
    """Parameters by the paper's names; all lanes share what is in the table of kicks."""
    assert set(system.parameters) == {"a", "c", "d", "omega"}
    assert set(dataclasses.replace(system, b=5.0).parameters) == {"a", "b", "c", "d", "omega"}
    assert [name for name in ("a", "b", "c", "d", "omega") if system.roles.is_shared(name)] == ["c", "d", "omega"]
    assert system.coordinates == ("x1", "x2", "y1", "y2")
    assert system.readout.labels.planes[0] == ("x1", "x2")
    assert system.readout.labels.long_names["b"] == "coupling b"
    assert {
        system.readout.labels.long_names[name].rsplit(" ", 1)[1] for name in (*system.coordinates, *system.parameters)
    } == {
        *system.coordinates,
        *system.parameters,
    }


@systems
def test_start(system):
    """x1, x2, y1 and the positive root of the constraint, at the speed of t = 0; floats, or lanes side by side."""
    x2 = np.array([0.1, -0.9, 0.0, 1.0]) * np.sqrt(system.c)
    start = system.start({"x1": np.array([0.1, 0.2, 0.3, 0.4]), "x2": x2, "y1": -0.5})
    (x, y), _ = start
    assert (x.tolist(), y.tolist()) == ([0.1, 0.2, 0.3, 0.4], -0.5)
    v = [np.asarray(component) for component in system.velocity(0.0, start)]
    assert np.abs(v[0] - x2).max() < 4 * UNIT
    assert np.abs(v[1] - np.sqrt(system.c - x2**2)).max() < 4 * UNIT
    for i in range(4):
        one = system.start({"x1": x[i], "x2": x2[i], "y1": -0.5})
        assert [float(leaf) for leaf in jax.tree.leaves(one)] == [
            float(np.broadcast_to(leaf, 4)[i]) for leaf in jax.tree.leaves(start)
        ]
    exact = twin(system).start(0.2, x2[1], -0.5)
    assert (
        largest_difference(system.chart.host_points(system.start({"x1": 0.2, "x2": x2[1], "y1": -0.5})), exact)
        < 8 * UNIT
    )


def test_start_that_is_too_fast():
    """Faster than the constraint allows: that lane is not a number, and no other."""
    (_, _), (n1, n2) = constant_speed(c=0.25).start({"x1": 0.0, "x2": np.array([0.4, 0.6]), "y1": 0.0})
    assert np.isfinite(n2).tolist() == [True, False]
    assert np.isfinite(n1).all()


@systems
def test_section_points_of_many_states(system):
    """Of any shape, each with the digits of one alone, and those of the chart to the rounding of an arc tangent."""
    state = (X.reshape(8, -1), Y.reshape(8, -1)), tuple(n.reshape(8, -1) for n in N)
    points = system.chart.host_points(state)
    assert points.shape == (8, MOMENTS // 8, 3)
    charted = np.asarray(jax.vmap(jax.vmap(system.chart.point))(jax.tree.map(jnp.asarray, state)))
    assert largest_difference(points, charted).max() < 8 * UNIT
    for i, j in np.ndindex(points.shape[:2]):
        one = system.chart.host_points(jax.tree.map(lambda leaf, i=i, j=j: leaf[i, j], state))
        np.testing.assert_array_equal(one, points[i, j])


# ---- coordinates

angles = st.floats(-math.pi, math.pi)
places = st.floats(-10, 10)


@settings(deadline=None)
@given(places, places, angles)
def test_chart_and_back(x, y, theta):
    """The angle comes back modulo a whole turn, to the rounding of a sine, a cosine and an arc tangent."""
    u = np.array([x, y, theta])
    assert CHART.state(jnp.asarray(u))[0] == (x, y)
    back = np.asarray(CHART.point(CHART.state(jnp.asarray(u))))
    assert tuple(back[:2]) == (x, y)
    assert largest_difference(back, u) < 8 * UNIT
    assert -math.pi <= back[2] <= math.pi


@settings(deadline=None)
@given(places, places, angles, st.integers(-5, 5))
def test_wrap_takes_whole_turns_out(x, y, theta, turns):
    """For arrays of NumPy and of JAX alike, and never outside of [−π, π]."""
    u = np.array([x, y, theta + 2 * math.pi * turns])
    for wrapped in (CHART.wrap(u), np.asarray(CHART.wrap(jnp.asarray(u)))):
        assert tuple(wrapped[:2]) == (x, y)
        assert largest_difference(wrapped, [x, y, theta]) < 8 * 2 * math.pi * (1 + abs(turns)) * UNIT
        assert -math.pi <= wrapped[2] <= math.pi
    np.testing.assert_array_equal(CHART.wrap(np.stack([u, -u])), np.stack([CHART.wrap(u), CHART.wrap(-u)]))
