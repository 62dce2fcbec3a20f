"""A tile without its computation: a worker sleeps as long as it would compute, and writes a file of the same size.

It has the arguments of a piece of `jaxnh.engine.dask_workers`, and no JAX. What it does stands in the folder.
"""

from __future__ import annotations

import functools
import json
import time
from pathlib import Path

import numpy as np

from jaxnh.jobs.cutting import Piece
from jaxnh.jobs.job import Job
from jaxnh.jobs.provenance import SecondsSpent
from jaxnh.storage import tiles
from jaxnh.storage.tiles import TileRecord

ORDERS = "simulated.json"
"""File of the folder: `seconds` of sleep, and whether to `write`."""


@functools.lru_cache(maxsize=1)
def _task(folder: Path, job_id: str) -> tuple[Job, float, bool]:
    job = tiles.read_job(folder)
    if job is None or job.id != job_id:
        raise RuntimeError(f"{folder} has another job")
    orders = json.loads((folder / ORDERS).read_text(encoding="utf-8"))
    return job, orders["seconds"], orders["write"]


def sleep_and_write(folder: str, job_id: str, number: int) -> TileRecord:
    """Do what a worker does for a piece of a chart, but for the computation."""
    job, seconds, write = _task(Path(folder), job_id)
    time.sleep(seconds)
    if not write:
        return TileRecord(number, Path(), "", SecondsSpent(seconds, 0.0, 0.0, ""), {})
    return write_tile(Path(folder), job, job.cutting.pieces()[number])


def write_tile(folder: Path, job: Job, piece: Piece) -> TileRecord:
    """Write a tile with the variables of a chart of the largest exponent, in numbers that do not compress."""
    import xarray as xr

    (first,), (end,) = piece.begin, piece.end
    lanes, draws = end - first, np.random.default_rng(piece.number)
    chart = xr.Dataset(
        {
            "b": ("b", np.arange(first, end) / job.cutting.shape[0]),
            "exponents": (("b", "exponent"), draws.normal(size=(lanes, 1))),
            "exponents_error": (("b", "exponent"), draws.normal(size=(lanes, 1))),
            "exponents_method": ("b", draws.integers(0, 3, lanes, dtype=np.int8)),
            "averaging_periods": ("b", draws.integers(16, 256, lanes)),
            "status": ("b", np.zeros(lanes, np.int8)),
        }
    )
    return tiles.write_piece(folder, job, piece, {"lyapunov": chart}, {}, SecondsSpent(0.0, 0.0, 0.0, ""))
