"""The command `python -m jaxnh.sweep CONFIG [KEY=VALUE ...]`: a config to a result, in one run or in many."""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from jaxnh.cli.command import experiment_of, other_than
from jaxnh.cli.exit_codes import Refused, Stop, check_output, run_app
from jaxnh.config.experiment import Experiment, schema
from jaxnh.engine import dask_workers as workers
from jaxnh.engine.run import How, Run
from jaxnh.storage import hdf5 as store
from jaxnh.storage import tiles

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Run the analyses of a config and keep their results in one HDF5 file.")
def sweep(
    config: Annotated[Path | None, typer.Argument(help="YAML file of the experiment", show_default=False)] = None,
    overrides: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Values to use in place of the file's")
    ] = None,
    output: Annotated[Path | None, typer.Option(help="Result file; by default results/NAME.h5")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Replace a result that exists")] = False,
    dask: Annotated[
        str | None,
        typer.Option(metavar="WHERE", help="Use Dask workers: local[:N], tcp://HOST:PORT or a scheduler file"),
    ] = None,
    part: Annotated[str | None, typer.Option(metavar="K/N", help="Do only share K of N; --merge joins them")] = None,
    merge_only: Annotated[bool, typer.Option("--merge", help="Join what the parts have done")] = False,
    tile: Annotated[
        int | None, typer.Option(min=1, metavar="LANES", help="Lanes a tile; by default some ten seconds of work")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing but warnings and errors")] = False,
    print_schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of a config")] = False,
) -> None:
    """Body of the command; the words above are what --help shows."""
    if print_schema:
        print(json.dumps(schema(), indent=2, ensure_ascii=False))
        return
    began = time.perf_counter()
    how = How(_part(part), merge_only, dask, tile, quiet)
    if merge_only and (part or dask):
        raise Refused("command line: --merge: it goes without --part and --dask")
    if dask:
        workers.check(dask)
    experiment = experiment_of(config, overrides)
    path = output or Path("results") / f"{experiment.source.stem}.h5"
    if _already_there(path, experiment, fresh):
        tiles.tidy(tiles.folder_of(path))
        if not quiet:
            print(f"{path}: the result of this config is there; --fresh runs it again")
        return
    check_output(path)
    folder = tiles.folder_of(path)
    try:
        with Stop() as stop, tiles.hold(folder, how.part):
            Run(experiment, path, how, stop, began).run(fresh)
    except tiles.Busy as busy:
        raise Refused(f"command line: --output: {busy}") from None


def _part(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise Refused(f"command line: --part: it is K/N with K from 1 to N, not {text}")
    return int(match[1]), int(match[2])


def _already_there(path: Path, experiment: Experiment, fresh: bool) -> bool:
    """Whether the output holds this very result. Anything else that is there is only replaced when asked for."""
    if fresh or not path.exists():
        return False
    try:
        attrs = store.read_attrs(path)
        same = attrs["config_sha256"] == experiment.sha256
    except (store.StoreError, KeyError):
        raise Refused(
            f"command line: --output: {path} is there and is no result of jaxnh; --fresh replaces it"
        ) from None
    if not same:
        other = other_than(experiment, attrs.get("system_file"))
        raise Refused(f"command line: --output: {path} holds the result of {other}; --fresh replaces it")
    return True


def main() -> int:
    """Run the command; returns its exit code."""
    return run_app(app)


if __name__ == "__main__":
    sys.exit(main())
