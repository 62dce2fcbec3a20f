"""Maps of fields with many surfaces, whose heights are one vector, against closed forms."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.jumping import jumping_strobe
from jaxnh.maps.protocol import Tangent
from jaxnh.solvers import verner9
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.corners import with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth

CORNERS = np.arange(1.0, 14.0)
SLOPES = 0.3 * (-1.0) ** np.arange(13)
LENGTH = 3.0


def speed(x):
    return 5.0 + np.sum(SLOPES * np.abs(x - CORNERS))


def staircase(a=1.0):
    """x' = a f(x) with thirteen corners, and y' = x − y, which reads them."""

    def rhs(y, t):
        f = 5.0 + sum(slope * jnp.abs(y[0] - corner) for slope, corner in zip(SLOPES, CORNERS, strict=True))
        return a * f, y[0] - y[1]

    return {"rhs": rhs, "coordinates": ("x", "y")}


def exact_x(x, t):
    """x after a time t: on each piece, of slope s, f(x) grows as e^(s t)."""
    while True:
        end = np.min(CORNERS, where=x < CORNERS, initial=np.inf)
        slope = np.sum(SLOPES * np.where(x < CORNERS, -1.0, 1.0))
        through = np.log(speed(end) / speed(x)) / slope if np.isfinite(end) else np.inf
        if through >= t:
            return x + speed(x) * np.expm1(slope * t) / slope
        x, t = end, t - through


@pytest.fixture(scope="module")
def system():
    made = piecewise_smooth(with_switches(staircase, {"a": 1.0}), {"a": 1.0}, ("a",))
    assert made.switches == len(CORNERS)
    assert made.many_surfaces
    return made


def test_what_many_heights_share_is_computed_once():
    """Levels k/14 of sin y are crossed by one sine, and heights are those of the surfaces one by one."""

    def steps(a=1.0):
        def rhs(y, t):
            s = jnp.sin(a * y[0])
            return (2.0 + sum(jnp.abs(s - k / 14.0) for k in range(13)),)

        return {"rhs": rhs, "coordinates": ("y",)}

    define = with_switches(steps, {"a": 1.0})
    made = piecewise_smooth(define, {"a": 1.0}, ("a",))
    state = made.start({"y": 0.3})

    def heights(state):
        return made.heights(0.0, state, {"a": 1.0})

    each = [switch["on"](state.y, 0.0) for switch in define(a=1.0)["switches"]]
    np.testing.assert_array_equal(heights(state), each)
    assert sorted(map(abs, each)) == pytest.approx(sorted(abs(np.sin(0.3) - np.arange(13) / 14.0)), abs=1e-16)
    assert str(jax.make_jaxpr(heights)(state)).count(" sin ") == 1


@pytest.mark.parametrize("solver", [verner9, in_loop(verner9)], ids=["written", "loop"])
def test_many_corners(system, solver):
    """State, tangents in the state and in a parameter, and volume; 24 steps of order 9, each across part of a piece.

    dx/dx₀ = f(x)/f(x₀), and dx/da = t f(x), as a scales time; y forgets where it began as e^(−t), and so the volume is
    e^(−t) f(x)/f(x₀). Steps between corners are of a linear field whose rates times a step, of an eighth, are at most
    1/8: the error of a step is of the order of (1/8)¹⁰/10!, below rounding, and what is left is that of some 50 trials.
    """
    strobe = jumping_strobe(system, solver, np.linspace(0.0, LENGTH, 25))
    starts = np.array([0.3, 0.5, 1.9])
    states = system.start({"x": starts, "y": np.zeros(3)})

    def pushed(state):
        still = jax.tree.map(jnp.zeros_like, state)
        units = [still._replace(y=(still.y[0] + float(i == 0), still.y[1] + float(i == 1))) for i in range(2)]
        tangents = (*(Tangent(unit, {}) for unit in units), Tangent(still, {"a": jnp.ones(())}))
        return strobe.pushforward(state, {"a": jnp.ones(())}, tangents)

    ended = jax.jit(jax.vmap(pushed))(states)
    exact = np.array([exact_x(x, LENGTH) for x in starts])
    assert np.all(exact > CORNERS[-1])
    ratio = np.array([speed(x1) / speed(x0) for x1, x0 in zip(exact, starts, strict=True)])
    by_x, by_y, by_a = ended.tangents
    assert np.array(ended.state.y[0]) == pytest.approx(exact, rel=1e-11)
    assert np.array(by_x.state.y[0]) == pytest.approx(ratio, rel=1e-11)
    assert np.array(by_y.state.y[0]) == pytest.approx(np.zeros(3), abs=1e-14)
    assert np.array(by_y.state.y[1]) == pytest.approx(np.full(3, np.exp(-LENGTH)), rel=1e-11)
    assert np.array(by_a.state.y[0]) == pytest.approx([LENGTH * speed(x) for x in exact], rel=1e-11)
    assert np.exp(ended.log_volume) == pytest.approx(np.exp(-LENGTH) * ratio, rel=1e-11)


def test_tangents_of_many_corners_are_one_array(system):
    """Four have the products of two: only where they are stacked and taken apart are there more equations."""
    strobe = jumping_strobe(system, in_loop(verner9), np.linspace(0.0, LENGTH, 25))
    state = system.start({"x": 0.3, "y": 0.0})

    def products(count):
        tangents = (Tangent(jax.tree.map(jnp.ones_like, state), {}),) * count
        return str(jax.make_jaxpr(lambda z: strobe.pushforward(z, {}, tangents))(state)).count(" mul ")

    assert products(4) == products(2)
