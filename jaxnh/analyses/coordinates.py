"""Coordinates of the flow at points that a return map acts on, by name, as results have them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxnh.analyses.base import Entry, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.section_points import states_at
from jaxnh.maps.section import outputs, plot_plane
from jaxnh.systems.readout import Output
from jaxnh.systems.rows import select


def coordinates_at(batch: LaneBatch, lanes: LaneRunner, points: np.ndarray, instant: float = 0.0) -> dict[str, Output]:
    """Return coordinates of points, (..., d), at an instant of the period by name, each (...,).

    Those that motions are drawn over come first. Of a point that is not finite they are NaN.
    """
    flat = points.reshape(-1, points.shape[-1])
    known = np.isfinite(flat).all(axis=1)
    subset = flat[known] if known.any() else np.zeros((1, flat.shape[1]))
    states = select(states_at(batch, lanes, subset), np.s_[:, None])
    named, coordinates = outputs(batch.flow, states, np.array([instant])), dict[str, Output]()
    for name in dict.fromkeys((*plot_plane(batch.system), *batch.flow.coordinates)):
        if name in named:
            whole = np.full(len(flat), np.nan)
            whole[known] = np.asarray(named[name].data)[: np.count_nonzero(known), 0]
            coordinates[name] = named[name]._replace(data=whole.reshape(points.shape[:-1]))
    return coordinates


def named_points(
    batch: LaneBatch,
    lanes: LaneRunner,
    points: np.ndarray,
    dims: Sequence[str],
    ending: str,
    words: str,
    instant: float = 0.0,
) -> dict[str, Entry]:
    """Return points, (..., d) over the dimensions, as variables: coordinates by name with an ending."""
    return {
        f"{name}{ending}": variable(dims, output.data, f"{output.long_name} {words}", **output.attrs)
        for name, output in coordinates_at(batch, lanes, points, instant).items()
    }
