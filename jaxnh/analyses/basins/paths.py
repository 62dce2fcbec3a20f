"""Points of motions: recorded one after the other, followed, beside a cloud of others, and how far they drift."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.section_points import states_at
from jaxnh.analyses.window_averages import maps, points_a_unit
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import rates
from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State

FOLLOWED = 4
"""Periods that restless lanes are followed to see whether they are on an attractor."""
LAGS = 64
"""Points later than a point, up to which the drift of a motion is looked at."""

_EVERY = 4  # point of a cloud without a clock is held against those after it
_NEAREST = 3  # steps of Gauss and Newton to the nearest point of a path
_BOXED = 6  # coordinates


def pad_points(
    points: Float[np.ndarray, "reps points d"], steps: Float[np.ndarray, "reps points d"], count: int
) -> tuple[Float[np.ndarray, "reps count d"], Float[np.ndarray, "reps count d"]]:
    """Pad points and their steps to `count`: the last point is repeated, without a step."""
    more = [(0, 0), (0, count - points.shape[1]), (0, 0)]
    return np.pad(points, more, mode="edge"), np.pad(steps, more)


def batch_from_points(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"]) -> LaneBatch:
    """Return the same lanes started from section points."""
    return LaneBatch(**{**batch.__dict__, "start": states_at(batch, lanes, u)})


def follow_paths(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"]
) -> Float[np.ndarray, "lanes points d"]:
    """Return points of lanes that go on from u, which is the first of them."""
    strobe, parts = maps(batch)
    return lanes(_follow_path, (strobe,), (u, dict(batch.p)), periods=FOLLOWED, static=(parts,))


def _follow_path(strobe: ReturnMap, u: Array, p: Parameters, parts: int) -> Float[Array, "points d"]:
    chart = strobe.chart

    def follow(state: State, _: None) -> tuple[State, Array]:
        if parts:
            state, _ = lax.scan(lambda z, part: (part(z, p), None), state, strobe)
        else:
            state = strobe(state, p)
        return state, chart.point(state)

    return jnp.concatenate([u[None], lax.scan(follow, chart.state(u), length=FOLLOWED)[1]])


def stays_near(
    turns: Bool[np.ndarray, " d"],
    paths: Float[np.ndarray, "lanes followed d"],
    points: Float[np.ndarray, "points d"],
    edge: Float[np.ndarray, " d"],
) -> Bool[np.ndarray, " lanes"]:
    """Return whether all points of paths lie in boxes of these edges that contain some of the points, or next to one.

    Boxes are looked up by number, in the order of the points: a million lanes take a second. Of more than six
    coordinates the first six are looked at.
    """
    turns, paths, points, edge = turns[:_BOXED], paths[..., :_BOXED], points[:, :_BOXED], edge[:_BOXED]
    around = np.where(turns, np.ceil(2 * np.pi / edge), np.inf)  # boxes
    lowest = np.where(turns, -np.pi, points.min(axis=0))
    own = np.unique(np.floor((points - lowest) / edge), axis=0)
    steps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * len(edge), indexing="ij"), axis=-1).reshape(-1, 1, len(edge))
    boxes = (own + steps).reshape(-1, len(edge))
    boxes = np.where(turns, np.mod(boxes, around), boxes)
    place = np.floor((paths - lowest) / edge)
    place = np.where(turns, np.mod(place, around), place)
    first = boxes.min(axis=0)
    counts = boxes.max(axis=0) - first + 1.0
    with np.errstate(invalid="ignore"):
        inside = np.all((place >= first) & (place < first + counts), axis=-1)
    weights = np.concatenate([np.cumprod(counts[::-1])[-2::-1], [1.0]])
    known = np.unique((boxes - first) @ weights)
    at = np.where(inside, np.where(inside[..., None], place - first, 0.0) @ weights, -1.0)
    there = np.minimum(np.searchsorted(known, at), len(known) - 1)
    return np.all(known[there] == at, axis=1)


def recurrence_drift(
    chart: Chart, points: Float[np.ndarray, "lanes points d"], size: Float[np.ndarray, "lanes d"]
) -> Float[np.ndarray, " lanes"]:
    """Return how far points move a period, in sizes, after the lag at which they recur best."""
    drift, scale = np.full(len(points), np.inf), np.where(size > 0.0, size, 1.0)[:, None]
    for lag in range(1, LAGS + 1):
        moved = np.abs(chart.wrap(points[:, lag:] - points[:, :-lag])) / scale
        drift = np.fmin(drift, moved.max(axis=(1, 2)) / lag)
    return drift


def drift_across(
    batch: LaneBatch, motion: tuple[Float[np.ndarray, "lanes points d"], Float[np.ndarray, "lanes d"]]
) -> Float[np.ndarray, " lanes"]:
    """Return the drift of autonomous motions: across the flow, after the time at which they recur best.

    Paths between points are parabolas, through a point and those beside it.
    """
    drift, wrap = np.full(len(motion[0]), np.inf), batch.chart.wrap
    for k, (points, size) in enumerate(zip(*motion, strict=True)):
        scale = np.where(size > 0.0, size, 1.0)
        steps = wrap(np.diff(points, axis=0)) / scale
        velocity, bend = 0.5 * (steps[1:] + steps[:-1]), 0.5 * (steps[1:] - steps[:-1])  # of all but both ends
        first = np.arange(1, len(points) // 2, _EVERY)
        for lag in range(2, len(points) // 2 - 1):  # the path at a lag of one begins with the point itself
            away = wrap(points[first + lag] - points[first]) / scale
            v, c = velocity[first + lag - 1], bend[first + lag - 1]
            if np.max(np.abs(away) - np.abs(v) - np.abs(c)) >= lag * drift[k]:  # however near the paths come
                continue
            at = np.zeros(len(first))
            for _ in range(_NEAREST):
                slope = v + 2.0 * at[:, None] * c
                there = away + at[:, None] * (v + at[:, None] * c)
                along = np.sum(slope * slope, axis=1)
                at = np.clip(at - np.sum(slope * there, axis=1) / np.where(along > 0.0, along, 1.0), -1.0, 1.0)
            there = away + at[:, None] * (v + at[:, None] * c)
            drift[k] = min(drift[k], np.abs(there).max() / lag)
    return drift * points_a_unit(batch)


def record_points(batch: LaneBatch, lanes: LaneRunner, count: int) -> Float[np.ndarray, "lanes points d"]:
    """Return successive points of lanes: strobes, or for an autonomous flow several in a unit of time."""
    strobe, parts = maps(batch)
    return lanes(_record, (strobe,), batch.lanes, periods=count, static=(count, parts))


def _record(strobe: ReturnMap, state: State, p: Parameters, count: int, parts: int) -> Float[Array, "points d"]:
    def point(state: State, strobe: ReturnMap) -> tuple[State, Array]:
        after = strobe(state, p)
        return after, strobe.chart.point(after)

    if not parts:
        return lax.scan(lambda state, _: point(state, strobe), state, length=count)[1]
    points = lax.scan(lambda state, _: lax.scan(point, state, strobe), state, length=-(-count // parts))[1]
    return points.reshape(-1, points.shape[-1])[:count]


def flow_steps(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "lanes points d"]
) -> Float[np.ndarray, "lanes points d"]:
    """Return the displacement along the flow in the time between recorded points, zero with a clock."""
    if not batch.flow.autonomous:
        return np.zeros_like(points)
    each = batch.take(np.repeat(np.arange(batch.count), points.shape[1]))
    rates = lanes(_rate, (batch.flow,), (points.reshape(-1, points.shape[2]), dict(each.p)))
    return rates.reshape(points.shape) * (batch.flow.period / points_a_unit(batch))


def _rate(flow: Flow, u: Float[Array, " d"], p: Parameters) -> Float[Array, " d"]:
    state = flow.chart.state(u)
    return jnp.stack(rates(flow, state, p))
