"""The error estimate against the true error of other lanes than those it was measured on, by the Taylor reference."""

from __future__ import annotations

import math
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.accuracy.sample_maps import SampleMaps
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.plan import calibrate
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate, section_map
from jaxnh.solvers import SOLVERS, SPLITTINGS
from jaxnh.systems.particle import CHART, disturbed_speed
from jaxnh.systems.status import NOT_FINITE
from tests.flows.lorenz import lorenz
from tests.flows.particle import SYSTEMS, twin
from tests.helpers import taylor
from tests.helpers.batches import broadcast_start, calibrated
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.measurement import UNIT, largest_difference

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))


@pytest.fixture(scope="module")
def lanes():
    """Tiles as commands have them: here are a thousand lanes."""
    return lanes_with_kept_programs()


RANGES = {
    "constant, all b": ("constant", 0.1, 6.0),
    "constant, table 1": ("constant", 5.6, 5.45),
    "disturbed, all b": ("disturbed", 6.0, 0.01),
    "disturbed, table 2": ("disturbed", 5.9, 5.72),
}


def other_lanes(lanes, system, first, last):
    """b and section points of 500 lanes: b between the values of a sweep, a fifth each after 0, 3, 9, 41, 100 periods."""
    b = np.random.default_rng(17).uniform(*sorted((first, last)), 500)
    strobe = make_return_map(system, SPLITTINGS["kahan_li8"], 120)
    points = []
    for k, n in enumerate((0, 3, 9, 41, 100)):
        state = jax.tree.map(lambda leaf: np.full(100, leaf), START)
        points.append(
            jax.vmap(CHART.point)(lanes(iterate, (strobe, np.int32(n)), (state, {"b": b[100 * k : 100 * k + 100]})))
        )
    return b, np.concatenate(points)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "first", "last"), RANGES.values(), ids=RANGES)
def test_estimate_is_honest(lanes, name, first, last):
    """On lanes on the way and on the attractors the true error is below the estimate, which is below the target; and with
    every digit asked for there are more kicks.

    At most one in 10,000 may be above: of 500 there is one with a probability of 5 %, and there are two with 0.1 %.
    """
    system = SYSTEMS[name]
    calibration = calibrated(system, START, np.linspace(first, last, 1000), lanes)
    b, u = other_lanes(lanes, system, first, last)
    exact = taylor.strobe(twin(system), b, u)
    kicks = []
    for target in (1e-4, 1e-6, 1e-8, 1e-10):
        plan = calibration.cheapest(target)
        strobe = make_return_map(system, plan.solver, plan.steps, compensated=plan.compensated)
        error = largest_difference(lanes(section_map, (strobe, np.int32(1)), (u, {"b": b})), exact)
        assert np.sum(error > plan.error_estimate) <= 1
        assert plan.error_estimate <= target
        kicks.append(plan.steps * plan.solver.stages)
    assert kicks == sorted(set(kicks))


@pytest.mark.parametrize("name", ["constant", "disturbed"])
def test_estimate_on_its_own_lanes(lanes, name):
    """Where the sweep is one value and the lane a stable orbit, the estimate is its error against the reference, times
    the two that allow for other lanes."""
    system, b = SYSTEMS[name], {"constant": 5.58, "disturbed": 5.85}[name]
    point = taylor.attractor(twin(system), b, twin(system).start(), 400)[0]
    start = ((point[0], point[1]), (math.cos(point[2]), math.sin(point[2])))
    exact = taylor.strobe(twin(system), b, point)
    calibration = calibrated(system, start, np.array([b]), lanes)
    for solver, steps in ((SPLITTINGS["blanes_moan4"], 100), (SPLITTINGS["kahan_li8"], 40)):
        image = lanes(
            iterate,
            (make_return_map(system, solver, steps), np.int32(1)),
            (broadcast_start(start, 1), {"b": np.array([b])}),
        )
        (x, y), n = jax.tree.map(lambda leaf: leaf[0], image)
        end = [exact[0, 0], exact[0, 1], np.cos(exact[0, 2]), np.sin(exact[0, 2])]
        error = np.abs(np.array([x, y, *n]) - end).max()
        assert error < calibration.error(solver, steps) < 5 * error


def test_target_out_of_reach(lanes):
    """No plan comes out, but the smallest error there is: above the target, and about the rounding of one period."""
    calibration = calibrated(SYSTEMS["constant"], START, np.linspace(5.45, 5.6, 8), lanes)
    with pytest.raises(AccuracyError, match="1e-18") as caught:
        calibration.cheapest(1e-18)
    smallest = float(str(caught.value).rsplit(" ", 1)[1])
    assert UNIT < smallest < 1e-11


@pytest.fixture(scope="module")
def ten_lanes(lanes):
    return calibrated(SYSTEMS["constant"], START, np.linspace(5, 6, 10), lanes)


def test_rounding_is_measured_as_far_as_it_decides(ten_lanes):
    """One table of plain sums shows that the error of coarse steps is none of rounding; that of fine ones takes all."""
    coarse, fine = (SOLVERS["tsit5"], 100), (SPLITTINGS["sofroniou_spaletta10"], 250)
    with mock.patch.object(ten_lanes._maps, "of", wraps=ten_lanes._maps.of) as maps:
        error = ten_lanes.error(*coarse)
        assert maps.call_count == 1 + 2
        assert ten_lanes.error(*fine) < 1e-3 * error
        assert maps.call_count == 2 + 2 * 4
    assert ten_lanes.error(*coarse) == error


def test_overflow_has_no_estimate(ten_lanes):
    """Two Runge–Kutta steps a period overflow for large b: an infinite error, never a small one."""
    assert ten_lanes.error(SOLVERS["tsit5"], 2) > 1


@pytest.mark.parametrize("name", ["constant", "disturbed"])
def test_rounding_floor(lanes, name):
    """What rounding leaves of one period over the paper's b, at the start and on the attractors, at most 5e-12.

    250 steps of order ten are far below it in truncation. Compensated sums hold it on every lane; plain ones, whose
    roundings a few sensitive lanes enlarge by 1e4 and more, on all but these.
    """
    system, b = SYSTEMS[name], np.linspace(2, 6, 256)
    start = np.tile([0.1, 0.1, math.atan2(math.sqrt(0.99), 0.1)], (len(b), 1))
    plain, compensated = (
        make_return_map(system, SPLITTINGS["sofroniou_spaletta10"], 250, compensated=c) for c in (False, True)
    )
    u = np.concatenate([start, lanes(section_map, (plain, np.int32(30)), (start, {"b": b}))])
    b = np.tile(b, 2)
    exact = taylor.strobe(twin(system), b, u)
    errors = [
        largest_difference(lanes(section_map, (m, np.int32(1)), (u, {"b": b})), exact) for m in (plain, compensated)
    ]
    assert np.quantile(errors[0], 0.98) < 5e-12
    assert errors[1].max() < 5e-12


def test_reference_that_converges_unevenly(lanes):
    """Where the speed nearly vanishes a refinement may leave the reference as it is, and the next ones not.

    In no period here are errors enlarged more than some hundred times, by heyoka's variational equations.
    """
    system = disturbed_speed(d=0.99)
    start = system.start({"x1": 0.1, "x2": 0.1, "y1": 0.1})
    found = calibrated(system, start, np.linspace(0.1, 6.0, 48)[[46]], lanes)
    assert found.floor < 1e-11


def test_a_section_over_an_axis_that_lanes_share():
    """Both speeds are calibrated, on the lanes of each: at every crossing y1 = 0, rising, and the speed is its own."""
    found = jaxnh.run(
        jaxnh.Experiment.from_dict(
            {
                "system": {"constraint": "constant_speed", "b": 0.9, "without": ["forcing"]},
                "sweep": {"a": {"start": 0.4, "stop": 0.8, "count": 4}, "c": {"values": [1.0, 1.2]}},
                "section": {"coordinate": "y1"},
                "accuracy": {"target": 1e-4},
                "analyses": {"poincare": {"transient": 1, "strobes": 2}},
            }
        )
    )["poincare"]
    assert float(abs(found["y1"]).max()) < 1e-12
    assert float(found["y2"].min()) > 0.0
    assert float(abs(found["x2"] ** 2 + found["y2"] ** 2 - found["c"]).max()) < 1e-12  # splittings turn a unit vector


@pytest.mark.usefixtures("quick_compiling_once")
def test_a_section_that_is_never_met_is_refused_soon():
    """Once three numbers of steps agree: not after as many steps as any flow could need, by lanes that go on and on."""
    kicks, of = [], SampleMaps.of

    def counted(maps, solver, steps, **others):
        kicks.append(solver.total_kicks(steps))
        return of(maps, solver, steps, **others)

    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-8).on("z", 500.0, "up")
    refusal = (
        "every lane of this sweep does not come back to its section; at rho = 20 the section may not be met within"
    )
    with mock.patch.object(SampleMaps, "of", counted), pytest.raises(AccuracyError, match=refusal):
        session.run("diagram", rho=[20.0, 28.0])
    assert max(kicks) < 2_000


def emptying_tank(k=0.5):
    """Torricelli's law with an inflow; a motion from h = 0 begins with a rate that has no derivative there."""

    def rhs(y, t):
        return 0.5 + 0.5 * jnp.sin(t) - k * jnp.sqrt(jnp.maximum(y[0], 0.0))

    return {"rhs": rhs, "coordinates": "h", "period": 2 * jnp.pi}


def test_slow_convergence_is_not_taken_for_rounding():
    """Errors of every method fall as the power 3/2 of steps: 3 % more of them leave the error as it is, twice do not."""
    session = jaxnh.Session(emptying_tank, start={"h": 0.0}, target=1e-7)
    ours = float(session.run(jaxnh.Diagram(transient=30, strobes=1), k=[0.5])["h"].item())

    def rate(t, h):
        return 0.5 + 0.5 * np.sin(t) - 0.5 * np.sqrt(np.maximum(h, 0.0))

    exact = solve_ivp(rate, (0.0, 60.0 * np.pi), [0.0], method="DOP853", rtol=1e-11, atol=1e-13, max_step=0.1)
    assert ours == pytest.approx(exact.y[0, -1], abs=1e-8)  # the attracting cycle, whatever the first steps left


def hyperchaotic_roessler(a=0.25):
    """Phys. Lett. A 71 (1979) 155."""

    def rhs(y, t):
        x, y_, z, w = y
        return -y_ - z, x + a * y_ + w, 3.0 + x * z, -0.5 * z + 0.05 * w

    return {"rhs": rhs, "coordinates": ("x", "y", "z", "w")}


def test_steps_follow_what_is_violent_after_many_returns():
    """x falls to −130 in rare turns: the steps of the first returns lose every lane there, which the truth does not.

    The last lane goes to infinity, by LSODA at t = 174, and is marked.
    """
    start = {"x": -20.0, "y": 0.0, "z": 0.0, "w": 15.0}
    session = jaxnh.Session(hyperchaotic_roessler, start=start, target=1e-6).on("y", 0.0, "up")
    a = np.array([0.24, 0.25, 0.255, 0.26])
    with mock.patch("jaxnh.engine.accuracy.calibration.are_lost_by", side_effect=[True, False]) as rehearsals:
        found = session.run("diagram", jaxnh.Diagram(transient=1, strobes=40), a=a)
    first, again = (call.args[3] for call in rehearsals.call_args_list)  # as steps that lose a lane in a rehearsal
    assert again == 2 * first
    assert list(found["status"].to_numpy()) == [0, 0, 0, NOT_FINITE]
    with mock.patch("jaxnh.engine.accuracy.calibration.are_lost_by", return_value=False) as rehearsals:
        session.run("diagram", jaxnh.Diagram(transient=1, strobes=20), a=a)
        rehearsals.assert_not_called()
        session.run("diagram", jaxnh.Diagram(transient=61, strobes=40), a=a)
    assert [call.args[4] for call in rehearsals.call_args_list] == [100]  # longer than what was tried before
    for lane, value in enumerate(a[:3]):
        truth = solve_ivp(
            lambda t, y, value=value: hyperchaotic_roessler(value)["rhs"](y, t),
            (0.0, 40.0),
            list(start.values()),
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
            events=_rising,
        )
        exact = [y for t, y in zip(truth.t_events[0], truth.y_events[0], strict=True) if t > 0.0][:3]
        ours = np.stack([found[name].to_numpy()[lane, :3] for name in "xzw"], axis=-1)
        np.testing.assert_allclose(ours, np.array(exact)[:, [0, 2, 3]], atol=1e-3)


@pytest.mark.slow  # that steps are doubled is quick
def test_steps_lose_no_lane_in_long_runs():
    """Of these starts LSODA has none that goes to infinity within 4,000 units; x falls to −350 in some."""
    start = {"x": -20.0, "y": 0.0, "z": 0.0, "w": 15.0}
    session = jaxnh.Session(hyperchaotic_roessler, start=start, target=1e-6)
    found = session.run(
        "lyapunov", jaxnh.Lyapunov(transient=256, periods=4096, exponents=1), a=np.linspace(0.24, 0.255, 16)
    )
    assert not found["status"].to_numpy().any()


@pytest.mark.usefixtures("quick_compiling_once")
def test_what_is_not_violent_has_no_rehearsal():
    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-4).on("z", 27.0, "up")
    with mock.patch("jaxnh.engine.accuracy.calibration.are_lost_by") as rehearsal:
        session.run("diagram", jaxnh.Diagram(transient=1, strobes=1), rho=[28.0])
    rehearsal.assert_not_called()


def _rising(t, y):
    return y[1]


_rising.direction = 1.0


@pytest.mark.slow  # the matrix has basins of random starts
@pytest.mark.parametrize("analysis", ["diagram", "basins"])
def test_random_starts_are_among_the_samples(analysis):
    """Far beyond the start of the lanes, where their own steps are far too few.

    One in 10,000 of the first 170 periods may miss the target: of the first periods alone, the worst, 1.7 in 100 at
    most. Of 500 that is 8.5, and 16 or more have a probability of 1.4 %.
    """
    box, b, target = 3.0, 5.475, 1e-6
    options = {"start": "random", "n_starts": 8, "box": box, "transient": 0, "strobes": 1}
    if analysis == "basins":
        options = {"n_starts": 8, "transient": 32, "box": {"x1": [-box, box], "y1": [-box, box]}}
    content = {"system": {"constraint": "constant_speed"}, "accuracy": {"target": target}, "analyses": {"poincare": {}}}
    session = session_of(Experiment.from_dict({**content, "sweep": {"b": {"start": b, "stop": b + 0.01, "count": 64}}}))
    still = session.plan
    variant = session.experiment.variant({analysis: options}, {})
    drawn = session._plan_for(variant, variant.axes)
    longer = session.experiment.variant({analysis: {**options, "transient": 64}}, {})  # the same starts
    with mock.patch("jaxnh.engine.plan.calibrate", side_effect=AssertionError):
        assert session._plan_for(longer, variant.axes) == drawn
    assert session.plan == still

    u = np.random.default_rng(5).uniform([-box, -box, -np.pi], [box, box, np.pi], (500, 3))
    if analysis == "basins":
        u[:, 2] = math.acos(0.1)  # x2 is no side of the box
    exact = taylor.strobe(twin(SYSTEMS["constant"]), b, u.astype(taylor.REAL))
    image = jax.vmap(section_map, (None, None, 0, None))
    maps = (make_return_map(SYSTEMS["constant"], plan.solver, plan.steps) for plan in (drawn, still))
    missing = [np.sum(largest_difference(image(strobe, 1, u, {"b": b}), exact) > target) for strobe in maps]
    assert missing[0] < 16
    assert missing[1] > 100


@pytest.mark.parametrize(("starts", "tile"), [(3, 8), (100, 32), (1000, 256)])
def test_tiles_are_for_all_samples(starts, tile):
    """A single lane of a sweep has random starts, of which each is a sample."""
    analyses = {"basins": {"n_starts": starts, "transient": 32, "box": {"x1": [-1.0, 1.0]}}}
    content = {"system": {"constraint": "constant_speed"}, "sweep": {"b": {"values": [5.0]}}, "analyses": analyses}
    experiment = Experiment.from_dict(content)
    with mock.patch("jaxnh.engine.plan.Calibration") as made:
        made.return_value.passes_jumps = False
        calibrate(experiment, experiment.axes, LaneExecutor(devices=jax.devices()[:1]))
    assert made.call_args.args[1].tile == tile


def test_parts_of_a_unit_end_where_errors_are_infinite():
    """Of motions that leave a saddle for infinity the floor with steps of a lane's own is, and no part of it is less."""
    calibration = Calibration.__new__(Calibration)
    calibration._precision, calibration._target, calibration.floor = "float64", 1e-6, np.inf
    calibration._maps = calibration._reference = calibration._samples = calibration._sizes = mock.Mock()
    with (
        mock.patch("jaxnh.engine.accuracy.calibration.has_own_steps", return_value=True),
        mock.patch.object(Calibration, "_measure"),
        mock.patch.object(Calibration, "_split_unit", side_effect=[False]) as split,
    ):
        assert calibration._take_own_steps(mock.Mock())
    assert split.call_count == 1
