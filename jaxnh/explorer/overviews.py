"""Overviews of a large plane: blocks of 2, 4, 8, ... lanes either way, made once and kept in a file beside the result.

A result itself is not written to. The overviews of `chart.h5` are in the folder `chart.h5.overviews`, a file a
quantity; where that cannot be written, in a folder that goes when the program ends. A result that has changed gets new
ones. Memory is that of some strips of lanes, however large the plane is.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxnh.exceptions import ResultError
from jaxnh.explorer.lane_blocks import LaneBlocks, Rule, lane_blocks
from jaxnh.storage.atomic import Sink, replace_atomically
from jaxnh.storage.hdf5 import SEAL, UNREADABLE, read, read_attrs, variable

_VERSION = 1  # of the rules and of the layout of the file
_STRIP = 1 << 21  # lanes that are read at once
_CHUNK = 256  # blocks either way that lie in the file together
_PARTS = 255  # of one that a share is kept in

_temporary: list[tempfile.TemporaryDirectory[str]] = []

Strip = Callable[[slice], np.ndarray]
"""The lanes of some places across, (across, up)."""


class Overviews:
    """Overviews of one quantity of a plane.

    Attributes:
        levels: how many there are; blocks of the k-th have 2^k lanes either way.
        share: of the lanes that they are made of, so far.
    """

    def __init__(
        self, result: Path | None, name: str, shape: tuple[int, int], rule: Rule, levels: int, strip: Strip
    ) -> None:
        """Nothing is read or made yet.

        Args:
            result: file that they are kept beside; None: it is no file.
            name: of the quantity.
            shape: of the plane, (across, up).
            rule: of a block.
            levels: how many there are to be.
            strip: reads lanes.
        """
        self._name, self._shape, self.levels, self._strip = name, shape, levels, strip
        self._rule: Rule = rule
        self._origin = {"version": _VERSION, "rule": rule, "levels": levels, "shape": shape, **_identity(result)}
        self._path = result.with_name(f"{result.name}.overviews") / f"{name}.h5" if result else None
        self._making: Iterator[float] | None = None
        self._there: bool | None = None
        self.share = 0.0

    @property
    def are_made(self) -> bool:
        """Return whether they can be read."""
        if self._there is None:
            self._there = self._path is not None and _origin_of(self._path) == _plain(self._origin)
        return self._there

    def make(self) -> None:
        """Make some more of them; whoever asks next goes on from there, or begins anew after an error.

        Raises:
            ResultError: the disk refuses.
        """
        making, self._making, self.share = self._making or self._strips(), None, 0.0
        self.share = next(making, 1.0)
        self._making, self._there = (making, False) if self.share < 1.0 else (None, True)

    def read(self, level: int, across: slice, up: slice) -> LaneBlocks:
        """Return blocks of a level.

        Raises:
            ResultError: the file cannot be read.
        """
        assert self._path is not None
        try:
            with h5py.File(self._path, "r") as file:
                values, share = (read(variable(file, f"{kind}_{level}"), (across, up)) for kind in ("values", "share"))
        except UNREADABLE as error:
            raise ResultError(f"{self._path} cannot be read: remove it, and it is made again") from error
        return LaneBlocks(values, share / _PARTS)

    # ---- how

    def _strips(self) -> Iterator[float]:
        """Make all of them strip by strip; yields the share that is made, and 1 where the file has its name."""
        with contextlib.ExitStack() as stack:
            sink = stack.enter_context(self._writable())
            file = stack.enter_context(h5py.File(sink, "w"))
            file.attrs.update(self._origin)
            whole = 1 << self.levels
            rows = whole * max(1, _STRIP // (self._shape[1] * whole))
            for begin in range(0, self._shape[0], rows):
                values = self._strip(slice(begin, min(begin + rows, self._shape[0])))
                for k, blocks in enumerate(lane_blocks(values, self._rule, [(2, 2)] * self.levels), start=1):
                    self._put(file, k, begin >> k, blocks)
                if begin + rows < self._shape[0]:
                    yield (begin + rows) / self._shape[0]
            file.close()
            sink.settle()

    def _put(self, file: h5py.File, level: int, begin: int, blocks: LaneBlocks) -> None:
        """Write blocks of a level, from a place across on."""
        kind = np.float32 if self._rule == "mean" else blocks.values.dtype
        shares = np.floor(_PARTS * blocks.share).astype(np.uint8)  # the last one is where there is nothing else
        for name, values in (("values", blocks.values.astype(kind)), ("share", shares)):
            name = f"{name}_{level}"
            if name not in file:
                shape: Any = tuple(-(-size >> level) for size in self._shape)
                chunks = tuple(min(size, _CHUNK) for size in shape)
                file.create_dataset(
                    name, shape, values.dtype, chunks=chunks, shuffle=True, compression="gzip", compression_opts=1
                )
            variable(file, name)[begin : begin + len(values)] = values

    @contextlib.contextmanager
    def _writable(self) -> Iterator[Sink]:
        """A new file that takes its name at the end: beside the result, or else in a folder of this program."""
        with contextlib.ExitStack() as stack:
            sink = None
            if self._path is not None:
                with contextlib.suppress(ResultError, OSError):
                    self._path.parent.mkdir(exist_ok=True)
                    sink = stack.enter_context(replace_atomically(self._path))
            if sink is None:
                _temporary.append(tempfile.TemporaryDirectory(prefix="jaxnh-overviews-"))
                self._path = Path(_temporary[-1].name) / f"{self._name}.h5"
                sink = stack.enter_context(replace_atomically(self._path))
            yield sink


def _identity(result: Path | None) -> dict[str, Any]:
    """Attributes that tell a result from what it may be changed into."""
    if result is None:
        return {}
    state, seal = result.stat(), str(read_attrs(result).get(SEAL, ""))
    return {"seal": seal} if seal else {"bytes": state.st_size, "changed": state.st_mtime_ns}


def _origin_of(path: Path) -> dict[str, Any] | None:
    try:
        with h5py.File(path, "r") as file:
            return _plain(dict(file.attrs))
    except UNREADABLE:
        return None


def _plain(attrs: dict[str, Any]) -> dict[str, Any]:
    return {key: np.asarray(value).tolist() for key, value in attrs.items()}
