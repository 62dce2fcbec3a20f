"""One run of a sweep: what is done already, what is missing, and the result once all is there."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

import jaxnh
from jaxnh.analyses.base import Group, Variable
from jaxnh.cli import terminal
from jaxnh.cli.command import Account, account, other_than, provenance, versions
from jaxnh.cli.exit_codes import GO_ON, Failed, Refused, Stop, Unfinished
from jaxnh.config.experiment import Experiment
from jaxnh.engine import dask_workers as workers
from jaxnh.engine import plan as work
from jaxnh.engine.lanes import Lanes, Silent
from jaxnh.engine.xla_options import configure
from jaxnh.storage import hdf5 as store
from jaxnh.storage import tiles
from jaxnh.storage.merge import Extra, Unusable, merge
from jaxnh.storage.tiles import Job, Piece, Receipt, Spent

_LOG_WIDTH = 100  # columns of a table that goes to a file


class How(NamedTuple):
    """How a sweep is to be run: part (k, n), merge alone, cluster, lanes a tile, without a word."""

    part: tuple[int, int] | None
    merge: bool
    dask: str | None
    tile: int | None
    quiet: bool


class _Heeding:
    """Progress of a stage, which is also where a run comes to a place to stop."""

    def __init__(self, shown: Any, heed: Callable[[], None]) -> None:
        self.shown, self._heed = shown, heed

    def start(self, label: str, total: float) -> None:
        self._heed()
        self.shown.start(label, total)

    def advance(self, amount: float) -> None:
        self.shown.advance(amount)
        self._heed()

    def finish(self) -> None:
        self.shown.finish()


class Run:
    """One run of the command on a folder that is held."""

    def __init__(self, experiment: Experiment, path: Path, how: How, stop: Stop, began: float) -> None:
        self._experiment, self._path, self._how, self._stop, self._began = experiment, path, how, stop, began
        self._folder = tiles.folder_of(path)
        self._console = Console()
        if not self._console.is_terminal:
            self._console = Console(width=_LOG_WIDTH)
        self._shown = Silent() if how.quiet else terminal.progress(Console(stderr=True))
        self._progress = _Heeding(self._shown, stop.check)
        self._receipts: dict[int, Receipt] = {}
        self._pieces: Sequence[Piece] = ()
        self._lanes: Lanes | None = None
        self._earlier = 0.0  # seconds that earlier runs have spent on what is there

    def run(self, fresh: bool) -> None:
        """Everything from what is there to the result, or to the end of the part."""
        job = self._job(fresh)
        every = job.pieces()
        self._pieces = tiles.share(every, self._how.part) if self._how.part else every
        self._find(job)
        self._earlier += sum(receipt.spent.seconds for receipt in self._receipts.values())
        try:
            while True:
                self._compute(job, [piece for piece in self._pieces if piece.number not in self._receipts])
                if self._how.part:
                    self._say(
                        f"part {self._how.part[0]}/{self._how.part[1]}: {len(self._pieces)} of {len(every)} tiles"
                    )
                    return
                try:
                    self._finish(job)
                    return
                except Unusable as error:
                    self._drop(error.piece, error.why)
        except Unfinished as end:
            raise Unfinished(f"{end} with {len(self._receipts)} of {len(self._pieces)} tiles done") from None
        except (store.StoreError, Failed) as error:
            kept = f"; {len(self._receipts)} of {len(self._pieces)} tiles are kept: {GO_ON}"
            raise Failed(f"{error}{kept if self._folder.is_dir() else ''}") from error

    def _job(self, fresh: bool) -> Job:
        """The job of the folder if it is of this config, else a new one."""
        job = tiles.read_job(self._folder)
        if job is not None:
            now = {"jaxnh": jaxnh.__version__, **versions()}
            other = ""
            if job.config_sha256 != self._experiment.sha256:
                other = f"of {other_than(self._experiment, tiles.origin(self._folder).own_text)}"
            other = other or ("of other versions of the libraries" if dict(job.versions) != now else "")
            if not other:
                self._earlier = tiles.origin(self._folder).spent.seconds
                return job
            if not fresh or self._how.part:
                raise Refused(f"command line: --output: {self._folder} holds tiles {other}; --fresh drops them")
            tiles.clear(self._folder)
        if self._how.merge:
            raise Refused(f"command line: --merge: there are no tiles in {self._folder}")
        lanes = self._make_lanes()
        job = work.decide(self._experiment, lanes, self._how.tile)
        self._stop.check()
        spent = account(lanes, time.perf_counter() - self._began)
        own = self._experiment.own
        return tiles.publish(self._folder, job, tiles.Origin(self._experiment.text, own and own.text, Spent(*spent)))

    def _make_lanes(self) -> Lanes:
        if self._lanes is None:
            configure()
            self._lanes = Lanes(self._progress)
        return self._lanes

    def _find(self, job: Job) -> None:
        """Which pieces are done; those that are there and of no use are dropped."""
        for piece in self._pieces:
            try:
                self._receipts[piece.number] = tiles.check(self._folder, job, piece)
            except FileNotFoundError:
                continue
            except tiles.Damaged as error:
                self._drop(piece, str(error))
            self._stop.check()
        if self._receipts:
            self._say(f"{len(self._receipts)} of {len(self._pieces)} tiles are done; going on", err=True)

    def _drop(self, piece: Piece, why: str) -> None:
        self._receipts.pop(piece.number, None)
        path = tiles.piece_path(self._folder, piece)
        path.unlink(missing_ok=True)
        print(f"{path}: {why}; it is computed again", file=sys.stderr)

    def _compute(self, job: Job, missing: list[Piece]) -> None:
        if not missing:
            return
        if self._how.merge:
            lost = ", ".join(str(piece.number) for piece in missing[:8]) + (", …" if len(missing) > 8 else "")
            raise Refused(
                f"command line: --merge: {len(missing)} of {len(self._pieces)} tiles are missing ({lost}); "
                "run their parts again"
            )
        options = {analysis.name: (analysis, options) for analysis, options in self._experiment.requested()}
        each = {
            names: work.work_of(self._experiment, [options[n] for n in names]) for names in {p.names for p in missing}
        }
        cost = {piece.number: each[piece.names] * (piece.end - piece.first) for piece in missing}
        if self._how.dask:
            self._over(missing, cost, lambda: self._on_workers(job, missing, cost))
            return
        lanes = self._make_lanes()
        batches = work.batches(self._experiment, job, missing, len(lanes.devices))
        cut = [batch for batch in batches if batch[0].names == job.split]
        if len(cut) > 1:
            batches = batches[len(cut) :]
            self._over([piece for batch in cut for piece in batch], cost, lambda: self._in_turn(job, cut, lanes, cost))
        self._in_turn(job, batches, lanes, {})

    def _over(self, pieces: Sequence[Piece], cost: dict[int, float], body: Callable[[], object]) -> None:
        """Show many pieces as one stage."""
        label = f"{', '.join(dict.fromkeys(name for piece in pieces for name in piece.names))}: {len(pieces)} tiles"
        self._shown.start(label, sum(cost[piece.number] for piece in pieces))
        self._progress.shown = Silent()
        try:
            body()
        finally:
            self._progress.shown = self._shown
            self._shown.finish()

    def _in_turn(self, job: Job, batches: Sequence[Sequence[Piece]], lanes: Lanes, cost: dict[int, float]) -> None:
        """Compute batches one after the other; each is written while the next is computed."""
        written: list[Future[list[Receipt]]] = []

        def settle() -> None:
            while written:
                for receipt in written.pop().result():
                    self._done(receipt, cost)

        with ThreadPoolExecutor(1) as writer:
            try:
                for batch in batches:
                    self._stop.check()
                    computed = work.compute(self._experiment, job, batch, lanes)
                    settle()
                    written.append(writer.submit(self._write, job, computed))
            finally:
                settle()

    def _write(self, job: Job, computed: Sequence[work.Done]) -> list[Receipt]:
        return [tiles.write_piece(self._folder, job, *done) for done in computed]

    def _on_workers(self, job: Job, missing: list[Piece], cost: dict[int, float]) -> None:
        where = self._how.dask or ""
        workers.run(where, self._folder, job, missing, self._stop.check, lambda receipt: self._done(receipt, cost))

    def _done(self, receipt: Receipt, cost: dict[int, float]) -> None:
        self._receipts[receipt.number] = receipt
        self._shown.advance(cost.get(receipt.number, 0.0))

    def _finish(self, job: Job) -> None:
        """Merge, then remove the tiles, then show what there is."""
        decided = tiles.origin(self._folder).spent
        receipts = [self._receipts[piece.number] for piece in self._pieces]
        spent = [decided, *(receipt.spent for receipt in receipts)]
        total = Account(
            self._earlier + time.perf_counter() - self._began,
            sum(one.compile_seconds for one in spent),
            sum(one.lane_periods for one in spent),
            ", ".join(dict.fromkeys(one.device for one in spent)),
        )
        counts = {name: _counts(name, receipts) for name in job.order}
        extras = {name: Extra(found, _warnings(name, found)) for name, found in counts.items()}
        attrs = provenance(self._experiment, work.scene_of_job(self._experiment, job), total, "jaxnh.sweep")
        attrs["chosen"] = json.dumps(job.chosen)
        merge(self._path, attrs, self._folder, job, extras, self._stop.check)
        tiles.clear(self._folder)
        self._show(job, total)

    def _show(self, job: Job, total: Account) -> None:
        for name in job.order:
            group = _stored(self._path, name) if name in terminal.TABLES else None
            published = (self._experiment.compare or {}).get(name)
            columns, source = (published.columns(), published.source) if published else ({}, "")
            if group is not None and not self._how.quiet:
                self._console.print(terminal.TABLES[name](group, columns, source, self._experiment.sweep.swept))
            for warning in filter(None, store.read_attrs(self._path, name).get("warnings", "").split("\n")):
                print(f"warning: {warning}", file=sys.stderr)
        self._say(
            f"{job.solver} in {self._experiment.precision}, {job.steps} steps a period, "
            f"error of one {'return' if self._experiment.autonomous else 'period'} {job.error_estimate:.1e}; "
            f"{total.lane_periods:,.0f} lane-periods"
        )
        now = time.perf_counter() - self._began
        lanes = self._lanes
        if lanes is not None and lanes.run_seconds:
            parts = f"compile {lanes.compile_seconds:.1f} s, run {lanes.run_seconds:.1f} s"
            self._say(
                f"{now:.1f} s: {parts}, set-up and the rest {now - lanes.compile_seconds - lanes.run_seconds:.1f} s"
            )
        else:
            self._say(f"{now:.1f} s")
        self._say(f"wrote {self._path}")

    def _say(self, text: str, *, err: bool = False) -> None:
        if not self._how.quiet:
            print(text, file=sys.stderr if err else sys.stdout)


def _counts(name: str, receipts: Sequence[Receipt]) -> dict[str, int]:
    """What is counted in a group, over all pieces."""
    found: dict[str, int] = {}
    for receipt in receipts:
        for key, value in receipt.counts.get(name, {}).items():
            found[key] = found.get(key, 0) + value
    return found


def _warnings(name: str, counts: dict[str, int]) -> tuple[str, ...]:
    if not counts.get("not_finite"):
        return ()
    return (f"{name}: {counts['not_finite']} of {counts['trajectories']} trajectories are not finite at their end",)


def _stored(path: Path, name: str) -> Group:
    """A small group as it stands in a file, for a table."""
    variables, attrs = store.read_variables(path, name), store.read_attrs(path, name)
    return Group({key: Variable((), data, key) for key, data in variables.items()}, attrs)
