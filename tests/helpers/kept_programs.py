"""Lanes and sessions that find the programs of earlier runs in this process."""

from __future__ import annotations

from typing import Any

import jax

from jaxnh.engine.executor.lanes import TILE, LaneExecutor
from jaxnh.engine.executor.programs import Programs
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.progress import Progress
from jaxnh.engine.session import Session

_PROGRAMS = {unoptimised: Programs() for unoptimised in (False, True)}

# Compiled in a third of the time, and slower by several times: for runs so short that compiling is what takes time.
QUICKLY_COMPILED = Programs(options={"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False})


def lanes_with_kept_programs(
    progress: Progress | None = None,
    devices: list[Any] | None = None,
    tile: int = TILE,
    programs: Programs | None = None,
) -> LaneExecutor:
    """Lanes on all devices that find the programs of earlier runs in this process; their keys say all else there is."""
    if programs is None:
        programs = _PROGRAMS[jax.config.read("jax_disable_most_optimizations")]
    return LaneExecutor(progress, devices, tile, programs)


def session_of(experiment: Experiment) -> Session:
    """A session that finds the programs of earlier ones in this process."""
    found = Session(experiment)
    found._lanes = lanes_with_kept_programs(found._progress)
    return found
