"""Points that a return map acts on, of the states of lanes, and back; points that lanes come to."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import Crossing, Section, System, flow_of, rates, reports
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select
from jaxnh.systems.state import State, is_finite
from jaxnh.systems.status import NOT_FINITE

_STILL = 1e-9  # of the largest rates: integrators keep equilibria to rounding


def points_at(
    batch: LaneBatch, lanes: LaneRunner, state: State, tile: int | None = None
) -> Float[np.ndarray, "lanes ... d"]:
    """Return the section coordinates of states, components (lanes,) or (lanes, points)."""
    if not any(batch.system.chart.angles):  # they are components of the states as they are: no program is needed
        return batch.system.chart.host_points(state)
    function = _points_of if np.ndim(jax.tree.leaves(state)[0]) > 1 else _point_of
    return np.array(lanes(function, (batch.system,), (state,), tile=tile))


def first_points(batch: LaneBatch, lanes: LaneRunner) -> Float[np.ndarray, "lanes d"]:
    """Section coordinates of every lane's start, or of its first crossing where there is a section."""
    return first_places(batch, lanes)[0]


def first_places(batch: LaneBatch, lanes: LaneRunner) -> tuple[Float[np.ndarray, "lanes d"], Int[np.ndarray, " lanes"]]:
    """The points of `first_points`, and the status of lanes there."""
    if not batch.on_section:
        return batch.chart.host_points(batch.start), statuses(batch, batch.start)
    u, crossing = lanes(_first_crossing, (batch.strobe(),), batch.lanes, periods=1)
    return np.asarray(u), statuses(batch, crossing)


def points_of_starts(batch: LaneBatch, lanes: LaneRunner) -> Float[np.ndarray, "starts d"]:
    """Return points that starts lead to Newton for orbits with: `first_points` of all lanes, and then others of them.

    A motion comes to its section up to a whole turn after its start, and has left by then what repels. The others are
    the points of the section that have the coordinates of the starts; not with constraints, which these may break.
    """
    first, flow = first_points(batch, lanes), batch.flow
    if not batch.on_section or flow.chart.dimension > flow.exponents:
        return first
    return np.concatenate([first, points_at(batch, lanes, batch.start)])


def _first_crossing(strobe: ReturnMap, state: State, p: Parameters) -> tuple[Float[Array, " d"], State]:
    crossing = strobe(state, p)
    return strobe.chart.point(crossing), crossing


def states_at(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], tile: int | None = None) -> State:
    """Return the states at section coordinates."""
    return lanes(_state_at, (batch.system,), (u,), tile=tile)


def at_rest(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"]) -> Bool[np.ndarray, " lanes"]:
    """Return whether points on a section are equilibria of the flow: fixed points of its return map that are no orbits.

    Of every coordinate the rate is nothing beside the largest among these points and the starts of the lanes.
    """
    system = batch.system
    if not isinstance(system, Section):
        return np.zeros(len(u), bool)
    start = points_at(batch, lanes, batch.start)
    speeds = [np.abs(lanes(_rates_at, (system,), (each, dict(batch.p)))) for each in (u, start)]
    largest = np.nanmax(np.concatenate(speeds), axis=0, initial=0.0)
    return np.all(speeds[0] <= _STILL * largest, axis=1)


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
    return points_and_end(batch, lanes, states_at(batch, lanes, u, tile), wait, count, tile)[0]


def points_from(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], count: int
) -> Float[np.ndarray, "lanes count d"]:
    """Return points of lanes and the next ones, so many together."""
    if count == 1:
        return u[:, None]
    return np.concatenate([u[:, None], points_after(batch, lanes, u, 0, count - 1)], axis=1)


def points_and_end(
    batch: LaneBatch, lanes: LaneRunner, state: State, wait: int, count: int, tile: int | None = None
) -> tuple[Float[np.ndarray, "lanes count d"], State]:
    """Return the next points of lanes after a number of periods, and the last of their states."""
    p, strobe = dict(batch.p), batch.strobe()
    state = lanes.iterate(strobe, wait, (state, p), tile=tile) if wait else state
    return lanes.observe(strobe, count, (state, p), _point_of, (batch.system,), tile=tile)


def statuses(
    batch: LaneBatch, state: State, finite: Bool[np.ndarray, " lanes"] | None = None
) -> Int[np.ndarray, " lanes"]:
    """Return the status of lanes, numbers of `STATUS`, from their last states.

    Args:
        finite: which lanes are, where more is known of them than their last states.
    """
    ended = np.asarray(reports(batch.flow, select(state, np.s_[:, None]))["status"].data)
    finite = is_finite(state) if finite is None else finite
    return np.where(finite, 0, np.where(ended > 0, ended, NOT_FINITE)).astype(int)


def shear_along_flow(
    batch: LaneBatch,
    lanes: LaneRunner,
    u: Float[np.ndarray, "lanes points d"],
    size: Float[np.ndarray, "lanes d"],
    tile: int | None = None,
) -> Float[np.ndarray, "lanes points d d"]:
    """Return triangles that take tangents of a section to coordinates across the flow, where lengths are as in space.

    A tangent of a section and its projection along the flow onto the plane across it are of one motion nearby. Where
    the flow is nearly tangent to the section, the section's tangents are nearly all along it.

    Args:
        u: points on the section.
        size: of the motion in each section coordinate; tangents and lengths are in these.
    """
    points, (count, d) = u.reshape(-1, u.shape[2]), u.shape[1:]
    p = {name: np.repeat(values, count) for name, values in batch.p.items()}
    rate, basis = (np.array(leaf) for leaf in lanes(_rate_and_basis, (batch.system,), (points, p), tile=tile))
    scaled = basis * np.repeat(size, count, axis=0)[:, None, :]
    extent = np.sqrt(np.sum(scaled**2, axis=2))  # of the motion in each coordinate of space
    extent = np.where(extent > 0.0, extent, np.max(extent, axis=1, keepdims=True))
    scaled, rate = scaled / extent[:, :, None], rate / extent
    rate /= np.linalg.norm(rate, axis=1, keepdims=True)
    across = scaled - rate[:, :, None] * np.einsum("pi,pij->pj", rate, scaled)[:, None]
    return np.linalg.qr(across)[1].reshape(len(u), count, d, d)


def on_constraints(system: System, u: Float[Array, " d"], p: Parameters) -> tuple[Float[Array, " d"], State]:
    """Return the point on the constraints near section coordinates, and its state of the flow, of one lane."""
    state = system.chart.state(u)
    if isinstance(state, Crossing):
        state = state._replace(state=flow_of(system).nearest(state.state, p))
        return system.chart.point(state), state.state
    state = flow_of(system).nearest(state, p)
    return system.chart.point(state), state


def _rates_at(system: Section, u: Float[Array, " d"], p: Parameters) -> Float[Array, " rates"]:
    return jnp.stack(rates(system.flow, system.chart.state(u).state, p))


def _rate_and_basis(
    system: Section, u: Float[Array, " d"], p: Parameters
) -> tuple[Float[Array, " space"], Float[Array, "space d"]]:
    """Rates of the coordinates of space at a point of a section, and what its coordinate directions are there."""
    state, zero = system.chart.state(u).state, jnp.zeros_like(u[0])
    columns = [jax.jvp(system.chart.state, (u,), (e,))[1].state for e in jnp.eye(system.chart.dimension)]
    chart = system.flow.chart
    rate = chart.lower(state, system.flow.rhs(zero, state, p))
    return jnp.stack(rate), jnp.stack([jnp.stack(chart.lower(state, each)) for each in columns], axis=-1)


def _point_of(system: System, state: State) -> Float[Array, " d"]:
    return system.chart.point(state)


def _points_of(system: System, states: State) -> Float[Array, "points d"]:
    return jax.vmap(system.chart.point)(states)


def _state_at(system: System, u: Float[Array, " d"]) -> State:
    return system.chart.state(u)
