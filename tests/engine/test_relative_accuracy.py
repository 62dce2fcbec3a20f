"""Errors relative to the size of the motion in each coordinate, against closed forms and heyoka's Taylor integrator."""

from __future__ import annotations

import json
import math
import re
from types import SimpleNamespace

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.engine.accuracy import calibration, reference
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.accuracy.diagnostics import explain_long_returns, explain_motion
from jaxnh.engine.accuracy.kinks import find_kink
from jaxnh.engine.accuracy.sample_maps import Samples
from jaxnh.engine.accuracy.sizes import coordinate_names
from jaxnh.engine.axes import SweepPoints
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.section import Section, begin
from jaxnh.systems.first_order import first_order
from jaxnh.systems.lagrangian import lagrangian
from jaxnh.systems.particle import constant_speed
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from tests.helpers.batches import calibrated
from tests.helpers.commands import run_here
from tests.helpers.kept_programs import lanes_with_kept_programs
from tests.helpers.short_portrait import short_portrait

TARGET = 1e-9


@pytest.fixture(scope="module")
def lanes():
    return lanes_with_kept_programs(tile=8)


def plan_and_calibration(define, start, lanes, target=TARGET, **parameters):
    """The plan of one lane, by the parameter `rate`, and what it was chosen by."""
    flow = first_order(define, {"rate": 1.0, **parameters}, ("rate",))
    state = flow.start({name: float(value) for name, value in zip(flow.coordinates, start, strict=True)})
    calibration = calibrated(flow, state, [1.0], lanes, name="rate")
    return flow, calibration.cheapest(target), calibration


# ---- sizes


def forked(mu=0.5):
    """x' = cos t − x beside w' = μw − w³, where w dies out or comes to √μ."""
    rhs = lambda y, t: (jnp.cos(t) - y[0], mu * y[1] - y[1] ** 3)  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "w"), "period": 2 * jnp.pi}


def test_a_coordinate_that_rests_in_most_lanes_has_the_size_of_the_others():
    """Four lanes leave w nothing; in units of that rounding of the fifth, of √½, would be refused."""
    session = jaxnh.Session(forked, {"x": 0.5, "w": 0.01}, 1e-11)
    data = session.run(jaxnh.Diagram(strobes=2), mu=[-1.0, -0.9, -0.8, -0.7, 0.5])
    assert abs(float(data["w"][-1, -1]) - math.sqrt(0.5)) < 1e-11
    assert np.abs(data["x"] - 0.5).max() < 1e-10


def oscillator(rate=1.0, unit=2.0):
    """x'' = −rate² x − x'/8 + unit cos t, x in other units than its velocity."""
    return {
        "rhs": lambda y, t: (unit * y[1], -rate * rate * y[0] / unit - 0.125 * y[1] + jnp.cos(t)),
        "coordinates": ("x", "v"),
        "period": 2 * np.pi,
    }


@pytest.mark.parametrize("unit", [1e6, 1e-6])
def test_units_of_a_coordinate_do_not_count(lanes, unit):
    """A micrometre for a metre: the same steps, errors and sizes, these in their units."""
    _, plain, _ = plan_and_calibration(oscillator, (2.0, 0.0), lanes)
    _, scaled, _ = plan_and_calibration(oscillator, (2.0 * unit, 0.0), lanes, unit=2.0 * unit)
    assert (scaled.solver.name, scaled.steps, scaled.parts) == (plain.solver.name, plain.steps, 1)
    assert scaled.error_estimate == pytest.approx(plain.error_estimate, rel=0.05)  # rounding of sizes below 1e-9 is 1 %
    assert scaled.sizes["x"] == pytest.approx(unit * plain.sizes["x"], rel=1e-9)
    assert scaled.sizes["v"] == pytest.approx(plain.sizes["v"], rel=1e-9)


def test_estimate_is_relative(lanes):
    """Of x'' = −x with x of size 1e6 the true error of one unit of time, by cos and sin, is below the estimate."""

    def define(rate=1.0):
        return {"rhs": lambda y, t: (1e6 * y[1], -rate * y[0] / 1e6), "coordinates": ("x", "v"), "time_unit": 5.0}

    flow, plan, _ = plan_and_calibration(define, (1e6, 0.0), lanes)
    image = iterate(make_return_map(flow, plan.solver, plan.steps), 1, flow.start({"x": 1e6, "v": 0.0}), {"rate": 1.0})
    x, v = (float(leaf) for leaf in image.y)
    assert abs(x / 1e6 - math.cos(5.0)) < plan.error_estimate <= TARGET
    assert abs(v + math.sin(5.0)) < plan.error_estimate
    assert abs(x - 1e6 * math.cos(5.0)) > 1e-13  # an absolute target of 1e-9 has a millionth of it
    assert plan.sizes == pytest.approx({"x": 1e6, "v": 1.0}, rel=0.05)  # at multiples of 5, over ten turns


def test_a_size_that_the_user_gives(lanes):
    flow = first_order(oscillator, {"rate": 1.0, "unit": 2.0}, ("rate",))
    state, p = flow.start({"x": np.ones(1), "v": np.zeros(1)}), {"rate": np.ones(1)}
    given, measured = (
        Calibration([SweepPoints(flow, state, p, p)], lanes, sizes=sizes) for sizes in ({"x": 1e4, "v": 1e4}, {})
    )
    assert given.sizes == {"x": 1e4, "v": 1e4}
    solver = given.cheapest(1e-6).solver
    ratio = measured.error(solver, 24) / given.error(solver, 24)
    assert 1e4 / max(measured.sizes.values()) <= ratio * (1 + 1e-9)
    assert ratio * (1 - 1e-9) <= 1e4 / min(measured.sizes.values())


def rotator(rate=1.0):
    """θ' = 2 + rate sin θ."""
    return {"rhs": lambda y, t: (2.0 + rate * jnp.sin(y[0]),), "coordinates": ("theta",), "time_unit": 1.0}


def test_an_angle_that_runs(lanes):
    """Steps are those of the same motion near zero, and a thousand turns away it is as good, by heyoka."""
    _, near, _ = plan_and_calibration(rotator, (0.25,), lanes)
    far = 0.25 + 2000 * math.pi
    flow, away, calibration = plan_and_calibration(rotator, (far,), lanes)
    assert away.steps == near.steps
    assert 1.0 < away.sizes["theta"] < 3.0  # the rate is between 1 and 3
    assert calibration.floor < 1e-10  # the last digit of 6283 is 9e-13
    theta = hy.make_vars("theta")
    exact = hy.taylor_adaptive([(theta, 2.0 + hy.sin(theta))], [far])
    exact.propagate_until(1.0)
    image = iterate(make_return_map(flow, away.solver, away.steps), 1, flow.start({"theta": far}), {"rate": 1.0})
    assert abs(float(image.y[0]) - exact.state[0]) < away.error_estimate * away.sizes["theta"]


def test_a_place_far_from_zero_that_no_rate_knows(lanes):
    """x' = v at x = 1e5: what it changes by is its size, and not where it begins."""

    def define(rate=1.0):
        return {"rhs": lambda y, t: (y[1], -rate * jnp.sin(y[2]), y[1]), "coordinates": ("x", "v", "q")}

    _, plan, _ = plan_and_calibration(define, (1e5, 0.5, 0.0), lanes)
    assert plan.sizes["x"] < 1.0
    assert plan.sizes["x"] == pytest.approx(plan.sizes["q"], rel=0.6)  # of the same motion, one by its increments


def test_a_clock_as_a_coordinate(lanes):
    """s' = 1e4 a second and x'' = −x + cos(s/1e4): s comes to 1.7e6 and is compared by its increment, to the bit."""

    def define(rate=1.0):
        rates = lambda y, t: (y[1], -2.0 * rate * y[0] + jnp.cos(y[2] / 1e4), 1e4 + 0.0 * y[2])  # noqa: E731
        return {"rhs": rates, "coordinates": ("x", "v", "s")}

    _, plan, calibration = plan_and_calibration(define, (1.0, 0.0, 0.0), lanes)
    assert plan.sizes["s"] == pytest.approx(1e4, rel=1e-9)
    assert calibration.floor < 1e-11


def test_a_coordinate_that_is_nothing_but_rounding(lanes):
    """w keeps to 3 x − x − 2 x, which is zero but for rounding: it refuses nothing."""

    def define(rate=1.0):
        def rhs(y, t):
            noise = (y[0] * 1.1 - y[0]) - 0.1 * y[0]
            return y[1], -rate * y[0], noise - 5.0 * y[2]

        return {"rhs": rhs, "coordinates": ("x", "v", "w")}

    _, plan, _ = plan_and_calibration(define, (1.0, 0.0, 0.0), lanes)
    assert plan.error_estimate <= TARGET


def test_names_of_components():
    """Velocities after positions, as errors are compared in."""
    flow = lagrangian(
        lambda g=1.0: {
            "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2),
            "Q": lambda q, v, t: (-g * q[0], -q[1]),
            "coordinates": ("a", "b"),
        },
        {"g": 1.0},
    )
    assert coordinate_names(flow) == ("a", "b", "a_dot", "b_dot")


# ---- units of time that say nothing of the motion


def lorenz(rate=1.0):
    def rhs(y, t):
        x, y_, z = y
        return 10.0 * rate * (y_ - x), x * (28.0 - z) - y_, x * y_ - 8 / 3 * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "time_unit": 60.0}


@pytest.mark.slow  # `test_a_unit_of_time_of_many_oscillations` is quick
def test_a_unit_of_time_in_which_chaos_enlarges_everything(lanes):
    """Lorenz over 60: e^(0.9 · 60) of rounding is all there is, so that errors are of a part, and that keeps the target."""
    flow, plan, _ = plan_and_calibration(lorenz, (1.0, 1.0, 20.0), lanes, target=1e-8)
    assert plan.parts > 1
    assert plan.steps % plan.parts == 0
    length = 60.0 / plan.parts
    x, y, z = hy.make_vars("x", "y", "z")
    field = [(x, 10.0 * (y - x)), (y, x * (28.0 - z) - y), (z, x * y - 8 / 3 * z)]
    exact = hy.taylor_adaptive(field, [1.0, 1.0, 20.0])
    exact.propagate_until(length)
    part = make_return_map(flow, plan.solver, plan.steps, span=(0.0, length))
    image = iterate(part, 1, flow.start({"x": 1.0, "y": 1.0, "z": 20.0}), {"rate": 1.0})
    errors = np.abs(np.array([float(leaf) for leaf in image.y]) - exact.state)
    assert np.max(errors / np.array(list(plan.sizes.values()))) < plan.error_estimate <= 1e-8


# ---- jumps and corners


@pytest.mark.parametrize(
    ("force", "order"),
    [
        (lambda x: -x - 0.3 * jnp.sign(x), 1),
        (lambda x: -x - 0.3 * jnp.abs(x), 2),
        (lambda x: -x - 0.3 * jnp.where(x > 0.2, x - 0.2, 0.0), 2),
        (lambda x: -x - 0.3 * jnp.tanh(1e4 * x), None),
        (lambda x: -x - x**3, None),
    ],
    ids=["sign", "abs", "where", "steep but smooth", "smooth"],
)
def test_kinks_are_where_they_are(force, order):
    """On x = cos t: at x = 0, or 0.2, which cos passes at π/2, or arccos 0.2; nothing of what is only steep."""
    flow = first_order(
        lambda rate=1.0: {"rhs": lambda y, t: (y[1], force(y[0])), "coordinates": ("x", "v")}, {"rate": 1.0}
    )
    times = np.linspace(0.0, 3.0, 301)
    kink = find_kink(flow, times, flow.start({"x": np.cos(times), "v": -np.sin(times)}), {"rate": 1.0})
    assert (kink and kink.order) == order
    if kink:
        at = float(kink.description.split("at t = ")[1].split(",")[0])
        assert at == pytest.approx(
            math.acos(0.2) if "corner" in kink.description and order == 2 and at < 1.5 else math.pi / 2, abs=1e-3
        )


def test_a_fast_particle_does_not_go_to_infinity():
    """At constant speed nothing does; steps of a 2048th of a period do not follow the turning of a strong force."""
    system = constant_speed(c=0.0001)
    state = jax.tree.map(np.atleast_1d, system.start({"x1": 20.0, "x2": 0.001, "y1": 0.1}))
    sample = Samples(state, {"b": np.array([500.0])}, np.zeros(1, int), {})
    words = explain_motion(SimpleNamespace(flows=[system], flow=system, parts=1, sectioned=False), sample)
    assert re.fullmatch(
        "rates of change reach .* a period: the motion turns as fast; slow down what is fast in it, or ask for less",
        words,
    )


def test_a_long_period_is_looked_at_with_finer_steps():
    """At constant speed nothing goes to infinity, in a period of 628 units of time either, whose 2048th is too long a step."""
    system = constant_speed(omega=0.01)
    state = jax.tree.map(np.atleast_1d, system.start({"x1": 0.1, "x2": 0.1, "y1": 0.1}))
    sample = Samples(state, {"b": np.array([2.5])}, np.zeros(1, int), {})
    scheme = SimpleNamespace(reference=SimpleNamespace(most_steps=int))
    maps = SimpleNamespace(flows=[system], flow=system, parts=1, sectioned=False, scheme=scheme, tried=2**20)
    assert "infinity" not in explain_motion(maps, sample)


def test_no_kink_where_the_field_overflows():
    """x'' = −x³ on a motion that has gone to 1e200: its rates are infinite, and no warning of NumPy is heard."""
    flow = first_order(lambda rate=1.0: {"rhs": lambda y, t: (y[1], -(y[0] ** 3)), "coordinates": ("x", "v")}, {})
    x = np.array([1.0, 2.0, 1e150, 1e200])
    assert find_kink(flow, np.arange(4.0), flow.start({"x": x, "v": np.zeros(4)}), {}) is None


def test_no_kink_at_a_pole_on_the_chord_of_a_step():
    """x' = 1/(x − 0.3): between states on both sides, where no motion goes, ever more is left as the step is halved."""
    flow = first_order(lambda rate=1.0: {"rhs": lambda y, t: (1.0 / (y[0] - 0.3), y[0]), "coordinates": ("x", "v")}, {})
    x = np.array([1.0, 0.9, 0.1, 0.0])
    assert find_kink(flow, np.arange(4.0), flow.start({"x": x, "v": np.zeros(4)}), {}) is None


# ---- words


CONFIG = short_portrait(1.0, 1.0, 1e-9)
FAULTS = {
    "a jump": (
        "y[1], -y[0] - jnp.stack((0.0, 0.3))[jnp.argmax(jnp.stack((1.0, y[1])))] + 2 * jnp.cos(t)",
        "coordinates=('x', 'v'), period=2 * jnp.pi",
        "the right-hand side jumps at t = ",
    ),
    "a jump where a period ends": (
        "y[1], -y[0] - 0.1 * y[1] + t / 3 + jnp.stack((0.0, 1.0))[jnp.argmax(jnp.stack((t, 3.0)))]",
        "coordinates=('x', 'v'), period=3.0",
        "the right-hand side jumps at t = 3, ",
    ),
    "a corner": (
        "y[1], -y[0] - 0.3 * jnp.stack((y[0], -y[0]))[jnp.argmax(jnp.stack((y[0], -y[0])))] - 0.1 * y[1] + 2 * jnp.cos(t)",
        "coordinates=('x', 'v'), period=2 * jnp.pi",
        "the right-hand side has a corner at t = ",
    ),
    "infinity": (
        "y[0] ** 3, -y[1]",
        "coordinates=('x', 'v'), time_unit=3.0",
        "the motion goes to infinity at t = 0.5\n",
    ),
    "rounding": (
        "10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1] + jnp.cos(jnp.pi * t / 10), y[0] * y[1] - 8 / 3 * y[2]",
        "coordinates=('x', 'v', 'z'), period=20.0",
        "that is rounding: ",
    ),
}


@pytest.mark.parametrize(("rates", "more", "words"), FAULTS.values(), ids=FAULTS)
def test_words_are_of_the_fault(tmp_path, monkeypatch, rates, more, words):
    """Each is seen in one line: 1/√(1 − 2t) is infinite at 0.5; in 20 chaos makes e^18 of a last digit.

    A sixteenth of the kicks that there can be does not meet the target either.
    """
    for module in (calibration, reference):
        monkeypatch.setattr(module, "MOST_KICKS", 1 << 16)
    (tmp_path / "own.py").write_text(
        f"import jax.numpy as jnp\n\n\ndef system(rate=1.0):\n    return dict(rhs=lambda y, t: ({rates}), {more})\n"
    )
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", "--quiet", cwd=tmp_path)
    assert run.returncode == 2
    assert len(run.stderr.splitlines()) == 1
    assert words in run.stderr
    assert len({other[:28] for *_, other in FAULTS.values() if other in run.stderr}) == 1
    assert ("steps cannot end where argmax changes" in run.stderr) == ("jnp.argmax(" in rates)


def test_the_file_says_what_errors_are_relative_to(tmp_path):
    """Sizes by name, one of them as given; a session's result has them as well."""
    (tmp_path / "own.py").write_text(
        "def system(rate=1.0):\n    return dict(rhs=lambda y, t: (y[1], -rate * y[0]), coordinates=('x', 'v'))\n"
    )
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", "accuracy.scale={v: 2.5}", "--output", "own.h5", cwd=tmp_path)
    assert run.returncode == 0
    assert ", relative to the size of the motion; " in run.stdout
    sizes = json.loads(jaxnh.open_result(tmp_path / "own.h5").attrs["sizes_of_motion"])
    assert sizes["v"] == 2.5
    assert sizes["x"] == pytest.approx(1.0, rel=0.05)


# ---- lanes that say nothing of the steps


def test_lanes_that_grow_without_bound(lanes):
    """What a lane has grown to is no size of a motion: errors are relative to what all began with, or so."""

    def growth(rate=1.0):
        return {"rhs": lambda y, t: (rate * y[0] + 0.0 * jnp.cos(t),), "coordinates": "y", "period": 1.0}

    flow = first_order(growth, {"rate": 1.0}, ("rate",))
    calibration = calibrated(flow, flow.start({"y": 1.0}), [-0.05, 0.5, 2.0], lanes, name="rate")
    plan = calibration.cheapest(TARGET)
    strobe = make_return_map(flow, plan.solver, plan.steps)
    for rate in (-0.05, 2.0):
        end = strobe(flow.start({"y": 1.0}), {"rate": rate}).y[0]
        assert abs(float(end) - math.exp(rate)) <= plan.error_estimate * calibration.sizes["y"]
    assert calibration.sizes["y"] < 1e4


def test_lanes_that_all_come_to_rest_on_a_section(lanes):
    """z′ = (−rate + i) z on v = 0: at crossings v is rounding alone, and no size that errors could be relative to."""

    def spiral(rate=1.0):
        return {"rhs": lambda y, t: (-rate * y[0] - y[1], y[0] - rate * y[1]), "coordinates": ("x", "v")}

    section = Section(first_order(spiral, {"rate": 1.0}, ("rate",)), "v", 1, 0.0, "up")
    start = begin(section, section.flow.start({"x": 0.1, "v": 0.0}))
    rates = [0.03, 0.1, 0.2]
    plan = calibrated(section, start, rates, lanes, name="rate").cheapest(TARGET)
    assert 1e-5 < plan.sizes["v"] < 1e-3  # a thousandth of the first turn, as of x
    strobe = make_return_map(section, plan.solver, plan.steps)
    for rate in rates:
        end = strobe(jax.tree.map(jnp.asarray, start), {"rate": rate})
        assert abs(float(end.state.y[0]) - 0.1 * math.exp(-2 * math.pi * rate)) < TARGET * plan.sizes["x"]
        assert abs(float(end.t) - 2 * math.pi) < TARGET * plan.sizes["t"]


def test_a_lane_that_chatters_is_not_stiff(lanes):
    """A ball that comes to rest by infinitely many impacts within a period is left out, beside one that never does."""

    def ball(r=1.0):
        bounce = {"when": lambda y, t: y[0], "direction": "down", "then": lambda y, t: (y[0], -r * y[1])}
        rhs = lambda y, t: (y[1], -1.0 + 0.0 * jnp.cos(t))  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi, "jumps": (bounce,)}

    flow = piecewise_smooth(ball, {"r": 1.0}, ("r",))
    calibration = calibrated(flow, flow.start({"x": 1.0, "v": 0.0}), [0.5, 1.0], lanes, name="r")
    assert calibration.floor <= TARGET


def test_a_section_that_a_motion_does_not_come_back_to_is_named():
    """No number of units is the length of a return that does not come: within how many there was none is said."""
    section = Section(first_order(lorenz, {"rate": 1.0}, ("rate",)), "z", 2, 27.0, "up", longest=50.0)
    assert explain_long_returns(section, np.array([1.0, np.nan, 2.0]), 1).startswith(
        "it does not come back within 3000 units of time"  # 50 of the time_unit of this file
    )
    assert explain_long_returns(section, np.array([1.0, 1.5, 2.0]), 2) == ""


def shaken_pendulum(a=0.5, w=20.0, damping=0.05):
    """Kapitza's: from near the upright position it turns over hundreds of times before it comes to rest."""

    def rhs(y, t):
        angle, speed = y
        return speed, (1.0 - a * w**2 * jnp.cos(w * t)) * jnp.sin(angle) - damping * speed

    return {"rhs": rhs, "coordinates": ("angle", "speed"), "angles": "angle", "period": 2.0 * np.pi / w}


def test_an_angle_that_has_run_on_has_the_accuracy_of_one_that_has_not():
    """Rounding of hundreds of turns is none of the period's: the exponents at rest sum to minus the damping."""
    session = jaxnh.Session(shaken_pendulum, start={"angle": 0.001, "speed": 0.0}, target=1e-9)
    data = session.run(jaxnh.Lyapunov(transient=100, periods=2000, exponents=2), a=np.linspace(0.03, 0.6, 8))
    error = data["exponents_error"].to_numpy()
    assert np.all(np.abs(data["exponents"].to_numpy() + 0.025) <= error)
    assert np.all(error[1:] < 1e-9)
