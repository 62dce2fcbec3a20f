"""Runs that are stopped in the midst of a piece: what they have computed of it is not computed again."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
from unittest import mock

import jax
import numpy as np
import pytest

from jaxnh.analyses.batch import Link
from jaxnh.engine import journal
from jaxnh.engine.executor import lanes as engine
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.journal import with_journal
from jaxnh.exceptions import Stopped
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import SOLVERS
from jaxnh.storage.calls import CallJournal
from tests.flows.particle import SYSTEMS
from tests.helpers.comparisons import same_leaves
from tests.helpers.jobs import CONFIG, GO_ON, Job, content
from tests.helpers.paths import ROOT
from tests.helpers.storage_jobs import job

CARRIED = """\
system: {constraint: constant_speed}
sweep: {b: {start: 5.2, stop: 5.45, count: 200}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  diagram: {transient: 30, strobes: 3, start: up}
"""
DOUBLING = """\
system: {constraint: constant_speed}
sweep: {b: {start: 5.54, stop: 5.51, count: 32}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  doubling: {levels: 1}
"""
MANIFOLDS = """\
system: {constraint: constant_speed}
sweep: {b: {values: [5.2, 5.3]}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  manifolds: {box: {x1: [-1.0, 1.0], y1: [-1.0, 1.0]}, n_starts: 8, length: 4.0, kind: unstable}
"""
SURFACES = f"""\
system: {{file: {ROOT}/configs/flows/lorenz.py}}
initial: {{x: 1.0, y: 1.0, z: 20.0}}
sweep: {{rho: {{values: [13.926557, 28.0]}}}}
accuracy: {{solver: tsit5, steps: 64}}
analyses:
  manifolds: {{dimension: 2, kind: stable, box: {{x: [-20, 20], y: [-20, 20], z: [-20, 20]}}, length: 2.0, max_points: 2048}}
"""
COVARIANT, ROTATION = (
    MANIFOLDS[: MANIFOLDS.index("  manifolds")] + text
    for text in ("  covariant: {transient: 64, strobes: 256}\n", "  rotation: {transient: 64, periods: 256}\n")
)
# Every call is written; at the end of one of them, some numbers of which are given, the process does this to itself.
HEAD = """
import os, time
import jaxnh.engine.journal as journal
import jaxnh.storage.calls as storage
journal._WORTH_KEEPING = 0.0
storage._OFTEN, storage._BYTES = 0.0, 1 << 60
add, number = storage.CallJournal.add, iter(range(10**6))
def added(self, part):
    add(self, part)
    if next(number) == {at}:
        os.kill(os.getpid(), {signal})
        time.sleep({wait})
storage.CallJournal.add = added
"""


@pytest.fixture(autouse=True)
def every_call_is_kept(monkeypatch):
    """However little time it takes, as all calls of these small jobs do."""
    monkeypatch.setattr(journal, "_WORTH_KEEPING", 0.0)


def calls_of(batch, *arguments):
    """Run to the end in this process: the programs' calls that were made for pieces."""
    calls = []  # threads add side by side, and a mock loses counts among them
    with mock.patch.object(CallJournal, "add", lambda journal, part: calls.append(part)):
        code, _, err = batch.run_here(*arguments)
    assert code == 0, err
    assert batch.left() == {"job.h5"}
    return len(calls)


@pytest.mark.parametrize(
    ("text", "tile", "number", "at"),
    [
        pytest.param(CARRIED, None, signal.SIGTERM, 3, id="carried, SIGTERM"),
        pytest.param(CARRIED, None, signal.SIGINT, 1, id="carried, SIGINT"),
        pytest.param(DOUBLING, None, signal.SIGTERM, 4, id="doubling"),
        pytest.param(MANIFOLDS, None, signal.SIGKILL, 6, id="manifolds, killed"),
        pytest.param(SURFACES, None, signal.SIGKILL, 6, id="surfaces, killed"),
        pytest.param(COVARIANT, None, signal.SIGKILL, 1, id="covariant, killed"),
        pytest.param(ROTATION, None, signal.SIGKILL, 0, id="rotation, killed"),
        pytest.param(CONFIG, 32, signal.SIGKILL, 2, id="a batch of small tiles, killed"),
    ],
)
@pytest.mark.slow
def test_stopped_within_a_piece(tmp_path, text, tile, number, at):
    """No call that was over is made again, and the result is that of a run that nothing disturbs, bit for bit."""
    (tmp_path / "whole").mkdir()
    (tmp_path / "stopped").mkdir()
    whole, stopped = Job(tmp_path / "whole", text, tile), Job(tmp_path / "stopped", text, tile)
    every = calls_of(whole)
    process = stopped.start(head=HEAD.format(at=at, signal=int(number), wait=1.0))
    _, err = process.communicate(timeout=300)
    assert process.returncode == (-number if number == signal.SIGKILL else 75), err
    if number != signal.SIGKILL:
        assert err.splitlines()[-1].startswith(f"stopped by {number.name} with 0 of ")
        assert err.splitlines()[-1].endswith(f"tiles done; {GO_ON}")
    assert stopped.done() == []
    others = len(LaneExecutor().split()) - 1  # may each have kept a call that was not counted yet
    assert every - at - 1 - others <= calls_of(stopped) <= every - at - 1
    assert content(stopped.output) == content(whole.output)


@pytest.mark.slow
def test_call_that_does_not_end(tmp_path):
    """A signal is heeded within seconds all the same: the process ends, and the run can go on."""
    stopped = Job(tmp_path, CARRIED)
    process = stopped.start(head=HEAD.format(at=2, signal=int(signal.SIGINT), wait=300.0))
    _, err = process.communicate(timeout=120)
    assert process.returncode == 75
    assert err.splitlines()[-1] == f"stopped by SIGINT; {GO_ON}"
    assert len(list(stopped.tiles.glob("*.calls"))) == 1


# ---- lanes and their calls


STATE = (np.full(20, 0.1), np.full(20, 0.1)), (np.full(20, 0.1), np.full(20, np.sqrt(0.99)))
CHAOTIC = {"b": np.linspace(5.2, 5.45, 20)}


@pytest.mark.parametrize(
    ("system", "solver", "steps", "compensated"),
    [
        ("constant", "blanes_moan6", 40, False),
        ("disturbed", "processed6", 40, True),
        pytest.param("constant", "dopri8", 160, False, marks=pytest.mark.slow),
    ],
)
def test_many_calls_give_the_bits_of_one(system, solver, steps, compensated):
    """Of a chaotic map, 150 periods of it at once, and in calls of 7: a map keeps nothing from period to period."""
    strobe = make_return_map(SYSTEMS[system], SOLVERS[solver], steps, compensated=compensated)
    lanes = LaneExecutor(devices=jax.devices("cpu")[:1], tile=8)
    at_once = lanes(iterate, (strobe, np.int32(150)), (STATE, CHAOTIC), periods=150)
    one = lanes.accounts.lane_periods
    with mock.patch.object(engine, "_LONGEST", 7 * 8):
        cut = lanes.iterate(strobe, 150, (STATE, CHAOTIC))
    same_leaves(at_once, cut)
    assert lanes.accounts.lane_periods == 2 * one == 2 * 20 * 150
    assert np.ptp(at_once[0][0]) > 0.1
    assert len(lanes.programs) == 1


class StopsAt:
    """Progress that stops a computation when so many lane-periods are done."""

    def __init__(self, at):
        self.left = at

    def advance(self, amount):
        self.left -= amount
        if self.left <= 0:
            raise Stopped("enough")


def _add(by, x, pair):
    return {"sum": x + pair[0] + by, "rest": (pair[1], x > 3.0)}


def test_calls_that_take_no_time_are_not_kept(tmp_path, monkeypatch):
    """They would be written and read in the time in which they are computed; what is given is the same."""
    monkeypatch.setattr(journal, "_WORTH_KEEPING", np.inf)
    x, pair = np.arange(40.0), (np.arange(40.0) % 3, np.arange(80.0).reshape(40, 2))
    lanes = LaneExecutor(tile=4)
    with (
        mock.patch.object(CallJournal, "add", autospec=True) as add,
        with_journal(lanes, CallJournal(tmp_path, job(), job().cutting.pieces())) as keeping,
    ):
        same_leaves(keeping(_add, (np.float64(1.0),), (x, pair)), lanes(_add, (np.float64(1.0),), (x, pair)))
    assert not add.called


def test_call_stopped_between_tiles(tmp_path):
    """Its first lanes are found, on another number of devices as well; the account is that of all that is there."""
    pieces = job().cutting.pieces()
    x, pair = np.arange(40.0), (np.arange(40.0) % 3, np.arange(80.0).reshape(40, 2))
    expected = LaneExecutor(tile=4)(_add, (np.float64(1.0),), (x, pair), periods=2)
    lanes = LaneExecutor(StopsAt(30), devices=jax.devices("cpu")[:2], tile=4)
    with pytest.raises(Stopped), with_journal(lanes, CallJournal(tmp_path, job(), pieces)) as keeping:
        keeping(_add, (np.float64(1.0),), (x, pair), periods=2)
    assert lanes.accounts.lane_periods == 32
    lanes = LaneExecutor(devices=jax.devices("cpu")[:1], tile=4)
    with (
        mock.patch.object(CallJournal, "add", autospec=True) as add,
        with_journal(lanes, kept := CallJournal(tmp_path, job(), pieces)) as keeping,
    ):
        assert kept.seconds > 0
        found = keeping(_add, (np.float64(1.0),), (x, pair), periods=2)
        assert [call.args[1].first for call in add.call_args_list] == list(range(16, 40, 4))
        same_leaves(found, expected)
        assert jax.tree.structure(found) == jax.tree.structure(expected)
        other = keeping(_add, (np.float64(2.0),), (x, pair), periods=2)  # another call: nothing of it is there
    np.testing.assert_array_equal(other["sum"], expected["sum"] + 1)
    assert lanes.accounts.lane_periods == 160
    kept.close(remove=True)
    assert list(tmp_path.iterdir()) == []


def _squared_shift(traces, x):
    traces.made.append(1)
    return {"square": x * x, "shifted": (x + 1.0,)}


class _Traces:
    """Traces of a function, counted as they are made."""

    def __init__(self):
        self.made = []


def test_found_calls_are_traced_once(tmp_path):
    """Hundreds of short calls of one function, as of Newton's: what all of them need is not made for each of them."""
    pieces, traces, blocks = job().cutting.pieces(), _Traces(), [np.arange(8.0) + k for k in range(5)]
    counted = functools.partial(_squared_shift, traces)
    counted.__qualname__ = "_squared_shift"
    first = CallJournal(tmp_path, job(), pieces)
    with with_journal(LaneExecutor(tile=8), first) as keeping:
        expected = [keeping(counted, (), (x,)) for x in blocks]
    first.close(remove=False)
    traces.made.clear()
    with (
        mock.patch.object(CallJournal, "add", autospec=True) as add,
        with_journal(LaneExecutor(tile=8), CallJournal(tmp_path, job(), pieces)) as keeping,
    ):
        found = [keeping(counted, (), (x,)) for x in blocks]
    assert not add.called
    assert len(traces.made) == 1
    same_leaves(found, expected)
    assert jax.tree.structure(found) == jax.tree.structure(expected)


def _halved(by, total, pair):
    return total / by, pair[0]


def test_chain_stopped_between_tiles(tmp_path):
    """What of each of its functions came to the host is found; what stayed on the device is not computed again."""
    pieces = job().cutting.pieces()
    x, pair = np.arange(40.0), (np.arange(40.0) % 3, np.arange(80.0).reshape(40, 2))
    links = [
        Link(_add, (np.float64(1.0),), periods=1, keep=lambda grown: (grown["sum"], grown["rest"][1])),
        Link(_halved, (np.float64(2.0),), periods=1),
    ]
    grown = x + pair[0] + 1.0
    lanes = LaneExecutor(StopsAt(30), devices=jax.devices("cpu")[:2], tile=4)
    with pytest.raises(Stopped), with_journal(lanes, CallJournal(tmp_path, job(), pieces)) as keeping:
        keeping.chain(links, (x, pair))
    lanes = LaneExecutor(devices=jax.devices("cpu")[:1], tile=4)
    for last, computed in ((2.0, 6), (4.0, 10)):  # another end is another chain
        links[1] = links[1]._replace(shared=(np.float64(last),))
        with (
            mock.patch.object(CallJournal, "add", autospec=True) as add,
            with_journal(lanes, CallJournal(tmp_path, job(), pieces)) as keeping,
        ):
            larger, (halved, first) = keeping.chain(links, (x, pair))
        assert add.call_count == computed
        np.testing.assert_array_equal(larger, x > 3.0)
        np.testing.assert_array_equal(halved, grown / last)
        np.testing.assert_array_equal(first, pair[0])


DIGEST = """
import sys
import numpy as np
from jaxnh.engine.experiment import load
from jaxnh.engine.axes import points
from jaxnh.engine.cache.fingerprints import CallFingerprints
from jaxnh.engine.executor.grouped_blocks import evaluate_block
from jaxnh.engine.xla_options import configure
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import SOLVERS
configure()
experiment = load(sys.argv[1], [])
at = points(experiment, experiment.axes, tuple(np.arange(4) for _ in experiment.axes))
for steps in (40, 80):
    strobe = make_return_map(at.system, SOLVERS[sys.argv[2]], steps)
    print(CallFingerprints().of(iterate, (strobe, np.int32(3)), (at.start, at.p), (), 8))
    print(CallFingerprints().of(evaluate_block, (strobe, np.int32(3)), (at.start, at.p), ((iterate, (), 2),), 8))
"""


@pytest.mark.slow  # in make test a process is stopped and this one goes on
@pytest.mark.parametrize(("config", "solver"), [("table1.yaml", "processed6"), ("governor.yaml", "dopri8")])
def test_call_is_known_in_another_process(config, solver):
    """With a user's own functions in it, and functions among its arguments, whatever their addresses and the order of
    hashes are; other steps are another call."""
    said = []
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed}
        command = [sys.executable, "-c", DIGEST, f"configs/{config}", solver]
        run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        said.append(run.stdout.split())
    assert said[0] == said[1]
    assert len(set(said[0])) == 4
