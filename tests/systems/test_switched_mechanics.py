"""T, Q and f with walls, switches and constraints that come and go: closed forms, DOP853 from event to event, identities."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import dopri8, tsit5
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.corners import forces_with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.switched_mechanics import switched_mechanics
from tests.flows import switched_sleighs
from tests.flows.switched_sleighs import TURN, flow_of
from tests.helpers.cases import some_slow
from tests.helpers.one_lane import states_after

pytestmark = pytest.mark.usefixtures("quick_compiling")

STATES = {
    switched_sleighs.by_clock: [(0.4, 1.0, 0.5, 0.3), (-1.0, -0.3, 0.8, -1.1)],
    switched_sleighs.by_place: [(0.3, 0.4, 1.0, 0.5, 0.3), (-0.4, -1.0, -0.3, 0.8, -1.1)],
}


def end(flow, states, steps=60, periods=1, solver=dopri8):
    """States after some periods, (count, components), the energy lost, and their drift."""
    strobe = make_return_map(flow, in_loop(solver), steps)
    after = states_after(strobe, jnp.array(states, float), {}, periods)
    drift, lost = (np.asarray(x) for x in after.watch)
    return np.stack(np.broadcast_arrays(*(np.asarray(x) for x in after.y)), axis=-1), lost, drift


def whole(kind, u):
    """(x, y, θ, velocities) of the section coordinates of a sleigh."""
    return np.r_[0.0, 0.0, u] if kind is switched_sleighs.by_clock else np.r_[u[0], 0.0, u[1:]]


@pytest.mark.parametrize("kind", STATES)
def test_a_blade_that_comes_and_goes(kind):
    """States and lost energy follow DOP853 from event to event, by the clock and by the place."""
    flow = flow_of(kind, a=0.3, drive=1.0)
    states, lost, drift = end(flow, STATES[kind])
    times = 0
    for u, state, loss in zip(STATES[kind], states, lost, strict=True):
        known, known_loss, count = switched_sleighs.period(kind, whole(kind, u))
        times += count
        assert np.abs(state - known).max() < 1e-9
        assert loss == pytest.approx(known_loss, abs=1e-10)
    assert drift.max() < 1e-6
    assert kind is switched_sleighs.by_clock or times >= 2


@pytest.mark.parametrize("kind", some_slow({kind.__name__: kind for kind in STATES}, "by_place"))
def test_derivatives_of_a_blade_that_comes_and_goes(kind):
    """Saltation matrices, and derivatives in the parameters, by differences of the motion from event to event."""
    own = {"a": 0.3, "drive": 1.0}
    flow, u, h = flow_of(kind, **own), np.array(STATES[kind][0]), 1e-4
    d = jax.jit(lambda u: derivatives(make_return_map(flow, in_loop(dopri8), 60), 1, u, own, tuple(own)))(jnp.array(u))
    kept = list(flow.chart.kept)

    def slope(change):
        fine, coarse = (change(h) - change(-h)) / (2 * h), (change(2 * h) - change(-2 * h)) / (4 * h)
        return (fine + (fine - coarse) / 3)[kept]

    for j in range(len(u)):
        column = slope(lambda e, j=j: switched_sleighs.period(kind, whole(kind, u + e * np.eye(len(u))[j]))[0])
        assert np.abs(np.asarray(d.monodromy)[:, j] - column).max() < 1e-7
    for j, name in enumerate(own):
        column = slope(
            lambda e, name=name: switched_sleighs.period(kind, whole(kind, u), **{**own, name: own[name] + e})[0]
        )
        assert np.abs(np.asarray(d.by_parameter)[:, j] - column).max() < 1e-7


def test_a_constraint_that_begins_takes_a_rank():
    """The volume is zero, exactly, and so is the smallest singular value of the derivative, to rounding."""
    flow = flow_of(switched_sleighs.by_clock, a=0.3, drive=1.0)
    strobe, u = make_return_map(flow, in_loop(tsit5), 40), jnp.array(STATES[switched_sleighs.by_clock][0])

    @jax.jit
    def pushed(u):
        z = flow.chart.state(u)
        tangents = tuple(Tangent(flow.chart.lift(z, tuple(e))) for e in jnp.eye(4))
        after = strobe.pushforward(z, {}, tangents)
        return jnp.stack([jnp.stack(flow.chart.components(t.state)) for t in after.tangents]), jnp.exp(after.log_volume)

    matrix, volume = pushed(u)
    values = np.linalg.svd(np.asarray(matrix), compute_uv=False)
    assert volume == 0.0
    assert values[-1] < 1e-14 * values[0] < 1e-13 * values[2] * 1e3


@pytest.mark.slow  # the matrix has constraints that come and go
def test_between_constraints_a_body_is_free():
    """Lifted before it starts, a blade lets the body turn evenly and its centre go straight: to rounding."""
    flow = flow_of(lambda phase: switched_sleighs.by_clock(0.3, 0.0, phase) | free(), phase=np.pi)
    (state,), lost, _ = end(flow, [(0.4, 1.0, 0.5, 0.3)], 20)
    # down at t = π: until then free; then along its blade, of which the speed and the rate of turning obey a sum rule
    before = np.array([np.pi, np.pi / 2, 0.4 + 0.3 * np.pi, 1.0, 0.5, 0.3])
    after, loss = switched_sleighs.lowered(before, 0.3)
    assert lost == pytest.approx(loss, rel=1e-12)
    energy = 0.5 * (switched_sleighs.INERTIA * after[3:] ** 2).sum()
    assert 0.5 * (switched_sleighs.INERTIA * state[3:] ** 2).sum() == pytest.approx(energy, rel=1e-11)
    assert switched_sleighs.row(state, 0.3) @ state[3:] == pytest.approx(0.0, abs=1e-14)


def free():
    return {"Q": lambda q, v, t: (0.0, 0.0, 0.0)}


# ---- constraints that are nonlinear


def test_a_nonlinear_constraint_that_begins():
    """A speed that is prescribed for half a period: the nearest velocity is the same direction at that speed."""

    def regulated(c=0.5):
        def f(q, v, t):
            return v[0] ** 2 + v[1] ** 2 - c

        return {
            "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2), "Q": lambda q, v, t: (0.0, 0.0),
            "f": [{"constraint": f, "when": lambda q, v, t: -jnp.sin(t)}], "coordinates": ("x", "y"), "period": TURN,
        }  # fmt: skip

    states, lost, _ = end(flow_of(regulated, c=0.5), [(0.1, 0.2, 0.6, -0.9)], 8)
    v = np.array([0.6, -0.9])
    then = v / np.hypot(*v) * np.sqrt(0.5)
    assert states[0] == pytest.approx(np.r_[[0.1, 0.2] + np.pi * (v + then), then], abs=1e-13)
    assert lost[0] == pytest.approx(0.5 * (v @ v - 0.5), rel=1e-12)


def test_the_nearest_velocity_in_the_metric_of_the_mass():
    """The mass is not the same in all directions: the impulse is along ∂f/∂v at the velocity after it."""

    def regulated(c=0.5):
        return {
            "T": lambda q, v, t: 0.5 * (v[0] ** 2 + 2.0 * v[1] ** 2), "Q": lambda q, v, t: (0.0, 0.0),
            "f": [{"constraint": lambda q, v, t: v[0] ** 2 + v[1] ** 2 - c, "when": lambda q, v, t: -jnp.sin(t)}],
            "coordinates": ("x", "y"), "period": TURN,
        }  # fmt: skip

    before = np.array([0.6, -0.7])
    flow, one = flow_of(regulated, c=0.5), jnp.ones(())
    y = jax.tree.map(jnp.asarray, flow.start({"x": 0.1, "y": 0.2, "x_dot": before[0], "y_dot": before[1]}))
    after = np.array(flow.jumped(0, 3.5, y, {}, (-one,)).y)[2:]
    impulse = np.array([1.0, 2.0]) * (after - before)
    assert after @ after == pytest.approx(0.5, rel=1e-13)
    assert impulse[0] * after[1] == pytest.approx(impulse[1] * after[0], abs=1e-10)


# ---- on a section


def test_crossings_of_a_section_between_clamps():
    """An oscillator carried along evenly and clamped in stripes: cosines between, each stripe ends the speed.

    It is let go for a time τ, and its amplitude is less by |cos τ| each time; it rises through zero every other time.
    """

    def stripes(width=0.3):
        return {
            "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2),
            "Q": lambda q, v, t: (0.0, -q[1]),
            "f": [{"constraint": lambda q, v, t: v[1], "when": lambda q, v, t: jnp.sin(q[0]) + width}],
            "coordinates": ("x", "y"),
            "time_unit": TURN,
        }

    flow = flow_of(stripes, width=0.3)
    section = Section(flow, "y", 1, 0.0, "up", longest=4.0)
    strobe = make_return_map(section, in_loop(dopri8), 60)
    state = begin(section, flow.start({"x": np.pi, "y": 1.0, "x_dot": 1.0, "y_dot": 0.0}))
    met = jax.jit(lambda y: (strobe(y, {}), strobe.iterate(2, y, {})))(jax.tree.map(jnp.asarray, state))
    delta = np.arcsin(0.3)
    shrinks = abs(np.cos(np.pi - 2 * delta))
    for crossing, time, speed in zip(
        met, (delta + 2.5 * np.pi, delta + 6.5 * np.pi), (shrinks, shrinks**3), strict=True
    ):
        assert crossing.t == pytest.approx(time, abs=1e-10)
        x, y, along, across = (float(component) for component in crossing.state.y)
        assert (along, across) == pytest.approx((1.0, speed), abs=1e-10)
        assert (x - np.pi, y) == pytest.approx((time, 0.0), abs=1e-10)


# ---- walls


def impact(w=2.8, r=0.8):
    """x'' + x = cos(w t) in x < 0, the wall by its restitution."""
    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2,
        "Q": lambda q, v, t: (jnp.cos(w * t) - q[0],),
        "coordinates": ("x",),
        "period": TURN / w,
        "jumps": [{"when": lambda q, v, t: q[0], "restitution": r}],
    }


def impact_as_rates(w=2.8, r=0.8):
    return {
        "rhs": lambda y, t: (y[1], jnp.cos(w * t) - y[0]),
        "coordinates": ("x", "v"),
        "period": TURN / w,
        "jumps": ({"when": lambda y, t: y[0], "direction": "up", "then": lambda y, t: (y[0], -r * y[1])},),
    }


@pytest.mark.slow  # bodies that meet walls are in the matrix
def test_a_wall_is_that_of_a_right_hand_side():
    """States, derivatives and volume of an oscillator at a wall, by its restitution and by rates; the energy lost."""
    own = {"w": 2.8, "r": 0.8}
    flows = flow_of(impact, **own), piecewise_smooth(impact_as_rates, own)
    u = jnp.array([(-1.0, 0.3), (-0.2, 1.5), (-0.05, 0.9)])

    def pushed(flow):
        strobe = make_return_map(flow, in_loop(dopri8), 30)

        @jax.jit
        @jax.vmap
        def push(u):
            d = derivatives(strobe, 1, u, {"r": 0.8}, ("r",))
            after = strobe.pushforward(flow.chart.state(u), {}, ())
            return *after.state.y, jnp.exp(after.log_volume), d.monodromy, d.by_parameter

        return [np.asarray(x) for x in push(u)]

    for one, other in zip(*map(pushed, flows), strict=True):
        assert one == pytest.approx(other, abs=1e-12)
    lost = end(flows[0], u, 30)[1]
    assert np.any(lost > 0.01)


def test_an_impact_on_a_slope_that_rises():
    """A disk hits a rising slope: the speed across it turns over to −r times itself, that along it stays."""
    slope, rise, r, m = 0.75, 0.2, 0.6, 2.0

    def system(g=0.0):
        return {
            "T": lambda q, v, t: 0.5 * m * (v[0] ** 2 + v[1] ** 2), "Q": lambda q, v, t: (0.0, -m * g),
            "jumps": [{"when": lambda q, v, t: q[1] - slope * q[0] - rise * jnp.sin(t), "direction": "down", "restitution": r}],
            "coordinates": ("x", "y"), "period": TURN,
        }  # fmt: skip

    flow, t = flow_of(system, g=0.0), 0.7
    height, v = rise * np.sin(t), np.array([0.4, -1.1])
    y = flow.start({"x": 0.0, "y": height, "x_dot": v[0], "y_dot": v[1]})
    after = np.array(flow.jumped(0, t, jax.tree.map(jnp.asarray, y), {}, (-jnp.ones(()),)).y)
    normal, along = np.array([-slope, 1.0]), np.array([1.0, slope])
    assert normal @ after[2:] - rise * np.cos(t) == pytest.approx(-r * (normal @ v - rise * np.cos(t)), rel=1e-13)
    assert along @ after[2:] == pytest.approx(along @ v, rel=1e-13)


def test_rest_on_a_wall_by_its_restitution():
    """A ball whose bounces come to an end lies on the ground: all of its energy is lost."""

    def ball(r=0.5):
        return {
            "T": lambda q, v, t: 0.5 * v[0] ** 2, "Q": lambda q, v, t: (-1.0 + 0.0 * jnp.cos(t),), "coordinates": ("h",), "period": TURN,
            "jumps": [{"when": lambda q, v, t: q[0], "direction": "down", "restitution": r, "rest": True}],
        }  # fmt: skip

    states, lost, _ = end(flow_of(ball, r=0.5), [(0.5, 0.0)], 20)
    assert states[0] == pytest.approx([0.0, 0.0], abs=1e-14)
    assert lost[0] == pytest.approx(0.5, rel=1e-9)


def forced_block(mu=0.4):
    """A block of mass 2 on a spring, driven, with dry friction by sign and a stop by max."""
    return {
        "T": lambda q, v, t: v[0] ** 2,
        "Q": lambda q, v, t: (
            -2.0 * mu * jnp.sign(v[0]) - q[0] - 3.0 * jnp.maximum(q[0] - 0.5, 0.0) + 2.0 * jnp.cos(t),
        ),
        "coordinates": ("x",),
        "period": TURN,
    }


def forced_block_with_switches(mu=0.4):
    return {
        **forced_block(mu),
        "Q": lambda q, v, t, side: (
            -2.0 * mu * side[0] - q[0] - 3.0 * jnp.where(side[1] > 0.0, q[0] - 0.5, 0.0) + 2.0 * jnp.cos(t),
        ),
        "switches": [{"on": lambda q, v, t: v[0], "sliding": True}, {"on": lambda q, v, t: q[0] - 0.5}],
    }


def test_corners_of_forces_are_found():
    """Friction by `sign` sticks and slips, and a stop by `max` is met, as where both are said to be switches."""
    own = {"mu": 0.4}
    define = forces_with_switches(forced_block, own, (1, 1))
    assert [switch["sliding"] for switch in define(**own)["switches"]] == [True, False]
    states = [(0.3, 1.0), (-1.0, 0.0), (0.6, -0.2)]
    found, said = (end(switched_mechanics(each, own), states, 40)[0] for each in (define, forced_block_with_switches))
    assert np.abs(found - said).max() < 1e-13
    smooth = {"T": lambda q, v, t: v[0] ** 2, "Q": lambda q, v, t: (-q[0] * jnp.cos(t),), "coordinates": ("x",)}
    assert forces_with_switches(lambda: smooth, {}, (1, 1))() is smooth


def test_friction_by_the_side_of_a_switch():
    """A block that slides to rest by dry friction, as `Q` reads its side: x = v²/2μ after, and there it stays."""

    def block(mu=0.4):
        return {
            "T": lambda q, v, t: v[0] ** 2, "Q": lambda q, v, t, side: (-2.0 * mu * side[0],),
            "switches": [{"on": lambda q, v, t: v[0], "sliding": True}], "coordinates": ("x",), "time_unit": TURN,
        }  # fmt: skip

    states, *_ = end(flow_of(block, mu=0.4), [(0.0, 1.0)], 20)
    assert states[0] == pytest.approx([1.0 / 0.8, 0.0], abs=1e-13)
