"""Maps by an explicit pair with steps of a lane's own, in both forms: tangents and volume against DOP853 and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.maps import adaptive
from jaxnh.maps.adaptive import adaptive_strobe
from jaxnh.maps.build import cut_strobe, make_return_map
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import ADAPTIVE
from jaxnh.systems.first_order import first_order
from jaxnh.systems.lagrangian import Motion, lagrangian

pytestmark = pytest.mark.usefixtures("quick_compiling")

FORMS = pytest.mark.parametrize("rolled", [True, False], ids=["loop", "written out"])
PERIOD = 2 * math.pi


def solver_of(name, rolled):
    return replace(ADAPTIVE[name], rolled=rolled)


def forced(mu=2.0):
    """x'' = mu (1 − x²) x' − x + cos(t) / 2."""
    rhs = lambda y, t: (y[1], mu * (1.0 - y[0] ** 2) * y[1] - y[0] + 0.5 * jnp.cos(t))  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": PERIOD}


FORCED = first_order(forced, {"mu": 2.0}, ("mu",))
START = (1.3, -0.4)


def state_of(*values):
    return jax.tree.map(jnp.float64, FORCED.start(dict(zip("xv", values, strict=True))))


UNITS = Tangent(state_of(1.0, 0.0)), Tangent(state_of(0.0, 1.0))
BY_MU = Tangent(state_of(0.0, 0.0), {"mu": jnp.float64(1.0)})


def variations(t, y, mu=2.0):
    """Rates of (x, v), of its derivatives in x, v and mu at the beginning, and of the logarithm of a volume."""
    (x, v), columns = y[:2], y[2:8].reshape(2, 3)
    matrix = np.array([[0.0, 1.0], [-2.0 * mu * x * v - 1.0, mu * (1.0 - x * x)]])
    slopes = matrix @ columns
    slopes[1, 2] += (1.0 - x * x) * v
    field = [v, mu * (1.0 - x * x) * v - x + 0.5 * np.cos(t)]
    return np.concatenate([field, slopes.ravel(), [np.trace(matrix)]])


def pushed_by(rolled, tangents, name="adaptive_tsitouras_papakostas8"):
    strobe = make_return_map(FORCED, solver_of(name, rolled), 60)
    return jax.jit(lambda s, z: s.pushforward(z, {"mu": jnp.float64(2.0)}, tangents))(strobe, state_of(*START))


@FORMS
@pytest.mark.parametrize("parameter", [True, False], ids=["of a parameter as well", "of the state"])
def test_tangents_and_volume_solve_the_variational_equations(rolled, parameter):
    """With tangents of the parameter and without, by which ways to linearise differ."""
    pushed = pushed_by(rolled, (*UNITS, BY_MU) if parameter else UNITS)
    start = [*START, *np.eye(2, 3).ravel(), 0.0]
    exact = solve_ivp(variations, (0.0, PERIOD), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(jax.tree.leaves(pushed.state), exact[:2], atol=1e-10)
    columns = np.stack([jax.tree.leaves(t.state) for t in pushed.tangents], axis=1)
    np.testing.assert_allclose(columns, exact[2:8].reshape(2, 3)[:, : len(pushed.tangents)], atol=1e-9)
    assert abs(float(pushed.log_volume) - exact[8]) < 1e-9


@FORMS
def test_tangents_are_derivatives_of_the_map(rolled):
    """As `jax.jvp` has them of the state alone, of which steps are the same."""
    strobe, mu = make_return_map(FORCED, solver_of("adaptive_tsit5", rolled), 60), jnp.float64(2.0)
    pushed = pushed_by(rolled, (*UNITS, BY_MU), "adaptive_tsit5")
    along = [jax.jvp(lambda z: strobe(z, {"mu": mu}), (state_of(*START),), (unit.state,))[1] for unit in UNITS]
    along.append(jax.jvp(lambda mu: strobe(state_of(*START), {"mu": mu}), (mu,), (jnp.float64(1.0),))[1])
    for tangent, slope in zip(pushed.tangents, along, strict=True):
        np.testing.assert_allclose(jax.tree.leaves(tangent.state), jax.tree.leaves(slope), rtol=0, atol=1e-11)


def test_both_forms_take_the_same_steps_to_rounding():
    """Lanes side by side, each with its own number of steps and its own parameter; a single tangent is no array."""
    states = jax.tree.map(lambda x: x * jnp.linspace(0.5, 2.0, 5), state_of(*START))
    mu, results = jnp.linspace(0.5, 5.0, 5), []
    for rolled in (True, False):
        strobe = adaptive_strobe(FORCED, solver_of("adaptive_dopri8", rolled), 30, (0.0, PERIOD))

        def lane(z, mu, strobe=strobe):
            p = {"mu": mu}
            return (
                strobe.pushforward(z, p, (UNITS[0],)),
                strobe.pushforward(z, p, (UNITS[1], BY_MU)),
                strobe.trials(z, p),
            )

        results.append(jax.jit(jax.vmap(lane))(states, mu))
    counts = [np.asarray(result[-1]) for result in results]
    assert np.array_equal(counts[0], counts[1])
    assert counts[0].max() > 1.5 * counts[0].min()
    for one, other in zip(*(jax.tree.leaves(result[:2]) for result in results), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)


def test_parts_of_a_period_know_of_the_loop():
    """Trip counts, of maps one after another too: the second loop is that over the stages."""
    for rolled, inner in ((True, (13.0,)), (False, ())):
        solver = solver_of("adaptive_tsitouras_papakostas8", rolled)
        assert make_return_map(FORCED, solver, 40).trip_counts == (40.0, *inner)
        assert cut_strobe(FORCED, solver, 40, 4).trip_counts == (10.0, *inner)


def test_explicit_steps_may_be_eight_times_as_many(monkeypatch):
    """As where a motion passes a singularity: a lane with more than implicit ones may be still arrives."""
    monkeypatch.setattr(adaptive, "_MOST_TRIALS", 20)
    strobe = adaptive_strobe(FORCED, solver_of("adaptive_dopri8", rolled=True), 30, (0.0, PERIOD))
    trials, ended = jax.jit(lambda z: (strobe.trials(z, {"mu": 2.0}), strobe(z, {"mu": 2.0})))(state_of(*START))
    assert 20 < int(trials) < 160
    assert np.isfinite(jax.tree.leaves(ended)).all()


# ---- constraints


def sleigh(length=0.3):
    """Chaplygin's sleigh with springs: its constraint gives no velocity, and steps leave it."""
    return {
        "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2),
        "Q": lambda q, v, t: (-q[0], -q[1], -length * v[2]),
        "f": lambda q, v, t: (v[1] * jnp.cos(q[2]) - v[0] * jnp.sin(q[2]),),
        "coordinates": ("x", "y", "theta"),
        "period": 3.0,
    }


def sleigh_by_speed(t, z):
    """Rates of (x, y, theta, speed along the blade, rate of theta, length), and of two tangents of these."""

    def rates(z):
        x, y, theta, u, w, length = z
        c, s = np.cos(theta), np.sin(theta)
        return np.array([u * c, u * s, w, -x * c - y * s, -length * w, 0.0])

    x, y, theta, u, _, length = z[:6]
    c, s = np.cos(theta), np.sin(theta)
    matrix = np.zeros((6, 6))
    matrix[0, 2:4], matrix[1, 2:4], matrix[2, 4] = (-u * s, c), (u * c, s), 1.0
    matrix[3, :3], matrix[4, 4:] = (-c, -s, x * s - y * c), (-length, -z[4])
    return np.concatenate([rates(z[:6]), matrix @ z[6:12], matrix @ z[12:]])


@FORMS
def test_tangents_go_along_constraints(rolled):
    """Projected after every step, in the direction of theta and in that of the parameter."""
    flow = lagrangian(sleigh, {"length": 0.3}, ("length",))
    assert flow.reduction.leaves_constraints
    x, y, theta, u, w = start = 0.5, -0.2, 0.7, 0.8, 0.9
    c, s = math.cos(theta), math.sin(theta)

    def motion(q, v):
        return jax.tree.map(jnp.float64, Motion(q, v, (0.0, 0.0)))

    state = motion((x, y, theta), (u * c, u * s, w))
    turned = motion((0.0, 0.0, 1.0), (-u * s, u * c, 0.0))
    tangents = Tangent(turned), Tangent(jax.tree.map(jnp.zeros_like, state), {"length": jnp.float64(1.0)})
    strobe = make_return_map(flow, solver_of("adaptive_dopri8", rolled), 30)
    pushed = jax.jit(lambda m, z: m.pushforward(z, {"length": jnp.float64(0.3)}, tangents, volume=False))(strobe, state)
    begun = [*start, 0.3, *np.eye(6)[2], *np.eye(6)[5]]
    exact = solve_ivp(sleigh_by_speed, (0.0, 3.0), begun, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1].reshape(3, 6)
    theta, u = exact[0, 2:4]
    c, s = math.cos(theta), math.sin(theta)
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3, 2:4], whole[4, 2:4], whole[5, 4] = np.eye(3), (-u * s, c), (u * c, s), 1.0
    found = [np.array([*t.q, *t.v]) for t in (pushed.state, *(t.state for t in pushed.tangents))]
    np.testing.assert_allclose(found[0], [*exact[0, :3], u * c, u * s, exact[0, 4]], atol=1e-9)
    np.testing.assert_allclose(found[1:], exact[1:] @ whole.T, atol=1e-8)


# ---- a section


@FORMS
def test_tangents_of_a_return_in_closed_form(rolled):
    """x'' + 2γx' + w²x = 0 from x = 0 upwards: its time is 2π/Ω and its factor exp(−2πγ/Ω), with Ω² = w² − γ²."""
    gamma, w = 0.1, 1.5

    def damped(w=w):
        rhs = lambda y, t: (y[1], -2.0 * gamma * y[1] - w**2 * y[0])  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": 3.0}

    flow = first_order(damped, {"w": w}, ("w",))
    section = Section(flow, "x", 0, 0.0, "up")
    strobe = make_return_map(section, solver_of("adaptive_dopri8", rolled), 60)
    start = jax.tree.map(jnp.float64, begin(section, flow.start({"x": 0.0, "v": 1.0})))
    still = jax.tree.map(jnp.zeros_like, start)
    tangents = Tangent(section.chart.lift(start, (jnp.float64(1.0),))), Tangent(still, {"w": jnp.float64(1.0)})
    pushed = jax.jit(lambda m, z: m.pushforward(z, {"w": jnp.float64(w)}, tangents))(strobe, start)
    omega = math.sqrt(w**2 - gamma**2)
    factor, by_w = math.exp(-2 * math.pi * gamma / omega), -w / omega**3
    lowered = [float(section.chart.lower(pushed.state, t.state)[0]) for t in pushed.tangents]
    np.testing.assert_allclose(lowered, [factor, -2 * math.pi * gamma * by_w * factor], atol=1e-9)
    np.testing.assert_allclose([float(t.state.t) for t in pushed.tangents], [0.0, 2 * math.pi * by_w], atol=1e-9)
    assert abs(float(pushed.state.t) - 2 * math.pi / omega) < 1e-9
    assert abs(float(pushed.log_volume) - math.log(factor)) < 1e-9
