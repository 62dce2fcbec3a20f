"""A chart of a billion lanes, before it is run: what is not computing, measured in small, and times and costs reckoned.

    python -m sweeps.timing.scale [--workers 2 8 64] [--output results/scale.md]

Workers of Dask do everything that they do for a sweep but compute: they sleep as long as a tile takes, and write its
file (`scale_worker`). So one machine tells what scheduling costs of many. Merging, by copies and by virtual datasets,
is of real files. What follows for nodes and cards is reckoned from these and from a rate of lanes, and said to be.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from jaxnh.engine import dask_workers
from jaxnh.jobs.cutting import Cutting
from jaxnh.jobs.job import Job, NumericalPlan
from jaxnh.jobs.provenance import Provenance, SecondsSpent, versions
from jaxnh.storage import tiles
from jaxnh.storage.merge import merge
from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing import scale_worker
from sweeps.timing.effects import processor

LANES = 10**9
RATE = 1024**2 / 230 / 2
"""Lanes a second and core of the chart of b by d, a million lanes on two cores (docs/howto/planes.md)."""

CORES = 64
"""Of a node, in what is reckoned."""

CARDS = 8
CARD_RATE = 1024**2 / 18.6
"""Lanes a second of a chart of b by d on one H200, largest exponents alone, a million lanes (results/gpu.md)."""

_TILE_SECONDS, _ROUNDS = 10.0, 2
_EMPTY = 2000  # pieces without sleep
_MERGED, _TILE = 128, 1 << 17  # tiles, and lanes of one


class Scheduling(NamedTuple):
    """Workers, seconds until all have been there, share lost beside sleeping, and empty pieces a second."""

    workers: int
    start: float
    lost: float
    pieces_a_second: float


class Merging(NamedTuple):
    """Lanes and bytes of the tiles; seconds to write one, to copy all, and to lead to all."""

    lanes: int
    size: int
    written: float
    copied: float
    virtual: float


def job_of(pieces: int, lanes: int) -> Job:
    """A job of so many tiles over one axis."""
    cutting = Cutting((("b", pieces * lanes, False),), lanes, ("lyapunov",), ("lyapunov",))
    return Job(NumericalPlan("none", 1, False, 1e-6, {}), cutting, Provenance("0" * 64, versions(), {}))


@contextmanager
def folder_with(job: Job, *, seconds: float = 0.0, write: bool = False) -> Iterator[Path]:
    """Yield a folder with a job and what is to be done for its pieces."""
    with tempfile.TemporaryDirectory(prefix="jaxnh_scale_") as place:
        folder = Path(place) / "chart.h5.tiles"
        folder.mkdir()
        tiles.publish(folder, job, tiles.Origin("", None, SecondsSpent(0.0, 0.0, 0.0, "")))
        (folder / scale_worker.ORDERS).write_text(json.dumps({"seconds": seconds, "write": write}))
        yield folder


def measured_scheduling(workers: int, seconds: float = _TILE_SECONDS, empty: int = _EMPTY) -> Scheduling:
    """Have workers do pieces that sleep and are written, and then many that do nothing."""

    def run(job: Job, seconds: float, *, write: bool) -> float:
        with folder_with(job, seconds=seconds, write=write) as folder:
            began = time.perf_counter()
            dask_workers.run(client, folder, job, [job.cutting.pieces()], lambda: None, lambda _: None)
            return time.perf_counter() - began

    kept, dask_workers._piece = dask_workers._piece, scale_worker.sleep_and_write
    try:
        began = time.perf_counter()
        with dask_workers.cluster(f"local:{workers}") as client:
            run(job_of(workers, 256), 0.5, write=True)  # imports
            start = time.perf_counter() - began
            lasted = run(job_of(_ROUNDS * workers, 8192), seconds, write=True)
            idle = run(job_of(empty, 1), 0.0, write=False)
    finally:
        dask_workers._piece = kept
    return Scheduling(workers, start, lasted / (_ROUNDS * seconds) - 1.0, empty / idle)


def measured_merging(count: int = _MERGED, lanes: int = _TILE) -> Merging:
    """Write tiles, and merge them by copies and by virtual datasets."""
    job = job_of(count, lanes)
    with folder_with(job) as folder:
        began = time.perf_counter()
        for piece in job.cutting.pieces():
            scale_worker.write_tile(folder, job, piece)
        written = (time.perf_counter() - began) / count
        size = sum(path.stat().st_size for path in folder.glob("*.h5"))
        seconds = []
        for virtual in (False, True):
            began = time.perf_counter()
            merge(folder.parent / "chart.h5", {"jaxnh_version": "0"}, folder, job.cutting, {}, virtual=virtual)
            seconds.append(time.perf_counter() - began)
    return Merging(count * lanes, size, written, *seconds)


def reckoned(scheduling: Sequence[Scheduling], merging: Merging) -> list[str]:
    """Rows of a chart of a billion lanes on nodes: computing, what scheduling adds, and merging on one core."""
    most = max(scheduling)
    merges = {
        name: LANES / merging.lanes * seconds for name, seconds in (("c", merging.copied), ("v", merging.virtual))
    }
    rows = []
    for nodes in (1, 10, 100):
        cores = nodes * CORES
        computing = LANES / RATE / cores
        pieces = max(4 * cores, math.ceil(computing / _TILE_SECONDS) * cores)
        queue = pieces / most.pieces_a_second
        whole = max(computing * (1.0 + max(most.lost, 0.0)), queue)
        rows.append(
            f"| {nodes} of {CORES} cores | {LANES / RATE / 3600:.0f} core-hours | {_time(computing)} | {pieces:,} "
            f"| {_time(queue)} | {_time(whole)} | {_time(merges['c'])} | {_time(merges['v'])} |"
        )
    return rows


def _time(seconds: float) -> str:
    return (
        f"{seconds / 3600:.1f} h"
        if seconds > 5400
        else f"{seconds / 60:.1f} min"
        if seconds > 90
        else f"{seconds:.0f} s"
    )


def page(scheduling: Sequence[Scheduling], merging: Merging) -> str:
    """The page in Markdown."""
    of_cards = LANES / CARD_RATE
    bytes_a_lane = merging.size / merging.lanes
    lines = [
        "# A chart of a billion lanes",
        "",
        "`python -m sweeps.timing.scale` writes this page: what is not computing is measured in small, on one machine,",
        "and what follows for many is reckoned. How such a chart is run is in `docs/howto/batch.md`.",
        processor(),
        "",
        str(stamp()),
        "",
        "## Measured",
        "",
        f"Workers of Dask on this machine that sleep {_TILE_SECONDS:.0f} s a tile in place of computing it, and write",
        f"its file; then {_EMPTY:,} pieces that do nothing. All workers share its few cores, so that start and loss",
        "are upper bounds of what as many machines would have.",
        "",
        "| workers | start with imports | lost beside sleeping | empty pieces a second |",
        "|---|---|---|---|",
        *(f"| {s.workers} | {s.start:.1f} s | {100 * s.lost:.1f} % | {s.pieces_a_second:.0f} |" for s in scheduling),
        "",
        f"Tiles of {_TILE:,} lanes, as a chart of the largest exponent has them: {bytes_a_lane:.1f} bytes a lane,",
        f"{merging.written:.2f} s to write one. {merging.lanes:,} lanes in {_MERGED} files, each checked against its",
        "checksums and the whole read back:",
        "",
        "| merge | seconds | bytes written again |",
        "|---|---|---|",
        f"| copied into one file | {merging.copied:.1f} | all |",
        f"| `--virtual`, led to | {merging.virtual:.1f} | none |",
        "",
        "## Reckoned",
        "",
        f"From {RATE:,.0f} lanes a second and core, which the chart of b by d has (`docs/howto/planes.md`),",
        "the largest number of workers above, and merging in proportion to lanes, on one core. Pieces a second are",
        f"those of {_EMPTY:,}; the client goes through all open ones at each answer, so that many more take longer:",
        "",
        "| nodes | cost | computing alone | tiles | in the scheduler | all tiles done | merge, copied | virtual |",
        "|---|---|---|---|---|---|---|---|",
        *reckoned(scheduling, merging),
        "",
        f"The result has some {LANES * bytes_a_lane / 1e9:.0f} GB. Where the scheduler or merging takes longer than",
        "computing, more nodes gain nothing: take longer tiles (`--tile`), or parts without a scheduler",
        "(`--part K/N`).",
        "",
        f"**{CARDS} cards: {_time(of_cards / CARDS)}**, {of_cards / 3600:.1f} card-hours, from {CARD_RATE:,.0f} lanes",
        "a second, which an H200 has of the largest exponents of such a chart, a million lanes in one run with kept",
        "programs (`results/gpu.md`). Much of that run is the work of the host. Several cards were not measured.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", type=int, nargs="+", default=[2, 8, 64])
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "scale.md")
    arguments = parser.parse_args()
    merging = measured_merging()
    print(merging, flush=True)
    scheduling = []
    for workers in arguments.workers:
        scheduling.append(measured_scheduling(workers))
        print(scheduling[-1], flush=True)
    arguments.output.write_text(page(scheduling, merging), encoding="utf-8")


if __name__ == "__main__":
    main()
