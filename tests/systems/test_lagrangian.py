"""Equations of motion from T, Q and f: against the paper's own, closed forms of two classics, and exact identities."""

from __future__ import annotations

import math

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.solvers import SOLVERS, SPLITTINGS
from jaxnh.systems.lagrangian import Equations, Motion, accelerations, lagrangian
from jaxnh.systems.status import STATUS
from tests.flows import sleigh
from tests.flows.paper_equations import constrained_field
from tests.flows.particle import SYSTEMS
from tests.helpers.diffrax_solvers import DriftTerm, KickTerm, ProjectedSolver, RungeKuttaSolver, SplittingSolver

MOMENTS = 200
RNG = np.random.default_rng(21)
T, B = RNG.uniform(0, 20, MOMENTS), RNG.uniform(0.01, 6, MOMENTS)
X, Y, THETA = RNG.uniform(-1.5, 1.5, MOMENTS), RNG.uniform(-1.5, 1.5, MOMENTS), RNG.uniform(-np.pi, np.pi, MOMENTS)
EXACT = 1e-12  # some thirty products, each of them below 100, and one division by a speed near one


def particle(a, omega, b, c=None, d=0.0):
    """The paper's particle as T, Q and f: free where there is no c, at the speed √(c + d sin t) where there is."""

    def kinetic(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def forces(q, v, t):
        (x, y), g = q, 1.0 + jnp.sin(omega * t)
        return -a * g * x - g * x**3 - a * v[0] + b * y, -g * y - a * g * y**3 - a * v[1] + b * x

    def speed(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 - c - d * jnp.sin(t),)

    return Equations(kinetic, forces, None if c is None else speed)


def on_the_constraint(system):
    speed = np.sqrt(system.c + system.d * np.sin(T))
    return speed * np.cos(THETA), speed * np.sin(THETA)


def solved(system, v, *constraint):
    """q̈ and λ of the particle at all moments, in one program of arrays."""
    solve = jax.jit(lambda v, b, t: accelerations(particle(system.a, system.omega, b, *constraint), (X, Y), v, t))
    return jax.tree.map(np.asarray, solve(v, B, T))


def applied(system, v):
    """Forces of (1) with their damping, written out here."""
    a, g = system.a, 1 + np.sin(system.omega * T)
    return -a * g * X - g * X**3 - a * v[0] + B * Y, -g * Y - a * g * Y**3 - a * v[1] + B * X


systems = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)


def test_free_particle_is_1():
    system = SYSTEMS["other"]
    v = on_the_constraint(system)
    a, multipliers, singular = solved(system, v)
    assert multipliers == ()
    assert not singular.any()
    for one, other in zip(a, applied(system, v), strict=True):
        assert np.abs(one - other).max() < EXACT


@systems
def test_held_particle_is_12_and_22(system):
    """The accelerations are those of (12) and (22), and λ is (11) and, with + before d cos t, (21)."""
    v = on_the_constraint(system)
    a, (multiplier,), singular = solved(system, v, system.c, system.d)
    assert not singular.any()
    _, ax, _, ay = (np.asarray(rate) for rate in constrained_field(system, T, (X, v[0], Y, v[1]), {"b": B}))
    assert np.abs(a[0] - ax).max() < EXACT
    assert np.abs(a[1] - ay).max() < EXACT
    assert np.abs(multiplier - multiplier_of_21(system, v, +1)).max() < EXACT


@systems
def test_sign_slip_of_21(system):
    """(21) as printed, with −(d cos t)/2, is off by (d cos t)/2/(c + d sin t), half of it from either sign."""
    v = on_the_constraint(system)
    _, (multiplier,), _ = solved(system, v, system.c, system.d)
    slip = system.d * np.cos(T) / (2 * (system.c + system.d * np.sin(T)))
    assert np.abs(multiplier - multiplier_of_21(system, v, -1) - slip).max() < EXACT
    assert (np.abs(slip).max() > 0.01) == (system.d != 0)


def multiplier_of_21(system, v, sign):
    """(21), which is (11) without a disturbance, with a sign of its own before (d cos t)/2."""
    a, g = system.a, 1 + np.sin(system.omega * T)
    power = (a * g * X + g * X**3 - B * Y) * v[0] + (g * Y + a * g * Y**3 - B * X) * v[1]
    return a / 2 + (power + sign * system.d * np.cos(T) / 2) / (2 * (system.c + system.d * np.sin(T)))


# ---- the bordered solve


def test_reduced_mass():
    """A bead on a wire y = x²: with M and the constraint ẏ = 2xẋ, (1 + 4x²) ẍ = −4xẋ² − 2gx, g = 9."""
    bead = Equations(
        lambda q, v, t: v[0] ** 2 + v[1] ** 2,
        lambda q, v, t: (0.0, -18.0),
        lambda q, v, t: (v[1] - 2.0 * q[0] * v[0],),
    )
    a, _, _ = accelerations(bead, (X, X**2), (Y, 2 * X * Y), T)
    assert np.abs(np.asarray(a[0]) + (4 * X * Y**2 + 18 * X) / (1 + 4 * X**2)).max() < EXACT


def test_energy_that_depends_on_place_and_time():
    """T = (1 + t) e^{q} q̇²/2: d/dt(∂T/∂q̇) − ∂T/∂q = (1 + t) e^q (q̈ + q̇²/2) + e^q q̇ = 0."""
    free = Equations(lambda q, v, t: 0.5 * (1.0 + t) * jnp.exp(q[0]) * v[0] ** 2, lambda q, v, t: (0.0,))
    a, _, _ = accelerations(free, (X,), (Y,), T)
    assert np.abs(np.asarray(a[0]) + Y**2 / 2 + Y / (1 + T)).max() < EXACT


# ---- trajectories


def march(system, state, t1, steps, p=None, solver="dopri8"):
    """State at t1 from t = 0 by constant steps."""
    solver = ProjectedSolver(SOLVERS[solver], system)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(system.rhs),
        solver,
        0.0,
        t1,
        t1 / steps,
        state,
        args=p or {},
        max_steps=steps + 1,
        throw=False,
    )
    return jax.tree.map(lambda leaf: np.asarray(leaf[-1]), solution.ys)


def motion(q, v):
    return jax.tree.map(jnp.asarray, Motion(tuple(map(float, q)), tuple(map(float, v)), (0.0, 0.0)))


def test_chaplygin_sleigh():
    """Its closed form, until it has turned round, and its energy."""
    phase, t1 = -2.0, 4.0
    system, start = lagrangian(sleigh.sleigh, sleigh.PARAMETERS), sleigh.start(phase)
    end = march(system, start, t1, 2000, {"mass": sleigh.PARAMETERS["mass"]}, "tsit5")
    exact = sleigh.motion(phase, t1, **sleigh.PARAMETERS)
    assert exact[1] > 1.4  # of 1.5: backwards at first, as fast as ahead in the end
    assert np.abs(sleigh.numbers(end) - exact).max() < 1e-11
    energy = [float(sleigh.sleigh(**sleigh.PARAMETERS)["T"](s.q, s.v, 0.0)) for s in (start, end)]
    assert abs(energy[1] - energy[0]) < 1e-11


def appell_hamel(ratio=0.7, gravity=9.0, stiffness=0.0):
    """The Appell–Hamel machine: ẋ² + ẏ² = ratio² ż², nonlinear in the velocities; springs to the origin if wanted."""

    def kinetic(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)

    def forces(q, v, t):
        return -stiffness * q[0], -2.0 * stiffness * q[1], -gravity

    def wheel(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 - ratio**2 * v[2] ** 2,)

    return {"T": kinetic, "Q": forces, "f": wheel, "coordinates": ("x", "y", "z"), "period": 1.0}


@pytest.mark.slow
def test_appell_hamel_machine():
    """It falls with z'' = −g/(1 + r²) along a straight line (Hamel, Theoretische Mechanik, 1949), λ = x''/(2x').

    The motion is quadratic in time, so that any method from order two on follows it to rounding.
    """
    ratio, gravity, t1 = 0.7, 9.0, 2.0
    system = lagrangian(appell_hamel, {"ratio": ratio, "gravity": gravity, "stiffness": 0.0})
    along, fall = np.array([0.6, 0.8]), gravity / (1 + ratio**2)
    start = motion((0, 0, 0), (*(ratio * along), -1))
    end = march(system, start, t1, 10, {"ratio": ratio}, "tsit5")
    expected = (*(ratio * along * (t1 + fall * t1**2 / 2)), -(t1 + fall * t1**2 / 2))
    assert np.abs(np.subtract(end.q, expected)).max() < 1e-12
    (multiplier,) = system.multipliers(0.0, start, {"ratio": ratio})
    assert abs(float(multiplier) - fall / 2) < 1e-12


@pytest.mark.slow
def test_energy_of_the_appell_hamel_machine_in_springs():
    """f is homogeneous in the velocities, so its reaction does no work: the energy stays to the error of the method."""
    parameters = {"ratio": 0.7, "gravity": 0.0, "stiffness": 1.0}
    system = lagrangian(appell_hamel, parameters)
    start = motion((0.3, -0.2, 0), (0.42, 0.56, -1))
    energies = []
    for state in (start, *(march(system, start, 2.0, steps, {"ratio": 0.7}) for steps in (25, 50))):
        (x, y, _), v = state.q, state.v
        energies.append(float(0.5 * sum(u * u for u in v) + 0.5 * x**2 + y**2))
    coarse, fine = np.abs(np.subtract(energies[1:], energies[0]))
    assert fine < coarse / 2**7 + 1e-14  # order eight, one power left for the terms that follow
    assert fine < 1e-10


# ---- projection and failures


@pytest.mark.slow
def test_projection_is_orthogonal_and_its_drift_is_kept():
    """One coarse step leaves f = 0 by its error; the projection moves v along M⁻¹Aᵀ alone, and keeps that |f|."""
    system, plain = lagrangian(sleigh.sleigh, {"mass": 1.3, "inertia": 0.4, "length": 0.6}), SOLVERS["tsit5"]
    start = motion((0, 0, 0.3), (math.cos(0.3), math.sin(0.3), 2.0))
    before, after = stepped(
        (RungeKuttaSolver(plain), ProjectedSolver(plain, system)), system, start, 0.3, {"mass": 1.3}
    )
    (drift,), (left,) = (system.residuals(0.3, state, {"mass": 1.3}) for state in (before, after))
    assert abs(float(drift)) > 1e-6
    assert abs(float(left)) < 1e-15
    assert abs(after.watch[0] - abs(float(drift))) < 1e-15
    assert after.watch[1] == 0
    assert after.q == before.q
    theta, moved = after.q[2], np.subtract(after.v, before.v)
    metric = jax.hessian(lambda v: sleigh.sleigh(1.3)["T"](after.q, v, 0.0))(jnp.asarray(before.v))
    for free in ((np.cos(theta), np.sin(theta), 0.0), (0.0, 0.0, 1.0)):  # directions that the blade allows
        assert abs(np.dot(free, np.asarray(metric) @ moved)) < 1e-15


def stepped(solvers, system, state, h, p):
    """States after one step from t = 0, one a solver, in one program."""
    term = diffrax.ODETerm(system.rhs)

    def step(y, p):
        return [solver.step(term, 0.0, h, y, p, solver.init(term, 0.0, h, y, p), False)[0] for solver in solvers]

    return jax.tree.map(np.asarray, jax.jit(step)(state, p))


def test_projection_of_a_nonlinear_constraint():
    """Two Newton steps bring a drift of a hundredth down to its cube, and a drift beyond measure is a failure."""
    system = lagrangian(appell_hamel, {"ratio": 1.0, "gravity": 9.0, "stiffness": 0.0})
    small = system.project(0.0, motion((0, 0, 0), (0.6, 0.8, -1.0001)), {"ratio": 1.0})
    assert abs(float(system.residuals(0.0, small, {"ratio": 1.0})[0])) < 1e-11
    assert STATUS[int(small.watch[1])] == "ok"
    large = system.project(0.0, motion((0, 0, 0), (0.6, 0.8, -9.0)), {"ratio": 1.0})
    assert STATUS[int(large.watch[1])] == "off_constraint"
    assert not np.isfinite(large.v).any()


def test_singular_lanes_fail_alone():
    """At rest the wheel may go anywhere, ∂f/∂q̇ = 0: that lane fails with its reason, its neighbour goes on."""
    system = lagrangian(appell_hamel, {"ratio": 1.0, "gravity": 9.0, "stiffness": 0.0})
    states = jax.tree.map(lambda *x: jnp.stack(x), motion((0, 0, 0), (0, 0, 0)), motion((0, 0, 0), (0.6, 0.8, -1)))
    end = jax.vmap(lambda state: march_traced(system, state, {"ratio": 1.0}, 1.0, 5))(states)
    assert [STATUS[int(code)] for code in np.asarray(end.watch[1])] == ["singular", "ok"]
    assert np.isfinite(np.asarray(end.v)).all(axis=0).tolist() == [False, True]


def test_redundant_constraints_are_singular():
    """The same constraint twice has no definite multipliers."""

    def twice(ratio=1.0):
        machine = appell_hamel(ratio)
        return machine | {"f": lambda q, v, t: machine["f"](q, v, t) * 2}

    system = lagrangian(twice, {"ratio": 1.0})
    assert system.constraints == 2
    end = march_traced(system, motion((0, 0, 0), (0.6, 0.8, -1)), {"ratio": 1.0}, 1.0, 5)
    assert STATUS[int(end.watch[1])] == "singular"


def march_traced(system, state, p, t1, steps):
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(system.rhs), ProjectedSolver(SOLVERS["dopri5"], system), 0.0, t1, t1 / steps, state, args=p
    )
    return jax.tree.map(lambda leaf: leaf[-1], solution.ys)


# ---- names, start states, section points


def pendulum(length=1.0, omega=2.0, push=0.3):
    """A pendulum on a carriage that nothing but its own place holds: an angle, and a coordinate that is ignorable."""
    return {
        "T": lambda q, v, t: 0.5 * (v[1] ** 2 + (length * v[0]) ** 2) + length * v[0] * v[1] * jnp.cos(q[0]),
        "Q": lambda q, v, t: (-length * jnp.sin(q[0]), push * jnp.cos(omega * t)),
        "coordinates": ("angle", "place"),
        "period": 2 * math.pi / omega,
        "angles": ("angle",),
        "ignorable": ("place",),
    }


PENDULUM = lagrangian(pendulum, {"length": 1.0, "omega": 2.0, "push": 0.3})


def test_names():
    """Coordinates with their velocities, parameters with their values; those that the period depends on are shared."""
    assert PENDULUM.coordinates == ("angle", "angle_dot", "place", "place_dot")
    assert dict(PENDULUM.parameters) == {"length": 1.0, "omega": 2.0, "push": 0.3}
    assert [name for name in (*PENDULUM.parameters, "angle") if PENDULUM.roles.is_shared(name)] == ["omega"]
    words = [PENDULUM.readout.labels.long_names[name] for name in ("angle", "angle_dot", "place", "push")]
    assert words == ["angle angle", "velocity angle_dot", "coordinate place", "parameter push"]
    assert PENDULUM.readout.labels.planes[0] == ("angle", "angle_dot")
    assert PENDULUM.period == math.pi
    assert PENDULUM.chart.dimension == PENDULUM.exponents == 3


def test_start_and_section_points():
    """Lanes side by side: coordinates by name, and section points without what is ignorable, as the chart has them."""
    theta, rate = np.linspace(-3, 3, 7), np.linspace(0, 1, 7)
    start = PENDULUM.start({"angle": theta, "angle_dot": rate, "place": 0.5, "place_dot": -1.0})
    assert start.q[1] == 0.5
    np.testing.assert_array_equal(start.watch[0], np.zeros(7))
    points = PENDULUM.chart.host_points(start)
    np.testing.assert_array_equal(points, np.stack([theta, rate, np.full(7, -1.0)], axis=-1))
    whole = jax.tree.map(lambda leaf: jnp.asarray(np.broadcast_to(leaf, 7)), start)
    np.testing.assert_allclose(points, jax.vmap(PENDULUM.chart.point)(whole), rtol=0, atol=1e-15)
    again = PENDULUM.chart.host_points(jax.tree.map(np.asarray, jax.vmap(PENDULUM.chart.state)(jnp.asarray(points))))
    np.testing.assert_array_equal(again, points)


def test_parameters_of_a_lane_replace_those_of_the_flow():
    """Two at once as one after the other, in rates and divergence."""
    state = jax.tree.map(jnp.float64, Motion((0.4, 0.1), (1.1, -0.3), (0.0, 0.0)))
    t = jnp.float64(0.7)
    for p in ({"length": 0.7, "push": 2.0}, {"push": 2.0}, {"length": 0.7, "push": 2.0, "omega": 1.3}):
        own = lagrangian(pendulum, {**PENDULUM.values, **p})
        for one, other in zip(PENDULUM.rhs(t, state, p).v, own.rhs(t, state, {}).v, strict=True):
            assert one == other
        assert PENDULUM.divergence(t, state, p) == own.divergence(t, state, {})
    # (M q̈)_place: place'' + length (angle'' cos − angle'² sin) = push cos ωt; (M q̈)_angle likewise, divided by length
    length, push = 0.7, 2.0
    q, v = (0.4, 0.1), (1.1, -0.3)
    a = PENDULUM.rhs(t, state, {"length": length, "push": push}).v
    assert abs(a[1] + length * (a[0] * math.cos(q[0]) - v[0] ** 2 * math.sin(q[0])) - push * math.cos(1.4)) < 1e-14
    assert abs(length * a[0] + a[1] * math.cos(q[0]) + math.sin(q[0])) < 1e-14


# ---- three dimensions


class Isokinetic3(eqx.Module):
    """A particle in three dimensions at unit speed, for the isokinetic splittings."""

    b: float

    def speed(self, t):
        return jnp.ones_like(t)

    def forcing(self, t):
        return 1.0 + jnp.sin(t)

    def path_length(self, t0, t1):
        return t1 - t0

    def force(self, q, g, weight, p):
        return oscillators(q, g, weight * p["b"])


def oscillators(q, g, coupling):
    x, y, z = q
    return coupling * y - g * x * (0.5 + x * x), coupling * z - g * y * (1.0 + y * y), coupling * x - g * z


@pytest.mark.slow
def test_three_dimensions():
    """Constant speed in space by an isokinetic splitting and by T, Q and f: two methods that share no code."""

    def define(b=1.5):
        return {
            "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2),
            "Q": lambda q, v, t: oscillators(q, 1.0 + jnp.sin(t), b),
            "f": lambda q, v, t: (v[0] ** 2 + v[1] ** 2 + v[2] ** 2 - 1.0,),
            "coordinates": ("x", "y", "z"),
            "period": 2 * math.pi,
        }

    b, q, n = 1.5, (0.1, -0.2, 0.3), (2 / 3, -2 / 3, 1 / 3)
    particle = Isokinetic3(b)
    start = jax.tree.map(jnp.asarray, (q, n))
    split = diffrax.diffeqsolve(
        (DriftTerm(particle), KickTerm(particle)), SplittingSolver(SPLITTINGS["sofroniou_spaletta10"]), 0.0, 2 * math.pi, math.pi / 60,
        start, args={"b": b}, max_steps=200,
    )  # fmt: skip
    general = march(lagrangian(define, {"b": b}), motion(q, n), 2 * math.pi, 400, {"b": b})
    for one, other in zip((*split.ys[0], *split.ys[1]), (*general.q, *general.v), strict=True):
        assert abs(float(one[-1]) - float(other)) < 1e-11
