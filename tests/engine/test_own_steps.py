"""The plan of flows that common steps do not follow: stiff ones and ones with corners; and what stays refused."""

from __future__ import annotations

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples
from jaxnh.engine.accuracy.surface_jumps import field_jumps
from jaxnh.engine.axes import SweepPoints
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import ADAPTIVE, SOLVERS
from jaxnh.systems.corners import with_switches
from jaxnh.systems.first_order import first_order
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from tests.helpers.commands import run_here
from tests.helpers.kept_programs import lanes_with_kept_programs
from tests.helpers.short_portrait import short_portrait

TARGET = 1e-7


@pytest.fixture(scope="module")
def lanes():
    return lanes_with_kept_programs(tile=8)


def plan_of(define, start, rate, lanes, target=TARGET, solver=None):
    """A flow of the parameter `rate`, and its plan for one lane."""
    flow = first_order(define, {"rate": rate}, ("rate",))
    state = flow.start({name: np.array([value]) for name, value in zip(flow.coordinates, start, strict=True)})
    p = {"rate": np.array([rate])}
    calibration = Calibration([SweepPoints(flow, state, p, p)], lanes, target=target, solver=solver)
    return flow, calibration.cheapest(target), calibration


def van_der_pol(rate=1e4):
    """x'' = rate (1 − x²) x' − x, by units of a sixteenth of its period."""
    rhs = lambda y, t: (y[1], rate * (1.0 - y[0] ** 2) * y[1] - y[0])  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": 1000.0}


def by_taylor(rate, start, **how):
    """The same by heyoka, whose steps are as short as the rates, and take a microsecond."""
    x, v = hy.make_vars("x", "v")
    return hy.taylor_adaptive([(x, v), (v, rate * (1.0 - x * x) * v - x)], list(start), tol=1e-15, **how)


def test_a_stiff_flow_is_followed_unasked(lanes):
    """Rates of 3e4 over 1e3 units of time leave explicit steps nothing; heyoka has the state after the jump from x = 1."""
    start = (1.2, 1.2 / (1e4 * (1.0 - 1.2**2)))  # on the slow manifold
    flow, plan, _ = plan_of(van_der_pol, start, 1e4, lanes)
    assert plan.solver.name == "rodas5p"
    assert 0.0 < plan.error_estimate <= TARGET
    state = flow.start(dict(zip("xv", start, strict=True)))
    image = iterate(make_return_map(flow, plan.solver, plan.steps), 1, state, {"rate": 1e4})
    reference = by_taylor(1e4, start)
    reference.propagate_until(1000.0)
    exact = reference.state
    assert exact[0] < -1.5
    for name, x, known in zip("xv", image.y, exact, strict=True):
        assert abs(float(x) - known) < plan.error_estimate * plan.sizes[name]


def brusselator(rate=20.0):
    """The Brusselator with A = 1, B the rate, whose spikes have rates of thousands and last a hundredth of its period."""
    rhs = lambda z, t: (1.0 - (rate + 1.0) * z[0] + z[0] ** 2 * z[1], rate * z[0] - z[0] ** 2 * z[1])  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "y")}


def test_steps_of_a_lane_s_own_are_taken_where_they_are_fewer(lanes):
    """Common steps would do, with 50,000 evaluations of the field a unit of time; heyoka has the state after the spike."""
    start = (1.0, 21.0)
    flow, plan, _ = plan_of(brusselator, start, 20.0, lanes)
    assert plan.solver.name == "adaptive_tsitouras_papakostas8"  # accuracy binds them, and not stability
    assert 0.0 < plan.error_estimate <= TARGET
    state = flow.start(dict(zip("xy", start, strict=True)))
    image = iterate(make_return_map(flow, plan.solver, plan.steps), 1, state, {"rate": 20.0})
    x, y = hy.make_vars("x", "y")
    exact = hy.taylor_adaptive([(x, 1.0 - 21.0 * x + x * x * y), (y, 20.0 * x - x * x * y)], list(start), tol=1e-15)
    exact.propagate_until(1.0)
    for name, z, known in zip("xy", image.y, exact.state, strict=True):
        assert abs(float(z) - known) < plan.error_estimate * plan.sizes[name]


@pytest.mark.slow  # fast lanes beside slow ones, and this flow without a section, are quick
def test_lanes_that_common_steps_lose_are_no_lanes_that_escape(lanes):
    """Van der Pol at μ = 50 beside 200: the return time of the stiffer lane, 323.91604, by heyoka between its events."""

    def define(rate=1.0):
        rhs = lambda y, t: (y[1], rate * (1.0 - y[0] ** 2) * y[1] - y[0])  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": 50.0}

    flow = first_order(define, {"rate": 1.0}, ("rate",))
    section = Section(flow, "x", 0, 0.0, "up")
    state, p = begin(section, flow.start({"x": np.full(2, 2.0), "v": np.zeros(2)})), {"rate": np.array([50.0, 200.0])}
    plan = Calibration([SweepPoints(section, state, p, p)], lanes, target=TARGET).cheapest(TARGET)
    assert plan.solver.name == "rodas5p"
    strobe = make_return_map(section, plan.solver, plan.steps)
    stiffer = jax.tree.map(lambda leaf: jnp.float64(leaf[1]), state)
    crossing = jax.jit(lambda s, z, p: s.iterate(2, z, p))(strobe, stiffer, {"rate": 200.0})
    later = jax.jit(lambda s, z, p: s(z, p))(strobe, crossing, {"rate": 200.0})

    times = []
    event = hy.nt_event(hy.make_vars("x"), lambda _, t, __: times.append(t), direction=hy.event_direction.positive)
    reference = by_taylor(200.0, (0.0, float(crossing.state.y[1])), nt_events=[event])
    reference.propagate_until(330.0)
    exact = times[-1]
    assert abs(float(later.t - crossing.t) / exact - 1.0) < plan.error_estimate


@pytest.mark.slow  # the matrix has steps of a lane's own
def test_fast_lanes_that_coarse_steps_lose_are_in_the_calibration(lanes):
    """Van der Pol's oscillator, and a hundred times as fast: it returns to its section in a hundredth of the time."""

    def define(rate=1.0):
        rhs = lambda y, t: (rate * y[1], rate * ((1.0 - y[0] ** 2) * y[1] - y[0]))  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": 1.0}

    flow = first_order(define, {"rate": 1.0}, ("rate",))
    section, rates = Section(flow, "x", 0, 0.0, "up"), np.array([1.0, 1.0, 100.0])
    state = begin(section, flow.start({"x": np.full(3, 1.0), "v": np.full(3, 0.5)}))
    p = {"rate": rates}
    plan = Calibration([SweepPoints(section, state, p, p)], lanes, target=TARGET).cheapest(TARGET)
    strobe = make_return_map(section, plan.solver, plan.steps)
    times = lanes(iterate, (strobe, np.int32(1)), (state, p)).t
    assert abs(times[2] - times[0] / 100.0) < 1.01 * plan.error_estimate * plan.sizes["t"]


@pytest.mark.slow  # a stiff flow is followed unasked in a quick test, and `test_corners` has corners
def test_a_corner_is_followed_unasked(lanes):
    """x'' = −x − rate max(x, 0): half-turns of frequencies 1 below zero and ω = √(1 + rate) above it, in closed form."""

    def define(rate=30.0):
        rhs = lambda y, t: (y[1], -y[0] - rate * jnp.maximum(y[0], 0.0))  # noqa: E731
        return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": 20.0}

    flow, plan, _ = plan_of(define, (1.0, 0.0), 30.0, lanes)
    assert plan.solver.name in ADAPTIVE
    image = iterate(make_return_map(flow, plan.solver, plan.steps), 1, flow.start({"x": 1.0, "v": 0.0}), {"rate": 30.0})
    omega = np.sqrt(31.0)  # the speed at zero
    since = (20.0 - 0.5 * np.pi / omega) % (np.pi + np.pi / omega)  # a passage down through zero
    below = -omega * np.sin(since), -omega * np.cos(since)
    above = np.sin(omega * (since - np.pi)), omega * np.cos(omega * (since - np.pi))
    exact = below if since < np.pi else above
    for name, x, known in zip("xv", image.y, exact, strict=True):
        assert abs(float(x) - known) < plan.error_estimate * plan.sizes[name]


def test_a_jump_stays_refused(lanes):
    """Tangents know nothing of a jump of the field, so that exponents and Newton would be wrong unasked."""

    def define(rate=1.0):
        return {"rhs": lambda y, t: (y[1], -rate * jnp.sign(y[0])), "coordinates": ("x", "v"), "time_unit": 4.0}

    with pytest.raises(AccuracyError, match="the right-hand side jumps"):
        plan_of(define, (1.0, 0.3), 1.0, lanes, target=1e-10)


def square_wave(rate=1.0):
    """x'' = rate x − x'/10 + 0.3 sign(sin ωt), of period 2.4."""
    rhs = lambda y, t: (y[1], rate * y[0] - 0.1 * y[1] + 0.3 * jnp.sign(jnp.sin(2.0 * jnp.pi * t / 2.4)))  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2.4}


def coulomb(rate=0.2):
    """x'' = −x − rate sign(x') + cos 1.7t."""
    rhs = lambda y, t: (y[1], -y[0] - rate * jnp.sign(y[1]) + jnp.cos(1.7 * t))  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2.0 * np.pi / 1.7}


def corner(rate=0.2):
    """x'' = −x − rate |x|, whose motions turn at x = 0."""
    return {"rhs": lambda y, t: (y[1], -y[0] - rate * jnp.abs(y[0])), "coordinates": ("x", "v"), "time_unit": 10.0}


def test_a_motion_that_leaves_a_saddle_needs_no_steps_of_its_own(lanes):
    """It grows by 9.8 a period, to 10¹⁶⁸ while samples are taken, where squares overflow whatever the steps."""
    flow = piecewise_smooth(with_switches(square_wave, {"rate": 1.0}), {"rate": 1.0}, ("rate",))
    p = {"rate": np.array([1.0])}
    lane = SweepPoints(flow, flow.start({"x": np.array([0.1]), "v": np.array([0.0])}), p, p)
    assert Calibration([lane], lanes, target=TARGET).cheapest(TARGET).solver.name not in ADAPTIVE


@pytest.mark.parametrize(
    ("define", "jumps"), [(square_wave, (True, False)), (coulomb, (True, True)), (corner, (False, False))]
)
def test_where_the_field_jumps(lanes, define, jumps):
    """At any surface that motions pass, and at one that moves with the state; a corner is no jump."""
    flow = piecewise_smooth(with_switches(define, {"rate": 0.2}), {"rate": 0.2}, ("rate",))
    start = flow.start({"x": np.array([0.1, 0.2]), "v": np.array([0.3, -0.5])})
    p = {"rate": np.array([0.2, 0.3])}
    assert field_jumps(SampleMaps([flow], lanes), Samples(start, p, np.zeros(2, int), p)) == jumps


def test_own_steps_asked_for_are_refused_where_the_field_jumps(tmp_path):
    """Exponents by them would be those of another flow: −0.1 twice in place of −0.1373, with an error bar of 10⁻¹¹."""
    (tmp_path / "own.py").write_text(
        "import jax.numpy as jnp\n\n\ndef system(rate=0.2):\n"
        "    rhs = lambda y, t: (y[1], -y[0] - 0.2 * y[1] - rate * jnp.sign(y[1]) + jnp.cos(1.7 * t))\n"
        "    return dict(rhs=rhs, coordinates=('x', 'v'), period=2 * jnp.pi / 1.7)\n"
    )
    (tmp_path / "own.yaml").write_text(short_portrait(2.0, 0.2, 1e-6))
    run = run_here("own.yaml", "accuracy={solver: rodas5p, target: 1.0e-6}", cwd=tmp_path)
    assert run.returncode == 2
    assert "accuracy.solver: rodas5p takes each lane by steps of its own across surfaces where" in run.stderr


@pytest.mark.parametrize("name", ["rodas5p", "adaptive_tsit5"])
def test_the_fineness_of_a_solver_that_is_asked_for(lanes, name):
    """A mild flow by the solver asked for: its true error, by cos and sin, is within the estimate."""

    def define(rate=1.0):
        return {"rhs": lambda y, t: (y[1], -rate * y[0]), "coordinates": ("x", "v"), "time_unit": 2.0}

    flow, plan, _ = plan_of(define, (1.0, 0.0), 1.0, lanes, solver=SOLVERS[name])
    assert plan.solver.name == name
    image = iterate(make_return_map(flow, plan.solver, plan.steps), 1, flow.start({"x": 1.0, "v": 0.0}), {"rate": 1.0})
    assert np.abs(np.array(image.y) - [np.cos(2.0), -np.sin(2.0)]).max() < plan.error_estimate <= TARGET


CONFIG = short_portrait(2.0, 1000.0, 1e-6)
FILE = (
    "def system(rate=1.0):\n"
    "    return dict(rhs=lambda y, t: (y[1], rate * (1 - y[0] ** 2) * y[1] - y[0]), coordinates=('x', 'v'))\n"
)


def test_a_solver_by_hand_without_steps(tmp_path):
    (tmp_path / "own.py").write_text(FILE)
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", "accuracy={solver: rodas5p, target: 1.0e-6}", cwd=tmp_path)
    assert run.returncode == 0
    assert "rodas5p in float64, " in run.stdout


@pytest.mark.parametrize(
    ("accuracy", "reason"),
    [
        ("{solver: verner9}", "accuracy.solver: solver and steps go together; give steps as well"),
        ("{steps: 100}", "accuracy.steps: solver and steps go together; give solver as well"),
        ("{solver: rodas5p, precision: extended}", "extended goes with all solvers but rodas5p"),
    ],
)
def test_what_does_not_go_with_it(tmp_path, accuracy, reason):
    (tmp_path / "own.py").write_text(FILE)
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", f"accuracy={accuracy}", cwd=tmp_path)
    assert run.returncode == 2
    assert reason in run.stderr
    assert len(run.stderr.splitlines()) == 1
