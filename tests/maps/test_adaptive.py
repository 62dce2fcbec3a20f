"""Maps by steps of a lane's own: stiff flows against closed forms, published numbers and Radau; tangents; failures."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.maps import adaptive
from jaxnh.maps.build import cut_strobe, make_parts, make_return_map, maps_between
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.section import Section, begin, reports
from jaxnh.solvers import ADAPTIVE, SOLVERS
from jaxnh.systems.first_order import first_order
from jaxnh.systems.lagrangian import lagrangian
from jaxnh.systems.status import NO_RETURN, NOT_FINITE, OUT_OF_STEPS
from tests.flows import calm_particle, linear_oscillator
from tests.helpers.cases import some_slow
from tests.helpers.one_lane import compiled_iterate

pytestmark = pytest.mark.usefixtures("quick_compiling")

RODAS = SOLVERS["rodas5p"]


def flow_of(rhs, names, unit=1.0, clock=False, **parameters):
    """A flow of rhs(y, t, **parameters)."""

    def define(**values):
        time = {"period" if clock else "time_unit": unit}
        return {"rhs": lambda y, t: rhs(y, t, **values), "coordinates": names, **time}

    return first_order(define, parameters)


def start_of(flow, *values):
    return jax.tree.map(jnp.float64, flow.start(dict(zip(flow.coordinates, values, strict=True))))


def image(strobe, state, **p):
    return np.array(jax.tree.leaves(compiled_iterate(strobe, 1, state, p)))


def van_der_pol(y, t, mu):
    return y[1], mu * (1.0 - y[0] ** 2) * y[1] - y[0]


def oregonator(y, t, s):
    q, w = 8.375e-6, 0.161
    return s * (y[1] + y[0] * (1.0 - q * y[0] - y[1])), (y[2] - (1.0 + y[0]) * y[1]) / s, w * (y[0] - y[2])


def robertson(y, t, k):
    slow, fast = k * y[0], 1e4 * y[1] * y[2]
    return -slow + fast, slow - fast - 3e7 * y[1] ** 2, 3e7 * y[1] ** 2


# ---- orders: errors fall with the steps as those of equal steps


@pytest.mark.parametrize("name", some_slow(dict(zip(ADAPTIVE, ADAPTIVE, strict=True)), "rodas5p", "adaptive_tsit5"))
def test_errors_fall_by_the_order(lanes, name):
    """Of the linear oscillator, whose motion is a closed form; over a factor of four, as steps come in whole numbers.

    The first steps grow from a short one and the last is cut, which is a good part of few: where 8, 12, 32 and 48 are
    asked for, 9, 12, 26 and 38 are tried (counted by the least number that may be tried).
    """
    flow, solver = linear_oscillator.known_flow(), SOLVERS[name]
    steps = 24 if solver.convergence_order < 8 else 12
    coarse, fine = (np.exp(np.log(flow.errors(lanes, solver, n)).mean()) for n in (steps, 4 * steps))
    assert abs(math.log(coarse / fine, 4.0) - solver.convergence_order) < 1.0


# ---- cards


def test_a_stiff_map_and_its_tangents_are_lowered_for_cuda():
    """In float64, with no call of the host and none of a CPU's library."""
    flow = flow_of(oregonator, ("x", "y", "z"), s=77.27)
    strobe, state = make_return_map(flow, RODAS, 16), start_of(flow, 1.0, 2.0, 3.0)

    def push(state, p):
        tangents = (Tangent(jax.tree.map(jnp.ones_like, state), {"s": jnp.float64(1.0)}),)
        return strobe.pushforward(state, p, tangents)

    batch = jax.tree.map(lambda leaf: jnp.full(8, leaf), (state, {"s": 77.27}))
    text = jax.jit(jax.vmap(push)).trace(*batch).lower(lowering_platforms=("cuda",)).as_text()
    assert "callback" not in text
    assert "custom_call" not in text
    assert "f64" in text
    assert "f32" not in text


# ---- stiff flows


@pytest.mark.parametrize(("mu", "period"), [(100.0, 162.83707109237), (1000.0, 1614.40112581)])
def test_period_of_van_der_pol(mu, period):
    """From crossing to crossing of x = 0 upwards on the cycle: the published periods, to their last digit."""
    flow = flow_of(van_der_pol, ("x", "v"), unit=mu / 4.0, mu=mu)
    section = Section(flow, "x", 0, 0.0, "up")
    strobe = make_return_map(section, RODAS, 256)
    crossing = compiled_iterate(strobe, 2, begin(section, start_of(flow, 2.0, 0.0)), {"mu": mu})
    later = compiled_iterate(strobe, 1, crossing, {"mu": mu})
    assert abs(float(later.t - crossing.t) / period - 1.0) < 1e-9


def test_period_of_the_oregonator():
    """Rates of 1e6 beside ones of 1e-3: the published period 302.858044, on the section y = 3 upwards."""
    flow = flow_of(oregonator, ("x", "y", "z"), unit=10.0, s=77.27)
    section = Section(flow, "y", 1, 3.0, "up")
    strobe = make_return_map(section, RODAS, 256)
    crossing = compiled_iterate(strobe, 2, begin(section, start_of(flow, 1.0, 2.0, 3.0)), {"s": 77.27})
    later = compiled_iterate(strobe, 1, crossing, {"s": 77.27})
    assert abs(float(later.t - crossing.t) - 302.858044) < 1e-5


@pytest.mark.slow  # a stiff flow beside Radau is quick
def test_robertson_against_published_values():
    """At t = 40 and 4e5 of Robertson's kinetics: the table of LSODE's demonstration, and Radau to more digits."""
    known = {
        40.0: (0.7158271, 9.1855e-6, 0.2841637),  # Hindmarsh, ACM SIGNUM Newsl. 15 (1980) 10
        4e5: (4.9383e-3, 1.9850e-8, 0.99506),
    }
    for length, values in known.items():
        flow = flow_of(robertson, ("a", "b", "c"), unit=length, k=0.04)
        ended = image(make_return_map(flow, RODAS, 256), start_of(flow, 1.0, 0.0, 0.0), k=0.04)
        exact = solve_ivp(
            lambda t, y: robertson(y, t, 0.04), (0.0, length), [1.0, 0.0, 0.0], "Radau", rtol=1e-12, atol=1e-18
        )
        np.testing.assert_allclose(ended, exact.y[:, -1], rtol=1e-8)
        np.testing.assert_allclose(ended, values, rtol=1e-4)
        assert abs(ended.sum() - 1.0) < 1e-12  # every linear invariant is kept


@pytest.mark.parametrize("name", ["rodas5p", "adaptive_tsit5"])
def test_forced_and_stiff_against_radau(name):
    """A van der Pol oscillator with a clock: the state a period later, and over parts of it one after another."""

    def forced(y, t, mu):
        x, v = van_der_pol(y, t, mu)
        return x, v + 1.2 * jnp.sin(0.63 * t)

    period = 2 * math.pi / 0.63
    flow = flow_of(forced, ("x", "v"), unit=period, clock=True, mu=50.0)
    exact = solve_ivp(lambda t, y: forced(y, t, 50.0), (0.0, period), [1.9, 0.1], "Radau", rtol=1e-12, atol=1e-13).y[
        :, -1
    ]
    whole = make_return_map(flow, SOLVERS[name], 400)
    assert np.shape(make_parts(flow, SOLVERS[name], 400, 1).length) == (1,)
    state = start_of(flow, 1.9, 0.1)
    np.testing.assert_allclose(image(whole, state, mu=50.0), exact, rtol=1e-8)

    @jax.jit
    def in_turn(parts, state):
        return jax.lax.scan(lambda z, part: (part(z, {"mu": 50.0}), None), state, parts)[0]

    for parts in (
        make_parts(flow, SOLVERS[name], 400, 4),
        cut_strobe(flow, SOLVERS[name], 400, 4),
        maps_between(flow, SOLVERS[name], 400, np.array([0.0, 0.1, 3.0, period])),
    ):
        np.testing.assert_allclose(jax.tree.leaves(in_turn(parts, state)), exact, rtol=1e-8)


# ---- tangents


def test_tangents_are_derivatives_of_the_map():
    """Of states and a parameter, as `jax.jvp` has them, and as central differences have them to the tolerance."""
    flow, mu = flow_of(van_der_pol, ("x", "v"), unit=5.0, mu=30.0), jnp.float64(30.0)
    strobe, state = make_return_map(flow, RODAS, 300), start_of(flow, 1.8, -0.4)
    zero, along = jax.tree.map(jnp.zeros_like, state), start_of(flow, 0.3, 0.7)
    tangents = Tangent(along, None), Tangent(zero, {"mu": jnp.float64(1.0)})
    pushed = jax.jit(lambda s, z: s.pushforward(z, {"mu": mu}, tangents))(strobe, state)
    by_state = jax.jvp(lambda z: strobe(z, {"mu": mu}), (state,), (along,))[1]
    by_mu = jax.jvp(lambda mu: strobe(state, {"mu": mu}), (mu,), (jnp.float64(1.0),))[1]
    for tangent, slope in zip(pushed.tangents, (by_state, by_mu), strict=True):
        np.testing.assert_allclose(jax.tree.leaves(tangent.state), jax.tree.leaves(slope), rtol=1e-12)
    ahead, behind = (image(strobe, state, mu=30.0 + s * 1e-3) for s in (1, -1))
    np.testing.assert_allclose(jax.tree.leaves(by_mu), (ahead - behind) / 2e-3, rtol=1e-5)


def test_a_stiff_linear_system_in_closed_form():
    """Rates −1e6, −40 and −0.5 in a basis that is not orthogonal: the map, its tangents and volume are exponentials."""
    rates, basis = np.array([-1e4, -40.0, -0.5]), np.array([[1.0, 0.4, 0.1], [-0.3, 1.0, 0.2], [0.5, 0.1, 1.0]])
    matrix = basis @ np.diag(rates) @ np.linalg.inv(basis)

    def linear(y, t, k):
        return tuple(k * sum(float(a) * x for a, x in zip(row, y, strict=True)) for row in matrix)

    length = 0.01
    flow = flow_of(linear, ("x", "y", "z"), unit=length, k=1.0)
    strobe, state = make_return_map(flow, RODAS, 300), start_of(flow, 1.0, -0.5, 0.7)
    units = [Tangent(start_of(flow, *row)) for row in np.eye(3)]
    pushed = jax.jit(lambda s, z: s.pushforward(z, {"k": jnp.float64(1.0)}, units))(strobe, state)
    exact = basis @ np.diag(np.exp(rates * length)) @ np.linalg.inv(basis)
    monodromy = np.stack([jax.tree.leaves(t.state) for t in pushed.tangents], axis=1)
    np.testing.assert_allclose(monodromy, exact, atol=1e-9)
    np.testing.assert_allclose(jax.tree.leaves(pushed.state), exact @ [1.0, -0.5, 0.7], atol=1e-9)
    assert abs(float(pushed.log_volume) - rates.sum() * length) < 1e-9  # a constant is integrated to rounding


@pytest.mark.slow  # tangents are derivatives of the map in a quick test
def test_multipliers_of_a_cycle_are_the_integral_of_the_divergence():
    """On van der Pol's cycle one multiplier is 1, and the other is exp ∮ μ (1 − x²) dt, which Radau integrates too."""
    mu = 5.0
    flow = flow_of(van_der_pol, ("x", "v"), unit=2.0, mu=mu)
    section = Section(flow, "x", 0, 0.0, "up")
    strobe = make_return_map(section, RODAS, 400)
    p = {"mu": jnp.float64(mu)}
    crossing = compiled_iterate(strobe, 3, begin(section, start_of(flow, 2.0, 0.0)), p)
    lifted = section.chart.lift(crossing, (jnp.float64(1.0),))
    pushed = jax.jit(lambda s, z: s.pushforward(z, p, (Tangent(lifted),)))(strobe, crossing)
    period = float(pushed.state.t - crossing.t)

    def with_divergence(t, y):
        return [*van_der_pol(y[:2], t, mu), mu * (1.0 - y[0] ** 2)]

    start = [*map(float, jax.tree.leaves(crossing.state)), 0.0]
    integral = solve_ivp(with_divergence, (0.0, period), start, "Radau", rtol=1e-12, atol=1e-13).y[2, -1]
    multiplier = float(section.chart.lower(pushed.state, pushed.tangents[0].state)[0])
    assert abs(float(pushed.log_volume) - integral) < 1e-7
    assert abs(multiplier) < 1e-8  # e^−21: far below what a cycle's rounding leaves of tangents


# ---- lanes


def test_lanes_have_steps_of_their_own_and_fail_alone():
    """y' = k y²: 1/(1 − k t) where it is finite, and not a number in the lane that goes to infinity."""
    flow = flow_of(lambda y, t, k: (k * y[0] ** 2,), ("y",), unit=2.0, k=0.1)
    strobe, k = make_return_map(flow, RODAS, 200), np.array([0.1, 0.45, 1.0, -3.0])
    ended = jax.jit(jax.vmap(lambda s, k: s(start_of(flow, 1.0), {"k": k}), (None, 0)))(strobe, k)
    found = np.asarray(ended.y[0])
    assert np.isnan(found[2])
    np.testing.assert_allclose(found[[0, 1, 3]], 1.0 / (1.0 - 2.0 * k[[0, 1, 3]]), rtol=1e-9)
    alone = [image(strobe, start_of(flow, 1.0), k=value) for value in k[[0, 1, 3]]]
    np.testing.assert_allclose(found[[0, 1, 3]], np.ravel(alone), rtol=1e-13)


def status_of(flow, states):
    """Status of lanes by their last states."""
    return np.asarray(reports(flow, jax.tree.map(lambda x: np.asarray(x)[..., None], states))["status"].data).tolist()


def test_a_lane_that_runs_out_of_steps_says_so(monkeypatch):
    """Beside one that arrives and one that goes to infinity; states tell it after one more map as well."""
    monkeypatch.setattr(adaptive, "_MOST_TRIALS", 2000)
    flow = flow_of(lambda y, t, k, w: (k * y[0] ** 2, w * y[2], -w * y[1]), ("x", "u", "v"), unit=2.0, k=0.1, w=1.0)
    strobe, k, w = make_return_map(flow, RODAS, 50), jnp.array([0.01, 0.01, 1.0]), jnp.array([1.0, 1e5, 1.0])
    move = jax.jit(jax.vmap(lambda s, z, k, w: s(z, {"k": k, "w": w}), (None, 0, 0, 0)))
    states = move(strobe, jax.tree.map(lambda x: jnp.full(3, x), start_of(flow, 1.0, 1.0, 0.0)), k, w)
    assert status_of(flow, states) == [0, OUT_OF_STEPS, NOT_FINITE]
    later = move(strobe, states, k, w)
    assert status_of(flow, later) == [0, OUT_OF_STEPS, NOT_FINITE]
    assert np.isnan(np.asarray(later.y)[:, 1:]).all()


def test_a_mechanical_system_runs_out_of_steps(monkeypatch):
    """An oscillator by T and Q from rest, whose states have a place of their own for the reason."""
    monkeypatch.setattr(adaptive, "_MOST_TRIALS", 2000)

    def define(w):
        return {
            "T": lambda q, v, t: 0.5 * v[0] ** 2, "Q": lambda q, v, t: (-(w**2) * q[0],), "coordinates": ("x",), "time_unit": 2.0
        }  # fmt: skip

    flow = lagrangian(define, {"w": 1.0})
    start = jax.tree.map(lambda x: jnp.full(2, x), flow.start({"x": 1.0, "x_dot": 0.0}))
    strobe, w = make_return_map(flow, RODAS, 50), jnp.array([1.0, 1e5])
    states = jax.jit(jax.vmap(lambda s, z, w: s(z, {"w": w}), (None, 0, 0)))(strobe, start, w)
    assert status_of(flow, states) == [0, OUT_OF_STEPS]


def test_a_section_knows_of_lanes_without_steps(monkeypatch):
    """Of two oscillators the second one turns thousands of times between two looks for its crossing."""
    monkeypatch.setattr(adaptive, "_MOST_TRIALS", 2000)
    flow = flow_of(lambda y, t, w: (w * y[1], -w * y[0]), ("x", "v"), unit=2.0, w=1.0)
    section = Section(flow, "x", 0, 0.0, "up")
    strobe, w = make_return_map(section, RODAS, 50), jnp.array([1.0, 1e6])
    begun = jax.tree.map(lambda x: jnp.full(2, x), begin(section, start_of(flow, 1.0, 0.0)))
    move = jax.jit(jax.vmap(lambda s, z, w: s(z, {"w": w}), (None, 0, 0)))
    crossings = move(strobe, begun, w)
    assert status_of(flow, crossings) == [0, OUT_OF_STEPS]
    assert abs(float(crossings.t[0]) - 1.5 * np.pi) < 1e-8
    assert status_of(flow, move(strobe, crossings, w)) == [0, OUT_OF_STEPS]


def test_a_section_that_is_not_met_says_so():
    flow = flow_of(lambda y, t, k: (-k * y[0],), ("y",), k=5.0)
    section = Section(flow, "y", 0, -1.0, "down", longest=20.0)
    strobe = make_return_map(section, RODAS, 64)
    crossing = compiled_iterate(strobe, 1, begin(section, start_of(flow, 1.0)), {"k": 5.0})
    assert float(crossing.reason) == NO_RETURN


def test_steps_are_projected_on_constraints(lanes):
    """The particle at a prescribed speed, whose direction keeps |n| = 1, against the Taylor reference."""
    known = calm_particle.known_flow("disturbed")
    coarse, fine = (np.exp(np.log(known.errors(lanes, RODAS, n)).mean()) for n in (60, 240))
    assert fine < 1e-6
    assert abs(math.log(coarse / fine, 4.0) - 5.0) < 1.0


def test_tangents_at_rest():
    """At rest, at zero and elsewhere, no state errs; tangents are exponentials of the field's matrix all the same."""

    def pendulum(y, t, place):
        return y[1], -jnp.sin(y[0] - place)

    flow = flow_of(pendulum, ("x", "v"), unit=3.0, place=1.0)
    strobe, tangents = make_return_map(flow, RODAS, 200), (Tangent(start_of(flow, 1.0, 0.0)),)
    push = jax.jit(lambda z, place: strobe.pushforward(z, {"place": place}, tangents))
    for place in (0.0, 3.0):
        pushed = push(start_of(flow, place, 0.0), place)
        slope = np.array(jax.tree.leaves(pushed.tangents[0].state))
        assert np.abs(slope - [np.cos(3.0), -np.sin(3.0)]).max() < 1e-8
