"""Maps with jumps and switches against closed forms between events, whose times are roots found apart, and identities."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import jaxnh
from jaxnh.analyses.exponents.tangent_growth import advance, begin
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.axes import SweepPoints
from jaxnh.maps.build import make_parts, make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.jumping import jumping_strobe
from jaxnh.maps.protocol import Tangent
from jaxnh.solvers import dopri8, nystrom8, tsit5, verner9
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.corners import with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.status import CHATTERING
from tests.helpers.one_lane import image_after, state_after, states_after

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")

TURN = 2 * np.pi


# ---- systems, and their motions between events in closed form


def impact_oscillator(w=2.8, r=0.8, wall=0.0):
    """x'' + x = cos(w t) in x < wall, where v becomes -r v."""
    return {
        "rhs": lambda y, t: (y[1], jnp.cos(w * t) - y[0]),
        "coordinates": ("x", "v"),
        "period": TURN / w,
        "jumps": ({"when": lambda y, t: y[0] - wall, "direction": "up", "then": lambda y, t: (y[0], -r * y[1])},),
    }


def harmonic(t0, y, t, w, force=1.0, offset=0.0):
    """The motion of x'' + x = force cos(w t) + offset from y at t0."""
    a = force / (1 - w * w)
    x0, v0 = y[0] - a * np.cos(w * t0) - offset, y[1] + a * w * np.sin(w * t0)
    c, s = np.cos(t - t0), np.sin(t - t0)
    return np.array([x0 * c + v0 * s + a * np.cos(w * t) + offset, v0 * c - x0 * s - a * w * np.sin(w * t)])


def ball(g=1.0, a=1.2, r=0.8):
    """A ball on a table at height a sin t."""
    return {
        "rhs": lambda y, t: (y[1], -g),
        "coordinates": ("h", "v"),
        "period": TURN,
        "jumps": (
            {
                "when": lambda y, t: y[0] - a * jnp.sin(t),
                "direction": "down",
                "then": lambda y, t: (y[0], -r * y[1] + (1 + r) * a * jnp.cos(t)),
            },
        ),
    }


def dry_oscillator(w=1.7, k=0.3, c=0.2):
    """x'' + x = cos(w t) on one side of x = c v, and + k on the other: a field that jumps."""
    return {
        "rhs": lambda y, t, side: (y[1], jnp.cos(w * t) - y[0] + k * (1 + side[0]) / 2),
        "coordinates": ("x", "v"),
        "period": TURN / w,
        "switches": ({"on": lambda y, t: y[0] - c * y[1]},),
    }


def follow(y, end, motion, height, event, looked_at=()):
    """A state at `end`, and the number of events on the way.

    Args:
        motion: (t0, y0, t, side) to the state.
        height: (y, t), zero at events.
        event: (y, t) to the state after; None of a switch, where the side changes.
        looked_at: more times at which heights are looked at than 20,000 even ones.
    """
    t, count, side, y = 0.0, 0, 1.0 if height(y, 0.0) >= 0.0 else -1.0, np.array(y)
    while True:
        at = lambda s: side * height(motion(t, y, s, side), s)  # noqa: B023, E731
        times = np.union1d(np.linspace(t, end, 20001)[1:], [s for s in looked_at if s > t])
        values = at(times)
        beyond = np.flatnonzero(values[1:] * (values[:-1] > 0.0) < 0.0)
        if not len(beyond):
            return motion(t, y, end, side), count
        s = brentq(at, times[beyond[0]], times[beyond[0] + 1], xtol=1e-15, rtol=1e-14)
        y, t, count = motion(t, y, s, side), s, count + 1
        side, y = (-side, y) if event is None else (side, np.array(event(y, s)))


def impact_exactly(y, w=2.8, r=0.8, wall=0.0, looked_at=()):
    return follow(
        y,
        TURN / w,
        lambda t0, y, t, side: harmonic(t0, y, t, w),
        lambda y, t: y[0] - wall,
        lambda y, t: (y[0], -r * y[1]),
        looked_at,
    )


def ball_exactly(y, g=1.0, a=1.2, r=0.8):
    def fall(t0, y, t, side):
        s = t - t0
        return np.array([y[0] + y[1] * s - g * s * s / 2, y[1] - g * s])

    return follow(
        y, TURN, fall, lambda y, t: y[0] - a * np.sin(t), lambda y, t: (y[0], -r * y[1] + (1 + r) * a * np.cos(t))
    )


def dry_exactly(y, w=1.7, k=0.3, c=0.2):
    return follow(
        y,
        TURN / w,
        lambda t0, y, t, side: harmonic(t0, y, t, w, offset=k * (1 + side) / 2),
        lambda y, t: y[0] - c * y[1],
        None,
    )


SYSTEMS = {
    "impact oscillator": (impact_oscillator, impact_exactly, {"w": 2.8, "r": 0.8, "wall": 0.0}, ("r", "wall")),
    "bouncing ball": (ball, ball_exactly, {"g": 1.0, "a": 1.2, "r": 0.8}, ("g", "a", "r")),
    "dry oscillator": (dry_oscillator, dry_exactly, {"w": 1.7, "k": 0.3, "c": 0.2}, ("k", "c")),
}
STATES = {
    "impact oscillator": [(-1.0, 0.3), (-0.2, 1.5), (-0.5, -1.1), (-0.05, 0.9), (-1.4, 2.2)],
    "bouncing ball": [(2.0, 0.0), (3.0, 1.0), (4.0, -1.0), (5.0, 2.5)],
    "dry oscillator": [(1.0, 0.3), (-0.4, 0.9), (0.7, -1.1), (0.2, 0.9)],
}


def flow_of(name):
    define, _, p, _ = SYSTEMS[name]
    return piecewise_smooth(define, p)


def points(states):
    return jnp.array(states, float)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("loop", [False, True])
def test_maps_are_exact(name, loop):
    """To rounding, with events in some periods and several in some; whole, and in parts with a share of the steps."""
    system, exact = flow_of(name), SYSTEMS[name][1]
    solver = in_loop(dopri8) if loop else dopri8
    strobe = make_return_map(system, solver, 40)
    parts = make_parts(system, solver, 40, 5)

    @jax.jit
    @jax.vmap
    def maps(u):
        z = system.chart.state(u)
        whole = strobe(z, {})
        return whole, jax.lax.scan(lambda z, part: (part(z, {}), None), z, parts)[0]

    ours, in_parts = ([np.asarray(x) for x in state.y] for state in maps(points(STATES[name])))
    theirs = [exact(y) for y in STATES[name]]
    assert max(count for _, count in theirs) >= 1
    exactly = np.array([y for y, _ in theirs]).T
    assert np.abs(np.stack(ours) - exactly).max() < 1e-12
    assert np.abs(np.stack(in_parts) - exactly).max() < 1e-12


@pytest.mark.parametrize("name", SYSTEMS)
def test_derivatives_are_those_of_the_exact_map(name):
    """Saltation matrices, and derivatives in parameters of walls and jumps, by differences of the closed form."""
    _, exact, p, swept = SYSTEMS[name]
    system = flow_of(name)
    strobe = make_return_map(system, dopri8, 40)
    own = {key: p[key] for key in swept}
    d = jax.jit(jax.vmap(lambda u: derivatives(strobe, 1, u, own, swept)))(points(STATES[name]))
    h = 1e-5
    for i, y in enumerate(STATES[name]):

        def difference(change):
            return (change(h) - change(-h)) / (2 * h)

        for j in range(2):
            column = difference(lambda e, j=j, y=y: exact(np.array(y) + e * np.eye(2)[j])[0])
            assert (
                np.abs(np.asarray(d.monodromy)[i, :, j] - column).max() < 1e-8 * max(1.0, np.abs(column).max()) + 1e-8
            )
        for j, key in enumerate(swept):
            column = difference(lambda e, y=y, key=key: exact(y, **{**p, key: p[key] + e})[0])
            assert (
                np.abs(np.asarray(d.by_parameter)[i, :, j] - column).max()
                < 1e-8 * max(1.0, np.abs(column).max()) + 1e-8
            )


@pytest.mark.parametrize("name", SYSTEMS)
def test_volume_is_the_determinant(name):
    """Of the impact oscillator without damping it is r² for each impact, exactly."""
    system = flow_of(name)
    strobe = make_return_map(system, dopri8, 40)

    @jax.jit
    @jax.vmap
    def pushed(u):
        z = system.chart.state(u)
        tangents = tuple(Tangent(system.chart.lift(z, tuple(e))) for e in jnp.eye(2))
        after = strobe.pushforward(z, {}, tangents)
        return jnp.stack([jnp.stack(t.state.y) for t in after.tangents]), jnp.exp(after.log_volume)

    matrices, volume = (np.asarray(x) for x in pushed(points(STATES[name])))
    assert volume == pytest.approx(np.linalg.det(matrices), rel=1e-11)
    if name == "impact oscillator":
        impacts = np.array([impact_exactly(y)[1] for y in STATES[name]])
        assert volume == pytest.approx(0.64**impacts, rel=1e-12)


# ---- exponents


@pytest.mark.parametrize(("w", "known"), [(2.0, -0.0710287984), pytest.param(2.5, -0.0887860, marks=pytest.mark.slow)])
def test_exponents_of_the_impact_oscillator(w, known):
    """Two periodic motions, whose exponents are ln r times the rate of impacts: one impact a period, or in two or three."""
    session = jaxnh.Session(impact, start={"x": -1.0}, target=1e-9, parameters={"w": w})
    found = session.run(jaxnh.Lyapunov(transient=500, periods=500))
    assert found["exponents"].to_numpy().ravel() == pytest.approx([known, known], abs=1e-7)


CHAOS = {2.8: (0.1424, -0.2103), 2.85: (0.2152, -0.2430)}  # of 24,000 periods by `impact_exponents`, ± 0.002


@pytest.mark.slow  # exponents of periodic motions with impacts are quick
@pytest.mark.parametrize("w", CHAOS)
def test_chaos_of_the_impact_oscillator(w):
    """The largest exponent and the sum, which is 2 ln r times the rate of impacts."""
    session = jaxnh.Session(impact, target=1e-9, parameters={"w": w})
    found = session.run(jaxnh.Lyapunov(transient=500, periods=4000), x=np.linspace(-1.0, -0.5, 16))
    exponents = found["exponents"].to_numpy().reshape(-1, 2)
    largest, total = CHAOS[w]
    assert np.all(found["status"] == 0)
    assert exponents[:, 0].mean() == pytest.approx(largest, abs=0.004)
    assert exponents.sum(axis=1).mean() == pytest.approx(total, abs=0.001)


@pytest.mark.slow
@pytest.mark.parametrize("w", CHAOS)
def test_where_the_numbers_of_chaos_are_from(w):
    runs = [impact_exponents(w, 0.8, -1.0 + 0.1 * k, 6000) for k in range(4)]
    assert np.mean(runs, axis=0) == pytest.approx(CHAOS[w], abs=0.004)


def impact_exponents(w, r, x, periods, transient=300):
    """The largest exponent by closed forms and the saltation matrix, and the sum by counting impacts."""
    period, a = TURN / w, 1 / (1 - w * w)
    v, u, growth, impacts = 0.0, np.array([0.6, 0.8]), 0.0, 0
    for i in range(periods + transient):
        t = 0.0
        while True:
            x0, v0 = x - a * np.cos(w * t), v + a * w * np.sin(w * t)
            position = lambda s: x0 * np.cos(s - t) + v0 * np.sin(s - t) + a * np.cos(w * s)  # noqa: B023, E731
            times = np.linspace(t, period, 1200)[1:]
            beyond = np.flatnonzero(np.diff(np.sign(position(times))) > 0)
            end = brentq(position, *times[beyond[0] :][:2], xtol=1e-14) if len(beyond) else period
            c, s = np.cos(end - t), np.sin(end - t)
            x, v = position(end), v0 * c - x0 * s - a * w * np.sin(w * end)
            u, t = np.array([c * u[0] + s * u[1], c * u[1] - s * u[0]]), end
            if not len(beyond):
                break
            force = np.cos(w * t)
            u = np.array([-r * u[0], (1 + r) * force / v * u[0] - r * u[1]])
            x, v, impacts = 0.0, -r * v, impacts + (i >= transient)
        length = np.linalg.norm(u)
        u, growth = u / length, growth + (np.log(length) if i >= transient else 0.0)
    return growth / (periods * period), 2 * np.log(r) * impacts / (periods * period)


def impact(r=0.8, w=2.0):
    def rhs(y, t):
        return y[1], jnp.cos(w * t) - y[0]

    def wall(y, t):
        return y[0]

    def bounce(y, t):
        return y[0], -r * y[1]

    return {
        "rhs": rhs,
        "coordinates": ("x", "v"),
        "period": 2 * jnp.pi / w,
        "jumps": [{"when": wall, "direction": "up", "then": bounce}],
    }


# ---- walls that are hard to see


def test_grazing_is_seen():
    """Impacts that begin and end within one of few steps, at depths down to 1e-10, and motions that just pass by.

    Errors of steps, below 1e-13, grow by the inverse of the speed of the impact, √(2 · depth · acceleration); so do
    entries of the derivative, whose products cancel in the determinant.
    """
    y, w = (-1.5, 0.0), 1.7
    top = brentq(lambda t: harmonic(0.0, y, t, w)[1], 2.0, 2.7, xtol=1e-15)
    peak = harmonic(0.0, y, top, w)[0]
    depths = np.array([1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
    walls = peak + np.concatenate([-depths, depths])
    system = piecewise_smooth(impact_oscillator, {"w": w, "r": 0.8, "wall": 0.0})

    @jax.jit
    @jax.vmap
    def image(wall):
        return derivatives(make_return_map(system, dopri8, 30), 1, jnp.array(y), {"wall": wall})

    ours = image(jnp.asarray(walls))
    for k, (wall, depth) in enumerate(zip(walls, (*depths, *-depths), strict=True)):
        theirs, impacts = impact_exactly(y, w=w, wall=wall, looked_at=(top,))
        assert impacts == (depth > 0) or depth > 1e-3
        assert np.abs(ours.image[k] - theirs).max() < 1e-12 / np.sqrt(abs(depth)), depth
        assert np.linalg.det(ours.monodromy[k]) == pytest.approx(0.64**impacts, rel=1e-14 / abs(depth) + 1e-10)


def test_chattering_is_a_reason():
    """A ball at rest on a table comes there by infinitely many impacts in finite time; another lane goes on."""
    system = piecewise_smooth(ball, {"g": 1.0, "a": 0.0, "r": 0.5})
    strobe = make_return_map(system, tsit5, 10)
    state = states_after(strobe, points([(0.5, 0.0), (100.0, 0.0)]), {}, 1)
    assert state.reason.tolist() == [CHATTERING, 0]
    assert np.isnan(state.y[0][0])
    assert float(state.y[0][1]) == pytest.approx(100.0 - TURN**2 / 2, abs=1e-12)
    codes = system.readout.reports(jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], state))["status"].data
    assert codes.tolist() == [CHATTERING, 0]
    for failed in (jnp.array([0.5, 0.0]), jnp.array([jnp.nan, 0.0])):
        z = system.chart.state(failed)
        pushed = strobe.pushforward(z, {}, (Tangent(system.chart.lift(z, (jnp.float64(1.0), jnp.float64(0.0)))),))
        assert np.isnan([*pushed.tangents[0].state.y, pushed.log_volume]).all()


def test_other_solvers_are_refused():
    with pytest.raises(TypeError, match="Nystrom has no steps that end at jumps and switches"):
        make_return_map(flow_of("dry oscillator"), nystrom8, 10)


def test_sliding_is_chattering():
    """A field that points to its surface from both sides keeps the motion on it, which no crossing is."""

    def define(k=2.0):
        return {
            "rhs": lambda y, t, side: (-k * side[0] + jnp.cos(t),),
            "coordinates": ("x",),
            "period": TURN,
            "switches": ({"on": lambda y, t: y[0]},),
        }

    system = piecewise_smooth(define, {"k": 2.0})
    assert float(make_return_map(system, tsit5, 10)(system.chart.state(jnp.array([0.5])), {}).reason) == CHATTERING


# ---- Chua's circuit


def chua(y, t, side, m0=-8 / 7, m1=-5 / 7):
    x, u, v = y
    corner = side[0] * (x + 1.0) - side[1] * (x - 1.0)
    return 9.0 * (u - x - m1 * x - 0.5 * (m0 - m1) * corner), x - u + v, -100.0 / 7.0 * u


def chua_circuit(alpha=9.0):
    return {
        "rhs": chua,
        "coordinates": ("x", "u", "v"),
        "switches": ({"on": lambda y, t: y[0] + 1.0}, {"on": lambda y, t: y[0] - 1.0}),
    }


def chua_exactly(y, end):
    """The state by exponentials of the three linear parts, with crossings of x = ±1 as roots."""

    def linear(zone):
        slope = -8 / 7 if zone == 0 else -5 / 7
        whole = np.zeros((4, 4))
        whole[:3, :3] = [[-9.0 * (1 + slope), 9.0, 0.0], [1.0, -1.0, 1.0], [0.0, -100.0 / 7.0, 0.0]]
        whole[0, 3] = 9.0 * zone * 3 / 7
        return whole

    y, t, zone = np.array(y), 0.0, int(np.fix(y[0]))
    while True:
        at = lambda s: (expm(linear(zone) * (s - t)) @ np.append(y, 1.0))[:3]  # noqa: B023, E731
        times = np.linspace(t, end, 1001)[1:]
        step, path = expm(linear(zone) * (end - t) / 1000), [np.append(y, 1.0)]
        for _ in times:
            path.append(step @ path[-1])
        x = np.array(path)[1:, 0]
        passed = [(i, wall) for wall in (-1.0, 1.0) for i in np.flatnonzero((x[1:] - wall) * (x[:-1] - wall) < 0)[:1]]
        if not passed:
            return at(end)
        i, wall = min(passed)
        s = brentq(lambda s: at(s)[0] - wall, times[i], times[i + 1], xtol=1e-15, rtol=1e-14)  # noqa: B023
        y, t, zone = at(s), s, int(wall) if zone == 0 else 0


def test_order_of_convergence_at_corners():
    """Methods have their order across the corners of Chua's circuit."""
    system, start = piecewise_smooth(chua_circuit, {"alpha": 9.0}), (0.7, 0.1, -0.2)
    exact = chua_exactly(start, 4.0)
    for solver, counts in ((tsit5, (16, 24, 36, 54)), (dopri8, (8, 10, 13, 16))):
        errors = []
        for count in counts:
            strobe = make_return_map(system, solver, count, span=(0.0, 4.0))
            state = state_after(strobe, jnp.array(start), {})
            errors.append(np.abs(np.array(state.y) - exact).max())
        order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
        assert order > solver.convergence_order - 0.7, (solver.name, errors)


@pytest.mark.slow  # `test_a_target_that_corners_had_refused` is quick
def test_a_target_is_met_at_corners(lanes):
    """1e-10 of the size of the motion, where steps over the corners come down to 1e-8 by the most there can be."""
    system = piecewise_smooth(chua_circuit, {"alpha": 9.0})
    draws = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 24)) * [[2.0], [0.4], [2.5]]
    start = system.start(dict(zip("xuv", draws, strict=True)))
    alpha = {"alpha": np.full(24, 9.0)}
    plan = Calibration([SweepPoints(system, start, alpha, alpha)], lanes).cheapest(1e-10)
    assert plan.error_estimate <= 1e-10
    strobe = make_return_map(system, plan.solver, plan.steps)
    ours = np.array(lanes(iterate, (strobe, np.int32(1)), (start, alpha), periods=1).y)
    theirs = np.array([chua_exactly(y, 1.0) for y in draws.T]).T
    sizes = np.array([plan.sizes[name] for name in "xuv"])
    assert np.max(np.abs(ours - theirs) / sizes[:, None]) < 1e-10


# ---- several walls


def billiard(speed=1.0):
    """A point in the square |x|, |y| < 1."""

    def mirror(i):
        return lambda y, t: tuple(-x if j == i else x for j, x in enumerate(y))

    walls = [(i, way) for i in (0, 1) for way in (1.0, -1.0)]
    return {
        "rhs": lambda y, t: (speed * y[2], speed * y[3], 0.0, 0.0),
        "coordinates": ("x", "y", "u", "v"),
        "jumps": [
            {
                "when": lambda y, t, i=i, way=way: way * y[i] - 1.0,
                "direction": "up",
                "then": mirror(i + 2),
            }
            for i, way in walls
        ],
    }


def test_a_billiard_is_unfolded():
    """Many walls in one step, in order, and two at once in a corner; the volume and squares of velocities are kept."""
    system = piecewise_smooth(billiard, {"speed": 1.0})
    strobe = make_return_map(system, tsit5, 2)
    starts = np.array([(0.1, 0.3, 3.0, -5.0), (0.5, 0.5, 4.0, 4.0), (-0.2, 0.2, 7.0, -7.0), (0.0, -0.9, -2.5, 17.0)])

    @jax.jit
    @jax.vmap
    def pushed(u):
        z = system.chart.state(u)
        after = strobe.pushforward(z, {}, (Tangent(system.chart.lift(z, (1.0, 0.0, 0.0, 0.0))),))
        return after.state, after.tangents[0].state, jnp.exp(after.log_volume)

    state, tangent, volume = pushed(points(starts))
    x, y, u, v = starts.T
    phase = np.stack([x + u, y + v]) + 1.0  # unfolded, from the wall at −1
    folded = np.abs((phase + 2.0) % 4.0 - 2.0) - 1.0
    up = np.where(phase % 4.0 < 2.0, 1.0, -1.0)
    assert state.reason.tolist() == [0] * 4
    assert np.abs(np.stack(state.y[:2]) - folded).max() < 1e-13
    assert np.abs(np.stack(state.y[2:]) - np.stack([u, v]) * up).max() == 0.0
    assert np.abs(np.asarray(tangent.y[0]) - up[0]).max() < 1e-12
    assert volume == pytest.approx(np.ones(4), abs=1e-12)


def test_both_directions():
    """x'' = −x with v halved whenever x = 0 is passed, once in each half turn."""

    def define(r=0.5):
        return {
            "rhs": lambda y, t: (y[1], -y[0]),
            "coordinates": ("x", "v"),
            "time_unit": TURN / 2,
            "jumps": [{"when": lambda y, t: y[0], "direction": "both", "then": lambda y, t: (y[0], r * y[1])}],
        }

    def turned(y, angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.array([c * y[0] + s * y[1], c * y[1] - s * y[0]])

    system, start = piecewise_smooth(define, {"r": 0.5}), np.array([0.6, -0.8])
    for steps in (16, 112):
        y = start
        for n in range(1, 4):
            wait = (np.arctan2(y[1], y[0]) - np.pi / 2) % np.pi  # states turn clockwise
            y = turned([0.0, 0.5 * turned(y, wait)[1]], np.pi - wait)
            strobe = make_return_map(system, dopri8, steps)
            ours = image_after(strobe, jnp.asarray(start), {}, n)
            assert np.abs(np.asarray(ours) - y).max() < 1e-10


def test_trip_counts_of_stacked_maps_of_an_array_field():
    """A parameter that all lanes share is an array of the parts in a stack, and no number that multiplies a matrix."""

    def define(a=1.0, r=2.0):
        def rhs(y, t):
            x = jnp.stack(y)
            return jnp.abs(r * (2.0 * jnp.eye(2) @ jnp.stack([x, x]))).sum(axis=1) - a * x

        return {"rhs": rhs, "coordinates": ("x", "y")}

    values = {"a": 1.0, "r": 2.0}
    system = piecewise_smooth(with_switches(define, values), values, ("a",))
    grids = np.linspace(0.0, 1.0, 5) + np.arange(3.0)[:, None]
    assert jumping_strobe(system, verner9, grids).trip_counts == jumping_strobe(system, verner9, grids[0]).trip_counts


def test_a_jump_that_sets_a_coordinate():
    """u' = u/5 is set to 0.3 when the clock x strikes one, so that a tangent along it vanishes, as rank is lost."""

    def clock(then):
        jumps = ({"when": lambda y, t: y[0] - 1.0, "direction": "up", "then": then},)
        return {"rhs": lambda y, t: (1.0 + 0.0 * y[0], 0.2 * y[1]), "coordinates": ("x", "u"), "jumps": jumps}

    shifts = piecewise_smooth(lambda: clock(lambda y, t: (y[0] - 1.0, y[1] - 0.3)), {})
    sets = piecewise_smooth(lambda: clock(lambda y, t: (y[0] - 1.0, 0.0 * y[1] + 0.3)), {})
    roots = piecewise_smooth(lambda: clock(lambda y, t: (y[0] - 1.0, -jnp.sqrt(y[1] - 3.0))), {})  # of what is above 3
    assert (shifts.loses_rank, sets.loses_rank, roots.loses_rank) == (False, True, False)
    begun = begin(sets, sets.start({"x": np.float64(0.5), "u": np.float64(0.3 * np.exp(0.1))}), 1)
    strobes = make_parts(sets, tsit5, 2, 1)
    along, across = jax.jit(lambda growth: advance(strobes, None, 3, 0.0, growth, {}).logs)(begun)
    assert np.isneginf(across)
    assert along == pytest.approx(0.0, abs=1e-6)  # after each period the state is the same


def test_a_dense_field_is_evaluated_once_a_stage_for_its_divergence():
    """Each of eight rates depends on all coordinates through one exponential, which no derivative repeats."""

    def coupled():
        def rhs(y, t, side):
            weight = jnp.exp(-sum(x * x for x in y))
            return tuple(weight * x - side[0] for x in y)

        names = tuple(f"x{i}" for i in range(8))
        return {"rhs": rhs, "coordinates": names, "period": 1.0, "switches": ({"on": lambda y, t: y[0]},)}

    system = piecewise_smooth(coupled, {})
    strobe = jumping_strobe(system, in_loop(tsit5), np.linspace(0.0, 1.0, 9))
    state = system.chart.state(jnp.ones(8))

    def exponentials(volume):
        tangents = (Tangent(jax.tree.map(jnp.ones_like, state), {}),)
        return str(jax.make_jaxpr(lambda z: strobe.pushforward(z, {}, tangents, volume))(state)).count(" exp ")

    assert exponentials(volume=True) == exponentials(volume=False)
