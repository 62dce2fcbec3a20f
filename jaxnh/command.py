"""What the commands share: a config read or refused, the scene made of it, provenance, exit codes. No numerics."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import typer

import jaxnh
from jaxnh import store
from jaxnh.accuracy import Calibration, Plan, TargetError
from jaxnh.analyses.record import Scene
from jaxnh.experiment import ConfigError, Experiment, load
from jaxnh.lanes import Lanes
from jaxnh.solvers import SOLVERS

# The base of all faults of a command line, wherever typer keeps its parser.
_UsageError: Any = typer.BadParameter.__mro__[1]
_VERSIONS = ("jax", "jaxlib", "diffrax", "equinox", "numpy", "h5py")


class Refused(Exception):
    """Bad input; the message is the line to print."""


def experiment_of(config: Path | None, overrides: Sequence[str] | None) -> Experiment:
    """The validated config.

    Raises:
        Refused: none is named, or it says something that it cannot say.
    """
    if config is None:
        raise Refused("command line: CONFIG: name a YAML file")
    try:
        return load(config, overrides or [])
    except ConfigError as error:
        raise Refused(str(error)) from None


def check_output(path: Path) -> None:
    """Make the folder of an output.

    Raises:
        Refused: nothing can be written there.
    """
    try:
        store.check_writable(path)
    except store.StoreError as error:
        raise Refused(f"command line: --output: {error}") from None


def scene_of(experiment: Experiment, calibration: Calibration) -> Scene:
    """System, start and sweep, with the solver and steps asked for or else the cheapest that meet the target.

    Raises:
        Refused: nothing meets the target.
    """
    accuracy = experiment.accuracy
    if accuracy.solver and accuracy.steps:
        solver = SOLVERS[accuracy.solver]
        plan = Plan(solver, accuracy.steps, False, calibration.error(solver, accuracy.steps))
    else:
        try:
            plan = calibration.cheapest(accuracy.target)
        except TargetError as error:
            raise Refused(f"{experiment.source}: accuracy.target: {error}") from None
    system = experiment.system.build()
    return Scene(system, experiment.initial.state(system), experiment.sweep.grid(), *plan)


def calibrate(experiment: Experiment, lanes: Lanes) -> Calibration:
    """Errors of one period on sample lanes of the sweep."""
    system = experiment.system.build()
    return Calibration(system, experiment.initial.state(system), experiment.sweep.grid(), lanes)


def provenance(experiment: Experiment, scene: Scene, lanes: Lanes, seconds: float, module: str) -> dict[str, Any]:
    """Root attributes of what a command writes; `module` is how it is called by `python -m`."""
    device = lanes.devices[0]
    command = shlex.join(["python", "-m", module, *sys.argv[1:]])
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


def run_app(app: typer.Typer) -> int:
    """Run a command; 0 done, 2 bad input, 1 any other failure, each failure with one line and no traceback."""
    try:
        code = app(standalone_mode=False)  # a number where typer itself ended the run, as after Control-C
        if isinstance(code, int) and code:
            print("interrupted; nothing was written", file=sys.stderr)
            return code
    except Refused as refusal:
        print(refusal, file=sys.stderr)
        return 2
    except _UsageError as error:
        print(f"command line: {' '.join(str(error.format_message()).split())}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    except Exception as error:
        print(f"failed: {type(error).__name__}: {' '.join(str(error).split())[:500]}", file=sys.stderr)
        return 1
    return 0
