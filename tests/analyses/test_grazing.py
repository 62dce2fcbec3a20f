"""Orbits that graze on branches and along curves, against motions between impacts in closed form."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxnh
from jaxnh.analyses.continuation.curve_tables import CURVE_KINDS
from jaxnh.analyses.continuation.families import orbit_family
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.analyses.continuation.grazing import arc_problem, grazing_sensitivities, may_graze, with_grazing
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.maps.event_arcs import event_sequence
from jaxnh.maps.section import Section, begin
from jaxnh.orbits.bifurcations.grazing import ArcSequence, grazing_orbit, touching
from jaxnh.orbits.continuation.kinds import GRAZING, KINDS
from jaxnh.orbits.continuation.paths import ENDS, GRAZES, RANGE, StepControl
from jaxnh.solvers import dopri8
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import QUICKLY_COMPILED, lanes_with_kept_programs, session_of

OMEGA = 2.8
FORCED = 1 / (1 - OMEGA**2)  # x = FORCED cos ωt without a wall
IMPACT = f"""
import jax.numpy as jnp


def system(omega={OMEGA}, r=0.8, s=0.0):
    def rhs(y, t):
        x, v = y
        return v, jnp.cos(omega * t) - x

    wall = {{"when": lambda y, t: y[0] - s, "direction": "up", "then": lambda y, t: (y[0], -r * y[1])}}
    return {{"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega, "jumps": [wall]}}
"""


class Motion(NamedTuple):
    """x″ + x = cos ωt from x, v at the time t on, in closed form."""

    t: float
    x: float
    v: float

    def at(self, t):
        a, b = self.x - FORCED * np.cos(OMEGA * self.t), self.v + FORCED * OMEGA * np.sin(OMEGA * self.t)
        later, phase = t - self.t, OMEGA * t
        x = FORCED * np.cos(phase) + a * np.cos(later) + b * np.sin(later)
        return x, -FORCED * OMEGA * np.sin(phase) - a * np.sin(later) + b * np.cos(later)


def impacts_of(point, s, r, end):
    """Times and speeds of the impacts from a point at t = 0 on, and the turn next to the wall between them."""
    motion, impacts, nearest = Motion(0.0, *point), [], (np.inf, 0.0)
    while True:
        times = np.linspace(motion.t + 1e-6, end, 4000)
        x, v = motion.at(times)
        hits = np.flatnonzero((x[:-1] < s - 1e-6) & (x[1:] >= s - 1e-6) & (v[:-1] > 1e-2))
        last = hits[0] if len(hits) else len(times) - 2
        turns = np.flatnonzero((v[:-1] > 0) & (v[1:] <= 0) & (np.arange(len(v) - 1) < last))
        for k in turns:
            t = brentq(lambda t, m=motion: m.at(t)[1], times[k], times[k + 1])
            nearest = min(nearest, (abs(motion.at(t)[0] - s), t))
        if not len(hits):
            return np.array(impacts), nearest[1]
        t = brentq(lambda t, m=motion: m.at(t)[0] - s, times[last], times[last + 1] + 1e-5)
        impacts.append((t, motion.at(t)[1]))
        motion = Motion(t, s, -r * impacts[-1][1])


def grazing_near(point, s, r, periods):
    """Impact times and speeds, the time of the touch and the place of the wall, nearly."""
    impacts, touch = impacts_of(point, s, r, periods * 2 * np.pi / OMEGA)
    return np.array([*impacts[:, 0], *impacts[:, 1], touch, s])


def grazing_exactly(z, r, periods):
    """The same of the orbit that grazes, by Newton in closed form."""
    end, count = periods * 2 * np.pi / OMEGA, len(z) // 2 - 1

    def missing(z):
        t, v, (touch, s) = z[:count], z[count : 2 * count], z[2 * count :]
        rows, before = [], int(np.sum(t < touch)) - 1  # −1: the impact of the orbit's last turn
        for k in range(count):
            x, speed = Motion(t[k], s, -r * v[k]).at(t[(k + 1) % count] + end * (k + 1 == count))
            rows += [x - s, speed - v[(k + 1) % count]]
        x, speed = Motion(t[before] - end * (before < 0), s, -r * v[before]).at(touch)
        return np.array([*rows, x - s, speed])

    for _ in range(12):
        slopes = np.stack([(missing(z + e) - missing(z - e)) / 2e-6 for e in 1e-6 * np.eye(len(z))], axis=1)
        step = np.linalg.solve(slopes, missing(z))
        z = z - step
    assert np.abs(step).max() < 1e-13
    return z


def assert_on_curve(near, s, r, s_error, r_error):
    """Within their errors of the closed form, from the restitution 0.8 on both ways."""
    first = int(np.argmin(np.abs(r - 0.8)))
    for part in (range(first, len(s)), range(first, -1, -1)):
        z = near
        for k in part:
            z = grazing_exactly(z, r[k], 2)
            slope = abs(grazing_exactly(z, r[k] + 1e-5, 2)[-1] - z[-1]) / 1e-5
            assert abs(s[k] - z[-1]) <= s_error[k] + slope * r_error[k] + 1e-14


def impact_oscillator(r=0.8, omega=OMEGA, s=0.0):
    """As in the file."""
    wall = {"when": lambda y, t: y[0] - s, "direction": "up", "then": lambda y, t: (y[0], -r * y[1])}
    rhs = lambda y, t: (y[1], jnp.cos(omega * t) - y[0])  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi / omega, "jumps": [wall]}


@pytest.fixture
def quick_lanes():
    return lanes_with_kept_programs(None, jax.devices()[:1], 32, QUICKLY_COMPILED)


def oscillators():
    """A batch over the wall's place."""
    flow = piecewise_smooth(impact_oscillator, {"r": 0.8, "omega": OMEGA, "s": 0.0})
    return batch_of(flow, flow.start({"x": -0.1, "v": 0.0}), [-0.3, 0.3], dopri8, 40, name="s")


def test_an_orbit_that_touches_the_wall(quick_lanes):
    """x = FORCED cos ωt does where s is its amplitude, 1/(ω² − 1); its multipliers are those without a wall."""
    batch, period = oscillators(), 2 * np.pi / OMEGA
    problem = arc_problem(batch, quick_lanes, ("s",), (np.array([-0.3]), np.array([0.3])), np.ones(2), period)
    without = ArcSequence(np.array([2]), np.array([[-1.0]]), 0)
    near = touching(without, np.array([[FORCED, 0.01, 0.0]]), np.array([period]), 0, 0.48, np.array([0.14, 0.1]), 0)
    orbit = grazing_orbit(problem, *near, np.array([0.16]))
    assert abs(orbit.values[0] + FORCED) < 1e-13  # of a method of order eight with 40 steps
    assert orbit.start == pytest.approx(np.array([[FORCED, 0.0, 0.0], [-FORCED, 0.0, 0.5 * period]]), abs=1e-12)
    assert np.sort_complex(orbit.multipliers) == pytest.approx(np.exp([-1j * period, 1j * period]), abs=1e-12)
    assert [one.points.tolist() for one in orbit.turned()] == [orbit.points.tolist()]


def test_what_an_orbit_that_touches_depends_on(quick_lanes):
    """Without an impact the restitution changes nothing, and a faster drive the amplitude 1/(ω² − 1)."""
    batch, ends = oscillators(), (np.array([-0.3]), np.array([0.3]))
    touching_orbit = ArcSequence(np.array([1, 2]), np.array([[-1.0], [-1.0]]), 0)
    half = np.pi / OMEGA
    start, length = np.array([[FORCED, 0.0, 0.0], [-FORCED, 0.0, half]]), np.array([half, half])
    problems = [arc_problem(batch, quick_lanes, ("s",), ends, np.ones(2), 2 * half, more) for more in (1, 2)]
    orbits = [grazing_orbit(problem, touching_orbit, start, length, np.array([-FORCED])) for problem in problems]
    found = grazing_sensitivities(batch, quick_lanes, [orbits])
    assert (found.names, found.absent) == (("r", "omega"), {})
    exact = np.array([[0.0, -2.0 * OMEGA / (OMEGA**2 - 1) ** 2]])
    assert np.all(np.abs(found.rates - exact) <= found.errors)
    assert np.all(found.errors < 1e-10)


def impacting_van_der_pol(s=2.2, r=0.8):
    """As in the file: without a clock, and a wall at x = s."""
    wall = {"when": lambda y, t: y[0] - s, "direction": "up", "then": lambda y, t: (y[0], -r * y[1])}
    rhs = lambda y, t: (y[1], (1.0 - y[0] * y[0]) * y[1] - y[0])  # noqa: E731
    return {"rhs": rhs, "coordinates": ("x", "v"), "jumps": [wall]}


def van_der_pol_until(start, **event):
    """Time and state at an event of van der Pol's flow by DOP853."""

    def passes(t, y):
        return y[event["number"]] - event["value"]

    passes.terminal, passes.direction = True, event["direction"]
    path = solve_ivp(
        lambda t, y: [y[1], (1.0 - y[0] ** 2) * y[1] - y[0]],
        (0.0, 50.0),
        start,
        "DOP853",
        events=passes,
        rtol=1e-13,
        atol=1e-13,
    )
    return path.t_events[0][0], path.y_events[0][0]


@pytest.fixture(scope="module")
def largest_x():
    """Of van der Pol's cycle, which is at v = 0 there, and the point where the cycle passes x = 0 upwards."""
    start = np.array([0.0, 2.17])
    for _ in range(4):
        _, right = van_der_pol_until(start, number=1, value=0.0, direction=-1)
        _, left = van_der_pol_until(right, number=1, value=0.0, direction=1)
        _, start = van_der_pol_until(left, number=0, value=0.0, direction=1)
    return right[0], start[1]


def test_events_between_crossings_of_a_section(quick_lanes, largest_x):
    """From x = 0 to the wall, and after the impact back to x = 0, by DOP853; an orbit that only touches is as large as
    van der Pol's cycle.
    """
    flow = piecewise_smooth(impacting_van_der_pol, {"s": 2.2, "r": 0.8})
    section, (amplitude, speed) = Section(flow, "x", 0, 0.0, "up"), largest_x
    start = begin(section, flow.start({"x": 0.0, "v": speed}))
    batch = batch_of(section, start, [1.5, 2.5], dopri8, 40, name="s")
    assert may_graze(batch)
    events = quick_lanes(event_sequence, (batch.strobe(),), (np.full((2, 1), speed), dict(batch.p)), static=(4,))
    assert events.met.tolist() == [1, 0]
    first, wall = van_der_pol_until([0.0, speed], number=0, value=1.5, direction=1)
    back, _ = van_der_pol_until([1.5, -0.8 * wall[1]], number=0, value=0.0, direction=1)
    assert events.time[0, 0] == pytest.approx(first, abs=1e-10)
    assert events.state[0, 1] == pytest.approx([1.5, -0.8 * wall[1]], abs=1e-10)
    assert (events.number[0, 0], events.side[0, :2, 0].tolist()) == (0, [-1.0, -1.0])
    assert events.duration[0] == pytest.approx(first + back, abs=1e-9)

    ends, period = (np.array([1.5]), np.array([2.5])), float(events.duration[1])
    problem = arc_problem(batch, quick_lanes, ("s",), ends, np.ones(1), period)
    without = ArcSequence(np.array([2]), np.array([[-1.0]]), 0)
    near = touching(without, np.array([[0.0, speed, 0.0]]), np.array([period]), 0, 0.25, np.array([2.0, 0.1]), 0)
    orbit = grazing_orbit(problem, *near, np.array([2.0]))
    assert abs(orbit.values[0] - amplitude) < 1e-9  # of 267 steps a turn of order eight
    assert orbit.points == pytest.approx(np.array([[speed]]), abs=1e-9)
    assert len(orbit.multipliers) == 1


VAN_DER_POL = """
def system(mu=1.0, r=0.8, s=1.9):
    def rhs(y, t):
        x, v = y
        return v, mu * (1 - x * x) * v - x

    wall = {"when": lambda y, t: y[0] - s, "direction": "up", "then": lambda y, t: (y[0], -r * y[1])}
    return {"rhs": rhs, "coordinates": ("x", "v"), "jumps": [wall]}
"""


@pytest.mark.slow
def test_a_cycle_without_a_clock_grazes(tmp_path, largest_x):
    """Van der Pol's cycle touches the wall where that is as far as it is large, and the branch goes on."""
    (tmp_path / "own.py").write_text(VAN_DER_POL)
    (tmp_path / "own.yaml").write_text(
        "system: {file: own.py}\ninitial: {x: -0.1, v: 0.3}\nsweep: {s: {start: 1.5, stop: 2.3, count: 5}}\n"
        "section: {coordinate: x, value: 0, direction: up}\naccuracy: {target: 1.0e-9}\n"
        "analyses:\n  branches: {max_period: 1, transient: 64, sensitivities: true}\n"
    )
    tree = session_of(jaxnh.load(tmp_path / "own.yaml")).tree()
    branches, points = (tree[name].to_dataset() for name in ("branches", "bifurcations"))
    assert {ENDS[int(branches[name][0])] for name in ("begins", "ends")} == {"range"}
    [kind], [s], [error] = (points[name].values for name in ("kind", "s", "s_error"))
    assert KINDS[kind] == "grazing"
    assert abs(s - largest_x[0]) <= error + 1e-11  # of DOP853
    assert error < 1e-11
    by_r = points.isel(bifurcation=0).sel(parameter="r")
    assert abs(by_r["s_sensitivity"]) <= by_r["s_sensitivity_error"] + 1e-12  # a touch has no impact


PHASE = f"""
import jax.numpy as jnp


def system(omega={OMEGA}, r=0.8, s=0.0):
    def rhs(y, t):
        x, v, theta = y
        return v, jnp.cos(theta) - x, omega + 0.0 * x

    wall = {{"when": lambda y, t: y[0] - s, "direction": "up", "then": lambda y, t: (y[0], -r * y[1], y[2])}}
    return {{"rhs": rhs, "coordinates": ("x", "v", "theta"), "angles": ("theta",), "jumps": [wall]}}
"""


@pytest.mark.slow
def test_curves_of_impacting_orbits_on_a_section(tmp_path):
    """With the drive's phase as a coordinate and its section in place of the clock: the closed form, each curve once."""
    (tmp_path / "phase.py").write_text(PHASE)
    (tmp_path / "phase.yaml").write_text(
        "system: {file: phase.py}\ninitial: {x: -0.1, theta: -0.1}\nsweep: {s: {start: -0.2, stop: 0.3, count: 9}, "
        "r: {start: 0.6, stop: 0.9, count: 3}}\nsection: {coordinate: theta, value: 0, direction: up}\n"
        "accuracy: {target: 1.0e-8}\nanalyses:\n  curves: {max_period: 2, "
        "n_values: 2, transient: 128, bifurcations: false, grazing: true, ds_max: 0.1}\n"
    )
    data = session_of(jaxnh.load(tmp_path / "phase.yaml")).tree()["curves"].to_dataset()
    assert {CURVE_KINDS[kind] for kind in data["kind"].values} == {"grazing"}
    smooth = np.flatnonzero(data["period"].values == 1)
    assert len(smooth) == 1
    assert np.nanmax(np.abs(data["s"].values[smooth] + FORCED) - data["s_error"].values[smooth]) <= 0.0
    known = np.isfinite(data["duration"].values)
    assert np.abs(data["duration"].values - data["period"].values[:, None] * 2 * np.pi / OMEGA)[known].max() < 1e-9
    near = grazing_near(np.array([-0.47434507614, 7.91376931e-05]), 0.049134403319, 0.8, 2)
    followed = 0
    for k in np.flatnonzero(data["period"].values == 2):
        at = np.isfinite(data["s"].values[k])
        s, r, s_error, r_error = (data[name].values[k][at] for name in ("s", "r", "s_error", "r_error"))
        first = int(np.argmin(np.abs(r - 0.8)))
        if abs(s[first] - grazing_exactly(near, r[first], 2)[-1]) > 1e-6:
            continue  # another orbit of two periods, which meets the wall later
        followed += 1
        assert_on_curve(near, s, r, s_error, r_error)
    assert followed == 1


@pytest.mark.slow
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_branch_ends_where_its_orbit_touches_the_wall(lanes, side):
    """The same, found where Newton by shooting no longer converges; from above, where the orbit touches at the strobe."""
    batch, start = oscillators(), [SeedOrbit(np.array([[FORCED, 0.0]]), -side * 0.2)]
    families = [orbit_family(batch, lanes, strobe, np.ones(2), (-0.3, 0.3)) for strobe in refined_maps(batch)]
    assert may_graze(batch)
    tree = with_grazing(batch, lanes, families[0], grow(families, [start], 1, StepControl(0.25)), np.ones(2))
    [branch], [point] = tree.branches, tree.bifurcations
    assert set(branch.ends) == {GRAZES, RANGE}
    assert (point.kind, point.branch) == (GRAZING, 0)
    assert abs(point.value - side * FORCED) <= point.error < 1e-13
    assert point.points == pytest.approx(np.array([[FORCED, 0.0]]), abs=1e-12)


@pytest.mark.slow
def test_impacting_orbits_that_graze(tmp_path):
    """Branches of periods up to 4 that Newton by shooting loses end where orbits graze, to rounding of the closed form.

    But for those whose orbits have an impact at the very strobe, where the state that the map sees jumps.
    """
    (tmp_path / "impact.py").write_text(IMPACT)
    (tmp_path / "impact.yaml").write_text(
        "system: {file: impact.py}\ninitial: {x: -0.1}\nsweep: {s: {start: -0.3, stop: 0.3, count: 33}}\n"
        "accuracy: {target: 1.0e-9}\nanalyses:\n  branches: {max_period: 4, n_starts: 8, n_values: 5, seed: 1, "
        "box: {x: [-1, 0], v: [-1, 1]}, sensitivities: true}\n"
    )
    tree = session_of(jaxnh.load(tmp_path / "impact.yaml")).tree()
    branches, points = (tree[name].to_dataset() for name in ("branches", "bifurcations"))
    ends = np.array([[ENDS[k] for k in branches[name].values] for name in ("begins", "ends")])
    assert np.sum(ends == "grazing") > 8
    for which, k in np.argwhere(ends == "no_convergence"):
        last = np.flatnonzero(np.isfinite(branches["s"].values[k]))[[0, -1][which]]
        away = branches["x_points"].values[k, last] - branches["s"].values[k, last]
        assert np.nanmin(np.abs(away)) < 1e-6
    grazing = points.isel(bifurcation=np.flatnonzero(points["kind"] == KINDS.index("grazing")))
    checked = 0
    for k in range(grazing.sizes["bifurcation"]):
        one = grazing.isel(bifurcation=k)
        s, error, n = float(one["s"]), float(one["s_error"]), int(one["period"])
        orbit = np.array([one["x_points"].values[0], one["v_points"].values[0]])
        if len(impacts_of(orbit, s, 0.8, n * 2 * np.pi / OMEGA)[0]):
            exact = grazing_exactly(grazing_near(orbit, s, 0.8, n), 0.8, n)
            assert abs(s - exact[-1]) <= error + 1e-14
            more, less = (grazing_exactly(exact, 0.8 + h, n)[-1] for h in (1e-4, -1e-4))
            by_r = one.sel(parameter="r")
            assert abs(by_r["s_sensitivity"] - (more - less) / 2e-4) <= by_r["s_sensitivity_error"] + 1e-7
            checked += 1
        else:
            assert abs(abs(s) - abs(FORCED)) <= error
        assert error < 1e-11
    assert checked > 5


@pytest.mark.slow
def test_curves_of_impacting_orbits_that_graze(tmp_path):
    """Over the wall's place and the restitution: every point within its error of the closed form."""
    (tmp_path / "impact.py").write_text(IMPACT)
    (tmp_path / "impact.yaml").write_text(
        "system: {file: impact.py}\ninitial: {x: -0.1}\nsweep: {s: {start: -0.2, stop: 0.3, count: 9}, "
        "r: {start: 0.6, stop: 0.9, count: 3}}\naccuracy: {target: 1.0e-9}\nanalyses:\n  curves: {max_period: 2, "
        "n_values: 2, transient: 128, bifurcations: false, grazing: true, ds_max: 0.1}\n"
    )
    data = session_of(jaxnh.load(tmp_path / "impact.yaml")).tree()["curves"].to_dataset()
    assert {CURVE_KINDS[kind] for kind in data["kind"].values} == {"grazing"}
    assert data["period"].values.tolist() == [1, 2]
    for k in range(2):
        known = np.isfinite(data["s"].values[k])
        s, r, s_error, r_error = (data[name].values[k][known] for name in ("s", "r", "s_error", "r_error"))
        assert (r.min(), r.max()) == pytest.approx((0.6, 0.9))
        assert max(s_error.max(), r_error.max()) < 1e-11
        if k == 0:  # without an impact, whatever the restitution
            assert np.all(np.abs(s + FORCED) <= s_error)
            continue
        near = grazing_near(np.array([-0.47434507614, 7.91376931e-05]), 0.049134403319, 0.8, 2)
        assert_on_curve(near, s, r, s_error, r_error)


BILINEAR = """
import jax.numpy as jnp


def system(force=0.3, zeta=0.1, omega=0.8, stiffer=2.0):
    def rhs(y, t, side):
        x, v = y
        return v, force * jnp.cos(omega * t) - 2 * zeta * v - x - jnp.where(side[0] > 0, stiffer * (x - 1.0), 0.0)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega, "switches": [{"on": lambda y, t: y[0] - 1.0}]}
"""


@pytest.mark.slow
def test_a_bilinear_oscillator_first_touches_its_corner(tmp_path):
    """A second spring is met at x = 1, which the linear one's amplitude is at F = √((1 − ω²)² + 4ζ²ω²); the branch goes on."""
    (tmp_path / "bilinear.py").write_text(BILINEAR)
    (tmp_path / "bilinear.yaml").write_text(
        "system: {file: bilinear.py}\ninitial: {x: 0.1}\nsweep: {force: {start: 0.2, stop: 0.8, count: 4}}\n"
        "accuracy: {target: 1.0e-9}\nanalyses:\n  branches: {max_period: 1, transient: 128}\n"
    )
    tree = session_of(jaxnh.load(tmp_path / "bilinear.yaml")).tree()
    branches, points = (tree[name].to_dataset() for name in ("branches", "bifurcations"))
    [grazing] = np.flatnonzero(points["kind"] == KINDS.index("grazing"))
    force, error = (float(points[name][grazing]) for name in ("force", "force_error"))
    assert abs(force - np.hypot(1 - 0.64, 0.16)) <= error < 1e-10
    assert {ENDS[int(branches[name][0])] for name in ("begins", "ends")} == {"range"}
