"""Pieces of a run that are done: their records, and those that are damaged and dropped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from jaxnh.engine.progress import Progress
from jaxnh.exceptions import DamagedError
from jaxnh.jobs.cutting import Piece
from jaxnh.jobs.job import Job
from jaxnh.storage import tiles
from jaxnh.storage.tiles import TileRecord


class FinishedPieces:
    """Pieces of a folder that are done.

    Attributes:
        records: of each, by its number.
        dropped: numbers of those that were damaged, to be computed again.
    """

    def __init__(self, folder: Path, progress: Progress, check: Callable[[], None]) -> None:
        self.records: dict[int, TileRecord] = {}
        self.dropped: set[int] = set()
        self._folder, self._progress, self._check = folder, progress, check

    def sound(self, job: Job, pieces: Sequence[Piece]) -> list[Piece]:
        """Return the pieces that are there and sound; damaged ones are dropped."""
        for piece in pieces:
            try:
                self.records[piece.number] = tiles.check(self._folder, job, piece)
            except FileNotFoundError:
                continue
            except DamagedError as error:
                self.drop(piece, str(error))
            self._check()
        return [piece for piece in pieces if piece.number in self.records]

    def drop(self, piece: Piece, why: str) -> None:
        """Remove a piece, with a warning that says why."""
        self.records.pop(piece.number, None)
        self.dropped.add(piece.number)
        path = tiles.piece_path(self._folder, piece)
        path.unlink(missing_ok=True)
        self._progress.warn(f"{path}: {why}; it is computed again")
