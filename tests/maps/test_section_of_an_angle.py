"""Sections of angles, which are met once a turn: times and states in closed form, with jumps and without."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.maps.build import make_return_map
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import tsit5
from jaxnh.systems.first_order import first_order
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.status import NO_RETURN
from tests.helpers.one_lane import compiled_iterate

pytestmark = pytest.mark.usefixtures("quick_compiling")
TURN = 2.0 * np.pi


def rotor(omega=1.0):
    """An angle that turns evenly, beside a coordinate that rises at speed 1."""
    return {
        "rhs": lambda y, t: (omega + 0.0 * y[0], 1.0 + 0.0 * y[1]),
        "coordinates": ("angle", "x"),
        "angles": "angle",
    }


def sawtooth(omega=1.0):
    """The same, x from 1 back to −1."""
    jump = {"when": lambda y, t: y[1] - 1.0, "direction": "up", "then": lambda y, t: (y[0], -1.0 + 0.0 * y[1])}
    return {**rotor(omega), "jumps": (jump,)}


def swing():
    """angle = 4 cos(t + phase): beyond half a turn to both sides."""
    return {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("angle", "w"), "angles": "angle"}


def struck_swing():
    """The same, with a wall that is never met."""
    return {
        **swing(),
        "jumps": ({"when": lambda y, t: y[0] - 9.0, "direction": "up", "then": lambda y, t: (y[0], -y[1])},),
    }


MAKERS = {rotor: first_order, sawtooth: piecewise_smooth, swing: first_order, struck_swing: piecewise_smooth}


def crossings(define, p, section, steps, start, count):
    """Times, states and reasons of the first crossings of (value, direction)."""
    system = Section(MAKERS[define](define, p), "angle", 0, *section, longest=20.0)
    state = begin(system, system.flow.start(dict(zip(system.flow.coordinates, map(np.asarray, start), strict=True))))
    met = [compiled_iterate(make_return_map(system, tsit5, steps), n, state, {}) for n in range(1, count + 1)]
    ends = [np.asarray(getattr(c.state, "y", c.state[0])) for c in met]
    return np.array([c.t for c in met]), np.array(ends), [float(c.reason) for c in met]


@pytest.mark.parametrize("omega", [5.0, -5.0])
@pytest.mark.parametrize(("define", "direction"), [(rotor, "up"), (sawtooth, "down")])
def test_an_angle_that_runs(define, direction, omega):
    """It is met after each turn, in steps of 5 as in shorter ones, and in one direction alone."""
    for steps in (1, 7):
        times, states, reasons = crossings(define, {"omega": omega}, (1.0, direction), steps, (0.5, 0.0), 3)
        if direction == ("down" if omega > 0 else "up"):
            assert reasons == [NO_RETURN] * 3
            assert np.isnan(times).all()
            continue
        expected = ((1.0 - 0.5) / omega) % (TURN / abs(omega)) + TURN / abs(omega) * np.arange(3)
        assert reasons == [0.0] * 3
        assert np.abs(times - expected).max() < 1e-12
        assert np.abs(states[:, 0] - 0.5 - omega * expected).max() < 1e-11
        x = expected if define is rotor else (expected + 1.0) % 2.0 - 1.0
        assert np.abs(states[:, 1] - x).max() < 1e-11


@pytest.mark.parametrize("define", [swing, struck_swing])
def test_an_angle_that_turns_back(define):
    """2.5 and 2.5 − 2π are both the section; the far side, half a turn away, is none."""
    times, states, _ = crossings(define, {}, (2.5, "both"), 100, (4.0, 0.0), 5)
    t = np.linspace(0.0, 20.0, 200_001)
    passed = np.diff(np.floor((4.0 * np.cos(t) - 2.5) / TURN)) != 0.0
    assert np.abs(times - t[:-1][passed][:5]).max() < 2e-4  # the grid's spacing, twice
    assert np.abs(4.0 * np.cos(times) - states[:, 0]).max() < 1e-9
    assert np.abs((states[:, 0] - 2.5) / TURN - np.round((states[:, 0] - 2.5) / TURN)).max() < 1e-12


@pytest.mark.parametrize(
    ("normal", "turn"), [(None, TURN), ((1.0, -1.0), TURN), ((2.0, 2.0), 2 * TURN), ((0.5, 1.0), 0.0)]
)
def test_what_values_repeat_after(normal, turn):
    """Of one angle, and of sums with whole weights; of others there is no such thing."""

    def two():
        return {"rhs": lambda y, t: (1.0 + 0 * y[0], 0.1 * y[1]), "coordinates": ("a", "b"), "angles": ("a", "b")}

    assert Section(first_order(two, {}), "a", 0, 0.0, "up", normal).turn == turn
    assert Section(first_order(two, {}), "a", 0, 0.0, "up", (1.0, 0.0)).turn == TURN


def test_a_start_at_rest_on_the_section_is_no_crossing():
    """x'' = 1 from the section, at rest across it: it leaves, in both directions."""

    def fall():
        return {"rhs": lambda y, t: (y[1], 1.0 + 0.0 * y[1]), "coordinates": ("angle", "v")}

    system = Section(first_order(fall, {}), "angle", 0, 0.0, "both", longest=2.0)
    state = begin(system, system.flow.start({"angle": np.array(0.0), "v": np.array(0.0)}))
    assert float(compiled_iterate(make_return_map(system, tsit5, 4), 1, state, {}).reason) == NO_RETURN
