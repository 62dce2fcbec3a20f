"""Steps of a period for lanes near their attractors, where starts far from them need more.

The error of a map in a period depends on the state of a lane: on a start box far beyond the attractors forces are
strong, and the steps that the accuracy of a sweep asks for are those of its corners. After a first window most of that
is over.
"""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import numpy as np

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.iterate import iterate
from jaxnh.systems.state import State, error_components

_PERIODS = 32  # that every lane is followed; 1024 lanes make as many samples as there are of a calibration, and more
_SAFETY = 2.0  # as of a calibration: some lanes of the sweep have larger errors
_FEWEST = 8
_WORTH = 0.95  # of the fewest steps that meet the target: those of another trial
_ROUNDS = 8


def choose_steps(batch: LaneBatch, lanes: LaneRunner, state: State) -> int:
    """Return the fewest steps of a period that meet the target of a batch, or all of its steps if half are too few.

    An error is the largest difference of any component after a period from the map of the batch, relative to the size
    of the motion where the target is, in all periods of its lanes from these states on. That map has twice the steps or
    more, and of a method of order six an error 64 times as small.
    """
    if not batch.target or batch.steps < 2 * _FEWEST:
        return batch.steps
    strobe, p = batch.strobe(), dict(batch.p)
    after = lanes.record(strobe, _PERIODS, (state, p))
    before = jax.tree.map(lambda first, later: np.c_[first, later[:, :-1]].ravel(), state, after)
    lane = np.repeat(np.arange(batch.count), _PERIODS)
    each = {name: values[lane] for name, values in p.items()}
    expected = _numbers(batch, jax.tree.map(np.ravel, after))
    good = np.all(np.isfinite(expected), axis=0)

    def error(steps: int) -> float:
        coarser = replace(batch, steps=steps).strobe()
        states = _numbers(batch, lanes(iterate, (coarser, np.int32(1)), (before, each), periods=1))
        gaps = np.max(np.abs(states - expected), axis=0, initial=0.0)[good]
        return _SAFETY * float(np.max(np.where(np.isfinite(gaps), gaps, np.inf), initial=0.0))

    order = getattr(batch.solver, "convergence_order", 1)
    failed, met, steps = 0, batch.steps, batch.steps // 2
    for _ in range(_ROUNDS):
        gap = error(steps)
        if gap <= batch.target:
            met = steps
        elif met == batch.steps:
            break
        else:
            failed = steps
        factor = (gap / (0.9 * batch.target)) ** (1.0 / order)
        steps = max(math.ceil(steps * min(max(factor, 0.5), 1.5)), failed + 1)
        if not _FEWEST <= steps < _WORTH * met:
            break
    return met


def _numbers(batch: LaneBatch, state: State) -> np.ndarray:
    """Return the components of states that errors count in, (components, points), in units of their sizes."""
    components = [np.asarray(leaf) for leaf in jax.tree.leaves(error_components(state))]
    sizes = list(batch.sizes.values()) or [1.0] * len(components)
    return np.stack([component / size for component, size in zip(components, sizes, strict=True)])
