"""Batch jobs as users run them: the same bits by every way to a result, and nothing lost to any fault."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from unittest import mock

import h5py
import jax
import numpy as np
import psutil
import pytest

from jaxnh.engine import compute as work
from jaxnh.engine import dask_workers, xla_options
from jaxnh.storage import hdf5 as store
from jaxnh.storage import tiles
from tests.helpers.cases import some_slow
from tests.helpers.jobs import CONFIG, GO_ON, TILES, Job, content, slow_tiles
from tests.helpers.memory import peak_memory
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("quickly_uncalibrated")


@pytest.fixture
def job(tmp_path):
    return Job(tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, worker_id):
    """The result of one run that nothing disturbs, as one tile."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "whole"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        job = Job(folder, tile=None)
        if not job.output.exists():
            code, _, err = job.run_here()
            assert code == 0, err
    return content(job.output)


def finish(job, whole, *arguments, code=0):
    """Run to the end, and compare with an undisturbed run; what was said on the way."""
    found, out, err = job.run_here(*arguments)
    assert found == code, err
    assert content(job.output) == whole
    assert job.left() == {"job.h5"}
    store.verify(job.output)
    return out, err


# ---- the same bits by every way


def test_lanes_are_chaotic(whole):
    """What these tests rest on: neighbours in b have long parted."""
    x1 = np.frombuffer(whole["/diagram/x1"][0]).reshape(whole["/diagram/x1"][1])
    assert np.median(np.abs(np.diff(x1[:, 0, -1]))) > 0.01


@pytest.mark.slow
def test_one_core(job, whole):
    """One device in place of two, and twelve tiles in place of one."""
    found, _, err = job.run(environment={"JAX_NUM_CPU_DEVICES": "1"})
    assert found == 0
    assert f"diagram, chaos01: {TILES} tiles (492,000 lane-periods)" in err
    assert content(job.output) == whole
    assert job.left() == {"job.h5"}


@pytest.mark.slow
def test_four_parts_at_once(job, whole):
    """On one folder: two processes, and two parts here meanwhile; then the join, to the bits of one large tile."""
    processes = {k: job.start("--part", f"{k}/4") for k in (1, 3)}
    for k in (2, 4):
        code, out, err = job.run_here("--part", f"{k}/4")
        assert (code, out) == (0, [f"part {k}/4: 3 of {TILES} tiles"]), err
    for k, process in processes.items():
        out, err = process.communicate(timeout=300)
        assert process.returncode == 0, err
        assert out == f"part {k}/4: 3 of {TILES} tiles\n"
    finish(job, whole, "--merge")


@pytest.mark.parametrize("tile", [None, pytest.param(1000, marks=pytest.mark.slow)])
def test_parts_of_a_small_sweep(tmp_path, tile):
    """Forty lanes, fewer than a tile of their own would have: each of two parts computes half of them."""
    small = Job(tmp_path, CONFIG.replace("count: 3000", "count: 40"), tile)
    lanes = []
    for k in (1, 2):
        before = set(small.done())
        code, _, err = small.run_here("--part", f"{k}/2")
        assert code == 0, err
        own = []
        for path in set(small.done()) - before:
            with h5py.File(path) as file:
                own.append(int((file.attrs["end"] - file.attrs["begin"]).prod()))
        lanes.append(sum(own))
    assert lanes == [20, 20]
    assert small.run_here("--merge")[0] == 0
    joined = content(small.output)
    small.output.unlink()
    assert small.run_here()[0] == 0
    assert content(small.output) == joined


def test_parts_stay_where_they_are(tmp_path):
    """`--merge --virtual`: the same numbers from the files of the tiles, which `--fresh` takes away."""
    small = Job(tmp_path, CONFIG.replace("count: 3000", "count: 40"), 10)
    for k in (1, 2):
        assert small.run_here("--part", f"{k}/2")[0] == 0
    assert small.run_here("--virtual")[0] == 2
    code, _, err = small.run_here("--merge", "--virtual")
    assert code == 0, err
    assert small.left() == {"job.h5", "job.h5.parts"}
    store.verify(small.output)
    virtual = content(small.output)
    assert small.run_here()[1] == ["job.h5: the result of this config is there; --fresh runs it again"]
    assert small.run_here("--fresh")[0] == 0
    assert content(small.output) == virtual
    assert small.left() == {"job.h5"}


OTHER = {"processor": "x86_64 avx avx2 fma avx512f", "xla_options": "--xla_some_option=1"}


@pytest.mark.slow
@pytest.mark.parametrize("key", OTHER)
def test_machine_of_another_kind(job, whole, key):
    """Tiles of two kinds of processor, or of other XLA options, are not put together: a resumed run, a part and a
    worker refuse, in a line. What is done can be joined anywhere, and --fresh begins anew."""
    here = xla_options.machine

    def elsewhere(*arguments):
        return here(*arguments) | {key: OTHER[key]}

    with mock.patch("jaxnh.engine.executor.lanes.machine", elsewhere):
        assert job.run_here("--part", "1/12")[0] == 0
    before = {path: path.read_bytes() for path in job.done()}
    assert len(before) == 1
    for arguments, remedy in (((), "--fresh drops them"), (("--part", "2/12"), "--fresh without --part drops them")):
        code, _, err = job.run_here(*arguments)
        assert code == 2
        assert len(err) == 1
        assert err[0].startswith("command line: --output: job.h5.tiles holds tiles of ")
        assert f"[{OTHER[key]}], and here it is" in err[0]
        assert err[0].endswith(f": go on where they were made; {remedy}")
    assert {path: path.read_bytes() for path in job.done()} == before
    code, _, err = job.run_here("--merge")
    assert (code, err[-1].split(" are missing")[0]) == (2, "command line: --merge: 11 of 12 tiles")
    lanes = mock.Mock(machine=here(jax.devices()[0]))
    with (
        mock.patch("jaxnh.engine.dask_workers._lanes", return_value=lanes),
        pytest.raises(RuntimeError, match=r"the tiles are of .*: go on where they were made"),
    ):
        dask_workers._piece(str(job.tiles), tiles.read_job(job.tiles).id, 1)
    finish(job, whole, "--fresh")
    with h5py.File(job.output) as file:
        assert {name: file.attrs[name] for name in OTHER} == lanes.machine


@pytest.mark.slow
def test_dask_worker_killed(job, whole):
    """Two workers of a local cluster, each killed in turn while at work: the run ends well, and nothing is lost."""
    process = job.start("--dask", "local:2")
    for kill in range(2):
        job.until(process, 1 + 4 * kill)
        workers = [
            c for c in psutil.Process(process.pid).children(recursive=True) if "spawn_main" in " ".join(c.cmdline())
        ]
        assert len(workers) >= 2 - kill
        workers[kill % len(workers)].kill()
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert content(job.output) == whole
    assert job.left() == {"job.h5"}
    assert out.splitlines()[-1] == "wrote job.h5"


DEADLY = """
import os, sys
if "--multiprocessing-fork" in sys.argv:  # a worker
    import jaxnh.engine.compute as work
    compute = work.compute
    def deadly(experiment, axes, requested, job, batch, *others):
        if batch[0].number == 5:
            os.kill(os.getpid(), 9)
        return compute(experiment, axes, requested, job, batch, *others)
    work.compute = deadly
"""


@pytest.mark.slow
def test_tile_that_kills_its_workers(job, whole):
    """It is given up with a clear line; all other tiles are done and kept, and a run elsewhere needs that one alone.

    Workers that take long to start again, as on a machine with much else to do, are waited for: Dask would have a cluster
    without them, here after the twentieth part of a second.
    """
    tools = job.folder.parent / f"{job.folder.name}-tools"
    tools.mkdir()
    (tools / "sitecustomize.py").write_text(DEADLY)
    few = "import jaxnh.engine.dask_workers; jaxnh.engine.dask_workers._MOST_LOSSES = 2"
    environment = {"PYTHONPATH": f"{tools}:{ROOT}", "DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "50ms"}
    code, out, err = job.run("--dask", "local:2", head=few, environment=environment)
    assert (code, out) == (1, []), err
    assert err[-1] == f"failed: tile 5 has lost its worker again and again; 11 of 12 tiles are kept: {GO_ON}"
    assert [int(path.stem) for path in job.done()] == [k for k in range(TILES) if k != 5]
    _, err = finish(job, whole)
    assert f"11 of {TILES} tiles are done; going on" in err


@pytest.mark.slow
@pytest.mark.parametrize("by", ["scheduler.json", "address"])
def test_dask_scheduler_killed(job, whole, by):
    """A clear line and the code to go on; the tiles that were done are not computed again."""
    place = job.folder / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "critical"}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard"]
    quiet = {"env": environment, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": job.folder}
    scheduler = subprocess.Popen([*dask, "--scheduler-file", place], **quiet)
    workers = subprocess.Popen(
        [*worker, "--scheduler-file", place, "--local-directory", "space", "--death-timeout", "60"], **quiet
    )
    try:
        while not place.exists():
            time.sleep(0.05)
        process = job.start("--dask", json.loads(place.read_text())["address"] if by == "address" else by)
        job.until(process, 2)
        scheduler.kill()
        _, err = process.communicate(timeout=120)
        assert process.returncode == 75, err
        assert "Traceback" not in err
        last = err.splitlines()[-1]
        assert last.startswith("the Dask scheduler is gone with ")
        assert last.endswith(f" of {TILES} tiles done; {GO_ON}")
    finally:
        scheduler.kill()
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in psutil.Process(workers.pid).children(recursive=True):
                child.kill()
        workers.kill()
        workers.wait()
        scheduler.wait()
    shutil.rmtree(job.folder / "space", ignore_errors=True)
    place.unlink()
    kept = len(job.done())
    assert kept >= 2
    _, err = finish(job, whole)
    assert f"{kept} of {TILES} tiles are done; going on" in err


# ---- ends in the middle


FOLLOWED = """\
system: {constraint: constant_speed}
sweep: {b: {start: 5.2, stop: 5.6, count: 40}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  covariant: {transient: 16, strobes: 256}
  rotation: {transient: 16, periods: 128}
"""


def test_covariant_vectors_and_rotation_numbers_go_on(tmp_path):
    """A run that finds half of its tiles there ends with the bits of one that was not stopped."""
    small = Job(tmp_path, FOLLOWED, 10)
    assert small.run_here()[0] == 0
    undisturbed = content(small.output)
    small.output.unlink()
    assert small.run_here("--part", "1/2")[0] == 0
    code, _, err = small.run_here()
    assert code == 0, err
    assert "2 of 4 tiles are done; going on" in err
    assert content(small.output) == undisturbed


@pytest.mark.slow
def test_killed_then_resumed(job, whole):
    """Killed once tiles are there, which a later run goes on from, whatever was half done."""
    for count in (2, 6):
        process = job.start()
        job.until(process, count)
        process.kill()
        process.communicate()
    kept = len(job.done())
    assert kept >= 6
    (job.tiles / ".000011.h5.xyz.part").write_text("half a tile of a process that was killed")
    _, err = finish(job, whole)
    assert f"{kept} of {TILES} tiles are done; going on" in err


@pytest.mark.slow
def test_killed_at_random_moments(job, whole):
    """Twenty kills from the start of a process to the end of the whole run; whenever one ends first, it begins anew.

    Tiles take a fifth of a second each, so that they are some third of the run: else most kills come before the first.
    """
    slowly = slow_tiles(job, 0.2)
    assert job.run()[0] == 0  # programs are in the cache from here on
    job.output.unlink()
    began = time.perf_counter()
    assert job.run(environment=slowly)[0] == 0
    longest = time.perf_counter() - began
    job.output.unlink()
    moments, killed, resumed = random.Random(1), 0, 0
    while killed < 20:
        process = job.start(environment=slowly)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=moments.uniform(0.0, longest))
        process.kill()
        process.communicate()
        assert process.returncode in (0, -signal.SIGKILL)
        killed += process.returncode != 0
        resumed += bool(job.done())
        if job.output.exists():  # never half of it, killed or not
            assert content(job.output) == whole
            store.verify(job.output)
            assert job.run("--quiet")[0] == 0  # says nothing, and removes what is left of the tiles
            job.output.unlink()
    assert resumed
    finish(job, whole)


@pytest.mark.slow
def test_stopped_by_a_signal(job, whole):
    """The code to go on, and a line with how far it came; asked to be quiet, the rest is done without a word."""
    process = job.start()
    job.until(process, 2)
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    kept = len(job.done())
    assert process.returncode == 75, err
    assert out == ""
    assert err.splitlines()[-1] == f"stopped by SIGTERM with {kept} of {TILES} tiles done; {GO_ON}"
    assert not job.output.exists()
    assert finish(job, whole, "--quiet") == ([], [])


def test_what_is_being_worked_on_is_refused(job):
    """Whoever has the lock, as a whole run or as a part; what a part does not have of it is free to another part."""
    for held, refused in ((None, ((), ("--part", "1/2"))), ((1, 2), ((), ("--part", "1/2")))):
        with tiles.hold(job.tiles, held):
            for arguments in refused:
                code, out, err = job.run_here(*arguments)
                assert (code, out) == (2, [])
                assert len(err) == 1
                assert err[0].startswith("command line: --output: another run is working on job.h5")


@pytest.mark.slow
def test_second_run_is_refused(job, whole):
    """On the same output, as a whole or as a part; nor is half of it joined. The lock of a dead one does not hinder."""
    head = "import jaxnh.engine.compute as w, time; c, k = w.compute, iter(range(99))\n"
    head += "w.compute = lambda *a: (time.sleep(60 * next(k)), c(*a))[1]"
    process = job.start(head=head)
    job.until(process, 1)
    for arguments in ((), ("--part", "1/2")):
        code, out, err = job.run_here(*arguments)
        assert (code, out) == (2, [])
        assert len(err) == 1
        assert err[0].startswith("command line: --output: another run is working on job.h5")
    process.kill()
    process.communicate()
    assert (job.tiles / "lock").exists()
    code, _, err = job.run_here("--merge")
    assert code == 2
    assert re.fullmatch(r"command line: --merge: \d+ of 12 tiles are missing \(\d.*\); run their parts again", err[-1])
    finish(job, whole)


# ---- tiles that are of no use


def flip(path, at):
    data = bytearray(path.read_bytes())
    data[at if at >= 0 else len(data) + at] ^= 1
    path.write_bytes(data)


def test_damaged_tiles_are_computed_again(job, whole):
    """A flipped bit, one cut short, one of another config and one in another's place, each said in a line.

    The plan of the run is damaged too: it is made anew, comes out the same, and the sound tiles still count.
    """
    assert job.run_here("--part", "1/2")[0] == 0
    tiles = job.done()
    with h5py.File(tiles[0]) as file:
        data = file["diagram/x1"].id
        middle = data.get_offset() + data.get_storage_size() // 2
    flip(tiles[0], middle)
    with tiles[1].open("r+b") as file:
        file.truncate(tiles[1].stat().st_size * 2 // 3)
    with h5py.File(tiles[2], "r+") as file:
        file.attrs["config_sha256"] = "0" * 64
    shutil.copy(tiles[4], tiles[3])
    with h5py.File(tiles[4], "r+") as file:
        file["chaos01/k_median"][5] = np.nextafter(file["chaos01/k_median"][5], 9)
    plan = (job.tiles / "job.json").read_text()
    (job.tiles / "job.json").write_text(plan.replace('"steps": 40', '"steps": 41'))
    _, err = finish(job, whole)
    assert f"{len(tiles) - 5} of {TILES} tiles are done; going on" in err
    said = [line for line in err if "it is computed again" in line]
    assert [line.split(":")[0] for line in said] == [f"job.h5.tiles/{k:06d}.h5" for k in range(5)]
    words = ["do not fit their checksum", "damaged", "another config", "another run", "do not fit their checksum"]
    assert all(word in line for word, line in zip(words, said, strict=True)), said


@pytest.mark.slow
def test_tiles_of_another_config_are_not_replaced(job, whole):
    """A job begun with other values stays, and one line says what to do; --fresh drops it."""
    assert job.run_here("sweep.b.count=257", "--part", "1/2")[0] == 0
    before = {path: path.read_bytes() for path in job.done()}
    code, _, err = job.run_here()
    assert code == 2
    assert err == ["command line: --output: job.h5.tiles holds tiles of another config; --fresh drops them"]
    assert {path: path.read_bytes() for path in job.done()} == before
    finish(job, whole, "--fresh")


# ---- disks and folders


@contextlib.contextmanager
def limited(limit):
    """No file may grow beyond so many bytes, as where a disk is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk(job, whole):
    """First for tiles, then for the merged result: a sentence with what is kept, and the run goes on when there is room.

    Programs come from the cache, which the limit would keep from growing.
    """
    with limited(20_000):  # a tile has 60 kB
        code, _, err = job.run_here()
    assert code == 1
    # Batches are computed side by side, and any of the first may be the one that says it.
    assert re.match(
        r"failed: cannot write job\.h5\.tiles/\d{6}\.h5: \[Errno 27\] File too large; 0 of 12 tiles", err[-1]
    )
    with limited(200_000):
        code, _, err = job.run_here()
    assert code == 1
    assert err[-1] == f"failed: cannot write job.h5: [Errno 27] File too large; 12 of 12 tiles are kept: {GO_ON}"
    assert job.left() == {"job.h5.tiles"}
    finish(job, whole)


@pytest.mark.slow
def test_full_disk_as_a_mount(job, whole):
    """The same with a file system that is really full, where mounts are allowed."""
    mount = job.folder / "small"
    mount.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", mount]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("mounts are not allowed here")
    try:
        small = Job(mount)
        code, _, err = small.run_here()
        assert code == 1
        assert "No space left on device" in err[-1]
        assert err[-1].endswith(f"tiles are kept: {GO_ON}")
        assert not small.output.exists()
        kept = len(small.done())
        assert 0 < kept < TILES
        subprocess.run(["mount", "-o", "remount,size=9m", mount], check=True)
        _, err = finish(small, whole)
        assert f"{kept} of {TILES} tiles are done; going on" in err
    finally:
        subprocess.run(["umount", mount], check=True)


def forbid(folder, forbidden):
    """Make a folder read-only, or no more: by its mode, for root by its attribute; whether it is so now."""
    if os.geteuid():
        folder.chmod(0o555 if forbidden else 0o755)
        return True
    command = ["chattr", "+i" if forbidden else "-i", folder]
    return bool(shutil.which("chattr")) and not subprocess.run(command, capture_output=True, check=False).returncode


@pytest.mark.parametrize("how", some_slow({how: how for how in ("removed", "a file", "read-only")}, "removed"))
def test_folder_taken_away(job, whole, how):
    """While the run is on: a sentence, no traceback; with the folder back, the same command has its result."""
    if how == "read-only" and not forbid(job.tiles.parent, True):
        pytest.skip("root may write in a folder that is read-only, and the file system has no other way")
    forbid(job.tiles.parent, False)
    away, calls = job.folder / "away", iter(range(TILES))

    def take_away(*arguments):
        if next(calls) == 4:  # that of a runner which has done a batch: two cores have two runners each
            waited = time.monotonic() + 60
            while not job.done():  # the batch is written meanwhile
                assert time.monotonic() < waited
                time.sleep(0.01)
            if how == "read-only":
                forbid(job.tiles, True)
            else:
                job.tiles.rename(away)
                if how == "a file":
                    job.tiles.write_text("in the way")
        return work.compute(*arguments)

    with mock.patch("jaxnh.engine.run.compute", take_away):
        code, _, err = job.run_here()
    if how == "read-only":
        forbid(job.tiles, False)
    assert code == 1, err
    last = err[-1]
    assert "job.h5.tiles" in last
    assert last.startswith("failed: ")
    assert not job.output.exists()
    if how != "read-only":
        job.tiles.unlink() if how == "a file" else None
        away.rename(job.tiles)
    finish(job, whole)


def test_clock_set_back(job, whole):
    """Each look at the clock finds it a day earlier, and the tiles of a first run are of tomorrow."""
    assert job.run_here("--part", "1/6")[0] == 0
    tomorrow = time.time() + 86400
    for path in job.tiles.iterdir():
        os.utime(path, (tomorrow, tomorrow))
    now, looks = time.time, iter(range(10**9))
    with mock.patch("time.time", side_effect=lambda: now() - 86400 * next(looks)):
        code, _, err = job.run_here()
    assert code == 0, err
    assert content(job.output) == whole


@pytest.mark.slow
def test_killed_between_result_and_tiles(job, whole):
    """A result with its tiles still beside it is a result: it is said to be there, and the tiles go."""
    head = "import jaxnh.storage.tiles as t, os; t.clear = lambda folder: os._exit(9)"
    process = job.start(head=head)
    process.communicate()
    assert process.returncode == 9
    assert job.left() == {"job.h5", "job.h5.tiles"}
    out, _ = finish(job, whole)
    assert out == ["job.h5: the result of this config is there; --fresh runs it again"]


# ---- words


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--part", "5/4"], "--part: it is K/N with K from 1 to N, not 5/4"),
        (["--merge"], "--merge: there are no tiles in job.h5.tiles"),
        (["--virtual"], "--virtual: it goes with --merge"),
        (
            ["--dask", "absent.json"],
            "--dask: absent.json is neither local[:N] nor tcp:// or tls://HOST:PORT nor a scheduler file",
        ),
    ],
)
def test_bad_command_line(job, arguments, said):
    code, out, err = job.run_here(*arguments)
    assert (code, out, err) == (2, [], [f"command line: {said}"])
    assert job.left() == set()


# ---- the launcher


@pytest.mark.slow
def test_slurm_script(job, whole):
    """Its array variant, by processes: a part that is preempted is put back into the queue, and the join follows."""
    tools = job.folder.parent / f"{job.folder.name}-tools"
    tools.mkdir()
    (tools / "scontrol").write_text(f'#!/bin/sh\necho "$@" >> {tools}/asked\n')
    (tools / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    for tool in tools.iterdir():
        tool.chmod(0o755)
    base = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{tools}:{os.environ['PATH']}", "PYTHON": "python"}
    slurm = {
        "SLURM_JOB_ID": "17",
        "SLURM_ARRAY_JOB_ID": "17",
        "SLURM_ARRAY_TASK_COUNT": "2",
        "SLURM_ARRAY_TASK_MIN": "1",
    }
    script = ["bash", ROOT / "sweeps" / "slurm.sbatch", "job.yaml", "--output", "job.h5", "--tile", "256"]

    def start(k, *arguments, **more):
        environment = {**base, **slurm, "SLURM_ARRAY_TASK_ID": str(k)} if k else {**base, "SLURM_JOB_ID": "18"}
        environment |= more
        options = {"cwd": job.folder, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen([*script, *arguments], env=environment, **options)

    first = start(1, **slow_tiles(job))
    job.until(first, 1)
    first.send_signal(signal.SIGTERM)
    out, _ = first.communicate(timeout=120)
    assert first.returncode == 75, out
    assert (tools / "asked").read_text() == "requeue 17_1\n"
    for k in (1, 2):
        again = start(k)
        out, _ = again.communicate(timeout=120)
        assert again.returncode == 0, out
    join = start(0, "--merge")
    out, _ = join.communicate(timeout=120)
    assert join.returncode == 0, out
    assert content(job.output) == whole


SRUN = r"""#!/bin/bash
echo "$@" >> {tools}/asked
count=1
while [[ $1 == --* ]]; do
    [[ $1 == --ntasks=* ]] && count=${{1#--ntasks=}}
    shift
done
for ((k = 0; k < count; k++)); do "$@" & done
trap 'kill $(jobs -p)' TERM
wait
wait
"""


@pytest.mark.slow
def test_slurm_script_with_dask(job, whole):
    """Its Dask variant: a scheduler and as many workers as there are tasks but two, and none of them is left.

    `srun` is one of our own that starts processes. First the job is preempted, then it runs to its end.
    """
    tools = job.folder.parent / f"{job.folder.name}-tools"
    tools.mkdir()
    (tools / "scontrol").write_text(f'#!/bin/sh\necho "$@" >> {tools}/asked\n')
    (tools / "srun").write_text(SRUN.format(tools=tools))
    (tools / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    for tool in tools.iterdir():
        tool.chmod(0o755)
    slurm = {"SLURM_JOB_ID": "17", "SLURM_NTASKS": "4", "TMPDIR": str(tools), "PYTHON": "python"}
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{tools}:{os.environ['PATH']}", **slurm}
    script = ["bash", ROOT / "sweeps" / "slurm.sbatch", "job.yaml", "--output", "job.h5", "--tile", "256"]
    for preempted in (True, False):
        (tools / "asked").unlink(missing_ok=True)
        with (tools / "log").open("w+") as log:
            options = {"cwd": job.folder, "stdout": log, "stderr": subprocess.STDOUT, "start_new_session": True}
            process = subprocess.Popen([*script, "--dask", "slurm"], env=environment, **options)
            if preempted:
                job.until(process, 2)
                process.send_signal(signal.SIGTERM)
            code = process.wait(timeout=240)
            log.seek(0)
            assert code == (75 if preempted else 0), log.read()
        psutil.wait_procs(session(process.pid), timeout=30)
        assert session(process.pid) == []
        asked = (tools / "asked").read_text().splitlines()
        assert sorted(line.split()[1] for line in asked[:2]) == ["--ntasks=1", "--ntasks=2"]
        assert asked[2:] == (["requeue 17"] if preempted else [])
    assert content(job.output) == whole
    assert job.left() == {"job.h5"}


def session(number):
    """Processes of a session that are alive."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(ProcessLookupError, psutil.NoSuchProcess):
            if os.getsid(process.pid) == number and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


# ---- a large one


@pytest.mark.slow
def test_million_lanes_in_little_memory(tmp_path):
    """8 strobes and 20 periods of a million lanes: largest resident memory below 4 GB."""
    config = "system: {constraint: constant_speed}\nsweep: {b: {start: 0.1, stop: 6.0, count: 1000000}}\n"
    config += "accuracy: {target: 1.0e-4}\nanalyses:\n  diagram: {transient: 13, strobes: 8}\n"
    job = Job(tmp_path, config, tile=None)
    process = job.start()
    assert 1e8 < peak_memory(process) < 4e9
    assert process.returncode == 0
    with h5py.File(job.output) as file:
        assert file["diagram/x1"].shape == (1_000_000, 8)
        assert json.loads(file.attrs["versions"])
