"""Lanes of a sweep in slices side by side on the cores: what each lane has is what it has alone."""

from __future__ import annotations

import threading
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.threads import run_slices
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.journal import with_journal
from jaxnh.engine.progress import NullProgress
from jaxnh.engine.session import Session
from jaxnh.exceptions import Stopped
from jaxnh.storage.calls import CallJournal
from tests.helpers.kept_programs import QUICKLY_COMPILED, lanes_with_kept_programs
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


def rotor(K=6.0, g=0.9):
    """A damped rotor that is kicked once a period, seen half way between kicks."""

    def image(y):
        angle, rate = y
        left = jnp.exp(-0.5 * g)
        angle, rate = angle + rate * (1.0 - left) / g, rate * left - K * jnp.sin(angle + rate * (1.0 - left) / g)
        return angle + rate * (1.0 - left) / g, rate * left

    return {"map": image, "coordinates": ("angle", "rate"), "angles": ("angle",)}


BOX = {"angle": (-1.0, 1.0), "rate": (-1.0, 1.0)}
OF_LANES = {
    "lyapunov": jaxnh.Lyapunov(transient=32, periods=64),
    "period": jaxnh.Period(transient=64, max_period=4, sensitivities=True),
    "diagram": jaxnh.Diagram(transient=16, strobes=4, start="random", n_starts=3),
    "chaos01": jaxnh.Chaos01(transient=64, periods=100),
    "rotation": jaxnh.Rotation(transient=64, periods=128),
    "covariant": jaxnh.Covariant(transient=64, strobes=256),
    "transport": jaxnh.Transport(transient=64, periods=256, path=("angle",)),
    "basins": jaxnh.Basins(transient=32, max_periods=128, max_period=2, n_starts=8, box=BOX),
    "transients": jaxnh.Transients(n_starts=16, box=BOX, max_periods=16, transient=1),
    "tori": jaxnh.Tori(transient=64, periods=128),
    "orbits": jaxnh.Orbits(max_period=2, transient=64, rounds=4),
    "verdict": jaxnh.Verdict(confirmation_factor=0),
}


@pytest.mark.parametrize("name", OF_LANES)
def test_every_analysis_of_lanes_is_that_of_one_core(name):
    """Nine lanes are two tiles, of which each core has one: periodic lanes, chaotic ones, and equal pairs of orbits."""
    groups = []
    for cores in (1, 2):
        session = jaxnh.Session(rotor, start={"angle": 0.3, "rate": 0.4})
        session._lanes = lanes_with_kept_programs(devices=jax.devices("cpu")[:cores], programs=QUICKLY_COMPILED)
        groups.append(session.groups({name: OF_LANES[name]}, K=np.linspace(3.0, 7.0, 9)))
    assert groups[0].keys() == groups[1].keys()
    for group in groups[0]:
        xr.testing.assert_identical(groups[0][group], groups[1][group])


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
