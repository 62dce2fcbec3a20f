"""Corners that are found in right-hand sides: their surfaces, the field written anew, and motions across them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import dopri8, verner9
from jaxnh.systems.corners import with_switches
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from tests.flows.piecewise_circuits import CIRCUITS
from tests.helpers.one_lane import state_after

pytestmark = pytest.mark.usefixtures("quick_compiling", "shared_programs")

Y = (0.0, 0.0, 0.0)


def definitions(rhs, **parameters):
    """A definition of three coordinates, and that with switches."""

    def define(a=1.0):
        return {"rhs": lambda y, t: rhs(y, t, a), "coordinates": ("x", "y", "z")}

    return define, with_switches(define, parameters or {"a": 1.0})


def step(x):
    return jnp.where(x > 0.0, 1.0, -1.0)


SURFACES = {
    "abs": (lambda y, t, a: (jnp.abs(y[0] - a), 0.0, 0.0), 1),
    "sign": (lambda y, t, a: (jnp.sign(y[0] - y[1]), 0.0, 0.0), 1),
    "max and min": (lambda y, t, a: (jnp.maximum(y[0], y[1]), jnp.minimum(y[1], jnp.sin(t)), 0.0), 2),
    "clip": (lambda y, t, a: (jnp.clip(y[0], -a, a), jax.lax.clamp(-1.0, y[1], 1.0), 0.0), 4),
    "where": (lambda y, t, a: (jnp.where((y[0] > a) & (y[1] <= 0.0), y[2], 0.0), 0.0, 0.0), 2),
    "heaviside": (lambda y, t, a: (jnp.heaviside(y[0], 0.5), (y[1] > a).astype(float) * y[2], 0.0), 2),
    "relu": (lambda y, t, a: (jax.nn.relu(y[0]), jax.nn.leaky_relu(y[1]), 0.0), 2),
    "of time": (lambda y, t, a: (jnp.sign(jnp.sin(t)), 0.0, 0.0), 1),
    "one in many forms": (
        lambda y, t, a: (
            jnp.abs(y[0] - 1.0) + jnp.abs(1.0 - y[0]) + jnp.maximum(y[0], 1.0) + jnp.sign(1.0 - y[0]),
            jnp.where(y[0] > 1.0, y[1], jnp.where(y[0] <= 1.0, y[2], 0.0)),
            0.0,
        ),
        1,
    ),
    "of an array": (lambda y, t, a: tuple(jnp.abs(jnp.stack(y) - a)), 3),
    "extremes of arrays": (
        lambda y, t, a: (jnp.max(jnp.stack(y)), jnp.min(jnp.stack([y[0], a, y[1]])), jnp.max(jnp.stack([*y, t]))),
        7,
    ),
    "extremes of rows": (lambda y, t, a: tuple(jnp.min(jnp.outer(jnp.stack(y), jnp.array([1.0, 2.0])), axis=1)), 3),
    "touched by one end": (
        lambda y, t, a: (jnp.clip(-(y[0] ** 2), -a, 0.0) + jnp.clip(y[1] ** 2, 0.0, a), 0.0, 0.0),
        2,
    ),
    "floor": (lambda y, t, a: (jnp.floor(y[0]) + jnp.mod(y[1], a) + jnp.round(y[2] - 0.1), t // 0.7, t % 3.0), 5),
    "decided by what leaps": (lambda y, t, a: (jnp.where(jnp.mod(y[0] - t, 2.0) < a, y[1], 0.0), 0.0, 0.0), 2),
    "decided by floor alone": (lambda y, t, a: (jnp.where(jnp.floor(y[0]) % 3 < 1, y[1], 0.0), 0.0, 0.0), 1),
    "a table": (lambda y, t, a: (jnp.interp(y[0], jnp.arange(4.0) - 1.5, jnp.arange(4.0) ** 2), 0.0, 0.0), 4),
    "within another": (lambda y, t, a: (jnp.abs(jnp.abs(y[0]) - a), 0.0, 0.0), 2),
    "within a condition": (lambda y, t, a: (jnp.where(jnp.abs(y[0]) < a, y[1], 0.0), 0.0, 0.0), 1),
    "on what jumps": (lambda y, t, a: (jnp.abs(step(y[0]) * y[1]), step(y[0]), 0.0), 1),
}


@pytest.mark.parametrize(("rhs", "count"), SURFACES.values(), ids=SURFACES)
def test_surfaces_and_the_field(rhs, count):
    """All surfaces are found; by its branches the field is as it was, to the last bit."""
    define, located = definitions(rhs)
    system = piecewise_smooth(located, {"a": 1.0})
    assert system.switches == count
    draws = np.random.default_rng(3).uniform(-3.0, 3.0, (64, 5))

    @jax.jit
    @jax.vmap
    def both(z):
        y, t, a = tuple(z[:3]), z[3], jnp.abs(z[4])
        ours = system.rhs(t, system.chart.state(z[:3]), {"a": a}).y
        return jnp.stack(ours), jnp.stack([jnp.asarray(rate, float) for rate in define(a)["rhs"](y, t)])

    ours, theirs = both(draws)
    assert np.array_equal(ours, theirs)


HALVES = (  # half-saturation constants of five resources, in rows, for five species
    (0.39, 0.34, 0.30, 0.24, 0.23),
    (0.22, 0.39, 0.34, 0.30, 0.27),
    (0.27, 0.22, 0.39, 0.34, 0.30),
    (0.30, 0.24, 0.22, 0.39, 0.34),
    (0.34, 0.30, 0.22, 0.20, 0.39),
)


def test_surfaces_of_minima_that_most_states_do_not_see():
    """Species that grow by the scarcest of five resources each (Huisman and Weissing, Nature 402 (1999) 407).

    A minimum of five has four surfaces. The first two numbers alone decide it on a quarter of the states at which they
    are equal, and sixteen states had shown eighteen surfaces of twenty.
    """

    def define(d=0.25, m=0.25, r=1.0):
        def rhs(y, t):
            species, resources = jnp.stack(y)[:5], jnp.stack(y)[5:]
            growth = jnp.min(r * resources[None] / (jnp.array(HALVES).T + resources[None]), axis=1)
            return (*(species * (growth - m)), *(d * (1.0 - resources) - 0.05 * growth * species))

        return {"rhs": rhs, "coordinates": tuple("abcdefghij")}

    parameters = {"d": 0.25, "m": 0.25, "r": 1.0}
    assert len(with_switches(define, parameters)(**parameters)["switches"]) == 20


NEEDLESS = {
    "smooth": lambda y, t, a: (y[1] * jnp.sin(t), y[0] ** 2, jnp.exp(-y[2])),
    "of parameters": lambda y, t, a: (y[0] * jnp.abs(a), jnp.where(a > 0.0, y[1], y[2]), 0.0),
    "even powers": lambda y, t, a: (jnp.abs(y[0]) ** 2, jnp.abs(y[1]) * jnp.abs(y[1]), 0.0),
    "smooth in two forms": lambda y, t, a: (jnp.logaddexp(y[0], y[1]), jax.nn.softplus(y[2]), jnp.hypot(y[0], y[1])),
    "touched alone": lambda y, t, a: (jnp.where(y[0] ** 2 + y[1] ** 2 > 0.0, y[2], 1.0), jnp.sinc(y[0]), 0.0),
    "not defined beyond": lambda y, t, a: (
        jnp.sqrt(jnp.maximum(y[0], 0.0)),
        jnp.where(y[1] > 0.0, y[1] ** 1.5, 0.0),
        0.0,
    ),
    "no part in the rates": lambda y, t, a: (0.0 * jnp.abs(y[0]), 1.0, 0.0),
}


@pytest.mark.parametrize("rhs", NEEDLESS.values(), ids=NEEDLESS)
def test_what_needs_no_switch_stays_as_it_is(rhs):
    """So that programs and bits are those of a smooth flow."""
    define, located = definitions(rhs)
    assert located is define


def test_switches_by_hand_are_all_there_are():
    def define():
        return {"rhs": lambda y, t: (jnp.abs(y[0]),), "coordinates": ("x",), "switches": ()}

    assert with_switches(define, {}) is define


ATTRACTING = {
    "friction": (lambda y, t, a: (y[1], -y[0] - a * jnp.sign(y[1] - 0.5), 0.0), True),
    "a relay that repels": (lambda y, t, a: (y[1], -y[0] + a * jnp.sign(y[1] - 0.5), 0.0), False),
    "a jump along the surface": (lambda y, t, a: (y[1], -y[0] - a * jnp.sign(y[2]) * y[1], y[1]), False),
    "a corner": (lambda y, t, a: (y[1], -y[0] - a * jnp.abs(y[0]), 0.0), False),
}


@pytest.mark.parametrize(("rhs", "slides"), ATTRACTING.values(), ids=ATTRACTING)
def test_surfaces_that_both_sides_may_push_towards(rhs, slides):
    """Along these alone motions may slide, which costs the others nothing."""
    assert piecewise_smooth(definitions(rhs)[1], {"a": 1.0}).holds == (slides,)


def test_friction_by_sign_slides():
    """x'' = −x − sign(v − 1/2): a block on a belt sticks to it, and slips where the spring pulls by more than 1."""
    _, located = definitions(lambda y, t, a: (y[1], -y[0] - a * jnp.sign(y[1] - 0.5), 0.0))
    system = piecewise_smooth(located, {"a": 1.0})
    strobe = make_return_map(system, dopri8, 40, span=(0.0, 2.5))
    x, v, _ = state_after(strobe, jnp.array([0.0, 0.5, 0.0]), {}).y
    after = 2.5 - 2.0  # it sticks for 2 until x = 1, and then turns about x = 1 at v = 1/2
    assert float(x) == pytest.approx(1.0 + 0.5 * np.sin(after), abs=1e-12)
    assert float(v) == pytest.approx(0.5 * np.cos(after), abs=1e-12)


# ---- motions


@pytest.mark.parametrize("name", CIRCUITS)
def test_motions_across_corners(name):
    """Against DOP853 from event to event, whose tolerance of 1e-13 these motions enlarge by e² or so."""
    circuit = CIRCUITS[name]
    system = piecewise_smooth(with_switches(circuit.define, {"scale": 1.0}), {"scale": 1.0})
    assert system.switches == len(circuit.heights(circuit.start))
    strobe = make_return_map(system, verner9, 160, span=(0.0, 4.0))
    ours = np.array(state_after(strobe, jnp.array(circuit.start), {}).y)
    theirs = circuit.follow(4.0)
    assert np.abs(ours - theirs).max() < 1e-10 * (1.0 + np.abs(theirs).max())


def test_order_of_convergence_at_corners_that_are_found():
    """A method of order 8 has it across the corners of Chua's circuit, written with |x|."""
    circuit = CIRCUITS["chua"]
    system = piecewise_smooth(with_switches(circuit.define, {"scale": 1.0}), {"scale": 1.0})
    exact = circuit.follow(4.0)
    counts, errors = (8, 10, 13, 16), []
    for count in counts:
        strobe = make_return_map(system, dopri8, count, span=(0.0, 4.0))
        state = state_after(strobe, jnp.array(circuit.start), {})
        errors.append(np.abs(np.array(state.y) - exact).max())
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > dopri8.convergence_order - 0.7, errors


def by_abs(alpha=9.0):
    def rhs(y, t):
        x, u, v = y
        corners = jnp.abs(x + 1.0) - jnp.abs(x - 1.0)
        return alpha * (u - x + 5 / 7 * x + 3 / 14 * corners), x - u + v, -100 / 7 * u

    return {"rhs": rhs, "coordinates": ("x", "u", "v")}


def by_hand(alpha=9.0):
    def rhs(y, t, side):
        x, u, v = y
        corners = side[0] * (x + 1.0) - side[1] * (x - 1.0)
        return alpha * (u - x + 5 / 7 * x + 3 / 14 * corners), x - u + v, -100 / 7 * u

    switches = [{"on": lambda y, t: y[0] + 1.0}, {"on": lambda y, t: y[0] - 1.0}]
    return {"rhs": rhs, "coordinates": ("x", "u", "v"), "switches": switches}


@pytest.mark.slow  # `test_motions_across_corners` is quick
def test_a_target_that_corners_had_refused():
    """1e-10, which steps over the corners miss by a hundred times; plan and bits are those of switches by hand."""
    runs = []
    for define in (by_abs, by_hand):
        session = jaxnh.Session(define, start={"x": 0.7, "u": 0.1, "v": -0.2}, target=1e-10)
        runs.append((session.plan, session.run(jaxnh.Portrait(transient=0, periods=1), alpha=[8.8, 9.0])))
    (plan, ours), (known, theirs) = runs
    assert plan == known
    assert plan.error_estimate <= 1e-10
    assert np.array_equal(ours["x"], theirs["x"])
