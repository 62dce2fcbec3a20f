"""First paths of cycles through all of phase space, from their points on a section or at strobes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.section_points import states_at
from jaxnh.maps.build import make_parts, make_return_map
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.paths import path_through
from jaxnh.systems.state import State

_SAMPLES = 64  # of a return
_INTERVALS = 20  # of the mesh, a return
_CORNER = 0.1  # of the size: states further apart have others between them
_FINER = 16  # parts of what is between them
_LEVELS = 4
_TILE = 8


def first_guesses(
    batch: LaneBatch, lanes: LaneRunner, seeds: Sequence[SeedOrbit]
) -> list[tuple[int, BoundarySolution]]:
    """The paths of orbits, with their durations and values of the parameter, after how often they return.

    In the order of these numbers; none of orbits that do not come back.
    """
    guesses = list[tuple[int, BoundarySolution]]()
    for seed in sorted(seeds, key=lambda seed: len(seed.points)):
        times, states = _times_and_states(batch, lanes, seed)
        if np.isfinite(states).all() and times[-1] > 0.0:
            path, duration = path_through(times, states, _INTERVALS * len(seed.points))
            guesses.append((len(seed.points), BoundarySolution(path, np.array([duration]), np.array([[seed.value]]))))
    return guesses


def duration_of(batch: LaneBatch, lanes: LaneRunner, seed: SeedOrbit) -> float:
    """Time that an orbit takes."""
    n, p = len(seed.points), dict(batch.at_values(np.array([seed.value])).p)
    if batch.flow is batch.system:
        return n * batch.flow.period
    ended = lanes.iterate(batch.strobe(), n, (states_at(batch, lanes, seed.points[:1]), p), tile=_TILE)
    return float(np.asarray(ended.t)[0])


def _times_and_states(
    batch: LaneBatch, lanes: LaneRunner, seed: SeedOrbit
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k d"]]:
    """Times and states around an orbit, close together where it turns; all coordinates of the flow."""
    n, at = len(seed.points), batch.at_values(np.array([seed.value]))
    state, p, flow, duration = (
        states_at(batch, lanes, seed.points[:1]),
        dict(at.p),
        at.without_section(),
        duration_of(batch, lanes, seed),
    )
    if batch.flow is not batch.system:
        state = state.state
    if not np.isfinite(duration) or duration <= 0.0:
        return np.zeros(1), np.zeros((1, batch.flow.chart.dimension))
    if not batch.flow.autonomous:
        path = _through_periods(flow, lanes, state, p, n)
        return np.linspace(0.0, duration, len(path)), path
    step, count = duration / (n * _SAMPLES), n * _SAMPLES
    states = np.concatenate([flow.chart.host_points(state), _record(flow, lanes, state, p, step, count)[0]])
    return _with_corners(flow, lanes, p, np.linspace(0.0, duration, count + 1), states)


def _with_corners(
    flow: LaneBatch, lanes: LaneRunner, p: Mapping[str, np.ndarray], times: np.ndarray, states: np.ndarray
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k d"]]:
    """States at even times with others between them where they are far apart, and so on."""
    size, step = np.maximum(np.ptp(states, axis=0), np.finfo(float).tiny), times[1] - times[0]
    for _ in range(_LEVELS):
        jump = np.linalg.norm(np.diff(states, axis=0) / size, axis=1)
        wide = np.flatnonzero((jump > _CORNER) & (np.diff(times) > 0.5 * step))
        if not len(wide):
            break
        step /= _FINER
        many = {name: np.repeat(value, len(wide)) for name, value in p.items()}
        between = _record(flow, lanes, states_at(flow, lanes, states[wide], _TILE), many, step, _FINER - 1)
        more = times[wide][:, None] + step * np.arange(1, _FINER)
        times = np.concatenate([times, more.ravel()])
        order = np.argsort(times, kind="stable")
        states = np.concatenate([states, between.reshape(-1, states.shape[1])])[order]
        times = times[order]
    return times, states


def _record(
    flow: LaneBatch, lanes: LaneRunner, state: State, p: Mapping[str, np.ndarray], step: float, count: int
) -> Float[np.ndarray, "lanes count d"]:
    """States of lanes after 1, 2, … steps of time, without a clock."""
    moved = make_return_map(flow.flow, flow.solver, flow.steps, compensated=flow.compensated, span=(0.0, step))
    return flow.chart.host_points(lanes.record(moved, count, (state, dict(p)), tile=_TILE))


def _through_periods(
    batch: LaneBatch, lanes: LaneRunner, state: State, p: Mapping[str, np.ndarray], n: int
) -> Float[np.ndarray, "k d"]:
    """States of one lane at even times over n periods of a clock."""
    parts = make_parts(batch.flow, batch.solver, batch.steps, _SAMPLES, compensated=batch.compensated)
    maps = [jax.tree.map(lambda leaf, k=k: leaf[k], parts) for k in range(_SAMPLES)]
    path = [batch.chart.host_points(state)]
    for _ in range(n):
        for part in maps:
            state = lanes.iterate(part, 1, (state, dict(p)), tile=_TILE)
            path.append(batch.chart.host_points(state))
    return np.concatenate(path)
