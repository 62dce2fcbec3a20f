"""Calibrations kept for the rest of this process, and calibrations left out, in place of those that runs and sessions make."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any, cast
from unittest import mock

import jax

from jaxnh.analyses.batch import Axis
from jaxnh.engine import plan
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment

Calibrate = Callable[..., Calibration]


def once(calibrate: Calibrate) -> Calibrate:
    """`calibrate`, once for equal experiments and lanes, whose errors are equal to the bit."""
    found: dict[Any, Calibration] = {}

    def calibrate_once(
        experiment: Experiment,
        axes: Sequence[Axis],
        lanes: LaneExecutor,
        target: float | None = None,
        requested: plan.Requested | None = None,
    ) -> Calibration:
        grids = tuple((axis.name, axis.kind, axis.values.tobytes()) for axis in axes)
        drawn = frozenset(plan.start_samplers(requested or ()))
        runner = (len(lanes.devices), lanes.tile, jax.config.read("jax_disable_most_optimizations"))
        key = (experiment.sha256, experiment.sectioned, grids, target, drawn, runner)
        if key not in found:
            found[key] = calibrate(experiment, axes, lanes, target, requested)
        return found[key]

    return calibrate_once


def unless_given(calibrate: Calibrate, error: float = 1e-6) -> Calibrate:
    """`calibrate`, but for experiments that give their steps: no error is measured of those, nor sizes, and this is said."""

    def calibrate_unless_given(experiment: Experiment, *others: Any, **named: Any) -> Calibration:
        if experiment.accuracy.solver:
            return cast(Calibration, SimpleNamespace(error=lambda *_: error, sizes={}))
        return calibrate(experiment, *others, **named)

    return calibrate_unless_given


@contextlib.contextmanager
def calibrating_by(change: Callable[[Calibrate], Calibrate]) -> Iterator[None]:
    """Runs and sessions of this process calibrate by a changed `calibrate`."""
    with mock.patch.object(plan, "calibrate", change(plan.calibrate)):
        yield
