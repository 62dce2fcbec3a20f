"""Points that a return map acts on, of the states of lanes, and back; points that lanes come to."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.section import System
from jaxnh.systems.state import State


def points_at(
    batch: LaneBatch, lanes: LaneRunner, state: State, tile: int | None = None
) -> Float[np.ndarray, "lanes ... d"]:
    """Return the section coordinates of states, components (lanes,) or (lanes, points)."""
    if not any(batch.system.chart.angles):  # they are components of the states as they are: no program is needed
        return batch.system.chart.host_points(state)
    function = _points_of if np.ndim(jax.tree.leaves(state)[0]) > 1 else _point_of
    return np.array(lanes(function, (batch.system,), (state,), tile=tile))


def states_at(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], tile: int | None = None) -> State:
    """Return the states at section coordinates."""
    return lanes(_state_at, (batch.system,), (u,), tile=tile)


def states_after(
    batch: LaneBatch, lanes: LaneRunner, state: State, wait: int, count: int, tile: int | None = None
) -> State:
    """Return the next states (lanes, count) of lanes after a number of periods."""
    p = dict(batch.p)
    state = lanes.iterate(batch.strobe(), wait, (state, p), tile=tile) if wait else state
    return lanes.record(batch.strobe(), count, (state, p), tile=tile)


def points_after(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], wait: int, count: int, tile: int | None = None
) -> Float[np.ndarray, "lanes count d"]:
    """Return the next points of lanes after a number of periods."""
    states = states_after(batch, lanes, states_at(batch, lanes, u, tile), wait, count, tile)
    return points_at(batch, lanes, states, tile)


def _point_of(system: System, state: State) -> Float[Array, " d"]:
    return system.chart.point(state)


def _points_of(system: System, states: State) -> Float[Array, "points d"]:
    return jax.vmap(system.chart.point)(states)


def _state_at(system: System, u: Float[Array, " d"]) -> State:
    return system.chart.state(u)
