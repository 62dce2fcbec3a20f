"""Maps of a flow without a clock: crossings of a section against the Taylor reference, and exact identities."""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.axes import SweepPoints
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.section import Crossing, Section, reports
from jaxnh.solvers import dopri8
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.lagrangian import Motion
from tests.flows.unforced_particle import ANGLE, LANES, SPLITTING, START, B, P, particle_without, spread
from tests.helpers import taylor

pytestmark = pytest.mark.usefixtures("quick_compiling")

SECTIONS = {
    "up": (Section(particle_without("forcing"), "y1", 1, 0.0, "up"), 1),
    "down": (Section(particle_without("forcing"), "x1", 0, 0.0, "down"), -1),
    "both": (Section(particle_without("forcing"), "y1", 1, 0.0, "both"), 0),
}


def difference(crossing, exact):
    """Largest difference of states and times of crossings, lanes and counts first, from the reference."""
    (x, y), (n1, n2) = crossing.state
    found = np.stack([x, y, np.arctan2(n2, n1), crossing.t], axis=-1)
    gap = found - exact
    gap[..., 2] -= taylor.turns(gap[..., 2])
    return np.abs(gap).max(axis=-1).astype(float)


def exact_crossings(name, b):
    system, direction = SECTIONS[name]
    return np.array([taylor.crossings(ANGLE, value, system.number, 4, direction=direction) for value in b])


@pytest.mark.slow
def test_crossings_meet_the_target(lanes):
    """The plan that calibration chooses for a target keeps it at the first crossing, against Taylor in long double.

    States and times of the next ones go on with no more than what the flow makes of such an error: a hundredfold in
    these calm lanes.
    """
    system, _ = SECTIONS["up"]
    start = spread(Crossing(START, 0.0, 0.0))
    target = 1e-8
    plan = Calibration([SweepPoints(system, start, P, P)], lanes).cheapest(target)
    found = lanes.record(make_return_map(system, plan.solver, plan.steps), 4, (start, P))
    gap = difference(found, exact_crossings("up", B))
    assert gap[:, 0].max() < target
    assert np.median(gap[:, 0]) > 1e-5 * target  # the cheapest plan, and not by far too fine a one
    assert gap.max() < 100 * target


@pytest.mark.parametrize("name", SECTIONS)
def test_crossings_converge_at_the_order(lanes, name):
    """With twice the steps an eighth-order step leaves 2⁻⁸ of the error of a crossing, partial step and all.

    Twice that is left for the terms that follow, and 1e-13 for rounding; the section is met to rounding.
    """
    system, _ = SECTIONS[name]
    exact, start = exact_crossings(name, B), spread(Crossing(START, 0.0, 0.0))
    errors = []
    for steps in (40, 80):
        found = lanes.record(make_return_map(system, SPLITTING, steps), 4, (start, P))
        errors.append(math.exp(np.log(difference(found, exact)[:, 0]).mean()))
        assert np.abs(found.state[0][system.number]).max() < 1e-14
        assert np.all(found.reason == 0)
    assert errors[1] < 2.0**-7 * errors[0] + 1e-13 < 1e-6


def test_crossings_of_a_free_particle(lanes):
    """The same by the general route, with damping, whose energy only falls."""
    flow = free_particle(0.5, None, 1.0, ("forcing",))
    system = Section(flow, "x1", 0, 0.0, "both")
    start = Crossing(Motion((0.1, 0.1), (0.1, math.sqrt(0.99)), (0.0, 0.0)), 0.0, 0.0)
    b = np.array([0.1, 0.2, 0.3])
    strobe = make_return_map(system, dopri8, 120)
    found = lanes.record(strobe, 3, (spread(start, 3), {"b": b}))
    exact = np.array(
        [taylor.crossings([0.1, 0.1, 0.1, math.sqrt(0.99)], v, 0, 3, direction=0, constrained=False) for v in b]
    )
    ours = np.stack([*found.state.q, *found.state.v, found.t], axis=-1)
    assert np.abs(ours - exact).max() < 1e-9


def test_returns_without_waiting(lanes):
    """Over several returns at once every lane's are bit for bit those taken one by one, though it waits for no other."""
    system, _ = SECTIONS["up"]
    strobe, start = make_return_map(system, SPLITTING, 60), spread(Crossing(START, 0.0, 0.0))
    every = lanes.record(strobe, 4, (start, P))
    assert np.ptp(np.diff(every.t, axis=1)) > 1.0  # some returns take longer than others
    for n in (1, 4):
        found = lanes(iterate, (strobe, np.int32(n)), (start, P))
        jax.tree.map(lambda one, all_, n=n: np.testing.assert_array_equal(one, all_[:, n - 1]), found, every)


def test_return_in_one_step():
    """A passage and return within one step are seen, in each direction that is wanted, from above and from below."""
    flow = particle_without("forcing", "coupling", "cubic_stiffness")  # y'' alone: towards y = 0, however it starts
    for tilt, direction, expected in ((0.02, "up", "first"), (0.02, "both", "first"), (0.02, "down", "second")):
        system = Section(flow, "y1", 1, 1.0, direction)  # y = 1 is touched from below: passed up, and down again
        theta = math.asin(tilt)
        y = 1.0 - 0.4 * tilt**2 / 2.0
        start = Crossing(((0.0, y), (math.cos(theta), math.sin(theta))), 0.0, 0.0)
        coarse, fine = (
            make_return_map(system, SPLITTING, steps)(jax.tree.map(jnp.float64, start), {"b": 0.0})
            for steps in (40, 4000)
        )
        step = flow.period / 40
        assert float(fine.t) < step  # within the first coarse step
        assert abs(float(coarse.t - fine.t)) < 1e-9
        assert (float(fine.state[1][1]) > 0) == (expected == "first")


@pytest.mark.slow
def test_derivatives_of_the_return(lanes):
    """∂P/∂u and ∂P/∂b of the return map are those of differences; det ∂P/∂u is what the flux through the section says.

    In (x1, θ) on y1 = 0 the flux is sin θ dx1 dθ, and volume grows by exp(V/c) between: det = e^(ΔV/c) sin θ/sin θ'.
    """
    system = SECTIONS["up"][0]
    strobe = make_return_map(system, SPLITTING, 120)
    first = lanes(iterate, (strobe, np.int32(1)), (spread(Crossing(START, 0.0, 0.0)), P))
    u = np.stack([first.state[0][0], np.arctan2(first.state[1][1], first.state[1][0])], axis=-1)
    image, monodromy, slope = lanes(derivatives, (strobe, np.int32(1)), (u, P), static=("b",))
    h = 1e-5
    for j in range(2):
        ends = [lanes(derivatives, (strobe, np.int32(1)), (u + s * h * np.eye(2)[j], P)).image for s in (1, -1)]
        np.testing.assert_allclose(
            monodromy[..., j], system.chart.wrap(ends[0] - ends[1]) / (2 * h), atol=1e-5, rtol=1e-5
        )
    ends = [lanes(derivatives, (strobe, np.int32(1)), (u, {"b": B + s * h})).image for s in (1, -1)]
    np.testing.assert_allclose(slope, system.chart.wrap(ends[0] - ends[1]) / (2 * h), atol=1e-5, rtol=1e-5)

    def potential(x):  # at y1 = 0
        return 0.25 * x**2 + 0.25 * x**4

    expected = np.exp(potential(image[:, 0]) - potential(u[:, 0])) * np.sin(u[:, 1]) / np.sin(image[:, 1])
    np.testing.assert_allclose(np.linalg.det(monodromy), expected, rtol=1e-8)
    volume = lanes(volume_of, (strobe,), (u, P))
    np.testing.assert_allclose(volume, expected, rtol=1e-8)


def volume_of(strobe, u, p):
    return jnp.exp(strobe.pushforward(strobe.chart.state(u), p, ()).log_volume)


def test_reversal_of_time(lanes):
    """Reversed on the section, a motion comes back: P of (q, −n) downwards is where it came from, upwards."""
    up, down = (Section(particle_without("forcing"), "y1", 1, 0.0, way) for way in ("up", "down"))
    first, second = (
        lanes(iterate, (make_return_map(up, SPLITTING, 200), np.int32(n)), (spread(Crossing(START, 0.0, 0.0)), P))
        for n in (1, 2)
    )
    q, n = second.state
    turned = Crossing((q, tuple(-x for x in n)), np.zeros(LANES), np.zeros(LANES))
    back = lanes(iterate, (make_return_map(down, SPLITTING, 200), np.int32(1)), (turned, P))
    np.testing.assert_allclose(back.state[0], first.state[0], atol=1e-9)
    np.testing.assert_allclose(back.state[1], -np.asarray(first.state[1]), atol=1e-9)
    np.testing.assert_allclose(back.t, second.t - first.t, atol=1e-9)


def test_lanes_that_do_not_return(lanes):
    """A damped particle comes to rest beside the section, one lane begins with no number: both say why, others go on."""
    flow = free_particle(0.5, None, 1.0, ("forcing", "coupling"))
    system = Section(flow, "x1", 0, 3.0, "up")
    strobe = dataclasses.replace(make_return_map(system, dopri8, 40), most_steps=np.int32(400))
    x = np.array([2.9, 0.1, np.nan])
    state = Motion((x, np.full(3, 0.1)), (np.full(3, 5.0), np.zeros(3)), (np.zeros(3), np.zeros(3)))
    start = Crossing(state, np.zeros(3), np.zeros(3))
    found = lanes(iterate, (strobe, np.int32(1)), (start, {"b": np.zeros(3)}))
    reported = reports(flow, jax.tree.map(lambda leaf: leaf[:, None], found))
    reasons, _, flags = reported["status"]
    words = str(flags["flag_meanings"]).split()
    assert [words[i] for i in reasons] == ["ok", "no_return", "not_finite"]
    assert np.isfinite(found.t).tolist() == [True, False, False]
