"""Pieces of a sweep: every analysis has the same bits whatever it is cut into."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from jaxnh.analyses.registry import ANALYSES
from jaxnh.engine import compute as pieces
from jaxnh.engine import plan as work
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.jobs.cutting import Piece
from tests.helpers.cases import some_slow
from tests.helpers.kept_programs import lanes_with_kept_programs

pytestmark = pytest.mark.usefixtures("uncalibrated")
COUNT = 600
HEAD = f"""\
system: {{constraint: disturbed_speed, d: 0.1}}
sweep: {{b: {{start: 5.2, stop: 5.45, count: {COUNT}}}}}
accuracy: {{solver: blanes_moan6, steps: 40}}
analyses:
"""
# With the system, solver, steps and criteria of test_two_axes and test_session, whose programs these are as well.
# Each with few periods, but enough for chaos to show a bit that differs; `verdict` brings the criteria it needs.
OPTIONS = {
    "verdict": "{}\n  lyapunov: {transient: 8, periods: 16, exponents: 1}\n  period: {max_period: 4, transient: 16}\n  chaos01: {transient: 4, periods: 100}",
    "lyapunov": "{transient: 8, periods: 32, error: 0.05, exponents: 2}",
    "diagram": "{transient: 30, strobes: 3, start: random, n_starts: 3, seed: 5, phase: 0.25}",
    "poincare": "{transient: 30, strobes: 4}",
    "portrait": "{transient: 30, periods: 1, samples: 4}",
}


def decided(text, lanes, tile):
    """An experiment and the job of its sweep."""
    experiment = Experiment.from_text(text)
    return experiment, work.decide(experiment, lanes, tile)


def compute(experiment, job, batch, lanes):
    return pieces.compute(experiment, experiment.axes, experiment.requested(), job, batch, lanes, no_tiles)


def no_tiles(name):
    raise AssertionError(name)


@pytest.fixture(scope="module")
def runners():
    return {1: LaneExecutor(devices=jax.devices("cpu")[:1]), 2: lanes_with_kept_programs()}


@pytest.mark.parametrize("name", some_slow({name: name for name in OPTIONS}, "diagram"))
def test_pieces_are_rows_of_the_whole(runners, name):
    """Odd pieces on one device against all lanes at once on two: every variable over b, and every other one.

    All criteria together are compiled for two devices alone, which takes long enough; the next test cuts them too.
    """
    experiment, job = decided(f"{HEAD}  {name}: {OPTIONS[name]}\n", runners[2], 1 << 20)
    [whole] = compute(experiment, job, job.cutting.pieces(), runners[2])
    assert set(whole.groups) == set(job.cutting.independent)
    for first, end in ((0, 1), (37, 300), (COUNT - 2, COUNT)):
        runner = runners[2 if name == "verdict" else 1]
        [done] = compute(experiment, job, [Piece(0, job.cutting.independent, (first,), (end,))], runner)
        for key, group in done.groups.items():
            assert set(group.variables) == set(whole.groups[key].variables)
            for variable_name, item in group.variables.items():
                expected = whole.groups[key].variables[variable_name]
                rows = expected.values[first:end] if expected.dims[0] == "b" else expected.values
                assert item.values.tobytes() == np.ascontiguousarray(rows).tobytes(), (key, variable_name)
                assert item.dims == expected.dims


def test_pieces_computed_together_are_those_computed_alone(runners):
    """Neighbouring tiles as one call, cut afterwards; what is counted is counted in each."""
    experiment, job = decided(
        f"{HEAD}  poincare: {{transient: 4, strobes: 2}}\n  verdict: {OPTIONS['verdict']}\n", runners[2], 20
    )
    neighbours = job.cutting.pieces()[1:4]
    together = compute(experiment, job, neighbours, runners[2])
    for piece, one in zip(neighbours, together, strict=True):
        [alone] = compute(experiment, job, [piece], runners[2])
        assert one.counts == alone.counts
        assert one.counts["poincare"] == {"trajectories": 20, "failed": 0}
        for key, group in alone.groups.items():
            for name, item in group.variables.items():
                np.testing.assert_array_equal(one.groups[key].variables[name].values, item.values)
    assert sum(one.spent.lane_periods for one in together) > 60 * 100


def test_every_analysis_says_whether_its_lanes_are_independent():
    """What carries something from lane to lane is run along the whole first axis."""
    whole = {name for name, a in ANALYSES.items() if not a.independent(a.options())}
    assert whole == {"doubling", "windows", "tori"}
    for start, independent in (("fixed", True), ("random", True), ("up", False), ("down", False)):
        options = ANALYSES["diagram"].options(start=start)
        assert ANALYSES["diagram"].independent(options) == independent
