"""Points that a return map acts on, of the states of lanes, and back."""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State


def points_at(batch: LaneBatch, lanes: LaneRunner, state: State) -> Float[np.ndarray, "lanes d"]:
    """Return the section coordinates of states."""
    return np.array(lanes(_point_of, (batch.system,), (state,)))


def states_at(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"]) -> State:
    """Return the states at section coordinates."""
    return lanes(_state_at, (batch.system,), (u,))


def _point_of(system: Flow, state: State) -> Float[Array, " d"]:
    return system.chart.point(state)


def _state_at(system: Flow, u: Float[Array, " d"]) -> State:
    return system.chart.state(u)
