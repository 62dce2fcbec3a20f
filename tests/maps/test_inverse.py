"""Inverses of return maps: they undo the map, and its derivative, of all kinds of steps; and what has none."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.engine.from_python import experiment_of
from jaxnh.maps.build import make_return_map
from jaxnh.maps.crossings import EventStrobe
from jaxnh.maps.inverse import backward_parts, make_inverse_map
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.jumping_section import JumpingSection
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.section import Section
from jaxnh.solvers import SOLVERS
from jaxnh.systems.backward_motion import check_jumps
from jaxnh.systems.corners import with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from tests.flows.piecewise_circuits import CIRCUITS

pytestmark = pytest.mark.usefixtures("quick_compiling")

TURN = 2 * np.pi
KICKS = [0.1, 0.1 + 1 / 3, 0.1 + 2 / 3]
CLOSE = 1e-9
PASSED_WITHIN_A_STEP = "a corner, on a section, steps of a lane's own"


def square_wave():
    """A pendulum with damping that is pushed one way for half of a period and the other way for the rest."""

    def rhs(y, t):
        push = jnp.where(jnp.sin(t) > 0.0, 0.4, -0.4)
        return y[1], -jnp.sin(y[0]) - 0.1 * y[1] + push

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": TURN}


def straight_pieces():
    """An oscillator whose spring is stiffer on one side, driven."""

    def rhs(y, t):
        return y[1], -y[0] - 2.0 * jnp.maximum(y[0] - 0.1, 0.0) - 0.1 * y[1] + jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": TURN}


def skate_with_corners():
    """A knife edge on a plane that is bent: x' sin θ = y' cos θ, with a force that has a corner; it turns evenly."""

    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)

    def Q(q, v, t):
        return -jnp.abs(q[0] - 0.2), 0.3 * jnp.cos(TURN * t), 0.0 * q[0]

    def f(q, v, t):
        return (v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2]),)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y", "theta"), "angles": ("theta",), "period": 1.0}


def spikes():
    """The Brusselator, whose spikes have rates of thousands."""

    def rhs(y, t):
        x, z = y
        return 1.0 - 9.0 * x + x * x * z, 8.0 * x - x * x * z

    return {"rhs": rhs, "coordinates": ("x", "z")}


def stiff_drive():
    """Of rates 1 and 9, driven."""

    def rhs(y, t):
        return y[1] + 0.3 * jnp.cos(TURN * t), -9.0 * (y[1] - jnp.sin(y[0]))

    return {"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0}


def van_der_pol():
    def rhs(y, t):
        return y[1], 0.5 * (1.0 - y[0] ** 2) * y[1] - y[0]

    return {"rhs": rhs, "coordinates": ("x", "v")}


def bent_van_der_pol():
    def rhs(y, t):
        return y[1], 0.5 * (1.0 - jnp.abs(y[0])) * y[1] - y[0]

    return {"rhs": rhs, "coordinates": ("x", "v")}


def flow_of(define, **start):
    return experiment_of(define, start, 1e-9, None).flow()


def chua_on_section():
    flow = piecewise_smooth(with_switches(CIRCUITS["chua"].define, {"scale": 1.0}), {"scale": 1.0})
    return Section(flow, "y", 1, 0.05, "up")


CASES = {
    "a square wave": (lambda: flow_of(square_wave, x=0.1), "tsitouras_papakostas8", 200, [0.4, -0.2]),
    "straight pieces": (lambda: flow_of(straight_pieces, x=0.1), "tsitouras_papakostas8", 200, [0.4, -0.2]),
    "Chua's circuit on a section": (chua_on_section, "tsitouras_papakostas8", 60, None),
    "spikes, explicit steps": (
        lambda: flow_of(spikes, x=0.1), "adaptive_tsitouras_papakostas8", 3000, [1.2, 5.0],
    ),
    "stiff, implicit steps": (lambda: flow_of(stiff_drive, x=0.1), "rodas5p", 20000, [0.4, 0.2]),
    "on a section, steps of a lane's own": (
        lambda: Section(flow_of(van_der_pol, x=0.1), "x", 0, 0.0, "up"), "adaptive_tsitouras_papakostas8", 100, None,
    ),
}  # fmt: skip


def impacts():
    """An oscillator that strikes a table that moves, and is kicked at the end of each period."""

    def rhs(y, t):
        return y[1], jnp.cos(2.0 * TURN * t) - 20.0 * y[0]

    def bounce(y, t):
        speed = 0.1 * TURN * jnp.cos(TURN * t)
        return y[0], speed - 0.8 * (y[1] - speed)

    wall = {"when": lambda y, t: y[0] - 0.1 * jnp.sin(TURN * t), "then": bounce}
    kick = {"when": lambda y, t: jnp.sin(TURN * t), "then": lambda y, t: (y[0], y[1] - 0.7)}
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 1.0, "jumps": [wall, kick]}


def skate_that_rebounds():
    """The skate, in front of a wall."""
    made = skate_with_corners()
    return {**made, "jumps": [{"when": lambda q, v, t: q[0] - 0.3, "restitution": 0.6}]}


def kicks_at_one_time():
    """One after the other, three times in a period: the first takes from v, the second turns and halves it."""

    def rhs(y, t):
        return y[1], -y[0] + jnp.cos(TURN * t)

    when = lambda y, t: jnp.sin(3.0 * TURN * (t - 0.1))  # noqa: E731
    kicks = [lambda y, t: (y[0], y[1] - 0.7), lambda y, t: (y[0], -0.5 * y[1])]
    return {
        "rhs": rhs,
        "coordinates": ("x", "v"),
        "period": 1.0,
        "jumps": [{"when": when, "then": kick} for kick in kicks],
    }


def clock_set_back():
    """A clock that is a coordinate, and begins anew."""

    def rhs(y, t):
        return -0.3 * y[0] + jnp.cos(y[1]), 1.0

    again = {"when": lambda y, t: y[1] - TURN, "then": lambda y, t: (y[0], y[1] - TURN)}
    return {"rhs": rhs, "coordinates": ("x", "clock"), "jumps": [again]}


CASES |= {
    "impacts and kicks": (lambda: flow_of(impacts, x=-0.1), "tsitouras_papakostas8", 60, [-0.2, 0.9]),
    "kicks at one time": (lambda: flow_of(kicks_at_one_time, x=-0.1), "tsitouras_papakostas8", 12, [-0.2, 0.9]),
    PASSED_WITHIN_A_STEP: (
        lambda: Section(flow_of(bent_van_der_pol, x=0.1), "x", 0, 0.0, "up"), "adaptive_tsitouras_papakostas8", 3000, None,
    ),
    "a clock that is set back": (
        lambda: Section(flow_of(clock_set_back, x=0.1), "clock", 1, 1.0, "up"), "tsitouras_papakostas8", 20, [0.4],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_inverses_undo_maps_and_their_derivatives(case):
    make, solver, steps, u = CASES[case]
    system = make()
    ahead, back = (each(system, SOLVERS[solver], steps) for each in (make_return_map, make_inverse_map))
    once = jax.jit(lambda strobe, u: derivatives(strobe, 1, u, {}))
    u = jnp.array(u if u is not None else on_section(system, ahead))
    there = once(ahead, u)
    again = once(back, there.image)
    size = np.maximum(np.abs(u), np.abs(there.image))
    assert np.abs(again.image - u).max() < CLOSE * size.max() * np.abs(again.monodromy).max()
    product, both = again.monodromy @ there.monodromy, np.abs(again.monodromy).max() * np.abs(there.monodromy).max()
    # Steps of a lane's own pass corners within one of them, whose length is not differentiated.
    assert np.abs(product - np.eye(len(u))).max() < (1e-5 if case == PASSED_WITHIN_A_STEP else 1e-6) * both
    assert np.abs(there.image - u).max() > 0.001


@pytest.mark.parametrize(
    ("define", "solver", "steps", "kind"),
    [
        (van_der_pol, "tsitouras_papakostas8", 60, EventStrobe),
        (van_der_pol, "adaptive_tsitouras_papakostas8", 100, EventStrobe),
        (bent_van_der_pol, "tsitouras_papakostas8", 60, JumpingSection),
    ],
)
def test_time_falls_on_the_way_back(define, solver, steps, kind):
    """Of crossings, and of what a tangent changes in it: there and back in no time, and back alone in less than none."""
    section = Section(flow_of(define, x=0.1), "x", 0, 0.0, "up")
    ahead, back = (each(section, SOLVERS[solver], steps) for each in (make_return_map, make_inverse_map))
    assert isinstance(back, kind)
    start = section.chart.state(jnp.array([1.5]))
    aside = Tangent(jax.tree.map(jnp.subtract, section.chart.state(jnp.array([2.5])), start))
    once = jax.jit(lambda strobe, state, tangent: strobe.pushforward(state, {}, (tangent,)))
    there = once(ahead, start, aside)
    again = once(back, there.state, there.tangents[0])
    alone = once(back, there.state._replace(t=0.0 * there.state.t), aside)
    assert 5.0 < float(there.state.t) < 8.0  # near 2π
    assert abs(float(again.state.t)) < CLOSE
    assert float(alone.state.t) == pytest.approx(-float(there.state.t), abs=CLOSE)
    later, left = (float(pushed.tangents[0].state.t) for pushed in (there, again))
    assert abs(later) > 0.001
    assert (
        abs(left)
        < 1e-6 * abs(later) * np.abs(derivatives(back, 1, section.chart.point(there.state), {}).monodromy).max()
    )


def on_section(section, strobe):
    """The point of the second crossing."""
    state = jax.tree.map(
        jnp.asarray, section.chart.state(jnp.array([0.3, -0.1] if section.flow.exponents == 3 else [1.0]))
    )
    return section.chart.point(jax.jit(lambda z: strobe.iterate(2, z, {}))(state))


@pytest.mark.parametrize("define", [skate_with_corners, skate_that_rebounds])
def test_parts_back_in_time_undo_the_map_of_mechanics(define):
    """Part by part from the end of the period; constraints are kept as well."""
    flow = flow_of(define, x=0.1)
    state = flow.start({"x": 0.1, "y": 0.0, "theta": 0.3, "x_dot": 0.9, "y_dot": 0.9 * np.tan(0.3), "theta_dot": 1.0})
    state = jax.tree.map(jnp.asarray, state)
    strobe = make_return_map(flow, SOLVERS["tsitouras_papakostas8"], 60)
    parts = backward_parts(flow, SOLVERS["tsitouras_papakostas8"], 60, 4, flow.period)
    there = jax.jit(lambda z: strobe(z, {}))(state)
    back = jax.jit(lambda z: jax.lax.scan(lambda y, part: (part(y, {}), None), z, parts)[0])(there)
    assert np.abs(np.array(back.y) - np.array(state.y)).max() < CLOSE
    assert np.abs(np.array(there.y) - np.array(state.y)).max() > 0.1


def bouncing(then, **more):
    def define():
        wall = {"when": lambda y, t: -y[0], "direction": "up", "then": then, **more}
        return {"rhs": lambda y, t: (y[1], -1.0), "coordinates": ("x", "v"), "period": 1.0, "jumps": [wall]}

    return piecewise_smooth(define, {})


@pytest.mark.parametrize(
    ("flow", "words"),
    [
        (bouncing(lambda y, t: (y[0], -0.8 * y[1]), rest=True), "stick, rest or meet constraints"),
        (bouncing(lambda y, t: (y[0], 1.0)), "take several states to one"),
        (bouncing(lambda y, t: (y[0], -0.8 * y[1] * jnp.abs(y[1]))), "not linear in the state"),
        (bouncing(lambda y, t: (y[0], -0.8 * y[1] - 0.1 * jnp.sign(y[1]))), "not linear in the state"),
    ],
)
def test_what_has_no_inverse(flow, words):
    with pytest.raises(TypeError, match=words):
        make_inverse_map(flow, SOLVERS["tsit5"], 10)


def rebound(r=0.5):
    """A particle that rebounds from a wall."""
    wall = {"when": lambda y, t: y[0], "then": lambda y, t: (y[0], -r * y[1])}
    return {"rhs": lambda y, t: (y[1], -1.0), "coordinates": ("x", "v"), "jumps": [wall]}


def rebound_of_mechanics(r=0.5):
    wall = {"when": lambda q, v, t: q[0], "restitution": r}
    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2, "Q": lambda q, v, t: (-1.0,), "coordinates": ("x",),
        "jumps": [wall],
    }  # fmt: skip


@pytest.mark.parametrize("define", [rebound, rebound_of_mechanics])
def test_a_lane_whose_jump_takes_several_motions_to_one(define):
    """By the values of lanes, whatever the default is; none of what has no jumps, or no parameter."""
    flow = flow_of(define, x=0.1)
    check_jumps(flow, {"r": np.array([0.5, 1e-12, 1.0])})
    check_jumps(flow, {})
    check_jumps(flow_of(van_der_pol, x=0.1), {})
    with pytest.raises(TypeError, match="takes several motions to one in a lane, as an impact of restitution zero"):
        check_jumps(flow, {"r": np.array([0.5, 0.0])})


def test_kicks_at_one_time_come_in_the_order_of_the_list():
    """Three times in a period, by DOP853 between them; located by steps whose ends are elsewhere."""
    flow = flow_of(kicks_at_one_time, x=-0.1)
    strobe = make_return_map(flow, SOLVERS["tsitouras_papakostas8"], 13)
    start = jax.tree.map(jnp.asarray, flow.start({"x": -0.2, "v": 0.9}))
    image, exact, times = jax.jit(lambda z: strobe(z, {}))(start), np.array([-0.2, 0.9]), KICKS
    for begin, end in zip([0.0, *times], [*times, 1.0], strict=True):
        path = solve_ivp(
            lambda t, y: (y[1], -y[0] + np.cos(TURN * t)), (begin, end), exact, "DOP853", rtol=1e-12, atol=1e-13
        )
        exact = path.y[:, -1]
        if end in times:
            exact[1] = -0.5 * (exact[1] - 0.7)
    assert np.abs(np.array(image.y) - exact).max() < 1e-11


def test_kicks_at_both_ends_and_between_in_one_step():
    """Back from the end of a period: the kick there, that halfway, and not that at the beginning, as none is forward."""

    def define():
        kick = {"when": lambda y, t: jnp.sin(TURN * t), "direction": "both", "then": lambda y, t: (y[0], y[1] - 0.3)}
        rhs = lambda y, t: (y[1], y[0] + 0.0 * t)  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v"), "period": 1.0, "jumps": [kick]}

    flow, (a, b) = piecewise_smooth(define, {}), (np.cosh(0.5), np.sinh(0.5))
    exact, half = np.array([0.2, 0.1]), np.array([[a, -b], [-b, a]])
    for _ in range(2):
        exact = half @ (exact + np.array([0.0, 0.3]))
    back = make_inverse_map(flow, SOLVERS["verner9"], 1)
    end = jax.jit(lambda z: back(z, {}))(jax.tree.map(jnp.asarray, flow.start({"x": 0.2, "v": 0.1})))
    assert np.abs(np.array(end.y) - exact).max() < 1e-10  # two steps of 0.5 of order nine
