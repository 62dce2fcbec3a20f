"""What the commands share: a config read or refused, the scene made of it, provenance, accounts. No numerics."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxnh
from jaxnh.analyses.base import Scene
from jaxnh.cli.exit_codes import Refused
from jaxnh.config.experiment import Experiment, load
from jaxnh.config.yaml_source import ConfigError
from jaxnh.engine.calibration import Calibration, Plan, TargetError
from jaxnh.engine.lanes import Lanes
from jaxnh.engine.xla_options import configure
from jaxnh.maps.section import SectionedFlow
from jaxnh.solvers import SOLVERS
from jaxnh.systems.user_file import OwnSystem

_VERSIONS = ("jax", "jaxlib", "diffrax", "equinox", "numpy", "h5py")


class Account(NamedTuple):
    """What something has cost, and on what devices."""

    wall_seconds: float
    compile_seconds: float
    lane_periods: float
    device: str


def experiment_of(config: Path | None, overrides: Sequence[str] | None) -> Experiment:
    """The validated config.

    Raises:
        Refused: none is named, or it says something that it cannot say.
    """
    if config is None:
        raise Refused("command line: CONFIG: name a YAML file")
    configure()  # before a user's file is tried out
    try:
        return load(config, overrides or [])
    except ConfigError as error:
        raise Refused(str(error)) from None


def other_than(experiment: Experiment, own_text: str | None) -> str:
    """What something is of that is not of this config, made with a user's file of that text."""
    own = experiment.own
    return f"another text of {own.path}" if own and own_text not in (None, own.text) else "another config"


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
    system, start = experiment.system_and_start()
    return Scene(system, start, experiment.sweep.grid(), *plan, precision=experiment.precision)


def calibrate(experiment: Experiment, lanes: Lanes) -> Calibration:
    """Errors of one period on sample lanes of the sweep.

    Raises:
        Refused: no lane has a period that can be computed.
    """
    system, start = experiment.system_and_start()
    try:
        return Calibration(system, start, experiment.sweep.grid(), lanes, experiment.precision)
    except TargetError as error:
        raise Refused(f"{experiment.source}: sweep: {error}") from None


def account(lanes: Lanes, seconds: float) -> Account:
    """What a runner has spent so far, in so many seconds."""
    device = f"{len(lanes.devices)} x {lanes.devices[0].device_kind} ({lanes.devices[0].platform})"
    return Account(seconds, lanes.compile_seconds, lanes.lane_periods, device)


def provenance(experiment: Experiment, scene: Scene, spent: Account, module: str) -> dict[str, Any]:
    """Root attributes of what a command writes; `module` is how it is called by `python -m`."""
    command = shlex.join(["python", "-m", module, *sys.argv[1:]])
    return {
        "title": experiment.title,
        "Conventions": "CF-1.11",
        "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} {command}",
        "config": experiment.text,
        "config_sha256": experiment.sha256,
        "jaxnh_version": jaxnh.__version__,
        "versions": json.dumps(versions()),
        "solver": scene.solver.name,
        "steps_per_period": scene.steps,
        "summation": "compensated" if scene.compensated else "plain",
        "precision": scene.precision,
        "error_estimate": scene.error_estimate,
        "wall_seconds": spent.wall_seconds,
        "compile_seconds": spent.compile_seconds,
        "lane_periods": spent.lane_periods,
        "device": spent.device,
        "strobe_period": np.float64(scene.system.period),
        **({"section": scene.system.words} if isinstance(scene.system, SectionedFlow) else {}),
        **(_of_own(experiment.own, scene) if experiment.own else {}),
    }


def _of_own(own: OwnSystem, scene: Scene) -> dict[str, str]:
    """What of a user's system goes into the result: the file, as the config names it and in full, and what is swept."""
    return {
        "swept": scene.system.sweeps,
        "system_file": own.text,
        "system_file_path": str(own.path),
        "system_file_sha256": own.sha256,
    }


def versions() -> dict[str, str]:
    """Versions of the libraries that the numbers rest on."""
    return {name: version(name) for name in _VERSIONS}
