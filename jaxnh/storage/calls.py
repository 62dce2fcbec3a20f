"""Journal of pieces in hand: results of calls of programs, in a file beside the tiles. No JAX.

A piece may take hours, as a state that is carried along a parameter does. The results of its calls are appended to one
file every few seconds, so that a run that is killed loses no more. A later run makes the same calls in the same order,
and finds theirs; once the tiles of the pieces are written the file goes.

Every record has a checksum, is of one job and names its pieces; whatever follows a truncated one is dropped. Nothing in
it is code: arrays are in NumPy's own format.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from filelock import lock_descriptor

from jaxnh.jobs.cutting import Piece
from jaxnh.jobs.job import Job

_OFTEN = 5.0  # seconds of work that may be lost
_BYTES = 1 << 25  # a second that are written at most, on average: a few per cent of what a disk takes
_HEAD = 16 + 1 + 64 + 1  # of a record: its length and checksum, hexadecimal


class JournalEntry(NamedTuple):
    """Results of one call for neighbouring lanes.

    Attributes:
        call: number of the call among those for these pieces.
        first: the first of its lanes.
        digest: of the function and all arguments of the call.
        leaves: the results, each with these lanes as first axis.
    """

    call: int
    first: int
    digest: str
    leaves: tuple[np.ndarray, ...]


class CallJournal:
    """Results of the calls for some pieces: those in a folder, and those that are added.

    Attributes:
        seconds: cost of the results in the folder.
    """

    def __init__(self, folder: Path, job: Job, pieces: Sequence[Piece]) -> None:
        self._path = folder / f"{pieces[0].number:06d}.calls"
        self._of = {"job": job.id, "pieces": [piece.number for piece in pieces]}
        self._parts: dict[int, dict[int, JournalEntry]] = {}
        self._new: list[JournalEntry] = []
        self._size = 0  # of these, in bytes
        self._handle: int | None = None
        self._closed = False
        self._adding = threading.Lock()
        self._since = time.monotonic()
        self.seconds, self._sound = 0.0, 0
        for head, parts, end in _records(self._path):
            if {key: head[key] for key in self._of} != self._of:
                break
            self.seconds, self._sound = self.seconds + head["seconds"], end
            for part in parts:
                self._parts.setdefault(part.call, {})[part.first] = part

    def take_entries(self, call: int, digest: str) -> list[JournalEntry]:
        """The parts of a call that are there, one after the other from its first lane on."""
        parts, last = list[JournalEntry](), 0
        there = self._parts.pop(call, {})
        while last in there and there[last].digest == digest and there[last].leaves:
            parts.append(there[last])
            last += len(there[last].leaves[0])
        return parts

    def add(self, part: JournalEntry) -> None:
        """Add a part; it is written with others after some seconds of work. Threads may add side by side."""
        with self._adding:
            self._new.append(part)
            self._size += sum(leaf.nbytes for leaf in part.leaves)
            if time.monotonic() - self._since > max(_OFTEN, self._size / _BYTES):
                self.flush()

    def flush(self) -> None:
        """Write all parts to the disk; on a full disk the journal is dropped, since the tiles need the room."""
        if not self._new:
            return
        seconds = time.monotonic() - self._since
        try:
            handle = self._open()
            if handle is not None:
                with open(handle, "wb", closefd=False) as file:
                    file.write(_record({**self._of, "seconds": seconds}, self._new))
                os.fsync(handle)
        except OSError:  # where a tile cannot be written either, that is said
            self.close(remove=True)
            self._closed = True
        self._new, self._size, self._since = [], 0, time.monotonic()

    def _open(self) -> int | None:
        """The file, at the end of its sound records; None where another process has it, as a worker thought lost."""
        if self._handle is None and not self._closed:
            self._handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            if lock_descriptor(self._handle, blocking=False):
                os.ftruncate(self._handle, self._sound)
                os.lseek(self._handle, 0, os.SEEK_END)
            else:
                os.close(self._handle)
                self._handle, self._closed = None, True
        return self._handle

    def close(self, *, remove: bool) -> None:
        """Close the file: remove it, or write all parts to it."""
        if not remove:
            self.flush()
        with contextlib.suppress(OSError):
            if self._handle is not None:
                os.close(self._handle)
            if remove:
                self._path.unlink(missing_ok=True)
        self._handle = None


def interrupted_batches(folder: Path, job: Job) -> list[list[int]]:
    """Numbers of the pieces of which a stopped run of a job has left results, in the batches it computed them in."""
    batches: list[list[int]] = []
    for path in sorted(folder.glob("*.calls")):
        for head, _, _ in _records(path):
            if head["job"] == job.id:
                batches.append(head["pieces"])
            break
    return batches


def _record(head: dict[str, Any], parts: Sequence[JournalEntry]) -> bytes:
    content = io.BytesIO()
    listed = [[part.call, part.first, part.digest, len(part.leaves)] for part in parts]
    content.write(json.dumps({**head, "parts": listed}).encode() + b"\n")
    for part in parts:
        for leaf in part.leaves:
            np.lib.format.write_array(content, leaf, allow_pickle=False)
    data = content.getvalue()
    return f"{len(data):016x} {hashlib.sha256(data).hexdigest()}\n".encode() + data


def _records(path: Path) -> Any:
    """Head, parts and end of every record of a file, up to the first that is not whole."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError), path.open("rb") as file:
        while len(mark := file.read(_HEAD)) == _HEAD:
            data = file.read(int(mark[:16], 16))
            if hashlib.sha256(data).hexdigest().encode() != mark[17:-1]:
                return
            content = io.BytesIO(data)
            head = json.loads(content.readline())
            parts = [
                JournalEntry(
                    call,
                    first,
                    digest,
                    tuple(np.lib.format.read_array(content, allow_pickle=False) for _ in range(count)),
                )
                for call, first, digest, count in head["parts"]
            ]
            yield head, parts, file.tell()
