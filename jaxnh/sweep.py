"""The command `python -m jaxnh.sweep CONFIG [KEY=VALUE ...] [--output FILE] [--fresh]`: load, run, store, print."""

from __future__ import annotations

import json
import shlex
import sys
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import click
import numpy as np
import typer
from rich.console import Console

import jaxnh
from jaxnh import store, terminal
from jaxnh.accuracy import Calibration, Plan, TargetError
from jaxnh.analyses.record import Group, Scene
from jaxnh.experiment import ConfigError, Experiment, load, schema
from jaxnh.lanes import Lanes, configure
from jaxnh.solvers import SOLVERS

_VERSIONS = ("jax", "jaxlib", "diffrax", "equinox", "numpy", "h5py")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class _Refused(Exception):
    """Bad input; the message is the line to print."""


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
    if config is None:
        raise _Refused("command line: CONFIG: name a YAML file")
    began = time.perf_counter()
    try:
        experiment = load(config, overrides or [])
    except ConfigError as error:
        raise _Refused(str(error)) from None
    path = output or Path("results") / f"{config.stem}.h5"
    if _already_there(path, experiment, fresh):
        print(f"{path}: the result of this config is there; --fresh runs it again")
        return
    try:
        store.check_writable(path)
    except store.StoreError as error:
        raise _Refused(f"command line: --output: {error}") from None
    _run(experiment, path, began)


def _already_there(path: Path, experiment: Experiment, fresh: bool) -> bool:
    """Whether the output holds this very result. Anything else that is there is only replaced when asked for."""
    if fresh or not path.exists():
        return False
    try:
        same = store.read_attrs(path)["config_sha256"] == experiment.sha256
    except (store.StoreError, KeyError):
        raise _Refused(
            f"command line: --output: {path} is there and is no result of jaxnh; --fresh replaces it"
        ) from None
    if not same:
        raise _Refused(f"command line: --output: {path} holds the result of another config; --fresh replaces it")
    return True


def _run(experiment: Experiment, path: Path, began: float) -> None:
    console = Console()
    configure()
    lanes = Lanes(terminal.progress(Console(stderr=True)))
    scene = _scene(experiment, lanes)
    groups: dict[str, Group] = {}
    for analysis, options in experiment.requested():
        groups[analysis.name] = analysis.run(options, scene, lanes)
    stored = time.perf_counter()
    store.write(path, _attrs(experiment, scene, lanes, stored - began), groups)
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


def _scene(experiment: Experiment, lanes: Lanes) -> Scene:
    system = experiment.system.build()
    start = experiment.initial.state(system)
    values = experiment.sweep.grid()
    accuracy = experiment.accuracy
    with lanes.stage("accuracy: errors of one period on sample lanes", 0):
        calibration = Calibration(system, start, values, lanes)
        if accuracy.solver and accuracy.steps:
            solver = SOLVERS[accuracy.solver]
            plan = Plan(solver, accuracy.steps, False, calibration.error(solver, accuracy.steps))
        else:
            try:
                plan = calibration.cheapest(accuracy.target)
            except TargetError as error:
                raise _Refused(f"{experiment.source}: accuracy.target: {error}") from None
    return Scene(system, start, values, *plan)


def _attrs(experiment: Experiment, scene: Scene, lanes: Lanes, seconds: float) -> dict[str, Any]:
    """Root attributes of the result file."""
    device = lanes.devices[0]
    command = shlex.join(["python", "-m", "jaxnh.sweep", *sys.argv[1:]])
    return {
        "title": experiment.title,
        "Conventions": "CF-1.11",
        "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} {command}",
        "config": experiment.text,
        "config_sha256": experiment.sha256,
        "jaxnh_version": jaxnh.__version__,
        "versions": json.dumps({name: version(name) for name in _VERSIONS}),
        "solver": scene.solver.name,
        "steps_per_period": scene.steps,
        "summation": "compensated" if scene.compensated else "plain",
        "error_estimate": scene.error_estimate,
        "wall_seconds": seconds,
        "compile_seconds": lanes.compile_seconds,
        "lane_periods": lanes.lane_periods,
        "device": f"{len(lanes.devices)} x {device.device_kind} ({device.platform})",
        "strobe_period": np.float64(scene.system.period),
    }


def main() -> int:
    """Run the command; 0 done, 2 bad input, 1 any other failure, each failure with one line and no traceback."""
    try:
        app(standalone_mode=False)
    except _Refused as refusal:
        print(refusal, file=sys.stderr)
        return 2
    except click.ClickException as error:
        print(f"command line: {' '.join(error.format_message().split())}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, click.Abort):
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    except Exception as error:
        print(f"failed: {type(error).__name__}: {' '.join(str(error).split())[:500]}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
