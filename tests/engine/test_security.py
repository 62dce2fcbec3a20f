"""Who can make a worker run what: our own cluster listens on this machine alone, others by Dask's certificates."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import time

import dask
import distributed  # noqa: F401  # Dask has its settings from here on
import psutil
import pytest

from jaxnh.engine import dask_workers
from jaxnh.exceptions import ArgumentError
from jaxnh.storage import hdf5 as store
from tests.helpers.commands import run_here
from tests.helpers.paths import ROOT

CONFIG = """\
system: {constraint: constant_speed}
sweep: {b: {start: 5.2, stop: 5.45, count: 512}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses: {poincare: {transient: 8, strobes: 4}}
"""


def addresses(info):
    return [info["address"], *(name for name, worker in info["workers"].items() for name in (name, worker["nanny"]))]


@pytest.fixture
def taken_port():
    """The port in use that Dask would take for the pages of a cluster."""
    with socket.socket() as other:
        with contextlib.suppress(OSError):  # somebody has it
            other.bind(("127.0.0.1", 8787))
            other.listen()
        yield


@pytest.mark.filterwarnings("error:Port")
@pytest.mark.usefixtures("taken_port")
def test_our_own_cluster_is_on_loopback():
    """Scheduler, workers and their nannies: by their addresses, and by the sockets that their processes listen on.

    What it computes is waited for by the client that has asked for it, which is no default of the process. Of a port that
    another cluster has nothing is said.
    """
    with dask_workers.cluster("local:1") as client:
        client.wait_for_workers(1, timeout=60)
        future = client.submit(abs, -2, pure=False)
        while not (ended := dask_workers._finished(client, [future])):
            pass
        assert ended == [future]
        assert future.result() == 2
        found = addresses(client.scheduler_info())
        own = psutil.Process()
        sockets = [
            c for p in (own, *own.children(recursive=True)) for c in p.net_connections("inet") if c.status == "LISTEN"
        ]
    assert len(found) == 3
    assert all(address.split("://")[1].startswith("127.0.0.1:") for address in found)
    assert len(sockets) >= 3
    assert {socket.laddr.ip for socket in sockets} == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("address", "settings", "words"),
    [
        ("tls://127.0.0.1:9", {}, "no scheduler answers at tls://127.0.0.1:9: .*TLS"),
        ("tcp://127.0.0.1:9", {"distributed.comm.require-encryption": True}, "no scheduler answers .*encr"),
    ],
)
def test_what_is_not_secured_is_said(address, settings, words):
    """TLS without certificates, and an open address where Dask is told to encrypt: one line each, at once."""
    with dask.config.set(settings), pytest.raises(ArgumentError, match=f"(?i){words}"), dask_workers.cluster(address):
        pass


# ---- TLS


@pytest.fixture
def certificate(tmp_path):
    """A self-signed certificate and its key, and another one that nobody trusts."""
    openssl = shutil.which("openssl")
    if not openssl:
        pytest.skip("the openssl command, which makes the certificates, is not there")

    def made(name):
        key, cert = tmp_path / f"{name}.key", tmp_path / f"{name}.pem"
        request = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
        where = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(cert)]
        subprocess.run([openssl, *request, *where], check=True, capture_output=True)
        return key, cert

    return {name: made(name) for name in ("ours", "theirs")}


def settings_of(pair, authority):
    """Dask's settings of one pair."""
    key, cert = map(str, pair)
    roles = {
        f"{role}.{what}": path
        for role in ("scheduler", "worker", "client")
        for what, path in (("key", key), ("cert", cert))
    }
    return {
        "distributed.comm.require-encryption": True,
        **{f"distributed.comm.tls.{name}": path for name, path in {"ca-file": str(authority), **roles}.items()},
    }


def variables(settings):
    """The same as variables of the environment."""
    return {f"DASK_{name}".upper().replace(".", "__").replace("-", "_"): str(value) for name, value in settings.items()}


@pytest.mark.slow
def test_run_over_tls(certificate, tmp_path):
    """With Dask's own certificates a run over tls:// gives the same bits; with another certificate it is refused."""
    (tmp_path / "job.yaml").write_text(CONFIG)
    quiet = {"DASK_LOGGING__DISTRIBUTED": "critical", "PYTHONPATH": str(ROOT)}
    ours, theirs = certificate["ours"], certificate["theirs"]
    inside = {**os.environ, **quiet, **variables(settings_of(ours, ours[1]))}
    place = tmp_path / "scheduler.json"
    silent = {"env": inside, "cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    module, common = [sys.executable, "-m"], ["--no-dashboard", "--scheduler-file", str(place)]
    scheduler = [*module, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--protocol", "tls"]
    worker = [*module, "distributed.cli.dask_worker", "--nthreads", "1", "--death-timeout", "120", "--no-nanny"]
    processes = [subprocess.Popen([*scheduler, *common], **silent)]

    def command(output, *arguments):
        return ["job.yaml", "--output", output, "--quiet", "--tile", "256", *arguments]

    try:
        while not place.exists():
            assert processes[0].poll() is None
            time.sleep(0.05)
        processes.append(subprocess.Popen([*worker, *common, "--local-directory", str(tmp_path / "space")], **silent))
        address = json.loads(place.read_text())["address"]
        assert address.startswith("tls://127.0.0.1:")
        by_workers = [*module, "jaxnh.sweep", *command("tls.h5", "--dask", address)]
        done = subprocess.run(by_workers, env=inside, cwd=tmp_path, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, done.stderr
        for settings in (settings_of(theirs, ours[1]), {}):
            with dask.config.set(settings):
                refused = run_here(*command("refused.h5", "--dask", address), cwd=tmp_path)
            assert refused.returncode == 2, refused.stderr
            assert refused.stderr.splitlines()[-1].startswith(
                f"command line: --dask: no scheduler answers at {address}"
            )
            assert not (tmp_path / "refused.h5").exists()
    finally:
        for process in processes[::-1]:
            process.kill()
            process.wait()
    assert run_here(*command("here.h5"), cwd=tmp_path).returncode == 0
    one, other = (store.read_group(tmp_path / f"{name}.h5", "poincare")["x1"] for name in ("tls", "here"))
    assert one.values.tobytes() == other.values.tobytes()
