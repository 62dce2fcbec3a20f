"""Batches of lanes along one axis, and their calibrations."""

from __future__ import annotations

import jax
import numpy as np

from jaxnh.analyses.batch import Axis, LaneBatch
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.axes import SweepPoints
from jaxnh.maps.section import flow_of


def broadcast_start(start, lanes):
    """A start state of floats as lanes, components of shape (lanes,)."""
    return jax.tree.map(lambda component: np.full(lanes, component, float), start)


def batch_of(system, start, values, solver, steps, compensated=False, error=0.0, *, name="b", **others):
    """A scene of lanes along one axis, all from the same start state of floats."""
    values = np.asarray(values, float)
    axis = Axis(name, values, flow_of(system).readout.labels.long_names[name])
    return LaneBatch(
        system,
        broadcast_start(start, len(values)),
        {name: values},
        solver,
        steps,
        compensated,
        error,
        axis=axis,
        **others,
    )


def calibrated(system, start, values, lanes, precision="float64", *, name="b"):
    """The calibration of lanes along one axis, all of them samples and all from the same start state of floats."""
    p = {name: np.asarray(values, float)}
    return Calibration([SweepPoints(system, broadcast_start(start, len(values)), p, p)], lanes, precision)
