"""Effects left out: programs that are the same or smaller, crossings and spectra against references, what is refused."""

from __future__ import annotations

import dataclasses
import math
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import taylor
import xarray as xr
from conftest import ROOT
from measure import scene_of

from jaxnh import cost
from jaxnh.analyses import base, chaos01, diagram, lyapunov, period, poincare
from jaxnh.analyses.base import LANE
from jaxnh.config.experiment import load
from jaxnh.costs.operations import count
from jaxnh.engine.axes import Points
from jaxnh.engine.calibration import Calibration
from jaxnh.engine.lanes import Lanes
from jaxnh.maps.build import make_strobe
from jaxnh.maps.iterate import derivatives, iterate, record
from jaxnh.maps.section import Crossing, SectionedFlow
from jaxnh.solvers import SPLITTINGS, dopri8, tsit5
from jaxnh.systems.free_particle import definition, free_particle
from jaxnh.systems.lagrangian import Motion, lagrangian
from jaxnh.systems.particle import constant_speed, disturbed_speed, unchart
from sweeps import effects as page_of_effects

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
ANGLE = np.array([0.1, 0.1, math.atan2(math.sqrt(0.99), 0.1)])
LANES = 16
B = np.linspace(0.1, 0.8, LANES)
P = {"b": B}
SPLITTING = SPLITTINGS["kahan_li8"]
EFFECTS = ("forcing", "coupling", "cubic_stiffness")


@pytest.fixture(scope="module")
def lanes():
    return Lanes()


def without(*names, **others):
    return constant_speed(without=names, **others)


def spread(start, count=LANES):
    return base.spread(start, count)


def lowered(system, function=iterate):
    """The text that is compiled for three periods of a system."""
    strobe = make_strobe(system, SPLITTINGS["blanes_moan6"], 40)

    def tile(shared, z, p):
        return jax.vmap(lambda z, p: function(shared, 3, z, p))(z, p)

    return jax.jit(tile).lower(strobe, spread(START), P).as_text()


def operations(lanes, system):
    """Floating-point operations a period of the map of a system, under 40 steps."""
    strobe = make_strobe(system, SPLITTINGS["blanes_moan6"], 40)
    text, tile = lanes.program(iterate, (strobe, np.int32(1)), (spread(START), P))
    return count(text, tile).total((1.0, *strobe.turns))


# ---- programs


def test_no_disturbance_is_constant_speed():
    """d = 0 compiles to the same text as constant speed, and not to another table."""
    assert lowered(disturbed_speed(d=0.0)) == lowered(constant_speed())
    tables = [make_strobe(s, SPLITTING, 40).table for s in (disturbed_speed(d=0.0), constant_speed())]
    np.testing.assert_array_equal(*tables)


def test_operations_are_those_of_a_kick(lanes):
    """Counted by hand: drift 4, force 15, z 3, N and D 7, m 6, its two products 6, quotient 2, n' 4; 11 at the end."""
    kicks = SPLITTINGS["blanes_moan6"].total_kicks(40)
    at_the_end = 4 + 7  # the last drift, and 1/|n|
    assert operations(lanes, constant_speed()) == kicks * (4 + 15 + 3 + 7 + 6 + 6 + 2 + 4) + at_the_end


@pytest.mark.parametrize(
    ("left_out", "saved"), [(("forcing",), 2), (("coupling",), 4), (("cubic_stiffness",), 6), (EFFECTS, 10)]
)
def test_operations_fall_with_every_effect(lanes, left_out, saved):
    """In a kick the coupling has two products, times a weight and a sum: 4; the cubic stiffness 3 and 3; the forcing 2.

    With a force of one term the weight of the coupling is that of all, and the forcing then saves nothing more. Without
    a clock every step has a last drift and a 1/|n| of its own.
    """
    kicks = SPLITTINGS["blanes_moan6"].total_kicks(40)
    ends = 39 * 11 if "forcing" in left_out else 0
    assert operations(lanes, constant_speed()) - operations(lanes, without(*left_out)) == kicks * saved - ends


def test_tables_have_no_forcing_that_is_left_out():
    """Without forcing a disturbed speed has a clock and kicks of two numbers; a constant one has neither."""
    still = disturbed_speed(without=("forcing",), omega=math.sqrt(2))
    assert still.period == 2 * math.pi
    assert make_strobe(still, SPLITTING, 40).table.shape[-1] == 2
    free_running = make_strobe(without("forcing"), SPLITTING, 40)
    assert free_running.one.table.shape == (64, 2)  # the coefficients of one step, and no more
    assert (free_running.steps, int(free_running.one.kicks)) == (40, 17)


def test_map_without_forcing_is_diffeqsolve(lanes):
    """A disturbed speed without forcing, against the general route by another method, to the error of either."""
    system = disturbed_speed(without=("forcing",))
    other = lagrangian(
        definition(system.without, constrained=True), {"a": 0.5, "b": 0.0, "c": 1.0, "d": 0.1, "omega": 1.0}
    )
    (x, y), (n1, n2) = lanes(iterate, (make_strobe(system, SPLITTING, 200), np.int32(1)), (spread(START), P))
    motion = Motion(START[0], START[1], (0.0, 0.0))
    there = lanes(iterate, (make_strobe(other, dopri8, 400), np.int32(1)), (spread(motion), P))
    np.testing.assert_allclose([x, y, n1, n2], [*there.q, *there.v], atol=1e-9)


@pytest.mark.parametrize("names", [(), ("forcing", "cubic_stiffness")])
def test_sweep_over_a(lanes, names):
    """Lanes that differ in a are the lanes of their own a and one b, and so is ∂P/∂a by differences."""
    values = np.array([0.3, 0.5, 0.8])
    swept = make_strobe(without(*names, b=0.7), SPLITTING, 60)
    u = np.tile(ANGLE, (3, 1))
    _, monodromy, slope = lanes(derivatives, (swept, np.int32(1)), (u, {"a": values}), static=("a",))
    (x, y), (n1, n2) = lanes(iterate, (swept, np.int32(1)), (spread(START, 3), {"a": values}))
    for i, a in enumerate(values):
        own = make_strobe(without(*names, a=a), SPLITTING, 60)
        one = lanes(iterate, (own, np.int32(1)), (spread(START, 1), {"b": np.array([0.7])}))
        np.testing.assert_allclose([x[i], y[i], n1[i], n2[i]], np.array([*one[0], *one[1]])[:, 0], atol=1e-12)
    h = 1e-5
    for found, step_u, step_a in ((slope, 0.0, h), (monodromy[..., 0], h * np.eye(3)[0], 0.0)):
        ends = [
            lanes(derivatives, (swept, np.int32(1)), (u + s * step_u, {"a": values + s * step_a})).image
            for s in (1, -1)
        ]
        np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2 * h), atol=1e-6)  # h², and rounding over h


# ---- crossings


SECTIONS = {
    "up": (SectionedFlow(without("forcing"), "y1", 1, 0.0, "up"), 1),
    "down": (SectionedFlow(without("forcing"), "x1", 0, 0.0, "down"), -1),
    "both": (SectionedFlow(without("forcing"), "y1", 1, 0.0, "both"), 0),
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


def test_crossings_meet_the_target(lanes):
    """The plan that calibration chooses for a target keeps it at the first crossing, against Taylor in long double.

    States and times of the next ones go on with no more than what the flow makes of such an error: a hundredfold in
    these calm lanes.
    """
    system, _ = SECTIONS["up"]
    start = spread(Crossing(START, 0.0, 0.0))
    target = 1e-8
    plan = Calibration([Points(system, start, P, P)], lanes).cheapest(target)
    _, found = lanes(record, (make_strobe(system, plan.solver, plan.steps),), (start, P), static=(4,))
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
        _, found = lanes(record, (make_strobe(system, SPLITTING, steps),), (start, P), static=(4,))
        errors.append(math.exp(np.log(difference(found, exact)[:, 0]).mean()))
        assert np.abs(found.state[0][system.number]).max() < 1e-14
        assert np.all(found.reason == 0)
    assert errors[1] < 2.0**-7 * errors[0] + 1e-13 < 1e-6


def test_crossings_of_a_free_particle(lanes):
    """The same by the general route, with damping, whose energy only falls."""
    flow = free_particle(0.5, None, 1.0, ("forcing",))
    system = SectionedFlow(flow, "x1", 0, 0.0, "both")
    start = Crossing(Motion((0.1, 0.1), (0.1, math.sqrt(0.99)), (0.0, 0.0)), 0.0, 0.0)
    b = np.array([0.1, 0.2, 0.3])
    strobe = make_strobe(system, dopri8, 120)
    _, found = lanes(record, (strobe,), (spread(start, 3), {"b": b}), static=(3,))
    exact = np.array(
        [taylor.crossings([0.1, 0.1, 0.1, math.sqrt(0.99)], v, 0, 3, direction=0, constrained=False) for v in b]
    )
    ours = np.stack([*found.state.q, *found.state.v, found.t], axis=-1)
    assert np.abs(ours - exact).max() < 1e-9


def test_return_in_one_step():
    """A passage and return within one step are seen, in each direction that is wanted, from above and from below."""
    flow = without("forcing", "coupling", "cubic_stiffness")  # y'' alone: towards y = 0, however it starts
    for tilt, direction, expected in ((0.02, "up", "first"), (0.02, "both", "first"), (0.02, "down", "second")):
        system = SectionedFlow(flow, "y1", 1, 1.0, direction)  # y = 1 is touched from below: passed up, and down again
        theta = math.asin(tilt)
        y = 1.0 - 0.4 * tilt**2 / 2.0
        start = Crossing(((0.0, y), (math.cos(theta), math.sin(theta))), 0.0, 0.0)
        coarse, fine = (
            make_strobe(system, SPLITTING, steps)(jax.tree.map(jnp.float64, start), {"b": 0.0}) for steps in (40, 4000)
        )
        step = system.period / 40
        assert float(fine.t) < step  # within the first coarse step
        assert abs(float(coarse.t - fine.t)) < 1e-9
        assert (float(fine.state[1][1]) > 0) == (expected == "first")


def test_derivatives_of_the_return(lanes):
    """∂P/∂u and ∂P/∂b of the return map are those of differences; det ∂P/∂u is what the flux through the section says.

    In (x1, θ) on y1 = 0 the flux is sin θ dx1 dθ, and volume grows by exp(V/c) between: det = e^(ΔV/c) sin θ/sin θ'.
    """
    system = SECTIONS["up"][0]
    strobe = make_strobe(system, SPLITTING, 120)
    first = lanes(iterate, (strobe, np.int32(1)), (spread(Crossing(START, 0.0, 0.0)), P))
    u = np.stack([first.state[0][0], np.arctan2(first.state[1][1], first.state[1][0])], axis=-1)
    image, monodromy, slope = lanes(derivatives, (strobe, np.int32(1)), (u, P), static=("b",))
    h = 1e-5
    for j in range(2):
        ends = [lanes(derivatives, (strobe, np.int32(1)), (u + s * h * np.eye(2)[j], P)).image for s in (1, -1)]
        np.testing.assert_allclose(monodromy[..., j], system.wrap(ends[0] - ends[1]) / (2 * h), atol=1e-5, rtol=1e-5)
    ends = [lanes(derivatives, (strobe, np.int32(1)), (u, {"b": B + s * h})).image for s in (1, -1)]
    np.testing.assert_allclose(slope, system.wrap(ends[0] - ends[1]) / (2 * h), atol=1e-5, rtol=1e-5)

    def potential(x):  # at y1 = 0
        return 0.25 * x**2 + 0.25 * x**4

    expected = np.exp(potential(image[:, 0]) - potential(u[:, 0])) * np.sin(u[:, 1]) / np.sin(image[:, 1])
    np.testing.assert_allclose(np.linalg.det(monodromy), expected, rtol=1e-8)
    volume = lanes(volume_of, (strobe,), (u, P))
    np.testing.assert_allclose(volume, expected, rtol=1e-8)


def volume_of(strobe, u, p):
    return strobe.push(strobe.system.unchart(u), p, ()).volume


def test_reversal_of_time(lanes):
    """Reversed on the section, a motion comes back: P of (q, −n) downwards is where it came from, upwards."""
    up, down = (SectionedFlow(without("forcing"), "y1", 1, 0.0, way) for way in ("up", "down"))
    first, second = (
        lanes(iterate, (make_strobe(up, SPLITTING, 200), np.int32(n)), (spread(Crossing(START, 0.0, 0.0)), P))
        for n in (1, 2)
    )
    q, n = second.state
    turned = Crossing((q, tuple(-x for x in n)), np.zeros(LANES), np.zeros(LANES))
    back = lanes(iterate, (make_strobe(down, SPLITTING, 200), np.int32(1)), (turned, P))
    np.testing.assert_allclose(back.state[0], first.state[0], atol=1e-9)
    np.testing.assert_allclose(back.state[1], -np.asarray(first.state[1]), atol=1e-9)
    np.testing.assert_allclose(back.t, second.t - first.t, atol=1e-9)


def test_lanes_that_do_not_return(lanes):
    """A damped particle comes to rest beside the section, one lane begins with no number: both say why, others go on."""
    flow = free_particle(0.5, None, 1.0, ("forcing", "coupling"))
    system = SectionedFlow(flow, "x1", 0, 3.0, "up")
    strobe = dataclasses.replace(make_strobe(system, dopri8, 40), most_steps=np.int32(400))
    x = np.array([2.9, 0.1, np.nan])
    state = Motion((x, np.full(3, 0.1)), (np.full(3, 5.0), np.zeros(3)), (np.zeros(3), np.zeros(3)))
    start = Crossing(state, np.zeros(3), np.zeros(3))
    found = lanes(iterate, (strobe, np.int32(1)), (start, {"b": np.zeros(3)}))
    reports = system.reports(jax.tree.map(lambda leaf: leaf[:, None], found))
    reasons, _, flags = reports["failure"]
    words = str(flags["flag_meanings"]).split()
    assert [words[i] for i in reasons] == ["none", "no_return", "not_finite"]
    assert np.isfinite(found.t).tolist() == [True, False, False]


# ---- spectra


@pytest.fixture(scope="module")
def spectrum(lanes):
    """Scene without forcing, chaotic but at the last b, and its three exponents."""
    system = SectionedFlow(without("forcing"), "y1", 1, 0.0, "up")
    scene = scene_of(system, Crossing(START, 0.0, 0.0), [0.5, 0.8, 1.2], SPLITTING, 100, error=1e-9)
    options = lyapunov.LyapunovOptions(transient=64, periods=1024)
    return scene, lyapunov.run(options, scene, lanes)


def test_exponents_pair_about_zero(spectrum):
    """One is zero, along the flow, and the others are ±λ: the divergence is a time derivative (Dettmann and Morriss).

    Of the sum a finite average keeps the difference of V/c and of the flow's speed between its ends: less than ten.
    """
    scene, group = spectrum
    exponents = group["exponents"].to_numpy()
    time = group["averaged"].to_numpy() * scene.system.period
    np.testing.assert_array_equal(exponents[:, 1], 0.0)
    np.testing.assert_array_equal(group["exponents_error"].to_numpy()[:, 1], 0.0)
    assert np.all(np.abs(exponents.sum(axis=1)) < 10 / time)
    assert np.abs(group["sum_rule_residual"].to_numpy()).max() < 1e-9
    largest, error = exponents[:, 0], group["exponents_error"].to_numpy()[:, 0]
    assert np.all(largest[:2] > 3 * error[:2])  # chaos
    assert largest[2] < 0.02 * largest[0]  # order: tangents grow in proportion to time, and so ln T/T


def test_exponent_against_taylor(spectrum):
    """The largest exponent, by Taylor variational equations in float64 on the same lane, within both error bars."""
    scene, group = spectrum
    i = int(np.argmax(group["exponents"].to_numpy()[:, 0]))
    found = taylor.still_exponents(ANGLE + 1e-6 * np.arange(8)[:, None], scene.p["b"][i], 2000.0)
    bar = 2.5 * found.std(ddof=1) / math.sqrt(len(found))
    ours, error = (group[name].to_numpy()[i, 0] for name in ("exponents", "exponents_error"))
    assert bar + error < 0.5 * ours
    assert abs(found.mean() - ours) < bar + error


def test_one_exponent_is_one_tangent(lanes, spectrum):
    """One exponent alone is the largest of three, the same where motion is orderly; it carries one tangent, three two."""
    scene, group = spectrum
    one = lyapunov.run(lyapunov.LyapunovOptions(transient=64, periods=1024, exponents=1), scene, lanes)
    assert one["exponents"].to_numpy().shape == (3, 1)
    np.testing.assert_allclose(one["exponents"].to_numpy()[2], group["exponents"].to_numpy()[2, :1], atol=1e-7)
    assert lyapunov.tangents(lyapunov.LyapunovOptions(exponents=1), scene) == 1
    assert lyapunov.tangents(lyapunov.LyapunovOptions(exponents=3), scene) == 2


def test_motion_that_comes_to_rest(lanes):
    """A free particle with damping and no forcing ends at rest: no exponent is zero, that along the flow neither.

    Without coupling they are those of μ² + aμ + k = 0 with k = a and k = 1: both pairs have the real part −a/2.
    """
    flow = free_particle(0.5, None, 1.0, ("forcing", "coupling"))
    system = SectionedFlow(flow, "x1", 0, 0.0, "up")
    start = Crossing(Motion((0.1, 0.1), (0.1, 0.2), (0.0, 0.0)), 0.0, 0.0)
    scene = scene_of(system, start, [0.0, 0.0], tsit5, 60, error=1e-8)
    group = lyapunov.run(lyapunov.LyapunovOptions(transient=8, periods=64, exponents=1), scene, lanes)
    np.testing.assert_allclose(group["exponents"].to_numpy(), -0.25, atol=0.01)  # beats of rotating pairs over T


def test_other_analyses_on_a_section(lanes, spectrum):
    """The 0–1 test parts order from chaos on crossings; nothing is attracting, so that no period is found."""
    scene, group = spectrum
    largest = group["exponents"].to_numpy()[:, 0]
    k = chaos01.run(chaos01.Chaos01Options(transient=16, periods=600), scene, lanes)["k"].to_numpy()
    assert k[np.argmax(largest)] > 0.8
    assert k[np.argmin(largest)] < 0.2
    found = period.run(period.PeriodOptions(limit=2, transient=16), scene, lanes)
    np.testing.assert_array_equal(found["period"].to_numpy(), 0)
    assert found["period"].attrs["units"] == "crossings"


def test_diagram_from_random_starts(lanes, spectrum):
    """Crossings with their times, rising, in each of the dimensions of the diagram."""
    scene, _ = spectrum
    options = diagram.DiagramOptions(transient=2, strobes=8, start="random", starts=3)
    group = diagram.run(options, scene, lanes)
    assert group["t"].dims == (LANE, "start", "strobe")
    assert np.all(np.diff(group["t"].to_numpy(), axis=-1) > 0)
    assert np.abs(group["y1"].to_numpy()).max() < 1e-14
    assert group.attrs["section"] == "y1 = 0, up"
    assert poincare.ANALYSIS.count(group) == {"trajectories": 9, "not_finite": 0}


# ---- the free particle


def test_free_particle_keeps_its_energy(lanes):
    """Without damping and forcing H = v²/2 + V is constant; with damping it falls by a ∫ v² dt, and so at all."""
    b = np.array([0.2, 0.6])
    start = spread(Motion((0.3, -0.2), (0.5, 0.4), (0.0, 0.0)), 2)

    def energy(z):
        x, y = z.q
        springs = 0.25 * x**2 + 0.25 * x**4 + 0.5 * y**2 + 0.125 * y**4
        return 0.5 * (z.v[0] ** 2 + z.v[1] ** 2) + springs - b * x * y

    for damped in (False, True):
        names = frozenset({"forcing"} | (set() if damped else {"damping"}))
        flow = free_particle(0.5, None, 1.0, names)
        end = lanes(iterate, (make_strobe(flow, dopri8, 80), np.int32(3)), (start, {"b": b}))
        lost = energy(start) - energy(end)
        assert np.all(lost > 0.1) if damped else np.abs(lost).max() < 1e-9


def test_free_particle_is_equation_1():
    """Its accelerations are those of (1), written out here, with forcing and damping."""
    flow = free_particle(0.4, None, 1.3)
    t, b, (x, y), (u, v) = 0.7, 1.1, (0.3, -0.8), (0.2, 0.9)
    g = 1 + math.sin(1.3 * t)
    state = jax.tree.map(jnp.float64, Motion((x, y), (u, v), (0.0, 0.0)))
    found = flow.rhs(t, state, {"b": b})
    expected = b * y - g * (0.4 * x + x**3) - 0.4 * u, b * x - g * (y + 0.4 * y**3) - 0.4 * v
    np.testing.assert_allclose(found.v, expected, rtol=1e-14)
    assert unchart(jnp.asarray(ANGLE))[0] == (ANGLE[0], ANGLE[1])


# ---- configs

CONFIG = """\
title: Effects
system: {constraint: constant_speed, a: 0.5, c: 1.0, without: [forcing]}
sweep: {b: {values: [0.2, 0.3]}}
section: {coordinate: y1, value: 0.0, direction: up}
accuracy: {target: 1.0e-6}
analyses:
  poincare: {transient: 2, strobes: 16}
  diagram: {transient: 2, strobes: 4}
  portrait: {transient: 1, periods: 2, samples: 8}
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    return path


def test_run_of_a_scene_without_a_clock(result, config):
    """One config to one file that opens: crossings with their times, a portrait in time, the exponents."""
    path, out, _ = result("effects", config)
    tree = xr.open_datatree(path, engine="h5netcdf").load()
    assert tree.attrs["section"] == "y1 = 0, up"
    maps = tree["poincare"].to_dataset()
    assert maps["t"].dims == ("b", "strobe")
    assert np.all(np.diff(maps["t"].to_numpy(), axis=1) > 0)
    assert maps["failure"].to_numpy().tolist() == [0, 0]
    speed = maps["x2"].to_numpy() ** 2 + maps["y2"].to_numpy() ** 2
    np.testing.assert_allclose(speed, 1.0, atol=1e-14)
    assert np.all(maps["y2"] > 0)
    assert tree["diagram"].to_dataset()["t"].dims == ("b", "strobe")
    np.testing.assert_allclose(np.diff(tree["portrait"]["t"].to_numpy()), 2 * math.pi / 8)
    assert "error of one return" in out


def test_price_of_every_effect(tmp_path, capsys):
    """Of each effect: fewer operations without it, or why it is free; tangents add up, and what is stored is counted."""
    overrides = ["accuracy={solver: blanes_moan6, steps: 40}", "analyses.portrait={periods: 2, samples: 16}"]
    experiment = load(ROOT / "configs" / "fig06.yaml", overrides)
    path = tmp_path / "effects.h5"
    cost.price_effects(experiment, path, 1, time.perf_counter())
    group = xr.open_datatree(path, engine="h5netcdf").load()["effects"].to_dataset()
    columns = {name: variable.to_numpy() for name, variable in group.variables.items()}
    rows = {str(what): i for i, what in enumerate(columns["what"])}
    for what in ("forcing", "disturbance", "coupling", "cubic_stiffness", "damping", "constraint"):
        with_it, without_it = columns["operations"][rows[what]], columns["operations_without"][rows[what]]
        assert without_it < with_it or str(columns["note"][rows[what]]).startswith("free: ")
    assert [str(columns["note"][rows[what]])[:5] for what in ("disturbance", "damping")] == ["free:", "free:"]
    tangents = [columns["operations"][rows[f"tangent {k}"]] for k in (1, 2, 3)]
    assert columns["operations_without"][rows["tangent 1"]] < tangents[0] < tangents[1] < tangents[2]
    assert columns["stored"][rows["portrait"]] == 4 * 8 * 2 * 16  # four numbers of eight bytes a sample
    assert columns["stored"][rows["poincare"]] == 4 * 8 * 2048
    out = capsys.readouterr().out
    assert all(any(line.startswith(what) for line in out.splitlines()) for what in rows)


def test_page_is_of_the_scenes_that_are_priced():
    """The page reads what `make effects` prices, scene by scene."""
    [line] = [line for line in (ROOT / "Makefile").read_text().splitlines() if line.startswith("EFFECTS :=")]
    assert tuple(line.split()[2:]) == page_of_effects.SCENES
