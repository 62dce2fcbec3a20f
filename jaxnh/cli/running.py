"""A sweep from its config to its end, with progress on the terminal."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from jaxnh.cli.exit_codes import Stop
from jaxnh.cli.experiments import checked_experiment
from jaxnh.cli.report import report
from jaxnh.cli.terminal import progress
from jaxnh.config.config import Config
from jaxnh.engine import dask_workers
from jaxnh.engine.output import check_output, file_of, is_there
from jaxnh.engine.run import run_to_file
from jaxnh.engine.run_records import RunOptions
from jaxnh.exceptions import ArgumentError, BusyError
from jaxnh.storage import tiles


def run(config: Config, output: Path | None, how: RunOptions, *, quiet: bool) -> None:
    """Run a config into a result file, unless that is there, and print what has come of it."""
    if how.dask:
        dask_workers.check(how.dask)
    experiment = checked_experiment(config)
    path = file_of(output or Path("results") / f"{Path(experiment.label).stem}.h5")
    if is_there(experiment, path, fresh=how.fresh):
        tiles.tidy(tiles.folder_of(path))
        if not quiet:
            print(f"{path}: the result of this config is there; --fresh runs it again")
        return
    check_output(path)
    shown = progress(Console(stderr=True), quiet=quiet)
    try:
        with Stop() as stop:
            outcome = run_to_file(experiment, path, how, shown, stop.check)
            report(experiment, path, outcome, how.part, quiet=quiet)
    except BusyError as busy:
        raise ArgumentError("output", str(busy)) from None
