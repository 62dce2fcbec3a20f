"""Decisions for a sweep, kept from run to run as its programs are: a later run calibrates nothing.

The solver and its steps follow from the experiment, the package, the libraries and the machine alone, bit for bit. The
parts of a sweep, the jobs of a cluster, and a run after another of the same config decide once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from jaxnh.engine.cache import executables, store
from jaxnh.engine.experiment import Experiment
from jaxnh.jobs.job import NumericalPlan


@dataclass(frozen=True)
class Decision:
    """A decision that holds for a whole sweep.

    Attributes:
        plan: its numerical plan.
        fastest: seconds a lane for an iteration of the innermost loop of a map, as measured while deciding.
        rehearsed: periods in which the steps lose no sample lane, where longer runs decide anew.
    """

    plan: NumericalPlan
    fastest: float
    rehearsed: int


def name_of(experiment: Experiment, devices: Sequence[Any], tile: int | None, kind: str = "decision") -> str | None:
    """The name of a decision, the same in every process and on any number of cores; None where it is not to be kept.

    Args:
        kind: of decision.
    """
    user = experiment.user_file
    said = executables.of_user_file(user) if user else ""
    if store.folder() is None or said is None:
        return None
    of_a_program = devices[:1] if devices[0].platform == "cpu" else devices
    words = [kind, executables.environment(), executables.of_devices(of_a_program)]
    return hashlib.sha256("\n".join([*words, str(tile), said, experiment.sha256]).encode()).hexdigest()


def find(name: str | None) -> Decision | None:
    """The decision of that name, if it is kept."""
    data = store.find(name) if name else None
    if not data:
        return None
    content = json.loads(data)
    return Decision(NumericalPlan(**content["plan"]), content["fastest"], content["rehearsed"])


def keep(name: str | None, decision: Decision) -> None:
    """Keep a decision for later runs, where that is possible."""
    if name:
        store.keep(name, json.dumps(asdict(decision)).encode())
