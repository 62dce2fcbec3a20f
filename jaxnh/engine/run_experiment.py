"""A run of all that an experiment asks for: in memory by a session, or into a result file."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from jaxnh.engine import dask_workers
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.output import check_output, file_of, is_there
from jaxnh.engine.progress import Progress
from jaxnh.engine.run import RunOptions, run_to_file
from jaxnh.engine.session import ProgressCallback, Session, as_progress
from jaxnh.engine.xla_options import configure
from jaxnh.exceptions import InputError, take_path
from jaxnh.storage.hdf5 import open_result


def run(
    experiment: Experiment | object,
    output: str | Path | None = None,
    *,
    progress: ProgressCallback | Progress | None = None,
    fresh: bool = False,
    dask: str | None = None,
    tile: int | None = None,
    yes: bool = False,
) -> xr.DataTree:
    """All analyses that an experiment asks for, as a tree with a dataset each.

    Args:
        output: a result file to write, by tiles in a folder beside it: a call that was stopped goes on where it
            stopped, and a file that is there already is read. Without it everything stays in memory.
        progress: told of all work; an exception raised in it, as `jaxnh.Stopped`, ends the call.
        fresh: replace an output that is there.
        dask: workers to use: "local", "local:N", "tcp://HOST:PORT" or a scheduler file; needs an output.
        tile: lanes a tile of the output, by default some ten seconds of work.
        yes: run a sweep into an output however large: of days, or of more than 10,000,000 lanes.

    Raises:
        InputError: an argument cannot be used.
        AccuracyError: nothing meets the accuracy asked for.
        RunError: the run cannot go on; the message says what is kept.

    Warns:
        JaxStartedWarning: JAX had started without the options of the package.
    """
    if not isinstance(experiment, Experiment):
        raise InputError(
            f"run takes an experiment, not {type(experiment).__name__}: jaxnh.load reads one from a file, and "
            "a system in Python goes to jaxnh.Session"
        )
    configure()
    if output is None:
        if dask or tile:
            raise InputError("dask and tile are for a run with an output")
        return Session(experiment, progress=progress).tree()
    if dask:
        dask_workers.check(dask)
    path = file_of(take_path(output, "output", "result file"))
    if not is_there(experiment, path, fresh=fresh):
        check_output(path)
        run_to_file(experiment, path, RunOptions(fresh=fresh, dask=dask, tile=tile, yes=yes), as_progress(progress))
    return open_result(path)
