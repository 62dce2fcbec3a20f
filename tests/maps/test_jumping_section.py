"""Crossings of sections by flows with jumps and switches: against closed forms, scipy from event to event, identities."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxnh
from jaxnh.maps.build import make_return_map
from jaxnh.maps.crossings import MOST_SHOTS
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import dopri8, nystrom8, tsit5
from jaxnh.systems.corners import with_switches
from jaxnh.systems.first_order import first_order
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.status import CHATTERING, NO_RETURN
from tests.flows.piecewise_circuits import CIRCUITS
from tests.helpers.one_lane import compiled_iterate

pytestmark = pytest.mark.usefixtures("quick_compiling")


def circuit_on_section(name, value=0.05):
    circuit = CIRCUITS[name]
    flow = piecewise_smooth(with_switches(circuit.define, {"scale": 1.0}), {"scale": 1.0})
    return Section(flow, "y", 1, value, "up")


def start_of(section, *numbers):
    state = section.flow.start(dict(zip(section.flow.coordinates, numbers, strict=True)))
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), begin(section, state))


def crossings(section, solver, steps, start, count):
    """Times, states and reasons of the first crossings."""
    strobe = make_return_map(section, solver, steps)
    met = [compiled_iterate(strobe, n, start, {}) for n in range(1, count + 1)]
    return np.array([c.t for c in met]), np.array([c.state.y for c in met]), [float(c.reason) for c in met]


@pytest.mark.parametrize(("name", "value"), [("chua", 0.05), ("colpitts", 0.6), ("sprott", 0.0)])
def test_crossings_between_events(name, value):
    """The first three, by DOP853 from event to event, whose error grows in this time by e³ or so."""
    section, circuit = circuit_on_section(name, value), CIRCUITS[name]
    times, states, _ = crossings(section, dopri8, 60, start_of(section, *circuit.start), 3)
    known = circuit.follow(times[-1] + 0.1, value)[:3]
    assert np.abs(times - [t for t, _ in known]).max() < 1e-9
    assert np.abs(states - [y for _, y in known]).max() < 1e-9 * np.abs(states).max()


@pytest.mark.slow  # those of jumps without a section are quick, and the matrix has Newton on one
def test_derivatives_on_a_section():
    """By differences of the map, whose error is h²; the volume is the determinant in time shared among returns."""
    section = circuit_on_section("chua")
    strobe, names = make_return_map(section, dopri8, 60), ("scale",)
    _, states, _ = crossings(section, dopri8, 60, start_of(section, *CIRCUITS["chua"].start), 2)
    u, h = jnp.array([states[1][0], states[1][2]]), 1e-5
    image = jax.jit(lambda u, scale: derivatives(strobe, 1, u, {"scale": scale}).image)
    d = jax.jit(lambda u: derivatives(strobe, 1, u, {"scale": 1.0}, names))(u)
    columns = [(np.array(image(u + h * e, 1.0)) - np.array(image(u - h * e, 1.0))) / (2 * h) for e in np.eye(2)]
    assert np.abs(np.asarray(d.monodromy) - np.stack(columns, axis=1)).max() < 1e-7
    assert np.abs(np.asarray(d.by_parameter)).max() < 1e-10  # a faster clock changes no crossing
    state = section.chart.state(u)
    tangents = tuple(Tangent(section.chart.lift(state, tuple(e))) for e in jnp.eye(2))
    pushed = jax.jit(lambda z: strobe.pushforward(z, {"scale": 1.0}, tangents))(state)
    assert math.exp(pushed.log_volume) == pytest.approx(abs(np.linalg.det(d.monodromy)), rel=1e-8)


def test_a_switch_that_changes_nothing():
    """Crossings of Lorenz's flow are those of steps without events, to rounding, which grows by e^(0.9 t)."""

    def lorenz(state):
        x, y, z = state
        return 10.0 * (y - x), x * (28.0 - z) - y, x * y - 8 / 3 * z

    def smooth():
        return {"rhs": lambda y, t: lorenz(y), "coordinates": ("x", "y", "z")}

    def switched():
        return {**smooth(), "rhs": lambda y, t, side: lorenz(y), "switches": ({"on": lambda y, t: y[0]},)}

    start, found = (1.0, 1.0, 20.0), []
    for flow in (first_order(smooth, {}), piecewise_smooth(switched, {})):
        section = Section(flow, "z", 2, 27.0, "up")
        found.append(crossings(section, dopri8, 100, start_of(section, *start), 3))
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-11
    assert np.abs(found[0][1] - found[1][1]).max() < 1e-9


def sawtooth():
    """x rises from −1 to 1 at speed 1, and jumps back."""
    return {
        "rhs": lambda y, t: (1.0 + 0.0 * y[0], -y[1]),
        "coordinates": ("x", "y"),
        "jumps": (
            {"when": lambda y, t: y[0] - 1.0, "direction": "up", "then": lambda y, t: (-1.0 + 0.0 * y[0], y[1])},
        ),
    }


@pytest.mark.parametrize("steps", [1, 3, 20])
@pytest.mark.parametrize("direction", ["up", "both", "down"])
def test_a_jump_over_a_section_is_no_crossing(direction, steps):
    """x = 0.3 is passed upward at 0.3, 2.3, 4.3 and leapt over downward between, in whatever steps."""
    section = Section(piecewise_smooth(sawtooth, {}), "x", 0, 0.3, direction, longest=20.0)
    times, states, reasons = crossings(section, tsit5, steps, start_of(section, 0.0, 1.0), 3)
    if direction == "down":
        assert reasons == [NO_RETURN] * 3
        assert np.isnan(times).all()
    else:
        assert np.abs(times - [0.3, 2.3, 4.3]).max() < 1e-13
        assert np.abs(states[:, 0] - 0.3).max() < 1e-13


def ball(r=0.9):
    """A ball that falls on a table."""
    return {
        "rhs": lambda y, t: (y[1], -1.0 + 0.0 * y[0]),
        "coordinates": ("h", "v"),
        "jumps": ({"when": lambda y, t: y[0], "direction": "down", "then": lambda y, t: (y[0], -r * y[1])},),
    }


def test_a_crossing_and_a_bounce_in_one_step():
    """h = 0.02 is passed up 0.02 s after each impact or so, while steps are 1 long; exactly, for parabolas."""
    section = Section(piecewise_smooth(ball, {"r": 0.9}), "h", 0, 0.02, "up")
    times, states, _ = crossings(section, tsit5, 1, start_of(section, 1.0, 0.0), 4)
    t, speed, known = np.sqrt(2.0), np.sqrt(2.0), []
    for _ in range(4):
        speed *= 0.9
        known.append(t + speed - np.sqrt(speed**2 - 0.04))
        t += 2.0 * speed
    assert np.abs(times - known).max() < 1e-12
    assert np.all(states[:, 1] > 0.0)


def test_what_fails_on_the_way_to_a_section():
    """A ball that comes to rest never meets the section, and one that still falls has not yet."""
    section = Section(piecewise_smooth(ball, {"r": 0.5}), "v", 1, 5.0, "up", longest=50.0)
    assert crossings(section, tsit5, 1, start_of(section, 1.0, 0.0), 1)[2] == [CHATTERING]
    section = Section(piecewise_smooth(ball, {"r": 0.5}), "v", 1, 5.0, "up", longest=3.0)
    assert crossings(section, tsit5, 1, start_of(section, 1e3, 0.0), 1)[2] == [NO_RETURN]
    with pytest.raises(TypeError, match="Nystrom has no steps that end at jumps and switches"):
        make_return_map(section, nystrom8, 10)


def impact_oscillator(wall):
    """x'' = wall − x + cos s, s' = 2.85, with a wall at x = wall that reflects 0.8 of the speed."""

    def define():
        return {
            "rhs": lambda y, t: (y[1], wall - y[0] + jnp.cos(y[2]), 2.85),
            "coordinates": ("x", "v", "s"),
            "angles": ("s",),
            "jumps": [
                {"when": lambda y, t: y[0] - wall, "direction": "up", "then": lambda y, t: (y[0], -0.8 * y[1], y[2])}
            ],
        }

    return piecewise_smooth(define, {})


def next_impact(v, s):
    """Time, speed and phase at the next impact of a motion that leaves the wall with a speed v < 0: the closed form."""
    w, amplitude = 2.85, 1.0 / (1.0 - 2.85**2)
    b, c = -amplitude * np.cos(s), v + amplitude * w * np.sin(s)

    def height(t):
        return amplitude * np.cos(w * t + s) + b * np.cos(t) + c * np.sin(t)

    times = np.concatenate([np.geomspace(1e-6, 1e-2, 2000), np.linspace(1e-2, 8.0, 20000)[1:]])
    first = int(np.argmax((height(times[1:]) >= 0.0) & (height(times[:-1]) < 0.0)))
    t = float(brentq(height, times[first], times[first + 1], xtol=1e-15))  # pyright: ignore[reportArgumentType]
    return t, -amplitude * w * np.sin(w * t + s) - b * np.sin(t) + c * np.cos(t), s + w * t


@pytest.mark.parametrize("wall", [0.0, 1.3])
@pytest.mark.parametrize("direction", ["up", "down", "both"])
def test_a_section_on_a_wall(direction, wall):
    """The impact map: up as the motion arrives, down as it leaves, both ways one after the other; low speeds as well."""
    section = Section(impact_oscillator(wall), "x", 0, wall, direction)
    strobe = make_return_map(section, dopri8, 12)
    speed, phase = np.meshgrid([0.02, 0.1, 0.3, 0.6], np.linspace(0.5 * np.pi, 1.5 * np.pi, 6)[1:-1])
    arriving = np.stack([speed.ravel(), phase.ravel()], axis=1)
    returns = jax.jit(lambda state, n: strobe.iterate(n, state, {}))
    for v, s in arriving:
        t, after, later = next_impact(-0.8 * v, s)
        factor = -0.8 if direction == "down" else 1.0
        start = start_of(section, wall, factor * v, s)
        crossing = returns(start, 2 if direction == "both" else 1)
        known = [0.0, wall, factor * after, later]
        assert np.abs(np.array([crossing.t - t, *crossing.state.y]) - known).max() < 1e-9
        if direction == "both":  # the one as it leaves is at once
            left = returns(start, 1)
            assert np.abs(np.array([left.t, *left.state.y]) - [0.0, wall, -0.8 * v, s]).max() < 1e-12


@pytest.mark.parametrize(("direction", "v"), [("up", 0.3), ("down", -0.24)])
def test_the_derivative_of_an_impact_map(direction, v):
    """By differences of the closed form; its determinant is what the volume has grown by."""
    section = Section(impact_oscillator(0.0), "x", 0, 0.0, direction)
    strobe, s, h = make_return_map(section, dopri8, 12), 2.0, 1e-5

    def image(v, s):
        _, speed, later = next_impact(-0.8 * v if direction == "up" else v, s)
        return np.array([speed if direction == "up" else -0.8 * speed, later])

    columns = [(image(v + h, s) - image(v - h, s)) / (2 * h), (image(v, s + h) - image(v, s - h)) / (2 * h)]
    d = jax.jit(lambda u: derivatives(strobe, 1, u, {}))(jnp.array([v, s]))
    assert np.abs(np.asarray(d.monodromy) - np.stack(columns, axis=1)).max() < 1e-7
    state = section.chart.state(jnp.array([v, s]))
    tangents = tuple(Tangent(section.chart.lift(state, tuple(e))) for e in jnp.eye(2))
    pushed = jax.jit(lambda z: strobe.pushforward(z, {}, tangents))(state)
    assert math.exp(pushed.log_volume) == pytest.approx(abs(np.linalg.det(d.monodromy)), rel=1e-8)


def test_a_section_on_a_wall_where_a_motion_rests():
    """A ball on a table that moves, seen by it: ever lower impacts, rest, and a start where 1.5 cos s is 1 again."""

    def define():
        wall = {
            "when": lambda y, t: y[0],
            "direction": "down",
            "then": lambda y, t: (y[0], -0.5 * y[1], y[2]),
            "rest": True,
        }
        rhs = lambda y, t: (y[1], -1.0 + 1.5 * jnp.cos(y[2]), 1.0)  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v", "s"), "angles": ("s",), "jumps": [wall]}

    section = Section(piecewise_smooth(define, {}), "x", 0, 0.0, "up")
    _, states, reasons = crossings(section, dopri8, 8, start_of(section, 0.0, 1e-2, 3.6), 20)
    speeds, phases = states[:, 1], states[:, 2]
    assert reasons == [0.0] * 20
    start = int(np.argmin(speeds))
    impacts = -1.0 + 1.5 * np.cos(phases[:start])  # the acceleration, which changes little between low impacts
    assert np.all(impacts < 0.0)
    assert speeds[1:start] == pytest.approx(0.5 * speeds[: start - 1], rel=1e-2)
    nearly = 0.125 * (2 / 3) ** MOST_SHOTS  # of a step, by Newton at a height that leaves zero like t³
    assert phases[start] == pytest.approx(2.0 * np.pi - np.arccos(2.0 / 3.0), abs=nearly)
    assert np.abs(states[:, 0]).max() < 1e-15


def test_exponents_on_a_wall():
    """An impact oscillator's, whose sum is 2 ln 0.8 times the rate of impacts: one in each period of 2π/2.5."""

    def impacts(w=2.5, r=0.8):
        def rhs(y, t):
            return y[1], -y[0] + jnp.cos(y[2]), w

        wall = {"when": lambda y, t: y[0], "direction": "up", "then": lambda y, t: (y[0], -r * y[1], y[2])}
        return {"rhs": rhs, "coordinates": ("x", "v", "s"), "angles": ("s",), "jumps": [wall]}

    session = jaxnh.Session(impacts, start={"x": -0.1, "v": 0.0, "s": 0.0}, target=1e-7).on("x", 0.0, "up")
    lanes = session.run(jaxnh.Lyapunov(transient=500, periods=500))
    known = np.log(0.8) * 2.5 / (2.0 * np.pi) * np.array([0.0, 1.0, 1.0])
    exponents, error = (lanes[name].to_numpy().ravel() for name in ("exponents", "exponents_error"))
    assert np.all(np.abs(exponents - known) <= error)
    assert np.all(error < 1e-3)


def walking(gamma=0.009):
    """The simplest walking model of Garcia, Chatterjee, Ruina and Coleman, J. Biomech. Eng. 120 (1998) 281, eqs. 1 to 4."""

    def rhs(y, t):
        theta, speed, phi, swing = y
        fall = jnp.sin(theta - gamma)
        return speed, fall, swing, fall + speed**2 * jnp.sin(phi) - jnp.cos(theta - gamma) * jnp.sin(phi)

    def strike(y, t):
        theta, speed, _, _ = y
        c = jnp.cos(2.0 * theta)
        return -theta, c * speed, -2.0 * theta, c * (1.0 - c) * speed

    strikes = {"when": lambda y, t: y[2] - 2.0 * y[0], "direction": "up", "then": strike}
    return {"rhs": rhs, "coordinates": ("theta", "dtheta", "phi", "dphi"), "jumps": [strikes]}


def test_a_section_on_a_wall_that_a_motion_goes_on_over():
    """A walker is on the section of its heelstrikes after them: the fixed point that the article gives to 15 digits."""
    known = {"theta": 0.200310900544287, "dtheta": -0.199832473004977, "dphi": -0.015822999948318}
    flow = piecewise_smooth(walking, {"gamma": 0.009})
    section = Section(flow, "", 0, 0.0, "up", normal=(-2.0, 0.0, 1.0, 0.0))
    start = start_of(section, 0.2003, -0.1998, 0.4006, -0.0158)
    _, states, reasons = crossings(section, dopri8, 20, start, 40)
    assert reasons == [0.0] * 40
    assert states[-1] == pytest.approx([known["theta"], known["dtheta"], 2.0 * known["theta"], known["dphi"]], abs=1e-9)
