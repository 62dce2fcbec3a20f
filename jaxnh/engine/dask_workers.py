"""Pieces of a sweep on Dask workers: each computes on one core, writes its own file, and returns a receipt.

A worker runs what its scheduler sends it, and the text of a user's system that lies in the plan of the run. Connections
are secured by Dask's own settings alone (`distributed.comm.tls`, `distributed.comm.require-encryption`).
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import logging
import os
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxnh.engine import xla_options
from jaxnh.engine.compute import compute
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.journal import with_journal
from jaxnh.engine.levels import files
from jaxnh.engine.levels.levels import Level, axes_of
from jaxnh.exceptions import ArgumentError, DamagedError, RunError, Stopped
from jaxnh.jobs.cutting import Piece
from jaxnh.jobs.job import Job
from jaxnh.storage import tiles
from jaxnh.storage.calls import CallJournal
from jaxnh.storage.merge import gather
from jaxnh.storage.tiles import TileRecord

_RETRIES = 2
_MOST_LOSSES = 10  # of workers that a piece may have been at: a lost worker is no fault of the piece
_MOST_LOST = 3  # pieces that have lost so many, before the others are given up as well
_POLL = 0.5  # seconds between two looks at what is done
_CONNECT = 30.0  # seconds
_LOOPBACK = "127.0.0.1"  # a scheduler runs what it is sent: none of ours listens beyond this machine
_AT_ONCE = threading.Lock()
_LOCAL = re.compile(r"local(?::([1-9]\d*))?")
_NUMBERED = re.compile(r"(?!.*://).*?(\d+)")  # names of workers, but for an address: a port says nothing of cores


class LostError(RunError):
    """All workers that computed a piece were lost."""


def check(where: str) -> None:
    """Check the name of a cluster.

    Raises:
        ArgumentError: it is not, or Dask is not installed.
    """
    if not (_LOCAL.fullmatch(where) or "://" in where or Path(where).is_file()):
        raise ArgumentError("dask", f"{where} is neither local[:N] nor tcp:// or tls://HOST:PORT nor a scheduler file")
    if not importlib.util.find_spec("distributed"):
        raise ArgumentError("dask", "this needs the extra dask: pip install 'jaxnh[dask]'")


def run(
    client: Any,
    folder: Path,
    job: Job,
    stages: Sequence[Sequence[Piece]],
    heed: Callable[[], None],
    finished: Callable[[TileRecord], None],
) -> None:
    """Have pieces computed by the workers of a cluster.

    Args:
        client: of the cluster (`cluster`).
        job: that the pieces are of, a level's where the sweep has levels.
        stages: pieces; those of a stage begin once all before them are done.
        heed: called often; may raise to end the run.
        finished: called with each receipt.

    Raises:
        Stopped: the cluster is gone.
        RunError: a piece failed on every try; its reason. A piece that loses its workers does not delay others.
    """
    for pieces in stages:
        _run_stage(client, folder, job, pieces, heed, finished)


def _run_stage(
    client: Any,
    folder: Path,
    job: Job,
    pieces: Sequence[Piece],
    heed: Callable[[], None],
    finished: Callable[[TileRecord], None],
) -> None:
    """Have independent pieces computed."""
    futures = {
        client.submit(
            _piece,
            str(folder.resolve()),
            job.id,
            piece.number,
            key=f"{job.id[:8]}-{piece.number}",
            retries=_RETRIES,
            pure=False,
        ): piece
        for piece in pieces
    }
    lost: list[LostError] = []
    try:
        while futures and len(lost) < _MOST_LOST:
            heed()
            for future in _finished(client, list(futures)):
                try:
                    receipt = _receipt(future, futures[future])
                except LostError as error:
                    lost.append(error)
                else:
                    if receipt is None:
                        continue
                    finished(receipt)
                del futures[future]
        if lost:
            raise RunError("; ".join(map(str, lost))) from lost[0]
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(futures), force=True)


def machine(where: str | None, lanes: LaneExecutor, device: str | None, heed: Callable[[], None]) -> dict[str, str]:
    """The kind of processor and XLA's options of this process, or of a cluster's workers by the first that answers.

    Raises:
        ArgumentError: there is no such cluster.
        Stopped: the cluster is gone.
    """
    if where is None:
        return lanes.machine
    if _LOCAL.fullmatch(where):
        return xla_options.machine(lanes.devices[0], xla_options.flags_of_a_process())
    with cluster(where) as client:
        future = client.submit(_machine, device, pure=False)
        while not _finished(client, [future]):
            heed()
        return future.result()


def _receipt(future: Any, piece: Piece) -> TileRecord | None:
    """The receipt of a finished piece; None if it was lost with its worker, and the scheduler computes it again.

    Raises:
        LostError: all workers that computed the piece were lost.
        RunError: it failed on every try.
        Stopped: the cluster is gone.
    """
    from distributed import CancelledError

    status = future.status  # read once: another worker's death may change it at any time
    try:
        if status == "finished":
            return future.result(timeout=_CONNECT)
        error = future.exception(timeout=_CONNECT) if status == "error" else None
    except TimeoutError:  # the worker that had it died just now; one that has no scheduler is told by `_finished`
        return None
    except (OSError, CancelledError):
        raise Stopped("the Dask scheduler is gone") from None
    if status == "cancelled":
        raise Stopped("the Dask scheduler has dropped the work")
    if error is None:
        return None
    if type(error).__name__ == "KilledWorker":
        raise LostError(f"tile {piece.number} has lost its worker again and again") from error
    raise RunError(f"tile {piece.number} failed on a worker: {' '.join(str(error).split())[:500]}") from error


def _finished(client: Any, futures: list[Any]) -> list[Any]:
    """The futures that have come to an end, after a short wait."""
    from distributed import CancelledError, wait

    with client.as_current(), contextlib.suppress(TimeoutError, CancelledError):
        wait(futures, timeout=_POLL, return_when="FIRST_COMPLETED")
    if client.status != "running":
        raise Stopped("the Dask scheduler is gone")
    return [future for future in futures if future.done()]


@contextlib.contextmanager
def cluster(where: str) -> Iterator[Any]:
    """A client of a cluster; a local cluster is closed with it.

    Args:
        where: `local`, `local:N`, the address of a scheduler or its file.

    Raises:
        ArgumentError: there is no such cluster.
    """
    import dask.config as settings
    from distributed import Client, LocalCluster

    for name in ("distributed", "distributed.client", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what matters of it we say ourselves
    settings.set({"distributed.scheduler.allowed-failures": _MOST_LOSSES})
    settings.set({"distributed.comm.timeouts.connect": f"{_CONNECT}s"})
    options: dict[str, Any] = {}
    with contextlib.ExitStack() as stack:
        local = _LOCAL.fullmatch(where)
        if local:
            count = int(local[1] or len(xla_options.cores()))
            environment = {"JAX_NUM_CPU_DEVICES": "1", "OMP_NUM_THREADS": "1", "DASK_LOGGING__DISTRIBUTED": "critical"}
            settings.set({"distributed.nanny.pre-spawn-environ": environment})
            settings.set({"distributed.worker.multiprocessing-method": "spawn"})
            # One that takes long to start again is waited for: Dask would never start another one.
            settings.set({"distributed.deploy.lost-worker-timeout": "1 day"})
            # A worker that dies is counted against all pieces that wait there: so none but the one at work waits there.
            settings.set({"distributed.scheduler.worker-saturation": 1.0})
            layout: dict[str, Any] = {"n_workers": count, "threads_per_worker": 1, "processes": True}
            layout |= {"dashboard_address": None, "memory_limit": 0, "host": _LOOPBACK}
            layout |= {"scheduler_kwargs": {"dashboard_address": f"{_LOOPBACK}:0"}}  # a free port beside other clusters
            options["address"] = stack.enter_context(LocalCluster(**layout))
        elif "://" in where:
            _check_security(where)
            options["address"] = where
        else:
            options["scheduler_file"] = where
        try:
            client = stack.enter_context(Client(**options, set_as_default=False, timeout=_CONNECT))
        except (OSError, ValueError, TimeoutError, TypeError, RuntimeError) as error:
            # Of the address in a scheduler's file Dask has a TypeError for tls:// without certificates, a RuntimeError
            # for tcp:// where it is to encrypt.
            why = f": {' '.join(str(error).split())[:200]}" if isinstance(error, TypeError | RuntimeError) else ""
            raise ArgumentError("dask", f"no scheduler answers at {where}{why}") from error
        yield client


def _check_security(where: str) -> None:
    """Refuse an address that Dask's security settings do not fit: a client for it would hang for a minute."""
    from distributed.security import Security

    security = Security()
    if where.startswith("tls://") and security.get_connection_args("client")["ssl_context"] is None:
        raise ArgumentError(
            "dask",
            f"no scheduler answers at {where}: TLS needs the certificates that distributed.comm.tls of Dask names",
        )
    if where.startswith("tcp://") and security.require_encryption:
        raise ArgumentError(
            "dask", f"no scheduler answers at {where}: distributed.comm.require-encryption of Dask asks for encryption"
        )


# ---- in a worker


@functools.cache
def _lanes(device: str | None) -> LaneExecutor:
    """One device of a kind, a CPU on one core where there are several to choose from."""
    from distributed import get_worker

    cores = xla_options.cores()
    number = _NUMBERED.fullmatch(str(get_worker().name))
    if len(cores) > 1 and number and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {cores[int(number[1]) % len(cores)]})
    xla_options.configure(1)
    return LaneExecutor(devices=jax.devices(device))


class _Task(NamedTuple):
    """Data common to all pieces of a job: a level's where the sweep has levels."""

    experiment: Experiment
    job: Job
    level: Level | None


@functools.lru_cache(maxsize=1)
def _task(folder: Path, job_id: str) -> _Task:
    whole = tiles.read_job(folder)
    job = next((stage for stage in whole.stages() if stage.id == job_id), None) if whole else None
    if whole is None or job is None:
        raise RuntimeError(f"{folder}, as a worker sees it, is not the folder of this run")
    origin = tiles.origin(folder)
    experiment = Experiment.from_text(origin.config, origin.user_text)
    return _Task(experiment, job, files.read(folder, whole.cutting, job.cutting))


def _machine(device: str | None) -> dict[str, str]:
    with _AT_ONCE:
        return _lanes(device).machine


def _piece(folder: str, job_id: str, number: int) -> TileRecord:
    """Compute a piece and write it, unless it is there; runs in a worker, one at a time."""
    with _AT_ONCE:
        experiment, job, level = _task(Path(folder), job_id)
        lanes = _lanes(experiment.device)
        if other := xla_options.describe_differences(job.provenance.machine, lanes.machine):
            raise RuntimeError(f"the tiles are {other}")
        piece = job.cutting.pieces()[number - job.cutting.first]
        with contextlib.suppress(FileNotFoundError, DamagedError):
            return tiles.check(Path(folder), job, piece)
        calls = CallJournal(Path(folder), job, [piece])
        with with_journal(lanes, calls) as keeping:
            [done] = compute(
                experiment,
                axes_of(experiment.axes, job.cutting),
                experiment.requested(),
                job,
                [piece],
                keeping,
                lambda name: gather(Path(folder), job.cutting, name),
                level,
                calls.seconds,
            )
        receipt = tiles.write_piece(Path(folder), job, *done)
        calls.close(remove=True)
        return receipt
