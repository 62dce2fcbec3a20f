"""Motions that slide along switches and rest on walls, against closed forms of all their pieces, and identities."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxnh
from jaxnh.maps.build import make_parts, make_return_map
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import Tangent
from jaxnh.solvers import dopri8, tsit5
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.status import CHATTERING, CODIMENSION_TWO
from tests.flows.belt import belt, slip, stick_slip
from tests.helpers.cases import some_slow
from tests.helpers.one_lane import state_after, states_after

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")

TURN = 2 * np.pi
EPS = np.finfo(float).eps


def end(system, y, steps, time=None, solver=dopri8):
    """The state a period, or a time, after y, and why it failed."""
    span = None if time is None else (0.0, time)
    state = state_after(make_return_map(system, solver, steps, span=span), jnp.asarray(y, float), {})
    return np.array(state.y), float(state.reason)


# ---- a block on a belt


@pytest.mark.parametrize("solver", some_slow({"written out": dopri8, "loop": in_loop(tsit5)}, "written out"))
def test_stick_slip(solver):
    """A cycle from its release on: in its slip, when it is caught, in its stick, and in the next ones of both.

    Where the block sticks its position says when it was caught, x(t) = caught + u (t − t0).
    """
    system, (slipping, sticking, caught) = piecewise_smooth(belt, {"mu": 1.0, "c": 0.3, "u": 0.5}), stick_slip()
    period, steps = slipping + sticking, 60 if solver is dopri8 else 2000
    times = np.array([0.5 * slipping, slipping + 0.3 * sticking, period + 0.2 * slipping, 2 * period - 0.1 * sticking])
    exact = [slip(times[0]), [caught + 0.15 * sticking, 0.5], slip(times[2] - period), [1.0 - 0.05 * sticking, 0.5]]
    for time, known in zip(times, exact, strict=True):
        y, reason = end(system, (1.0, 0.5), steps, time, solver)
        assert reason == 0
        assert np.abs(y - known).max() < 1e-11
    elsewhere = [end(system, (1.2, 0.1), steps, n * period, solver)[0] for n in (3, 4)]  # one stick, and the cycle
    assert np.abs(elsewhere[0] - elsewhere[1]).max() < 1e-10


@pytest.mark.slow  # tangents at a sliding equilibrium are quick
def test_exponents_of_stick_slip():
    """Zero along the cycle, and all that is across it vanishes where the block is caught."""
    session = jaxnh.Session(belt, start={"x": 1.2, "v": 0.1}, target=1e-8)
    data = session.run(jaxnh.Lyapunov(transient=16, periods=32))
    assert data["exponents"].to_numpy().tolist() == [0.0, -np.inf]
    assert data["exponents_error"].to_numpy().tolist() == [0.0, 0.0]
    assert int(data["status"]) == 0


# ---- dry friction under a harmonic force


def dry(mu=0.3, w=0.4):
    """x'' + x + μ sgn x' = cos ωt."""
    return {
        "rhs": lambda y, t, side: (y[1], jnp.cos(w * t) - y[0] - mu * side[0]),
        "coordinates": ("x", "v"),
        "period": TURN / w,
        "switches": ({"on": lambda y, t: y[1], "sliding": True},),
    }


def arc(t0, y, t, w, force):
    """x'' + x = cos ωt + force from y at t0."""
    a = 1 / (1 - w * w)
    x, v = y[0] - a * np.cos(w * t0) - force, y[1] + a * w * np.sin(w * t0)
    c, s = np.cos(t - t0), np.sin(t - t0)
    return np.array([x * c + v * s + a * np.cos(w * t) + force, v * c - x * s - a * w * np.sin(w * t)])


def dry_exactly(y, mu, w):
    """The state a period later, by arcs and stops, and the number of stops."""
    t, y, last, stops = 0.0, np.array(y), TURN / w, 0

    def first(f, t):
        times = np.linspace(t, last, 20001)[1:]
        values = f(times)
        sign = np.flatnonzero(values[1:] * values[:-1] < 0.0)
        return brentq(f, times[sign[0]], times[sign[0] + 1], xtol=1e-15) if len(sign) else None

    while True:
        if y[1] == 0.0:
            pull = np.cos(w * t) - y[0]
            if abs(pull) < mu - 1e-12:
                stops += 1
                x = y[0]
                t = first(lambda s: mu - abs(np.cos(w * s) - x), t)  # noqa: B023
                if t is None:
                    return y, stops
            side = np.sign(np.cos(w * t) - y[0])
        else:
            side = np.sign(y[1])
        begun, from_y, force = t, y, -mu * side
        t = first(lambda s: arc(begun, from_y, s, w, force)[1], t)  # noqa: B023
        if t is None:
            return arc(begun, from_y, last, w, force), stops
        y = np.array([arc(begun, from_y, t, w, force)[0], 0.0])


def test_dry_friction_is_exact():
    """Periods with stops, whole and in parts, some of which begin at a stop; and their derivatives, of rank one."""
    system = piecewise_smooth(dry, {"mu": 0.3, "w": 0.4})
    strobe, parts = make_return_map(system, dopri8, 120), make_parts(system, dopri8, 120, 7)

    @jax.jit
    @jax.vmap
    def maps(u, mu):
        z, own = system.chart.state(u), {"mu": mu}
        whole = derivatives(strobe, 1, u, own, "mu")
        return whole, jax.lax.scan(lambda z, part: (part(z, own), None), z, parts)[0].y

    starts = [((0.2, 0.4), 0.3), ((0.9, -0.3), 0.6), ((0.1, 0.0), 0.3)]
    whole, in_parts = maps(jnp.array([y for y, _ in starts]), jnp.array([mu for _, mu in starts]))
    for i, (y, mu) in enumerate(starts):
        exact, stops = dry_exactly(y, mu, 0.4)
        assert stops >= 2
        assert np.abs(np.asarray(whole.image)[i] - exact).max() < 1e-11
        assert np.abs(np.stack(in_parts)[:, i] - exact).max() < 1e-11
        h = 1e-6
        near = lambda e, m=0.0, y=y, mu=mu: dry_exactly(np.array(y) + e, mu + m, 0.4)[0]  # noqa: E731
        columns = [(near(h * e) - near(-h * e)) / (2 * h) for e in np.eye(2) if y[1] or e[0]]
        assert np.abs(np.asarray(whole.monodromy)[i, :, : len(columns)] - np.array(columns).T).max() < 1e-8
        by_mu = (near(0.0, h) - near(0.0, -h)) / (2 * h)
        assert np.abs(np.asarray(whole.by_parameter)[i] - by_mu).max() < 1e-8
        singular = np.linalg.svd(np.asarray(whole.monodromy)[i], compute_uv=False)
        assert singular[1] < 1e-12 * max(singular[0], 1.0)


def test_amplitude_without_stops():
    """Den Hartog's: √(V² − μ² U²), V = 1/(1 − ω²), U = sin(π/ω)/(ω (1 + cos(π/ω))) (Trans. ASME 53 (1931) 107)."""
    mu, w = 0.3, 0.7
    system = piecewise_smooth(dry, {"mu": mu, "w": w})
    strobe = make_return_map(system, dopri8, 60)
    y = np.array(state_after(strobe, jnp.array([0.3, 0.1]), {}, 400).y)
    force = -mu * np.sign(y[1])
    times = np.linspace(0.01, np.pi / w, 400)
    velocity = [arc(0.0, y, s, w, force)[1] for s in times]
    k = np.flatnonzero(np.diff(np.sign(velocity)))[0]
    turn = brentq(lambda s: arc(0.0, y, s, w, force)[1], times[k], times[k + 1], xtol=1e-15)
    v, u = 1 / (1 - w * w), np.sin(np.pi / w) / (w * (1 + np.cos(np.pi / w)))
    assert abs(arc(0.0, y, turn, w, force)[0]) == pytest.approx(np.sqrt(v * v - mu * mu * u * u), abs=1e-11)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
def test_exponents_of_dry_friction():
    """With stops one is the logarithm of the multiplier of the closed form's orbit, the other −∞; stuck, 0 and −∞."""
    session = jaxnh.Session(dry, start={"x": 0.2, "v": 0.4}, target=1e-9)
    data = session.run(jaxnh.Lyapunov(transient=32, periods=32), mu=[0.3, 1.5])
    y = np.array([0.2, 0.4])
    for _ in range(80):
        y, _ = dry_exactly(y, 0.3, 0.4)
    assert y[1] == 0.0  # the period begins at a stop, and the position alone goes on
    h = np.array([1e-6, 0.0])
    change = (dry_exactly(y + h, 0.3, 0.4)[0][0] - dry_exactly(y - h, 0.3, 0.4)[0][0]) / (2 * h[0])
    known = np.log(abs(change)) * 0.4 / TURN
    exponents, error = (data[name].to_numpy() for name in ("exponents", "exponents_error"))
    assert exponents[0, 0] == pytest.approx(known, abs=1e-8)
    assert exponents[:, 1].tolist() == [-np.inf, -np.inf]
    assert abs(exponents[1, 0]) <= error[1, 0] < 1e-2
    assert data["status"].to_numpy().tolist() == [0, 0]


# ---- surfaces in more dimensions


def test_tangents_at_an_equilibrium_on_a_surface():
    """Halfway between (1 − 2x, −1) above and (−1 − x, 1) below x' = −3x/2, whose rate at 0 is the rest of two numbers."""

    def pseudo():
        def rhs(y, t, side):
            above, below = (1.0 - 2.0 * y[0], -1.0 + 0.0 * y[1]), (-1.0 - y[0], 1.0 + 0.0 * y[1])
            return tuple(0.5 * (a + b + side[0] * (a - b)) for a, b in zip(above, below, strict=True))

        return {"rhs": rhs, "coordinates": ("x", "h"), "switches": ({"on": lambda y, t: y[1], "sliding": True},)}

    flow = piecewise_smooth(pseudo, {})
    state = jax.tree.map(jnp.asarray, flow.start({"x": 0.0, "h": 0.0}))
    tangent = jax.tree.map(jnp.zeros_like, state)._replace(y=(jnp.float64(1.0), jnp.float64(0.0)))
    strobe = make_return_map(flow, dopri8, 8)
    pushed = jax.jit(lambda z, dz: strobe.pushforward(z, {}, (Tangent(dz),), volume=False))(state, tangent)
    assert [float(x) for x in pushed.state.y] == [0.0, 0.0]
    assert [float(x) for x in pushed.tangents[0].state.y] == pytest.approx([np.exp(-1.5), 0.0], abs=1e-9)


def crossed(k=0.3):
    """Sliding on x = 0, where the balance of the field changes at y = 0: z' is Filippov's weight, k times its side."""
    return {
        "rhs": lambda y, t, side: (-side[0] + k * side[1], 1.0, side[0]),
        "coordinates": ("x", "y", "z"),
        "switches": (
            {"on": lambda y, t: y[0], "sliding": True},
            {"on": lambda y, t: y[1], "sliding": True},
        ),
    }


def test_another_surface_is_crossed():
    system = piecewise_smooth(crossed, {"k": 0.3})
    y, reason = end(system, (0.0, -0.8, 0.0), 12, 2.0)
    assert (reason, y[0]) == (0, 0.0)
    assert y[1:] == pytest.approx([1.2, 0.3 * (1.2 - 0.8)], abs=1e-14)


def test_two_surfaces_at_once_are_refused():
    """x and y come to zero at different times; whoever begins at both is refused as well, and other lanes go on."""

    def corner(k=1.0):
        return {
            "rhs": lambda y, t, side: (-k * side[0], -side[1]),
            "coordinates": ("x", "y"),
            "switches": tuple({"on": lambda y, t, i=i: y[i], "sliding": True} for i in (0, 1)),
        }

    system = piecewise_smooth(corner, {"k": 1.0})
    strobe = make_return_map(system, tsit5, 10)
    starts = jnp.array([(0.5, 0.3), (0.0, 0.0), (0.5, 3.0)])
    state = states_after(strobe, starts, {}, 1)
    assert state.reason.tolist() == [CODIMENSION_TWO, CODIMENSION_TWO, 0]
    assert np.array(state.y)[:, 2] == pytest.approx([0.0, 2.0], abs=1e-14)


def test_a_curved_surface_is_kept():
    """Around a circle, whose height stays at rounding, with the speed of the weighted field, by steps that leave it."""

    def around(k=0.5):
        def rhs(y, t, side):
            x, v = y
            return -v - (side[0] + k) * x, x - (side[0] + k) * v

        return {
            "rhs": rhs,
            "coordinates": ("x", "v"),
            "switches": ({"on": lambda y, t: y[0] ** 2 + y[1] ** 2 - 1.0, "sliding": True},),
        }

    system = piecewise_smooth(around, {"k": 0.5})
    errors = []
    for steps in (8, 16):
        y, reason = end(system, (1.0, 0.0), steps, 10.0, tsit5)
        assert (reason, abs(y @ y - 1.0) <= 4 * EPS) == (0, True)
        errors.append(np.abs(y - [np.cos(10.0), np.sin(10.0)]).max())
    assert 1e-10 < errors[1] < errors[0] / 2**4.5  # of order five


# ---- rest on a wall


def table(g=1.0, a=0.0, r=0.5):
    """A ball on a table at height 1 + a sin t, and the integral of its height above it."""

    def bounce(y, t):
        return y[0], -r * y[1] + (1 + r) * a * jnp.cos(t), y[2]

    return {
        "rhs": lambda y, t: (y[1], -g, y[0] - 1.0 - a * jnp.sin(t)),
        "coordinates": ("h", "v", "s"),
        "period": TURN,
        "jumps": (
            {"when": lambda y, t: y[0] - 1.0 - a * jnp.sin(t), "direction": "down", "then": bounce, "rest": True},
        ),
    }


@pytest.mark.parametrize("r", [0.0, 0.5, 0.9])
def test_impacts_come_to_an_end(r):
    """After v/g + 2 v r/(g (1 − r)), of v at the first; the heights' integral over all bounces is a geometric sum."""
    v, system = 0.15, piecewise_smooth(table, {"g": 1.0, "a": 0.0, "r": r})
    over = v + 2 * v * r / (1 - r)
    start = (1.0 + v * v / 2, 0.0, 0.0)
    y, reason = end(system, start, 40, over + 0.01)
    assert reason == 0
    assert y[:2].tolist() == [1.0, 0.0]
    area = v**3 / 3 + 2 / 3 * (v * r) ** 3 / (1 - r**3)
    assert y[2] == pytest.approx(area, abs=1e-12)
    before, _ = end(system, start, 40, over - 1e-3)
    assert before[1] != 0.0


def test_a_ball_leaves_its_table():
    """At rest on it, and released where it falls with g, sin t = g/a: the rest of the flight is in closed form.

    Whatever the ball did before: its derivatives in state are zero, those in g and a the closed form's.
    """
    system = piecewise_smooth(table, {"g": 1.0, "a": 3.2, "r": 0.5})
    strobe = make_return_map(system, dopri8, 60)

    def flight(g, a):
        t = np.arcsin(g / a)
        s = TURN - t
        return np.array([1.0 + a * np.sin(t) + a * np.cos(t) * s - g * s * s / 2, a * np.cos(t) - g * s])

    @jax.jit
    @jax.vmap
    def image(u):
        own = {"g": jnp.float64(1.0), "a": jnp.float64(3.2)}
        return derivatives(strobe, 1, u, own, ("g", "a"))

    ours = image(jnp.array([(1.0, 3.2, 0.0), (1.001, 3.2, 0.0), (1.0, 3.22, 0.0)]))
    assert np.abs(np.asarray(ours.image)[:, :2] - flight(1.0, 3.2)).max() < 1e-11
    assert np.abs(np.asarray(ours.monodromy)[:, :2]).max() == 0.0
    e = 1e-5
    by_g = (flight(1.0 + e, 3.2) - flight(1.0 - e, 3.2)) / (2 * e)
    by_a = (flight(1.0, 3.2 + e) - flight(1.0, 3.2 - e)) / (2 * e)
    assert np.abs(np.asarray(ours.by_parameter)[:, :2] - np.stack([by_g, by_a], axis=-1)).max() < 1e-8


def test_impulses_become_a_force():
    """A ball whose impacts also slow it down along the table by k times the impulse: w + k v falls by k g t, exactly.

    Through impacts, at rest, and in the derivatives, of rank one: all impulses together do not depend on how many.
    """

    def rough(g=1.0, a=0.1, r=0.8, k=0.3):
        def bounce(y, t):
            impulse = -(1 + r) * (y[1] - a * jnp.cos(t))
            return y[0], y[1] + impulse, y[2] - k * impulse

        return {
            "rhs": lambda y, t: (y[1], -g, 0.0),
            "coordinates": ("h", "v", "w"),
            "period": TURN,
            "jumps": ({"when": lambda y, t: y[0] - a * jnp.sin(t), "direction": "down", "then": bounce, "rest": True},),
        }

    system = piecewise_smooth(rough, {"g": 1.0, "a": 0.1, "r": 0.8, "k": 0.3})
    strobe = make_return_map(system, dopri8, 40)
    ours = jax.jit(lambda u: derivatives(strobe, 1, u, {}))(jnp.array([0.02, 0.2, 0.4]))
    image = np.asarray(ours.image)
    assert image[:2] == pytest.approx([0.1 * np.sin(TURN), 0.1], abs=1e-15)
    assert image[2] + 0.3 * image[1] == pytest.approx(0.4 - 0.3 * 0.2 + 2 * 0.3 * 0.2 - 0.3 * TURN, abs=1e-12)
    assert np.asarray(ours.monodromy) == pytest.approx(np.array([[0, 0, 0], [0, 0, 0], [0, 0.3, 1.0]]), abs=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
def test_exponents_of_a_ball_at_rest():
    """All vanish on a table that releases the ball again once a period; other balls, on a table that does not, too."""
    session = jaxnh.Session(table, start={"h": 1.01}, target=1e-8, parameters={"a": 0.2})
    data = session.run(jaxnh.Lyapunov(transient=16, periods=32))
    assert data["exponents"].to_numpy()[1:].tolist() == [-np.inf, -np.inf]
    assert abs(float(data["exponents"][0])) <= float(data["exponents_error"][0])


# ---- what is not allowed


def test_no_rest_unless_allowed():
    """The same ball fails where its jump does not say that it may rest."""

    def bare(g=1.0):
        jump = {"when": lambda y, t: y[0], "direction": "down", "then": lambda y, t: (y[0], -0.5 * y[1])}
        return {"rhs": lambda y, t: (y[1], -g), "coordinates": ("h", "v"), "jumps": (jump,), "time_unit": TURN}

    assert end(piecewise_smooth(bare, {"g": 1.0}), (0.5, 0.0), 10, solver=tsit5)[1] == CHATTERING
