"""The systems against the paper's equations written out here, exact identities, and integrals in closed form."""

from __future__ import annotations

import math
from fractions import Fraction

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measure import SYSTEMS, UNIT
from scipy.integrate import quad
from scipy.special import ellipeinc

from jaxnh.systems.particle import constant_speed, constrained_field, disturbed_speed, strobe_period

MOMENTS = 200
RNG = np.random.default_rng(11)
T, B = RNG.uniform(0, 20, MOMENTS), RNG.uniform(0.01, 6, MOMENTS)
X, Y, THETA = RNG.uniform(-2, 2, MOMENTS), RNG.uniform(-2, 2, MOMENTS), RNG.uniform(-np.pi, np.pi, MOMENTS)
N = np.cos(THETA), np.sin(THETA)
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
    rates = constrained_field(system, T, (X, x2, Y, y2), B)
    for rate, expected in zip(rates, (x2, ax, y2, ay), strict=True):
        assert np.abs(np.asarray(rate) - expected).max() < ROUNDOFF


@systems
def test_sign_of_21(system):
    """d(x2² + y2²)/dt is d cos t with + in (21) and in the code; as printed, with −, it is −d cos t."""
    for sign in (+1, -1):
        (x2, y2), (ax, ay) = newton(system, sign)
        assert np.abs(2 * (x2 * ax + y2 * ay) - sign * system.d * np.cos(T)).max() < 3 * ROUNDOFF
    rates = [np.asarray(rate) for rate in constrained_field(system, T, (X, x2, Y, y2), B)]
    assert np.abs(2 * (x2 * rates[1] + y2 * rates[3]) - system.d * np.cos(T)).max() < 3 * ROUNDOFF


@systems
def test_isokinetic_field_is_the_field_on_the_constraint(system):
    """With velocity s n: (s n)' = s' n + s n' is the acceleration of (12), (22), with s' = d cos t/(2 s)."""
    velocity, rates = system.vector_field(T, ((X, Y), N), B)
    s = np.sqrt(squared_speed(system))
    x2, y2 = (s * n for n in N)
    _, ax, _, ay = (np.asarray(rate) for rate in constrained_field(system, T, (X, x2, Y, y2), B))
    stretch = system.d * np.cos(T) / (2 * s)
    for moved, n, rate, v, acceleration in zip(velocity, N, rates, (x2, y2), (ax, ay), strict=True):
        assert np.abs(np.asarray(moved) - v).max() < 4 * UNIT
        assert np.abs(stretch * n + s * np.asarray(rate) - acceleration).max() < ROUNDOFF
    assert np.abs(sum(n * np.asarray(rate) for n, rate in zip(N, rates, strict=True))).max() < ROUNDOFF


@systems
def test_symmetry(system):
    """(x, y, n) → (−x, −y, −n) turns every rate around, bit for bit."""
    state = (X, Y), N
    rates = system.vector_field(T, state, B)
    mirrored = system.vector_field(T, jax.tree.map(np.negative, state), B)
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
def test_force_pullback(system):
    """p ∂F/∂(x1, y1, b) in closed form is the reverse-mode derivative of the force."""
    q, p, weight = (X, Y), N, np.full(MOMENTS, 0.7)
    g = system.forcing(T) * weight
    by_q, by_b = jax.vjp(lambda q, b: system.force(q, g, weight, b), q, B)[1](p)
    rows = system.force_pullback(q, g, weight, B, p)
    np.testing.assert_allclose(np.array(rows), np.array([*by_q, by_b]), atol=ROUNDOFF, rtol=0)
