"""Options of a run of a sweep into a file, and its summary. No JAX."""

from __future__ import annotations

from typing import Literal, NamedTuple

from jaxnh.jobs.job import Job
from jaxnh.jobs.provenance import SecondsSpent


class RunOptions(NamedTuple):
    """Options of a run of a sweep.

    Attributes:
        fresh: drop what an earlier run has left.
        part: k and n, to do share k of n alone.
        merge: merge the tiles of the parts, and compute nothing; virtual: copy nothing either.
        dask: where Dask workers are.
        tile: lanes a tile.
        command: what is run, for the history of the result.
        yes: run a sweep however large.
    """

    fresh: bool = False
    part: tuple[int, int] | None = None
    merge: bool | Literal["virtual"] = False
    dask: str | None = None
    tile: int | None = None
    command: str = ""
    yes: bool = False


class RunSummary(NamedTuple):
    """Summary of a run.

    Attributes:
        job: what was decided for the sweep.
        spent: by this run and those before it.
        seconds: of this run.
        compile_seconds, run_seconds: of these, where this process has computed.
        pieces: number of pieces of this run, and of all.
        whole: whether the result is written.
    """

    job: Job
    spent: SecondsSpent
    seconds: float
    compile_seconds: float
    run_seconds: float
    pieces: tuple[int, int]
    whole: bool
