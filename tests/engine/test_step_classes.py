"""Steps of lanes of their own: a sweep with few fast lanes takes the mean of their steps, and no lane errs more."""

from __future__ import annotations

from unittest import mock

import heyoka as hy
import jax
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxnh.engine import plan as planning
from jaxnh.engine.accuracy import cost_model
from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.accuracy.step_classes import ClassSearch, classes_of, push_tangent, steps_of, text_of
from jaxnh.engine.axes import points
from jaxnh.engine.compute import batch_of, compute
from jaxnh.engine.executor.tiles import inner_trip_count
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.progress import NullProgress
from jaxnh.engine.run import run_to_file
from jaxnh.engine.run_records import RunOptions
from jaxnh.exceptions import Stopped
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SOLVERS
from jaxnh.storage import tiles
from jaxnh.storage.hdf5 import read_attrs
from tests.helpers.cases import some_slow
from tests.helpers.jobs import content
from tests.helpers.kept_programs import lanes_with_kept_programs

pytestmark = pytest.mark.usefixtures("calibrate_once")

TARGET, LANES, FAST = 1e-6, 100, 1
# Van der Pol's oscillator, `rate` times as fast, with a clock, in time alone and on a section.
SOURCE = """
import jax.numpy as jnp


def system(rate=1.0, push=0.0):
    def rhs(y, t):
        x, v = y
        return rate * v, rate * ((1 - x * x) * v - x + push * %s)

    return {"rhs": rhs, "coordinates": ("x", "v"), %s}
"""
CLOCK, NO_CLOCK = ("jnp.cos(2 * jnp.pi * t)", '"period": 1.0'), ("0.0", '"time_unit": 1.0')
KINDS = {
    "clock": (CLOCK, "{}"),
    "time": (NO_CLOCK, "{}"),
    "section": (NO_CLOCK, "{coordinate: x, value: 0.0, direction: up}"),
}
TEXT = """\
system: {{file: oscillator.py, push: 0.3}}
sweep: {{rate: {{values: {rates}}}}}
initial: {{x: 1.0, v: 0.0}}
accuracy: {{target: {target}}}
{section}
analyses: {{{analysis}}}
"""
POINCARE = "poincare: {transient: 40, strobes: 2}"
EXPONENT = "lyapunov: {transient: 8, periods: 32, exponents: 1, method: averages}"


def rates(count=LANES, fast=FAST, factor=100.0):
    """One lane in a hundred a hundred times as fast."""
    spread = 1.0 + 0.25 * np.linspace(0.0, 1.0, count)
    spread[np.linspace(count // 3, count - 1, fast).astype(int)] *= factor
    return spread


def experiment_of(kind="clock", values=None, analysis=None):
    formulas, section = KINDS[kind]
    values = rates() if values is None else values
    section = f"section: {section}" if section != "{}" else ""
    analysis = analysis or (EXPONENT if kind == "time" else POINCARE)
    text = TEXT.format(rates=values.tolist(), target=TARGET, section=section, analysis=analysis)
    return Experiment.from_text(text, SOURCE % formulas)


def planned(experiment, lanes):
    """The plan with common steps, and with those of lanes of their own."""
    common = planning.find_plan(experiment, experiment.axes, lanes, experiment.requested())
    return common, planning.with_step_classes(experiment, experiment.axes, common, experiment.requested(), lanes)


@pytest.fixture
def any_size(monkeypatch):
    """However short a run is, lanes are looked at."""
    monkeypatch.setattr(cost_model, "_WORTH_CLASSES", 0.0)


@pytest.fixture(scope="module")
def lanes():
    return lanes_with_kept_programs(None, jax.devices()[:1])


class CountingTiles:
    """Counts the steps of all lanes of all tiles, those that fill up tiles too."""

    def __init__(self, tiles):
        self.tiles, self.lane_steps = tiles, 0.0

    def run(self, call, first=0):
        filled = -(-len(jax.tree.leaves(call.lanes)[0]) // call.tile) * call.tile
        self.lane_steps += filled * sum(link.periods * inner_trip_count(link.shared) for link in call.links)
        return self.tiles.run(call, first)


# ---- classes as text


@given(arrays(np.int64, st.integers(1, 60), elements=st.integers(0, 12)))
def test_text_keeps_every_class(classes):
    text = text_of(classes)
    np.testing.assert_array_equal(classes_of(text) if text else np.zeros(len(classes), int), classes)


def test_neighbours_share_the_finest_class_where_the_text_is_too_long():
    """A file has room for 64 kB in an attribute."""
    classes = np.random.default_rng(1).integers(0, 3, 100_003)
    text = text_of(classes)
    assert len(text) < 1 << 16
    shared = classes_of(text)
    assert len(shared) == len(classes)
    assert np.all(shared <= classes)


# ---- plans


def test_one_lane_has_no_others_to_take_fewer_steps_than(any_size):
    """A sweep of one lane is not looked at: nothing could come of it, and a program would be compiled for it."""
    for values, why in (([1.0], "there is one lane"), ([1.0, 2.0], "")):
        experiment = experiment_of("time", np.array(values))
        plan = Plan(SOLVERS["verner9"], 64, False, TARGET)
        assert planning.why_common_steps(experiment, experiment.axes, plan, experiment.requested()) == why


def heyoka_periods(kind, values, states, times):
    """States (lanes, 2) so long a time after their own, by heyoka's Taylor series."""
    x, v, drive = *hy.make_vars("x", "v"), 0.3 * hy.cos(2 * np.pi * hy.time) if kind == "clock" else 0.0
    rate = hy.par[0]
    equations = [(x, rate * v), (v, rate * ((1.0 - x * x) * v - x + drive))]
    integrator = hy.taylor_adaptive(equations, [0.0, 0.0], pars=[1.0], tol=1e-18)
    ends = []
    for value, state, time in zip(values, states, times, strict=True):
        integrator.pars[0], integrator.time, integrator.state[:] = value, 0.0, state
        integrator.propagate_until(time)
        ends.append(integrator.state.copy())
    return np.array(ends)


def errors_of(kind, experiment, plan, lanes, numbers):
    """Errors of P on lanes after 0, 7 and 60 periods, in units of the sizes, by heyoka."""
    axes, classes = experiment.axes, classes_of(plan.step_classes)
    worst = []
    for number in numbers:
        at = points(experiment, axes, (np.array([number]),))
        own = plan._replace(steps=steps_of(plan.steps, int(classes[number])))
        batch = batch_of(at, own, experiment)
        strobe, state = batch.strobe(), batch.start
        for periods in (0, 7, 53):
            state = lanes.iterate(strobe, periods, (state, dict(at.p)))
            after = lanes.iterate(strobe, 1, (state, dict(at.p)))
            begun, ended = ((y.state if kind == "section" else y).y for y in (state, after))
            time = after.t - state.t if kind == "section" else np.ones(1)
            values = at.p["rate"]
            exact = heyoka_periods(kind, values, np.array(begun).T, time).T
            x, v = exact
            if kind == "section":  # from the state at our time onto the section
                late = -x / (values * v)
                got = np.array([ended[1] - (v + values * (1 - x * x) * v * late), late])
                sizes = np.array([plan.sizes["v"], plan.sizes["t"]])
            else:
                got, sizes = np.array(ended) - exact, np.array([plan.sizes["x"], plan.sizes["v"]])
            worst.append(float(np.max(np.abs(got) / sizes[:, None])))
    return np.array(worst)


@pytest.mark.usefixtures("any_size")
@pytest.mark.parametrize("kind", some_slow({kind: kind for kind in KINDS}, "clock"))
def test_a_wide_sweep_takes_the_mean_of_the_steps_within_the_target(kind, lanes):
    """Fast lanes keep the common steps, so that nothing of theirs changes; slow ones take at most a sixteenth of them.

    No slow lane errs by more than the target: of 16 lanes with 3 periods each none may, where one in 10,000 does.
    """
    experiment, values = experiment_of(kind), rates()
    common, plan = planned(experiment, lanes)
    classes = classes_of(plan.step_classes)
    fast = values > 10.0
    assert np.all(classes[fast] == 0)
    assert np.all(classes[~fast] >= 4)
    assert plan._replace(step_classes="") == common
    numbers = np.random.default_rng(3).choice(np.flatnonzero(~fast), 16, replace=False)
    assert np.max(errors_of(kind, experiment, plan, lanes, numbers)) <= TARGET


def test_lanes_of_a_short_run_are_not_looked_at(lanes):
    """Nothing is integrated, and the plan is the very same."""
    experiment = experiment_of()
    common = planning.find_plan(experiment, experiment.axes, lanes, experiment.requested())
    before = lanes.accounts.lane_periods
    plan = planning.with_step_classes(experiment, experiment.axes, common, experiment.requested(), lanes)
    assert plan is common
    assert lanes.accounts.lane_periods == before


@pytest.mark.usefixtures("any_size")
def test_lanes_that_are_alike_keep_the_common_steps(lanes):
    """Of a sweep over a quarter of the speed the plan, and so the job and its bits, is what it is without a look."""
    experiment = experiment_of(values=np.linspace(1.0, 1.25, LANES))
    common, plan = planned(experiment, lanes)
    assert plan == common


def test_lanes_at_rest_have_accurate_tangents(lanes):
    """At rest a state says nothing of steps; the derivative of a unit of time is that of exp(J), J = rate (0 1; −1 1)."""
    experiment, values = experiment_of("time"), np.array([4.0, 12.0])
    solver = SOLVERS["tsitouras_papakostas8"]
    at = points(experiment, experiment.axes, (np.arange(2),))
    start = jax.tree.map(np.zeros_like, at.start)
    plan = Plan(solver, 256, False, TARGET, {"x": 1.0, "v": 1.0})
    search = ClassSearch(at._replace(start=start, p={"rate": values}), plan, TARGET, lanes)
    assert np.all(search.classes(tangents=False) == search.coarsest)
    classes = search.classes()
    assert np.all((classes > 0) & (classes < search.coarsest))
    for number, halvings in enumerate(classes.tolist()):
        strobe = make_return_map(at.system, solver, steps_of(plan.steps, halvings))
        state = jax.tree.map(lambda leaf: leaf[0], start)
        image = push_tangent(strobe, state, {"rate": values[number]})
        exact = scipy.linalg.expm(values[number] * np.array([[0.0, 1.0], [-1.0, 1.0]])) @ np.ones(2)
        assert np.linalg.norm(image - exact) <= TARGET * np.linalg.norm(exact)


# ---- runs


def no_tiles(name):
    raise AssertionError(name)


def computed(experiment, plan, lanes, pieces=None):
    """The Poincaré map of a sweep by a plan, its lanes in order."""
    job = planning.job_of(experiment, experiment.axes, plan, {}, experiment.requested(), {}, LANES)
    [whole] = job.cutting.pieces()
    ends = pieces or [(0, LANES)]
    parts = [whole._replace(begin=(first,), end=(end,)) for first, end in ends]
    done = [
        compute(experiment, experiment.axes, experiment.requested(), job, [part], lanes, no_tiles)[0] for part in parts
    ]
    return np.concatenate([part.groups["poincare"]["x"].values for part in done])


@pytest.mark.usefixtures("any_size")
def test_steps_that_are_taken_are_the_mean_and_bits_those_of_a_lane_alone(lanes):
    """Counted with those that fill up tiles; in pieces of any size every lane has the same bits."""
    experiment = experiment_of()
    common, plan = planned(experiment, lanes)
    counting = []

    def count(tiles):
        counting.append(CountingTiles(tiles))
        return counting[-1]

    whole = computed(experiment, plan, lanes.through(count))
    taken = sum(tiles.lane_steps for tiles in counting) / (LANES * 42)
    mean = np.mean([steps_of(plan.steps, k) for k in classes_of(plan.step_classes).tolist()])
    assert mean < common.steps / 10.0
    assert taken < 8.0 * mean  # the fast lane fills a tile of 8, and the slow ones four of 32
    np.testing.assert_array_equal(computed(experiment, plan, lanes, [(0, 1), (1, 40), (40, LANES)]), whole)
    fast = rates() > 10.0
    np.testing.assert_allclose(whole[fast], computed(experiment, common, lanes)[fast], atol=1e-12)


# ---- files


TWO_AXES = """\
system: {file: oscillator.py, push: 0.3}
sweep:
  rate: {values: [1.0, 1.1, 60.0, 1.2, 1.3, 1.4, 1.15, 1.25]}
  x: {values: [0.5, 1.0, 1.5, 2.0]}
initial: {v: 0.0}
accuracy: {target: 1.0e-6}
analyses:
  poincare: {transient: 40, strobes: 2}
  lyapunov: {transient: 8, periods: 32, exponents: 1, method: averages}
"""
SWEEPS = {
    "clock": lambda: experiment_of("clock", analysis=f"{POINCARE}, {EXPONENT}"),
    "time": lambda: experiment_of("time"),
    "section": lambda: experiment_of("section"),
    "two axes": lambda: Experiment.from_text(TWO_AXES, SOURCE % CLOCK),
}


def content_of_run(experiment, path, check=lambda: None, **how):
    with mock.patch("jaxnh.engine.run.LaneExecutor", lanes_with_kept_programs):
        run_to_file(experiment, path, RunOptions(tile=16, **how), NullProgress(), check)
    return {name: item for name, item in content(path).items() if name != "/"} if path.exists() else {}


@pytest.mark.usefixtures("any_size")
@pytest.mark.slow  # the bits of a lane alone are quick
@pytest.mark.parametrize("kind", SWEEPS)
def test_files_are_the_same_in_parts_and_resumed(kind, tmp_path):
    """Whatever runs are cut into, each lane keeps its class and its bits."""
    experiment = SWEEPS[kind]()
    path = tmp_path / "whole.h5"
    whole = content_of_run(experiment, path)
    classes = classes_of(read_attrs(path)["step_classes"])
    assert len(classes) == np.prod([len(axis.values) for axis in experiment.axes])
    assert classes.max() >= 3
    for k in (2, 1):
        assert not content_of_run(experiment, tmp_path / "parts.h5", part=(k, 2))
    assert content_of_run(experiment, tmp_path / "parts.h5", merge=True) == whole

    def stop():
        if len(list(tiles.folder_of(tmp_path / "stopped.h5").glob("0*.h5"))) >= 1:
            raise Stopped("stopped")

    with pytest.raises(Stopped):
        content_of_run(experiment, tmp_path / "stopped.h5", stop)
    assert content_of_run(experiment, tmp_path / "stopped.h5") == whole
