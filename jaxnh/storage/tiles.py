"""Tiles on disk: the folder beside a result in which a run keeps what it has done, until the result is whole. No JAX.

A sweep is cut into tiles, contiguous shares of its values of b; what cannot be cut is one piece of work as a whole. All
that is decided for the sweep as a whole stands in `job.json`, made once: pieces of any process fit together bit for
bit. A piece is there whole or not at all, and says which job it is of. A lock keeps other runs away from a result; it
belongs to a process, so that a dead one leaves none behind.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import h5py

import jaxnh
from jaxnh.storage import hdf5 as store

if TYPE_CHECKING:
    from jaxnh.analyses.base import Group

_JOB, _LOCK = "job.json", "lock"
_WORK = 2e6  # lane-periods a tile: ten to thirty seconds on one core
_BYTES = 1 << 26  # of results a tile
_MOST_TILES = 1 << 14
_FEWEST_LANES = 16


class Busy(Exception):
    """Another process works on the same output; the message says on what."""


class Damaged(Exception):
    """A piece is there and is of no use; the message says why."""


@dataclass(frozen=True)
class Job:
    """What is decided once for a sweep and holds for every process that works on it.

    Attributes:
        config_sha256: hash of the config.
        versions: of the package and the libraries that the numbers rest on.
        solver, steps, compensated, error_estimate: what a period is computed with.
        chosen: what analyses have chosen from the whole sweep.
        order: names of the analyses in the order of the result.
        split: those whose lanes know nothing of each other; the others are pieces of work as a whole.
        lanes: number of values of b.
        tile: lanes a tile.
    """

    config_sha256: str
    versions: Mapping[str, str]
    solver: str
    steps: int
    compensated: bool
    error_estimate: float
    chosen: Mapping[str, Mapping[str, int]]
    order: tuple[str, ...]
    split: tuple[str, ...]
    lanes: int
    tile: int

    @property
    def id(self) -> str:
        """Hash of all of it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    def pieces(self) -> list[Piece]:
        """All pieces of work: the tiles, then the analyses that cannot be cut."""
        starts = range(0, self.lanes, self.tile) if self.split else ()
        found = [Piece(k, self.split, at, min(at + self.tile, self.lanes)) for k, at in enumerate(starts)]
        whole = [name for name in self.order if name not in self.split]
        return found + [Piece(len(found) + k, (name,), 0, self.lanes) for k, name in enumerate(whole)]


class Piece(NamedTuple):
    """A piece of work: its number, the analyses in it, and the first lane and the one after the last."""

    number: int
    names: tuple[str, ...]
    first: int
    end: int


class Spent(NamedTuple):
    """What a piece has cost: seconds, of these compiling, lane-periods, and the devices."""

    seconds: float
    compile_seconds: float
    lane_periods: float
    device: str


class Receipt(NamedTuple):
    """A piece that is done: its number, its file and that file's seal, what it has cost, and what was counted in it."""

    number: int
    path: Path
    seal: str
    spent: Spent
    counts: Mapping[str, Mapping[str, int]]


def tile_lanes(work: float, numbers: float, lanes: int) -> int:
    """Lanes a tile, from the config alone: a power of two for ten to thirty seconds of work and not too many bytes.

    Args:
        work: lane-periods a lane.
        numbers: numbers that a lane leaves.
        lanes: lanes of the sweep.
    """
    wanted = min(max(_WORK, work * lanes / _MOST_TILES) / max(work, 1e-9), _BYTES / (8 * max(numbers, 1)), 1 << 20)
    return max(_FEWEST_LANES, 1 << (max(int(wanted), 1).bit_length() - 1))


# ---- the folder, its lock and its job


def folder_of(path: Path) -> Path:
    """Folder of the tiles of a result."""
    return path.with_name(f"{path.name}.tiles")


@contextlib.contextmanager
def hold(folder: Path, part: tuple[int, int] | None = None) -> Iterator[None]:
    """Make the folder and keep others out: all of them, or for part (k, n) those of the same part and of the whole.

    The lock goes with the process however it ends. At the end an empty folder goes as well.

    Raises:
        Busy: another process is at work.
        store.StoreError: the folder cannot be made.
    """
    result = folder.name.removesuffix(".tiles")
    with contextlib.ExitStack() as held:
        try:
            held.enter_context(_locked(folder, _LOCK, shared=part is not None))
            if part:
                held.enter_context(_locked(folder, f"part-{part[0]}-of-{part[1]}.lock", shared=False))
            else:
                for left in (*folder.glob(".*.part"), *folder.parent.glob(f".{result}.*.part")):
                    left.unlink(missing_ok=True)  # of a process that was killed while it wrote
        except BlockingIOError:
            what = f"part {part[0]}/{part[1]} of it" if part else "it"
            raise Busy(f"another run is working on {folder.with_name(result)}, or on {what}") from None
        except OSError as error:
            raise store.StoreError(f"cannot write in {folder}: {error.strerror or error}") from error
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                if not part and {entry.name for entry in folder.iterdir()} <= {_LOCK}:
                    (folder / _LOCK).unlink()
                    folder.rmdir()


@contextlib.contextmanager
def _locked(folder: Path, name: str, *, shared: bool) -> Iterator[None]:
    """A lock on a file that is still the one of this name once the lock is had."""
    while True:
        folder.mkdir(exist_ok=True)
        try:
            handle = os.open(folder / name, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:
            continue  # another has just removed the folder
        try:
            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
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
        job = Job(
            **{**content["job"], "order": tuple(content["job"]["order"]), "split": tuple(content["job"]["split"])}
        )
        return job if content["id"] == job.id else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


class Origin(NamedTuple):
    """What a job was made for: the YAML, the text of the user's file if it names one, and what making it has cost."""

    config: str
    own_text: str | None
    spent: Spent


def publish(folder: Path, job: Job, origin: Origin) -> Job:
    """Put a job and its origin in a folder, unless a sound one is there already; the one that counts.

    Raises:
        store.StoreError: the folder or the disk refuses.
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
        store.sync(folder)
    except OSError as error:
        raise store.StoreError(f"cannot write in {folder}: {error.strerror or error}") from error
    return read_job(folder) or job


def origin(folder: Path) -> Origin:
    """What the job of a folder was made for.

    Raises:
        store.StoreError: the folder is gone.
    """
    try:
        content = json.loads((folder / _JOB).read_text())
    except OSError as error:
        raise store.StoreError(f"{folder} is gone, or what was in it") from error
    return Origin(content["config"], content["own_text"], Spent(*content["spent"]))


# ---- pieces


def piece_path(folder: Path, piece: Piece) -> Path:
    """File of a piece."""
    return folder / f"{piece.number:06d}.h5"


def write_piece(
    folder: Path, job: Job, piece: Piece, groups: Mapping[str, Group], counts: Mapping[str, Any], spent: Spent
) -> Receipt:
    """Write the groups of a piece, whole or not at all.

    Raises:
        store.StoreError: the folder or the disk refuses.
    """
    if not folder.is_dir():
        raise store.StoreError(f"{folder} is gone, and the tiles in it")
    attrs = {
        "title": f"lanes {piece.first} to {piece.end - 1} of a sweep of {job.lanes}",
        "jaxnh_version": jaxnh.__version__,
        "config_sha256": job.config_sha256,
        "job": job.id,
        "piece": piece.number,
        "first": piece.first,
        "end": piece.end,
        "counts": json.dumps(counts),
        "spent": json.dumps(spent),
    }
    path = piece_path(folder, piece)
    return Receipt(piece.number, path, store.write(path, attrs, groups), spent, counts)


def receipt(folder: Path, job: Job, piece: Piece) -> Receipt:
    """What a piece that is there says of itself.

    Raises:
        Damaged: it says something that does not fit, or cannot be read.
    """
    path = piece_path(folder, piece)
    try:
        with h5py.File(path, "r") as file:
            attrs = store.attributes(file)
            names = set(file)
        counts, spent = json.loads(attrs["counts"]), Spent(*json.loads(attrs["spent"]))
        seal, place = attrs[store.SEAL], (attrs["piece"], attrs["first"], attrs["end"])
        same_config, same_job = attrs["config_sha256"] == job.config_sha256, attrs["job"] == job.id
    except Exception as error:  # whatever HDF5 makes of damaged tables
        raise Damaged("it is cut off or damaged") from error
    if not same_config:
        raise Damaged("it is of another config")
    if not same_job or place != (piece.number, piece.first, piece.end) or names != set(piece.names):
        raise Damaged("it is of another run of this config")
    return Receipt(piece.number, path, seal, spent, counts)


def check(folder: Path, job: Job, piece: Piece) -> Receipt:
    """Read a piece as a whole and compare it with its checksums.

    Raises:
        FileNotFoundError: it is not there.
        Damaged: it is of no use.
    """
    path = piece_path(folder, piece)
    if not path.exists():
        raise FileNotFoundError(path)
    found = receipt(folder, job, piece)
    try:
        store.verify(path)
    except store.StoreError as error:
        raise Damaged(str(error).removeprefix(f"{path}: ")) from None
    return found


def share(pieces: Sequence[Piece], part: tuple[int, int]) -> Sequence[Piece]:
    """The pieces of part (k, n), k from 1: neighbours, and for n parts every piece in exactly one."""
    k, n = part
    return pieces[(k - 1) * len(pieces) // n : k * len(pieces) // n]


def clear(folder: Path) -> None:
    """Remove what is in a folder that is held, but for the lock; the job first: pieces without one are left-overs."""
    with contextlib.suppress(OSError):
        (folder / _JOB).unlink(missing_ok=True)
        for entry in folder.iterdir():
            if entry.name != _LOCK:
                entry.unlink(missing_ok=True)


def tidy(folder: Path) -> None:
    """Beside a result that is there: remove what a process left that was killed between the two."""
    if not folder.is_dir():
        return
    with contextlib.suppress(Busy, store.StoreError), hold(folder):
        job = read_job(folder)
        if job is None or all(piece_path(folder, piece).exists() for piece in job.pieces()):
            clear(folder)
