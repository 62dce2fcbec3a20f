"""Fields that jump at evenly spaced values, by floor and what is made of it, and by tables: surfaces and motions."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxnh
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives
from jaxnh.solvers import dopri8
from jaxnh.systems.corners import with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.small_arrays import by_numbers
from jaxnh.systems.straight_pieces import names_without_surface
from tests.helpers.one_lane import state_after

pytestmark = pytest.mark.usefixtures("quick_compiling", "shared_programs")

START = (0.3, 0.2)
PLACES, HEIGHTS = np.array([0.0, 0.7, 0.7, 1.6, 2.0]), np.array([0.0, 1.0, -0.5, 0.4, 0.0])
FORCES = {
    "a sawtooth": (lambda m, t: m.mod(t, 2.0) - 1.0, 1),
    "a sawtooth that falls": (lambda m, t: m.mod(-t, 1.3), 1),
    "a triangle": (lambda m, t: m.abs(m.mod(t, 2.0) - 1.0), 2),
    "pulses": (lambda m, t: m.where(m.mod(t, 2.0) < 0.3, 5.0, 0.0), 2),
    "pulses in the middle": (lambda m, t: m.where(m.abs(t % 2.0 - 1.0) < 0.17, 5.0, 0.0), 2),
    "every second one": (lambda m, t: m.where((m.mod(t, 1.0) < 0.4) & (t // 1.0 % 2 == 0), 3.0, 0.0), 2),
    "stairs": (lambda m, t: m.floor(t) - 2.0 * m.ceil(t / 1.7) + m.round(0.8 * t), 3),
    "a remainder with a sign": (lambda m, t: m.fmod(1.5 - t, 1.1), 1),
    "a table that repeats": (lambda m, t: m.interp(t, PLACES[1:4:2] - 0.3, HEIGHTS[1:4:2], period=2.0), 5),
    "a table with ends": (lambda m, t: m.interp(t, PLACES[3:] + 0.5, HEIGHTS[3:], 2.0, -1.0), 2),
    "a table": (lambda m, t: m.interp(m.mod(t, 2.0), PLACES, HEIGHTS), 3),
}
LEAPS = np.unique(np.concatenate([k * np.array([1.0, 1.3, 1.7, 2.0, 1.1]) for k in range(9)]))
EVENTS = np.concatenate([LEAPS, LEAPS + 0.3, LEAPS + 0.4, LEAPS + 0.7, LEAPS + 0.83, LEAPS + 1.17, LEAPS + 1.6])
EVENTS = np.unique(
    np.concatenate([EVENTS, LEAPS + 0.5, LEAPS + 2.1, (np.arange(9) + 0.5) / 0.8, 1.5 + LEAPS]).round(12)
)
END = 4.5


def oscillator(force):
    def define(a=1.0):
        return {"rhs": lambda y, t: (y[1], -0.3 * y[1] - y[0] ** 3 + a * force(jnp, t)), "coordinates": ("x", "v")}

    return define


def followed(force, y=START, a=1.0):
    """DOP853 from leap to leap, with the force of the middle between them and none of their ends."""
    times = np.unique(np.concatenate([[0.0, END], EVENTS[(EVENTS > 0) & (EVENTS < END)]]))
    for begin, end in itertools.pairwise(times):

        def rhs(t, y, begin=begin, end=end):
            inside = np.clip(t, begin + 1e-13, end - 1e-13)
            return y[1], -0.3 * y[1] - y[0] ** 3 + a * force(np, inside)

        y = solve_ivp(rhs, (begin, end), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return y


@pytest.mark.parametrize("name", FORCES)
def test_forces_that_leap(name):
    """A method of order 8 comes to rounding across all leaps, in 67 steps of which none ends there by itself."""
    force, surfaces = FORCES[name]
    system = piecewise_smooth(with_switches(oscillator(force), {"a": 1.0}), {"a": 1.0})
    assert system.switches == surfaces
    strobe = make_return_map(system, dopri8, 67, span=(0.0, END))
    ours = np.array(state_after(strobe, jnp.array(START), {}).y)
    assert np.abs(ours - followed(force)).max() < 1e-11


def test_derivatives_across_leaps():
    """Pulses whose end moves with a state: the tangents have its saltation, by differences of DOP853 of order h²."""

    def define(a=1.0):
        def rhs(y, t):
            x, v = y
            return v, -0.3 * v - jnp.floor(2.0 * x) + jnp.where(jnp.mod(x + t, 1.0) < 0.3, a, 0.0)

        return {"rhs": rhs, "coordinates": ("x", "v")}

    def exact(y, a=1.0):
        """From event to event: floor(2x), floor(x + t) and the pulse as they are in the middle of a piece."""
        t, y = 0.0, np.array(y)
        while t < 2.0:
            x = y[0] + 1e-9 * y[1]
            stair, cell = np.floor(2.0 * x), np.floor(x + t + 1e-9)
            force = (a if x + t + 1e-9 - cell < 0.3 else 0.0) - stair
            borders = [(2, 0, stair), (2, 0, stair + 1), (1, 1, cell), (1, 1, cell + 1), (1, 1, cell + 0.3)]
            events = [lambda t, y, f, border=border: border[0] * y[0] + border[1] * t - border[2] for border in borders]
            for event in events:
                event.terminal = True
            for end in (t + 1e-10, 2.0):  # events are looked for from a little later on
                piece = solve_ivp(
                    lambda t, y, f: (y[1], -0.3 * y[1] + f), (t, end), y, args=(force,),
                    method="DOP853", rtol=1e-13, atol=1e-15, events=events if end == 2.0 else None, max_step=0.02,
                )  # fmt: skip
                t, y = piece.t[-1], piece.y[:, -1]
        return y

    system = piecewise_smooth(with_switches(define, {"a": 1.0}), {"a": 1.0})
    strobe = make_return_map(system, dopri8, 40, span=(0.0, 2.0))
    ours = np.array(state_after(strobe, jnp.array([0.31, 0.9]), {"a": 1.0}).y)
    assert np.abs(ours - exact((0.31, 0.9))).max() < 1e-10
    d = jax.jit(lambda u: derivatives(strobe, 1, u, {"a": 1.0}, ("a",)))(jnp.array([0.31, 0.9]))
    h = 1e-5
    columns = [(exact((0.31 + s, 0.9 + r)) - exact((0.31 - s, 0.9 - r))) / (2 * h) for s, r in ((h, 0), (0, h))]
    by_a = (exact((0.31, 0.9), 1.0 + h) - exact((0.31, 0.9), 1.0 - h)) / (2 * h)
    assert np.abs(np.asarray(d.monodromy) - np.array(columns).T).max() < 1e-7
    assert np.abs(np.asarray(d.by_parameter)[:, 0] - by_a).max() < 1e-7


R, L, C, RAMP, GAIN = 22.0, 20e-3, 47e-6, 400e-6, 8.4


def buck(vin=33.0):
    """A converter of voltages (Deane and Hamill 1990): on where the gained error is below a ramp of 400 microseconds."""

    def rhs(y, t):
        v, i = y
        on = jnp.where(GAIN * (v - 11.3) < 3.8 + 4.4 * (t % RAMP) / RAMP, 1.0, 0.0)
        return (i - v / R) / C, (on * vin - v) / L

    return {"rhs": rhs, "coordinates": ("v", "i"), "period": RAMP}


def switched_exactly(y, vin):
    """A ramp by exponentials of the linear equations between switchings, which are sought at 4,000 places."""
    a = np.array([[-1.0 / (R * C), 1.0 / C], [-1.0 / L, 0.0]])
    values, vectors = np.linalg.eig(a)
    t, y = 0.0, np.array(y)
    while t < RAMP:
        on = GAIN * (y[0] + 1e-9 * (y[1] - y[0] / R) / C - 11.3) < 3.8 + 4.4 * (t + 1e-9) / RAMP
        rest = np.array([vin * on, vin * on / R])

        def moved(span, rest=rest, y=y):
            share = np.linalg.solve(vectors, y - rest)
            return rest[:, None] + np.real(vectors @ (np.exp(np.outer(values, np.atleast_1d(span))) * share[:, None]))

        def gap(span, t=t, moved=moved):
            return GAIN * (moved(span)[0] - 11.3) - 3.8 - 4.4 * (t + span) / RAMP

        spans = np.linspace(1e-9, RAMP - t, 4001)
        passed = np.flatnonzero(np.diff(np.sign(gap(spans))))
        span = RAMP - t
        if len(passed):
            span = brentq(lambda s, gap=gap: gap(s)[0], *spans[passed[0] : passed[0] + 2], xtol=1e-18)
        t, y = t + span, moved(span)[:, 0]
        t = RAMP if not len(passed) else t
    return y


@pytest.mark.parametrize("vin", [28.0, 33.0])
def test_a_ramp_that_is_compared_with(vin):
    """Ramps without a switching, and with several, whose comparison leaps with the ramp; areas shrink by exp(−T/RC)."""
    system = piecewise_smooth(with_switches(buck, {"vin": vin}), {"vin": vin})
    strobe = make_return_map(system, dopri8, 8)
    y = np.array([12.0, 0.55])
    step = jax.jit(lambda u: derivatives(strobe, 1, u, {"vin": jnp.float64(vin)}, ("vin",)))
    for _ in range(24):
        exact = switched_exactly(y, vin)
        ours = step(jnp.array(y))
        assert np.abs(np.asarray(ours.image) / exact - 1.0).max() < 1e-9
        assert np.linalg.det(np.asarray(ours.monodromy)) == pytest.approx(np.exp(-RAMP / (R * C)), rel=1e-8)
        y = exact


def comb(push=0.3):
    """x'' = −x + push where 3x has a fraction below a half: its energy is kept."""

    def rhs(y, t):
        x, v = y
        return v, -x + jnp.where((3.0 * x) % 1.0 < 0.5, push, 0.0)

    return {"rhs": rhs, "coordinates": ("x", "v")}


def test_returns_to_a_section_past_leaps():
    """At v = 0 motions of each start have the energy of it, and neither exponent is far from zero."""
    session = jaxnh.Session(comb, start={"x": 1.3}, target=1e-9).on(normal={"v": 1.0}, direction="up")
    push = np.array([0.1, 0.3])
    x = session.run(jaxnh.Diagram(transient=4, strobes=16), push=push)["x"].to_numpy()
    exponents = session.run(jaxnh.Lyapunov(periods=64, exponents=2), push=push)["exponents"].to_numpy()

    def energy(x):
        cell = np.floor(3.0 * x)
        return 0.5 * x**2 - push[:, None] * (0.5 * cell + np.minimum(3.0 * x - cell, 0.5)) / 3.0

    assert np.abs(energy(x) - energy(np.full((2, 1), 1.3))).max() < 1e-8
    assert np.abs(exponents).max() < 0.1


def test_names_of_what_has_no_surface():
    def rhs(y):
        inner = jax.lax.fori_loop(0, 3, lambda i, x: x + jnp.abs(y[1]), 0.0)
        return jnp.floor(y[0]) + jnp.mod(y[1], 1.0) + inner, jnp.max(jnp.stack(y)), jax.nn.softplus(y[0]), jnp.abs(y[0])

    assert set(names_without_surface(rhs, (0.0, 0.0, 0.0))) == {"floor", "rem", "abs", "max"}

    def leaping(y, t):
        return jnp.floor(y[0]) + jnp.mod(y[1], 1.0) + jnp.argmax(jnp.stack(y)).astype(float), 0.0, 0.0

    rhs = with_switches(lambda: {"rhs": leaping, "coordinates": ("x", "y", "z")}, {})()["rhs"]
    assert names_without_surface(lambda y: rhs(y, 0.0, (1.0, 1.0)), (0.0, 0.0, 0.0)) == ("argmax",)
    assert names_without_surface(lambda y: (jnp.abs(y[0]), jnp.hypot(y[1], y[2])), (0.0, 0.0, 0.0)) == ()


def test_remainders_of_whole_numbers_stay():
    """They are no places of a motion: rates are as they were."""

    def rhs(x, v):
        weights = jnp.stack([x, v, x]) * ((jnp.arange(3) % 2) // 2).astype(float)
        return jnp.abs(x) + weights.sum() + (jnp.arange(3) % 2).sum().astype(float) * v, -v

    assert [float(x) for x in jax.jit(by_numbers(rhs))(-0.5, 0.25)] == [0.75, -0.25]
