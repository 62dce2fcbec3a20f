"""The plan of flows with brief changes that are not stiff: explicit steps of a lane's own, against DOP853 at 1e-12."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.accuracy.own_steps import agree, spread_over_unit
from jaxnh.engine.accuracy.reference import Reference
from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples
from jaxnh.engine.axes import SweepPoints
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import AdaptiveMethod
from jaxnh.systems.first_order import first_order
from tests.helpers.kept_programs import lanes_with_kept_programs

TARGET = 1e-8


@pytest.fixture(scope="module")
def lanes():
    return lanes_with_kept_programs(tile=8)


def plan_of(define, start, lanes):
    """A flow of the parameter `rate`, and its plan for one lane."""
    flow = first_order(define, {"rate": 1.0}, ("rate",))
    state = flow.start({name: np.array([value]) for name, value in zip(flow.coordinates, start, strict=True)})
    p = {"rate": np.array([1.0])}
    return flow, Calibration([SweepPoints(flow, state, p, p)], lanes, target=TARGET).cheapest(TARGET)


def worst_error(flow, plan, define, start, most=0.002):
    """Largest error after the time that the plan's error is of, in units of it, with steps of DOP853 up to `most`."""
    length = define()["time_unit"] / plan.parts
    strobe = make_return_map(flow, plan.solver, plan.steps, span=(0.0, length))
    state = jax.tree.map(jnp.float64, flow.start(dict(zip(flow.coordinates, start, strict=True))))
    image = jax.jit(iterate)(strobe, 1, state, {"rate": 1.0})
    rates = jax.jit(lambda y: jnp.stack(jnp.broadcast_arrays(*define()["rhs"](y, 0.0))))
    exact = solve_ivp(
        lambda t, y: np.asarray(rates(y)), (0.0, length), start, "DOP853", rtol=1e-12, atol=1e-13, max_step=most
    )
    gaps = [
        abs(float(x) - known) / plan.sizes[name]
        for name, x, known in zip(flow.coordinates, image.y, exact.y[:, -1], strict=True)
    ]
    return max(gaps) / plan.error_estimate


def switched(rate=1.0):
    """An oscillator pushed to and fro, twice in a turn of s, within two thousandths of it."""
    rhs = lambda y, t: (y[1], -0.1 * y[1] - y[0] + rate * jnp.tanh(1e3 * jnp.sin(y[2])), 1.0)  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v", "s"), "time_unit": 5.0}


def test_brief_changes_are_followed_by_explicit_steps(lanes):
    """Common steps as short as the change needs are some ten thousand in a unit of time."""
    start = (0.3, 0.1, 0.5)
    flow, plan = plan_of(switched, start, lanes)
    assert plan.solver.name == "adaptive_tsitouras_papakostas8"
    assert 0.0 < plan.error_estimate <= TARGET
    assert worst_error(flow, plan, switched, start) < 1.0


def relaxing(rate=1.0):
    """Van der Pol's oscillator at mu = 100, for most of a period on its slow manifold."""
    rhs = lambda y, t: (y[1], 100.0 * rate * (1.0 - y[0] ** 2) * y[1] - y[0])  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "time_unit": 160.0}


def test_a_stiff_flow_keeps_implicit_steps(lanes):
    """Explicit steps are bound by stability: with an error 32 times as large they are hardly fewer."""
    _, plan = plan_of(relaxing, (2.0, 0.0), lanes)
    assert plan.solver.name == "rodas5p"


def pushed_lorenz(rate=1.0):
    """Lorenz's flow under a force that changes its sign within ten thousandths of its period, over twelve units of time."""

    def rhs(y, t):
        force = 20.0 * rate * jnp.tanh(5e3 * jnp.sin(3.0 * y[3]))
        return 10.0 * (y[1] - y[0]), y[0] * (28.0 - y[2]) - y[1] + force, y[0] * y[1] - 8.0 / 3.0 * y[2], 1.0

    return {"rhs": rhs, "coordinates": ("x", "y", "z", "s"), "time_unit": 12.0}


def diffusion(rate=1.0, n=12):
    """u' = rate u_xx of n points between walls at zero, whose fastest rate is 4 (n + 1)² times the constant."""

    def rhs(y, t):
        u = jnp.pad(jnp.stack(y), 1)
        return rate * (n + 1) ** 2 * (u[2:] - 2.0 * u[1:-1] + u[:-2])

    return {"rhs": lambda y, t: tuple(rhs(y, t)), "coordinates": tuple(f"u{i}" for i in range(n))}


_MUCH_STIFFER = pytest.param(4e3, True, marks=pytest.mark.slow)  # a step of as many coordinates is quick


@pytest.mark.parametrize(("rate", "implicit"), [(8.0, False), (12.0, False), _MUCH_STIFFER])
def test_implicit_steps_of_many_coordinates_have_a_price(lanes, rate, implicit):
    """Mildly stiff motion keeps common steps, on its way to rest at 1e-308 as well."""
    flow = first_order(diffusion, {"rate": rate}, ("rate",))
    state = flow.start({name: np.array([1.0]) for name in flow.coordinates})
    p = {"rate": np.array([rate])}
    plan = Calibration([SweepPoints(flow, state, p, p)], lanes, target=1e-6).cheapest(1e-6)
    assert (plan.solver.name == "rodas5p") == implicit
    assert plan.error_estimate <= 1e-6


@pytest.mark.slow  # brief changes without chaos, and samples of parts, are quick
def test_chaos_over_a_long_unit_of_time_has_parts(lanes):
    """Rounding grows by 1e5 in a unit; the fineness of the steps is that of the plan, whatever the parts."""
    start = (1.0, 2.0, 20.0, 0.0)
    flow, plan = plan_of(pushed_lorenz, start, lanes)
    assert plan.solver.name == "adaptive_tsitouras_papakostas8"
    assert plan.parts in (4, 16, 64)
    assert 0.0 < plan.error_estimate <= TARGET
    assert worst_error(flow, plan, pushed_lorenz, start) < 1.0


def samples_of(define, start, count):
    """A flow, and as many equal samples of it."""
    flow = first_order(define, {"rate": 1.0}, ("rate",))
    values = {name: np.full(count, value) for name, value in zip(flow.coordinates, start, strict=True)}
    return flow, Samples(flow.start(values), {"rate": np.ones(count)}, np.zeros(count, int), {})


def reference_of(steps, known):
    """A reference by explicit steps of a lane's own, thirteen stages each."""
    return Reference([], known, 13 * steps)


@pytest.mark.parametrize("parts", [4, 16])
def test_samples_of_parts_begin_all_over_the_unit(lanes, parts):
    flow, samples = samples_of(switched, (0.3, 0.1, 0.0), 32)
    for cut in (4, 16) if parts == 16 else (4,):
        maps = SampleMaps([flow], lanes).with_own_steps(explicit=True).in_parts(cut)
        samples = spread_over_unit(maps, reference_of(40, np.zeros(32)), samples)
    begins, counts = np.unique(np.round(np.asarray(samples.states.y[2]) * parts / 5.0).astype(int), return_counts=True)
    assert begins.tolist() == list(range(parts))
    assert set(counts) == {32 // parts}


def pulsed(rate=1.0, width=0.005):
    """An oscillator kicked once in a turn of s, within a few widths."""

    def rhs(y, t):
        return y[1], -0.1 * y[1] - y[0] + 0.4 * rate / width * jnp.exp((jnp.cos(y[2]) - 1.0) / width**2), 1.0

    return {"rhs": rhs, "coordinates": ("x", "v", "s"), "time_unit": 2 * np.pi}


@pytest.mark.parametrize(("define", "same"), [(switched, True), (lambda rate: pulsed(rate, 3e-4), False)])
def test_common_steps_tell_what_long_ones_pass(lanes, define, same):
    """A change that lasts is seen by every step after it; a pulse by none that has no stage in it."""
    flow, samples = samples_of(define, (0.3, 0.1, 0.5), 2)
    common = SampleMaps([flow], lanes)
    own, sizes = common.with_own_steps(explicit=True), np.ones(3)
    assert agree(own, reference_of(24, np.zeros(2)), samples, sizes, common, 1 << 15, 1e-8) == same


@pytest.mark.slow  # what decides it is quick
def test_a_pulse_that_long_steps_may_pass_is_not_left_to_them(lanes):
    start = (0.3, 0.1, 0.5)
    flow, plan = plan_of(pulsed, start, lanes)
    assert plan.solver.name != "adaptive_tsitouras_papakostas8"
    assert worst_error(flow, plan, pulsed, start) < 1.0


def swinging_atwood_machine(m=0.4):
    """Two weights on a thread over pulleys, of which one swings: near r = 0 it turns round in no time."""

    def T(q, v, t):
        return 0.5 * (1.0 + m) * v[0] ** 2 + 0.5 * m * (q[0] * v[1]) ** 2

    def Q(q, v, t):
        return m * jnp.cos(q[1]) - 1.0, -m * q[0] * jnp.sin(q[1])

    return {"T": T, "Q": Q, "coordinates": ("r", "theta")}


def test_rare_and_violent_turns_are_left_to_steps_of_a_lane_s_own():
    """Four times the steps that are right in first periods lose a lane later on; its own keep its energy."""
    m = np.array([1.0 / 3.0, 0.4])
    session = jaxnh.Session(swinging_atwood_machine, start={"r": 1.0, "theta": 1.5}, target=1e-8)
    path = session.run(jaxnh.Portrait(transient=0, periods=400, samples=2), m=m)
    assert isinstance(session.plan.solver, AdaptiveMethod)
    r, theta, r_dot, theta_dot = (path[name].to_numpy() for name in ("r", "theta", "r_dot", "theta_dot"))
    m = m[:, None]
    energy = 0.5 * (1.0 + m) * r_dot**2 + 0.5 * m * (r * theta_dot) ** 2 + r * (1.0 - m * np.cos(theta))
    assert np.all(np.abs(energy - energy[:, :1]) < 1e-5)
