"""Files that are there whole or not at all: a temporary name first, the final one at the end. Nothing of HDF5."""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from jaxnh.exceptions import ResultError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer


class Sink(io.RawIOBase):
    """A file for HDF5 that accepts every write: HDF5 cannot close a file that a full disk kept it from writing.

    The first error is kept in `error`, and from then on nothing is written.

    Attributes:
        path: its temporary name.
        error: the first error that a write has met.
    """

    def __init__(self, handle: int, path: Path) -> None:
        self.path = path
        self.error: OSError | None = None
        self._handle, self._at = handle, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: os.fstat(self._handle).st_size}[whence]
        self._at = base + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        view = memoryview(buffer).cast("B")
        data = os.pread(self._handle, len(view), self._at)
        view[: len(data)] = data
        view[len(data) :] = bytes(len(view) - len(data))
        self._at += len(view)
        return len(view)

    def write(self, buffer: ReadableBuffer, /) -> int:
        view = memoryview(buffer).cast("B")
        done = 0
        while self.error is None and done < len(view):
            try:
                done += os.pwrite(self._handle, view[done:], self._at + done)
            except OSError as error:
                self.error = error
        self._at += len(view)
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        size = self._at if size is None else size
        try:
            os.ftruncate(self._handle, size)
        except OSError as error:
            self.error = self.error or error
        return size

    def check(self) -> None:
        """Raise the error that a write has met."""
        if self.error is not None:
            raise self.error

    def settle(self) -> None:
        """Write all of it through to the disk, with the permissions of new files."""
        self.check()
        os.fchmod(self._handle, 0o666 & ~_umask())
        os.fsync(self._handle)


@contextlib.contextmanager
def replace_atomically(path: Path) -> Iterator[Sink]:
    """A new file beside `path`, which takes its name where the context ends without an exception.

    Killed at any moment, this leaves either what was there before or the whole file under the final name. The caller
    settles the file (`Sink.settle`) last of all.

    Raises:
        ResultError: the folder or the disk refuses.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    except OSError as error:
        raise ResultError(f"cannot write in {path.parent}: {error.strerror or error}") from error
    sink = Sink(handle, Path(name))
    try:
        yield sink
        sink.path.replace(path)
        sync(path.parent)
    except (OSError, RuntimeError) as error:
        raise ResultError(f"cannot write {path}: {sink.error or error}") from error
    finally:
        os.close(handle)
        with contextlib.suppress(OSError):
            sink.path.unlink(missing_ok=True)


def same_file(source: Path, path: Path) -> None:
    """Give a finished file a second name, replacing what has that name.

    Raises:
        ResultError: the folder or the disk refuses.
    """
    try:
        name = path.with_name(f".{path.name}.{os.getpid()}.part")
        name.unlink(missing_ok=True)
        name.hardlink_to(source)
        name.replace(path)
        sync(path.parent)
    except OSError as error:
        raise ResultError(f"cannot write {path}: {error.strerror or error}") from error


def check_writable(path: Path) -> None:
    """Make the folder of an output and check that a file can be made in it.

    Raises:
        ResultError: it cannot; the message names the folder and the reason.
    """
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "a device or a pipe"
        raise ResultError(f"{path} is {what}, not a file to write")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ResultError(f"cannot write in {path.parent}: {error.strerror or error}") from error


def target_of(path: Path) -> Path:
    """The file that an output path stands for: the target of a link, whether it exists or not.

    Raises:
        ResultError: links that point to each other.
    """
    try:
        target = path.resolve() if path.is_symlink() else path
    except (OSError, RuntimeError):
        target = path
    if target.is_symlink():  # in a circle
        raise ResultError(f"{path} is a link that leads nowhere")
    return target


def sync(path: Path) -> None:
    """Write the content of a file or folder through to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
