"""A run of an experiment into a result file: it computes the missing tiles and merges all of them.

Nothing is printed here: notes and warnings go to `Progress`, and a summary is returned.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from threading import Lock
from typing import Any

from jaxnh.engine import dask_workers
from jaxnh.engine.batches import batches
from jaxnh.engine.compute import ComputedPiece, compute, seconds_spent
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.threads import run_side_by_side
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.finished_pieces import FinishedPieces
from jaxnh.engine.journal import with_journal
from jaxnh.engine.levels import files
from jaxnh.engine.levels.levels import Level, axes_of
from jaxnh.engine.output import other_than
from jaxnh.engine.plan import decide, work_of_pieces
from jaxnh.engine.progress import InterruptibleProgress, NullProgress, Progress
from jaxnh.engine.result_attributes import attributes, warnings_of
from jaxnh.engine.run_records import RunOptions, RunSummary
from jaxnh.engine.xla_options import configure, describe_differences, devices_of
from jaxnh.exceptions import ArgumentError, ResultError, RunError, Stopped
from jaxnh.jobs.arrays import import_beside
from jaxnh.jobs.cutting import Piece, share
from jaxnh.jobs.job import Job
from jaxnh.jobs.provenance import SecondsSpent, versions
from jaxnh.storage import tiles
from jaxnh.storage.atomic import same_file
from jaxnh.storage.calls import CallJournal, interrupted_batches
from jaxnh.storage.merge import DamagedPieceError, gather, merge
from jaxnh.storage.tiles import TileRecord

GO_ON = "run the same command again to go on where it stopped"
_ENOUGH = 4  # batches a core that are computed side by side; of fewer, which one may wait for, all cores share each


def run_to_file(
    experiment: Experiment, path: Path, how: RunOptions, progress: Progress, check: Callable[[], None] = lambda: None
) -> RunSummary:
    """Compute what is missing and write the result; the folder of the tiles is held meanwhile.

    Args:
        path: the result file.
        check: called often; may raise `Stopped`.

    Raises:
        ArgumentError: the folder holds tiles of something else, or there is nothing to merge.
        AccuracyError: no solver meets the target.
        ConfigError: the sweep is larger than is run unasked.
        BusyError: another process is at work on the same output.
        Stopped: `check` has raised it; what is done is kept.
        RunError: the run cannot go on; the message says what is kept.
    """
    began = time.perf_counter()
    import_beside()
    with tiles.hold(tiles.folder_of(path), how.part):
        return _Run(experiment, path, how, progress, check, began).run()


class _Waiting(Stopped):
    """A part has done its share of a level, and the next one needs that of the others."""


class _Run:
    """One run on a folder that is held."""

    def __init__(
        self,
        experiment: Experiment,
        path: Path,
        how: RunOptions,
        progress: Progress,
        check: Callable[[], None],
        began: float,
    ) -> None:
        self._experiment, self._path, self._how, self._check, self._began = experiment, path, how, check, began
        self._requested = experiment.requested()
        self._folder = tiles.folder_of(path)
        self._shown, self._progress = progress, InterruptibleProgress(progress, check)
        self._finished = FinishedPieces(self._folder, self._progress, check)
        self._pieces: list[Piece] = []  # this run's to do, of the levels up to the present one
        self._every = 0  # pieces of these levels
        self._level: Level | None = None
        self._workers = ExitStack()
        self._client: Any = None
        self._lanes: LaneExecutor | None = None
        self._one_at_a_time = Lock()  # of batches side by side
        self._earlier = 0.0  # seconds that earlier runs have spent on what is there

    def run(self) -> RunSummary:
        """Complete the result, or the part, one level after the other."""
        job = self._job()
        stages = job.stages()
        try:
            with self._workers:
                for stage in stages:
                    self._stage(job, stage)
            return self._summary(job, whole=not self._how.part)
        except _Waiting:
            raise
        except Stopped as end:
            raise Stopped(f"{end} with {len(self._finished.records)} of {len(self._pieces)} tiles done") from None
        except (ResultError, RunError) as error:
            kept = f"; {len(self._finished.records)} of {len(self._pieces)} tiles are kept: {GO_ON}"
            raise RunError(f"{error}{kept if self._folder.is_dir() else ''}") from error

    def _stage(self, job: Job, stage: Job) -> None:
        """Complete a level of the sweep, or without levels all of it."""
        cutting = stage.cutting
        part, last = self._how.part, cutting.level in (0, cutting.levels)
        if not self._how.merge:
            self._level = files.read(self._folder, job.cutting, cutting)
        every = [piece for piece in cutting.pieces() if not (part and cutting.is_whole(piece))]
        mine = every
        if part:
            mine = share(cutting, part, work_of_pieces(self._requested, cutting, every, self._level))
        self._pieces += mine
        self._every += len(every)
        self._find(stage, mine)
        while True:
            self._compute(stage, [piece for piece in mine if piece.number not in self._finished.records])
            if part and last:
                return
            if part:
                self._join(stage, every)
            try:
                if last:
                    self._merge(stage, self._path)
                    tiles.clear(self._folder)
                elif not self._how.merge:
                    self._publish(stage)
                return
            except DamagedPieceError as error:
                if error.piece.number in self._finished.dropped:  # computed anew, and the same: it is not the disk
                    raise RunError(f"tile {error.piece.number} does not fit the others: {error.why}") from error
                self._finished.drop(error.piece, error.why)

    def _join(self, stage: Job, every: Sequence[Piece]) -> None:
        """Check that the other parts have done their tiles of a level, and compute the groups of all tiles.

        Raises:
            _Waiting: they have not.
        """
        others = [piece for piece in every if piece.number not in self._finished.records]
        there = self._finished.sound(stage, others)
        if len(there) < len(others):
            (part, parts), cutting = self._how.part or (1, 1), stage.cutting
            raise _Waiting(
                f"part {part}/{parts} of level {cutting.level} of {cutting.levels} is done, "
                f"and {len(others) - len(there)} tiles of other parts are not"
            )
        last = [piece for piece in stage.cutting.pieces() if stage.cutting.is_whole(piece)]
        missing = set(last) - set(self._finished.sound(stage, last))
        self._compute(stage, sorted(missing))

    def _job(self) -> Job:
        """The job of the folder if it is of this config, else a new one."""
        job = tiles.read_job(self._folder)
        if job is not None:
            other = ""
            if job.provenance.config_sha256 != self._experiment.sha256:
                other = f"of {other_than(self._experiment, tiles.origin(self._folder).user_text)}"
            elif dict(job.provenance.versions) != versions():
                other = "of other versions of the libraries"
            other = other or self._machine_differences(job)
            if not other:
                self._earlier = tiles.origin(self._folder).spent.seconds
                return job
            if not self._how.fresh or self._how.part:
                remedy = "without --part drops them" if self._how.part else "drops them"
                raise ArgumentError("output", f"{self._folder} holds tiles {other}", remedy)
            tiles.clear(self._folder)
        if self._how.merge:
            raise ArgumentError("merge", f"there are no tiles in {self._folder}")
        lanes = self._make_lanes()
        machine = dask_workers.machine(self._how.dask, lanes, self._experiment.device, self._check)
        parts = self._how.part[1] if self._how.part else 1
        job = decide(self._experiment, lanes, self._how.tile, parts, machine, asked=self._how.yes)
        self._check()
        cost = seconds_spent(lanes, time.perf_counter() - self._began)
        own = self._experiment.user_file
        return tiles.publish(self._folder, job, tiles.Origin(self._experiment.text, own and own.text, cost))

    def _machine_differences(self, job: Job) -> str:
        """Return how the machines of a job differ from this one, which is to go on with it; "" where they do not.

        Joining tiles computes nothing, and Dask workers look for themselves.
        """
        if self._how.dask or (self._how.merge and not job.cutting.wholes):
            return ""
        return describe_differences(job.provenance.machine, self._make_lanes().machine)

    def _make_lanes(self) -> LaneExecutor:
        if self._lanes is None:
            configure()
            self._lanes = LaneExecutor(self._progress, devices_of(self._experiment))
        return self._lanes

    def _find(self, job: Job, pieces: Sequence[Piece]) -> None:
        """Note the pieces that are done; damaged ones are dropped."""
        there = self._finished.sound(job, pieces)
        self._finished.dropped.clear()
        self._earlier += sum(self._finished.records[piece.number].spent.seconds for piece in there)
        if there:
            level = f" of level {job.cutting.level}" if job.cutting.level else ""
            self._progress.note(f"{len(there)} of {len(pieces)} tiles{level} are done; going on")

    def _compute(self, job: Job, missing: list[Piece]) -> None:
        if not missing:
            return
        last = [piece for piece in missing if job.cutting.is_whole(piece)]
        missing = [piece for piece in missing if not job.cutting.is_whole(piece)]
        if self._how.merge and missing:
            lost = ", ".join(str(piece.number) for piece in missing[:8]) + (", …" if len(missing) > 8 else "")
            raise ArgumentError(
                "merge", f"{len(missing)} of {len(self._pieces)} tiles are missing ({lost}); run their parts again"
            )
        cost = work_of_pieces(self._requested, job.cutting, [*missing, *last], self._level)
        if self._how.dask:
            self._run_stage(job, [*missing, *last], cost, lambda: self._on_workers(job, (missing, last), cost))
            return
        lanes = self._make_lanes()
        tile_batches = self._batches(job, missing, lanes)
        cut = [batch for batch in tile_batches if batch[0].names == job.cutting.independent]
        if len(cut) > 1:
            tile_batches = [batch for batch in tile_batches if batch[0].names != job.cutting.independent]
            pieces = [piece for batch in cut for piece in batch]

            def all_of_them() -> None:
                if lanes.on_card or (len(lanes.devices) > 1 and len(cut) >= _ENOUGH * len(lanes.devices)):
                    run_side_by_side(lanes, cut, lambda subset, runner: self._run_batches(job, subset, runner, cost))
                else:
                    self._run_batches(job, cut, lanes, cost)

            self._run_stage(job, pieces, cost, all_of_them)
        self._run_batches(job, tile_batches, lanes, {})
        self._run_batches(job, [[piece] for piece in last], lanes, {})  # what they are made of has been written

    def _batches(self, job: Job, missing: Sequence[Piece], lanes: LaneExecutor) -> list[list[Piece]]:
        """Batches of pieces, first those that a stopped run has begun."""
        rest, ready = {piece.number: piece for piece in missing}, list[list[Piece]]()
        for numbers in interrupted_batches(self._folder, job):
            if rest.keys() >= set(numbers):  # those of another part are not ours to go on with
                ready.append([rest.pop(number) for number in numbers])
        axes, left = axes_of(self._experiment.axes, job.cutting), list(rest.values())
        return ready + batches(self._experiment, axes, self._requested, job, left, lanes, self._level)

    def _run_stage(self, job: Job, pieces: Sequence[Piece], cost: dict[int, float], body: Callable[[], object]) -> None:
        """Show many pieces as one stage."""
        names = ", ".join(dict.fromkeys(name for piece in pieces for name in piece.names))
        level = f" of level {job.cutting.level} of {job.cutting.levels}" if job.cutting.level else ""
        label = f"{names}: {len(pieces)} tiles{level}"
        self._shown.start(label, sum(cost[piece.number] for piece in pieces))
        self._progress.shown = NullProgress()
        try:
            body()
        finally:
            self._progress.shown = self._shown
            self._shown.finish()

    def _run_batches(
        self, job: Job, tile_batches: Iterable[Sequence[Piece]], lanes: LaneExecutor, cost: dict[int, float]
    ) -> None:
        """Compute batches one after the other; each is written while the next is computed."""
        written: list[Future[list[TileRecord]]] = []
        axes = axes_of(self._experiment.axes, job.cutting)

        def settle() -> None:
            while written:
                for receipt in written.pop().result():
                    self._done(receipt, cost)

        with ThreadPoolExecutor(1) as writer:
            try:
                for batch in tile_batches:
                    self._check()
                    calls = CallJournal(self._folder, job, batch)
                    if calls.seconds:
                        with self._one_at_a_time:
                            self._earlier += calls.seconds
                        numbers = ", ".join(str(piece.number) for piece in batch)
                        self._progress.note(f"tiles {numbers}: going on after {calls.seconds:.0f} s of work")
                    with with_journal(lanes, calls) as keeping:
                        computed = compute(
                            self._experiment,
                            axes,
                            self._requested,
                            job,
                            batch,
                            keeping,
                            lambda name: gather(self._folder, job.cutting, name),
                            self._level,
                            calls.seconds,
                        )
                    settle()
                    written.append(writer.submit(self._write, job, computed, calls))
            finally:
                settle()

    def _write(self, job: Job, computed: Sequence[ComputedPiece], calls: CallJournal) -> list[TileRecord]:
        receipts = [tiles.write_piece(self._folder, job, *done) for done in computed]
        calls.close(remove=True)
        return receipts

    def _on_workers(self, job: Job, stages: Sequence[Sequence[Piece]], cost: dict[int, float]) -> None:
        if self._client is None:
            self._client = self._workers.enter_context(dask_workers.cluster(self._how.dask or ""))
        dask_workers.run(self._client, self._folder, job, stages, self._check, lambda piece: self._done(piece, cost))

    def _done(self, receipt: TileRecord, cost: dict[int, float]) -> None:
        with self._one_at_a_time:
            self._finished.records[receipt.number] = receipt
            self._shown.advance(cost.get(receipt.number, 0.0))

    def _spent(self) -> SecondsSpent:
        """Cost of all runs for the pieces that are there."""
        costs = [tiles.origin(self._folder).spent, *(receipt.spent for receipt in self._finished.records.values())]
        return SecondsSpent(
            self._earlier + time.perf_counter() - self._began,
            sum(cost.compile_seconds for cost in costs),
            sum(cost.lane_periods for cost in costs),
            ", ".join(dict.fromkeys(cost.device for cost in costs)),
        )

    def _publish(self, stage: Job) -> None:
        """Write the result of a level into the folder, for the next level, and as the result so far."""
        kept = files.path_of(self._folder, stage.cutting)
        if not files.is_there(self._folder, stage.cutting):
            self._merge(stage, kept)
        same_file(kept, self._path)

    def _merge(self, job: Job, path: Path) -> None:
        self._total = self._spent()
        attrs = attributes(self._experiment, job, self._total, self._how.command)
        counted = {number: receipt.counts for number, receipt in self._finished.records.items()}
        warnings, virtual = warnings_of(job.cutting, counted), self._how.merge == "virtual"
        merge(path, attrs, self._folder, job.cutting, warnings, self._check, virtual=virtual)

    def _summary(self, job: Job, *, whole: bool) -> RunSummary:
        lanes = self._lanes
        return RunSummary(
            job,
            self._total if whole else self._spent(),
            time.perf_counter() - self._began,
            lanes.accounts.compile_seconds if lanes else 0.0,
            lanes.accounts.run_seconds if lanes else 0.0,
            (len(self._pieces), self._every),
            whole,
        )
