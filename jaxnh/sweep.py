"""The command `python -m jaxnh.sweep CONFIG [KEY=VALUE ...] [--output FILE] [--fresh]`: load, run, store, print."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from jaxnh import store, terminal
from jaxnh.analyses.record import Group
from jaxnh.command import Refused, calibrate, check_output, experiment_of, provenance, run_app, scene_of
from jaxnh.experiment import Experiment, schema
from jaxnh.lanes import Lanes, configure

_LOG_WIDTH = 100  # columns of a table that goes to a file

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Run the analyses of a config and keep their results in one HDF5 file.")
def sweep(
    config: Annotated[Path | None, typer.Argument(help="YAML file of the experiment", show_default=False)] = None,
    overrides: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Values to use in place of the file's")
    ] = None,
    output: Annotated[Path | None, typer.Option(help="Result file; by default results/NAME.h5")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Replace a result that exists")] = False,
    print_schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of a config")] = False,
) -> None:
    """Body of the command; the words above are what --help shows."""
    if print_schema:
        print(json.dumps(schema(), indent=2, ensure_ascii=False))
        return
    began = time.perf_counter()
    experiment = experiment_of(config, overrides)
    path = output or Path("results") / f"{experiment.source.stem}.h5"
    if _already_there(path, experiment, fresh):
        print(f"{path}: the result of this config is there; --fresh runs it again")
        return
    check_output(path)
    _run(experiment, path, began)


def _already_there(path: Path, experiment: Experiment, fresh: bool) -> bool:
    """Whether the output holds this very result. Anything else that is there is only replaced when asked for."""
    if fresh or not path.exists():
        return False
    try:
        same = store.read_attrs(path)["config_sha256"] == experiment.sha256
    except (store.StoreError, KeyError):
        raise Refused(
            f"command line: --output: {path} is there and is no result of jaxnh; --fresh replaces it"
        ) from None
    if not same:
        raise Refused(f"command line: --output: {path} holds the result of another config; --fresh replaces it")
    return True


def _run(experiment: Experiment, path: Path, began: float) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=_LOG_WIDTH)
    configure()
    lanes = Lanes(terminal.progress(Console(stderr=True)))
    with lanes.stage("accuracy: errors of one period on sample lanes", 0):
        scene = scene_of(experiment, calibrate(experiment, lanes))
    groups: dict[str, Group] = {}
    for analysis, options in experiment.requested():
        needed = ({name: groups[name] for name in analysis.needs},) if analysis.needs else ()
        groups[analysis.name] = analysis.run(options, scene, lanes, *needed)
    stored = time.perf_counter()
    store.write(path, provenance(experiment, scene, lanes, stored - began, "jaxnh.sweep"), groups)
    for name, group in groups.items():
        published = (experiment.compare or {}).get(name)
        columns, source = (published.columns(), published.source) if published else ({}, "")
        if name in terminal.TABLES:
            console.print(terminal.TABLES[name](group, columns, source))
        for warning in group.warnings:
            print(f"warning: {warning}", file=sys.stderr)
    print(
        f"{scene.solver.name}, {scene.steps} steps a period, error of one period {scene.error_estimate:.1e}; "
        f"{lanes.lane_periods:,.0f} lane-periods"
    )
    total = time.perf_counter() - began
    print(
        f"{total:.1f} s: compile {lanes.compile_seconds:.1f} s, run {lanes.run_seconds:.1f} s, "
        f"set-up and the rest {total - lanes.compile_seconds - lanes.run_seconds:.1f} s"
    )
    print(f"wrote {path}")


def main() -> int:
    """Run the command; returns its exit code."""
    return run_app(app)


if __name__ == "__main__":
    sys.exit(main())
