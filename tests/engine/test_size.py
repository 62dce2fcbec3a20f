"""A sweep that is larger than is run unasked: one line that says how large it is and how long it would take."""

from __future__ import annotations

import re

import pytest

import jaxnh
from jaxnh.engine import plan as work
from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import ConfigError
from jaxnh.solvers import SOLVERS
from tests.helpers.commands import run_here

pytestmark = pytest.mark.usefixtures("uncalibrated")
CONFIG = """\
system: {constraint: constant_speed}
sweep:
  b: {start: 5.2, stop: 5.6, count: 31623}
  a: {start: 0.4, stop: 0.6, count: 31623}
accuracy: {solver: blanes_moan6, steps: 20}
analyses: {lyapunov: {transient: 128, periods: 256, exponents: 1}}
"""
SIZE = "31,623 x 31,623 are 1,000,014,129 lanes, 8 GB a variable, and about 9.0e11 lane-periods, "


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(CONFIG)
    return path


def test_a_billion_lanes(config, monkeypatch):
    """128 + 256 (1 + 2) lane-periods of each, 900 with the transient; nothing else is done before it is said."""
    monkeypatch.setattr(work, "choose", None)
    done = run_here(config.name, cwd=config.parent)
    assert done.returncode == 2
    line = done.stderr.splitlines()[-1]
    assert re.fullmatch(rf"a\.yaml:2: sweep: {re.escape(SIZE)}[\d.,]+ \w+ on this machine; --yes goes on", line)
    assert {path.name for path in config.parent.rglob("*")} == {"a.yaml", "results"}


def test_what_is_asked(config):
    """A day is the longest that is run unasked: 81 million lane-periods of 10 stages of 20 steps at 6 us each."""
    lanes = LaneExecutor()
    plan = Plan(SOLVERS["blanes_moan6"], 20, False, 1e-3)

    def check(*overrides):
        experiment = jaxnh.load(config, overrides)
        work.check_size(experiment, experiment.axes, plan, experiment.requested(), lanes)

    small = ["sweep.b.count=300", "sweep.a.count=300"]
    check(*small)  # where no call has told how fast the machine is
    turns = 10 * 20
    lanes.accounts.fastest = 0.9 * 86400 / (90_000 * 900 * turns)
    check(*small)
    lanes.accounts.fastest *= 10
    with pytest.raises(ConfigError) as caught:
        check(*small)
    size = "300 x 300 are 90,000 lanes, and about 8.1e7 lane-periods, 9 days on this machine; --yes goes on"
    assert str(caught.value) == f"command line: sweep.b.count: {size}"


def test_too_many_for_memory():
    experiment = Experiment.from_text(CONFIG)
    with pytest.raises(ConfigError) as caught:
        jaxnh.run(experiment)
    message = "1,000,014,129 lanes, and 10,000,000 is the most in memory; a run with an output may have more"
    assert str(caught.value) == f"experiment:2: sweep: 31,623 x 31,623 are {message}"


def test_axis_given_twice(config):
    config.write_text(CONFIG.replace("  a: {", "  b: {"))
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(config)
    assert str(caught.value) == f"{config}:4: sweep.b: this key is already given on line 3; each key stands once"
