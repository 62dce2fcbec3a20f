"""Tiles on disk: the folder beside a result in which a run keeps what it has done, until the result is whole. No JAX.

All decisions for a sweep as a whole are in `job.json`, which is made once: pieces of any process fit together bit for
bit. A piece exists whole or not at all, and names its job. A lock keeps other runs away from a result; it belongs to a
process, so that a dead one leaves none behind.

Neither xarray nor h5netcdf has locks between processes, or tells whether a file is whole and of the same run.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import h5py
import numpy as np
from filelock import lock_descriptor

from jaxnh.exceptions import BusyError, DamagedError, ResultError
from jaxnh.jobs.cutting import Cutting, Piece
from jaxnh.jobs.job import Job, NumericalPlan
from jaxnh.jobs.provenance import Provenance, SecondsSpent
from jaxnh.storage import hdf5 as store
from jaxnh.storage.atomic import sync

if TYPE_CHECKING:
    import xarray as xr

_JOB, _LOCK = "job.json", "lock"
_PATIENCE = 1.0  # seconds; another part has the lock of the whole for as long as it takes to take its own


class TileRecord(NamedTuple):
    """A piece that is done: its number, its file and that file's seal, what it has cost, and what was counted in it."""

    number: int
    path: Path
    seal: str
    spent: SecondsSpent
    counts: Mapping[str, Mapping[str, int]]


# ---- the folder, its lock and its job


def folder_of(path: Path) -> Path:
    """Folder of the tiles of a result."""
    return path.with_name(f"{path.name}.tiles")


@contextlib.contextmanager
def hold(folder: Path, part: tuple[int, int] | None = None) -> Iterator[None]:
    """Make the folder and keep others out: all of them, or for part (k, n) those of the same part and of the whole.

    The lock goes with the process however it ends. At the end an empty folder goes as well.

    Raises:
        BusyError: another process is at work.
        ResultError: the folder cannot be made.
    """
    result = folder.name.removesuffix(".tiles")
    with contextlib.ExitStack() as held:
        try:
            if part:  # which others may join: the lock of the whole is held while that of the part is taken
                with _locked(folder, _LOCK, patience=_PATIENCE):
                    held.enter_context(_locked(folder, f"part-{part[0]}-of-{part[1]}.lock"))
            else:
                held.enter_context(_locked(folder, _LOCK))
                for lock in folder.glob("part-*.lock"):
                    held.enter_context(_locked(folder, lock.name))
                for left in (*folder.glob(".*.part"), *folder.parent.glob(f".{result}.*.part")):
                    left.unlink(missing_ok=True)  # of a process that was killed while it wrote
        except BlockingIOError:
            what = f"part {part[0]}/{part[1]} of it" if part else "it"
            raise BusyError(f"another run is working on {folder.with_name(result)}, or on {what}") from None
        except OSError as error:
            raise ResultError(f"cannot write in {folder}: {error.strerror or error}") from error
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                if not part and {entry.name for entry in folder.iterdir()} <= {_LOCK}:
                    (folder / _LOCK).unlink()
                    folder.rmdir()


@contextlib.contextmanager
def _locked(folder: Path, name: str, *, patience: float = 0.0) -> Iterator[None]:
    """Lock a file that still has this name once the lock is held.

    Args:
        patience: seconds to wait for another process to release it.

    Raises:
        BlockingIOError: another process holds it.
    """
    until = time.monotonic() + patience
    while True:
        folder.mkdir(exist_ok=True)
        try:
            handle = os.open(folder / name, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:
            continue  # another has just removed the folder
        try:
            while not lock_descriptor(handle, blocking=False):
                if time.monotonic() >= until:
                    raise BlockingIOError
                time.sleep(0.01)
            if _is_at(handle, folder / name):
                yield
                return
        finally:
            os.close(handle)


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def read_job(folder: Path) -> Job | None:
    """The job of a folder; None where there is none, or one that is damaged."""
    try:
        content = json.loads((folder / _JOB).read_text())
        plan, cutting, provenance = (content["job"][part] for part in ("plan", "cutting", "provenance"))
        for key in ("order", "independent"):
            cutting[key] = tuple(cutting[key])
        for key in ("axes", "wholes"):
            cutting[key] = tuple(map(tuple, cutting[key]))
        job = Job(NumericalPlan(**plan), Cutting(**cutting), Provenance(**provenance))
        return job if content["id"] == job.id else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


class Origin(NamedTuple):
    """Origin of a job: the YAML, the text of the user's file if it names one, and what making it has cost."""

    config: str
    user_text: str | None
    spent: SecondsSpent


def publish(folder: Path, job: Job, origin: Origin) -> Job:
    """Put a job and its origin in a folder, unless a sound one is there already; return the job that is then there.

    Raises:
        ResultError: the folder or the disk refuses.
    """
    content = {"id": job.id, "job": asdict(job), **origin._asdict()}
    try:
        with tempfile.NamedTemporaryFile("w", prefix=f".{_JOB}.", suffix=".part", dir=folder, delete=False) as file:
            json.dump(content, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        try:
            if read_job(folder) is None:
                (folder / _JOB).unlink(missing_ok=True)
            with contextlib.suppress(FileExistsError):  # of two processes the first decides
                os.link(file.name, folder / _JOB)
        finally:
            os.unlink(file.name)
        sync(folder)
    except OSError as error:
        raise ResultError(f"cannot write in {folder}: {error.strerror or error}") from error
    return read_job(folder) or job


def origin(folder: Path) -> Origin:
    """Read the origin of the job of a folder.

    Raises:
        ResultError: the folder is gone.
    """
    try:
        content = json.loads((folder / _JOB).read_text())
    except OSError as error:
        raise ResultError(f"{folder} is gone, or what was in it") from error
    return Origin(content["config"], content["user_text"], SecondsSpent(*content["spent"]))


# ---- pieces


def piece_path(folder: Path, piece: Piece) -> Path:
    """File of a piece."""
    return folder / f"{piece.number:06d}.h5"


def write_piece(
    folder: Path,
    job: Job,
    piece: Piece,
    groups: Mapping[str, xr.Dataset],
    counts: Mapping[str, Mapping[str, int]],
    spent: SecondsSpent,
) -> TileRecord:
    """Write the groups of a piece, whole or not at all.

    Args:
        groups: by analysis; the axes are dimensions, with a place for each value of the piece.

    Raises:
        ResultError: the folder or the disk refuses.
    """
    if not folder.is_dir():
        raise ResultError(f"{folder} is gone, and the tiles in it")
    attrs = {
        "title": _title(job.cutting, piece),
        "jaxnh_version": job.provenance.versions["jaxnh"],
        "config_sha256": job.provenance.config_sha256,
        "job": job.id,
        "piece": piece.number,
        "axes": " ".join(job.cutting.names),
        "begin": np.array(piece.begin, int),
        "end": np.array(piece.end, int),
        "counts": json.dumps(counts),
        "spent": json.dumps(spent),
    }
    path = piece_path(folder, piece)
    return TileRecord(piece.number, path, store.write(path, attrs, groups), spent, counts)


def _title(cutting: Cutting, piece: Piece) -> str:
    places = [
        f"{name} {begin} to {end - 1} of {size}"
        for name, size, begin, end in zip(cutting.names, cutting.shape, piece.begin, piece.end, strict=True)
    ]
    return f"lanes of a sweep: {', '.join(places)}"


def receipt(folder: Path, job: Job, piece: Piece) -> TileRecord:
    """Read the record of a piece that is there.

    Raises:
        DamagedError: it does not belong to the job, or cannot be read.
    """
    path = piece_path(folder, piece)
    try:
        with h5py.File(path, "r") as file:
            attrs = store.attributes(file)
            names = set(store.groups(file))
        counts, spent = json.loads(attrs["counts"]), SecondsSpent(*json.loads(attrs["spent"]))
        seal, place = attrs[store.SEAL], (attrs["piece"], tuple(attrs["begin"]), tuple(attrs["end"]))
        same_config, same_job = attrs["config_sha256"] == job.provenance.config_sha256, attrs["job"] == job.id
    except store.UNREADABLE as error:
        raise DamagedError("it is cut off or damaged") from error
    if not same_config:
        raise DamagedError("it is of another config")
    if not same_job or place != (piece.number, piece.begin, piece.end) or names != set(piece.names):
        raise DamagedError("it is of another run of this config")
    return TileRecord(piece.number, path, seal, spent, counts)


def check(folder: Path, job: Job, piece: Piece) -> TileRecord:
    """Read a piece as a whole and compare it with its checksums.

    Raises:
        FileNotFoundError: it is not there.
        DamagedError: it is of no use.
    """
    path = piece_path(folder, piece)
    if not path.exists():
        raise FileNotFoundError(path)
    record = receipt(folder, job, piece)
    try:
        store.verify(path)
    except DamagedError as error:
        raise DamagedError(str(error).removeprefix(f"{path}: ")) from None
    return record


def clear(folder: Path) -> None:
    """Empty a folder that is held, but for the lock; the job first, so that pieces without a job are left-overs."""
    with contextlib.suppress(OSError):
        (folder / _JOB).unlink(missing_ok=True)
        for entry in folder.iterdir():
            if entry.name != _LOCK:
                entry.unlink(missing_ok=True)


def tidy(folder: Path) -> None:
    """Remove the tiles beside a finished result, left by a process that was killed before it removed them."""
    if not folder.is_dir():
        return
    with contextlib.suppress(BusyError, ResultError), hold(folder):
        job = read_job(folder)
        pieces = [piece for stage in job.cutting.stages() for piece in stage.pieces()] if job else []
        if all(piece_path(folder, piece).exists() for piece in pieces):
            clear(folder)
