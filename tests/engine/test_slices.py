"""Lanes of a sweep in slices side by side on the cores: what each lane has is what it has alone."""

from __future__ import annotations

import threading
from unittest import mock

import jax
import numpy as np
import pytest
import xarray as xr

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.threads import run_slices
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.journal import with_journal
from jaxnh.engine.progress import NullProgress
from jaxnh.engine.session import Session
from jaxnh.exceptions import Stopped
from jaxnh.storage.calls import CallJournal
from tests.helpers.kept_programs import lanes_with_kept_programs
from tests.helpers.storage_jobs import job

SWEEPS = {
    "of own values": ("disturbed_speed, d: 0.1", "b: {start: 5.2, stop: 5.6, count: 45}"),
    "of values that lanes share": (
        "disturbed_speed",
        "d: {values: [0.05, 0.1, 0.15]}, b: {start: 5.2, stop: 5.6, count: 15}",
    ),
}
CONFIG = """\
system: {constraint: %s}
sweep: {%s}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  lyapunov: {transient: 16, periods: 32, exponents: 1}
  period: {transient: 16, max_period: 4}
"""


@pytest.mark.parametrize("sweep", SWEEPS.values(), ids=SWEEPS)
def test_results_are_those_of_one_core(sweep):
    """Chaotic lanes and periodic ones, in their order, to the bit."""
    trees = []
    for cores in (1, 2):
        session = Session(Experiment.from_text(CONFIG % sweep))
        session._lanes = lanes_with_kept_programs(devices=jax.devices("cpu")[:cores])
        trees.append(session.tree())
    assert trees[1]["lyapunov"].dataset["status"].size == 45
    for name in ("lyapunov", "period"):
        xr.testing.assert_identical(*(tree[name].dataset for tree in trees))


class Counter(NullProgress):
    """Progress that adds up what it is told."""

    def __init__(self, most=np.inf):
        self.done, self.stages, self.most = 0.0, [], most

    def start(self, label, total):
        self.stages.append((label, total))

    def advance(self, amount):
        self.done += amount
        if self.done > self.most:
            raise Stopped("enough")


def _square(x):
    return x * x


def halves(count):
    return [np.arange(0.0, count, 2), np.arange(1.0, count, 2)]


def test_slices_are_one_stage():
    """With the lane-periods of all of them; programs and accounts are those of the executor that is split."""
    told = Counter()
    lanes = LaneExecutor(told, jax.devices("cpu")[:2], tile=4)

    def squares(x, one):
        assert len(one.devices) == 1
        with one.stage("of a slice", 0):
            return one(_square, (), (x,), periods=3)

    even, odd = run_slices(lanes, halves(24), ("all", 72), squares)
    np.testing.assert_array_equal(even, np.arange(0.0, 24, 2) ** 2)
    np.testing.assert_array_equal(odd, np.arange(1.0, 24, 2) ** 2)
    assert told.stages == [("all", 72)]
    assert told.done == lanes.accounts.lane_periods == 72
    assert len(lanes.programs) == 1


def test_what_fails_in_one_slice_ends_the_others():
    """And is what is told of; the stage is over."""
    told, ended = Counter(), threading.Event()
    lanes = LaneExecutor(told, jax.devices("cpu")[:2], tile=4)

    def work(k, one):
        if k:
            raise ZeroDivisionError("a lane of this slice")
        try:
            for _ in range(100_000):
                one(_square, (), (np.ones(4),), periods=1)
        except Exception:
            ended.set()
            raise

    with pytest.raises(ZeroDivisionError, match="a lane of this slice"):
        run_slices(lanes, (0, 1), ("all", 0), work)
    assert ended.is_set()


def test_slices_that_are_stopped_go_on_where_they_were(tmp_path):
    """Calls of each slice have numbers of their own in a journal, whichever thread was faster."""
    pieces = job().cutting.pieces()

    def sums(x, one):
        return [one(_square, (), (x + k,), periods=1) for k in range(6)]

    def run(progress):
        lanes, journal = LaneExecutor(progress, jax.devices("cpu")[:2], tile=4), CallJournal(tmp_path, job(), pieces)
        with with_journal(lanes, journal) as keeping:
            return run_slices(keeping, halves(16), ("all", 0), sums), journal

    with pytest.MonkeyPatch.context() as always:
        always.setattr("jaxnh.engine.journal._WORTH_KEEPING", 0.0)
        with pytest.raises(Stopped):
            run(Counter(50.0))
        with mock.patch.object(CallJournal, "add", autospec=True) as add:
            found, kept = run(told := Counter())
    assert add.call_count <= 24 - 13  # tiles that are computed again, of all
    for sums_found, x in zip(found, halves(16), strict=True):
        np.testing.assert_array_equal(sums_found, [(x + k) ** 2 for k in range(6)])
    assert told.done == 96
    assert kept.seconds > 0.0
    kept.close(remove=True)
    assert list(tmp_path.iterdir()) == []
