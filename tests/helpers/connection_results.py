"""Results of `homoclinic` on flows of tests, and the points of their curves."""

from __future__ import annotations

import inspect

import numpy as np

from jaxnh.engine.experiment import Experiment
from tests.helpers import contract
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of

STEPS = "accuracy: {solver: tsit5, steps: 20}\n"


def experiment(folder, flow, initial, sweep, options, section=""):
    path = folder / "flow.py"
    path.write_text(inspect.getsource(flow).replace(f"def {flow.__name__}", "def system"))
    config = f"system: {{file: {path}}}\ninitial: {initial}\nsweep: {sweep}\n{section}{STEPS}"
    return Experiment.from_text(config + f"analyses: {{homoclinic: {options}}}\n")


def result_of(*arguments):
    asked = experiment(*arguments)
    session = session_of(asked)
    session._lanes = lanes_with_kept_programs(None, session._lanes.devices[:1], 32)
    groups = session.tree()
    units = asked.flow().readout.labels.units
    for name, group in groups.children.items():
        contract.check(name, group.to_dataset(), [key for key, unit in units.items() if not unit])
    return groups


def points(data, curve, names):
    """Values and errors of a curve, (points, 2) each."""
    one = data.isel(curve=curve)
    values, errors = (np.stack([one[name + rest].to_numpy() for name in names], axis=1) for rest in ("", "_error"))
    known = np.isfinite(values).all(axis=1)
    return values[known], errors[known]
