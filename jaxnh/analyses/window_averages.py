"""Averages of a lane's motion over windows: running means that tell attractors apart, whatever phase a lane arrives in.

Means are taken of each section coordinate and of its square, of an angle of its cosine and sine and of how far it turns
a period, at the strobes or, without a clock, several times a unit of time, so that a cycle that the unit of time is a
multiple of has no phase either. Under the smooth window of `smooth_window` they converge faster than any power of their
length on periodic and quasiperiodic motion. Twins by a symmetry differ in odd means, running solutions in
their turns.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import half_window_weights
from jaxnh.maps.batching import as_batched
from jaxnh.maps.build import make_parts
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import LaneStates, State

_STILL = 1e-9  # of its modulus: a coordinate that changes by no more is at rest
_MOST_PARTS = 8
"""Points of a unit of time that means are taken over, at most, where there is no clock.

Fewer where a unit has fewer steps: what these resolve to the accuracy asked for has no harmonics worth mention at as
many points, so that a cycle that the unit is a multiple of has the same means at every phase.
"""


class WindowAverages(NamedTuple):
    """Lanes after a window and their averages; arrays of one lane, or of all with the lanes as first axis.

    Attributes:
        state: at the end.
        whole: smooth means over the window, (F,).
        halves: smooth means over its halves, (2, F).
        blocks: plain means over sixteenths of it, (BLOCKS, F).
        low, high: of each section coordinate, (d,).
        path: how far each has gone to and fro, (d,).
    """

    state: LaneStates
    whole: Float[Array, " F"]
    halves: Float[Array, "2 F"]
    blocks: Float[Array, "blocks F"]
    low: Float[Array, " d"]
    high: Float[Array, " d"]
    path: Float[Array, " d"]

    @property
    def largest(self) -> np.ndarray:
        """Largest modulus of each section coordinate."""
        return np.maximum(np.abs(self.low), np.abs(self.high))


class _Sums(NamedTuple):
    """Sums over periods, and the range so far."""

    state: LaneStates
    whole: Array
    halves: Array
    block: Array
    low: Array
    high: Array
    path: Array


def features(turns: Bool[np.ndarray, " d"], u: Array, moved: Array) -> Array:
    """Return the features whose means are taken, (F,), from section coordinates and their displacements, (d,)."""
    values = []
    for i, turning in enumerate(turns):
        values += [jnp.cos(u[i]), jnp.sin(u[i]), moved[i]] if turning else [u[i], u[i] * u[i]]
    return jnp.stack(values)


def units(turns: Bool[np.ndarray, " d"], size: Float[np.ndarray, "lanes d"]) -> Float[np.ndarray, "lanes F"]:
    """Return the size of each feature for coordinates of these sizes; 1 for the features of an angle."""
    sizes = []
    with np.errstate(over="ignore"):  # of lanes that go to infinity
        for i, turning in enumerate(turns):
            sizes += [np.ones(len(size))] * 3 if turning else [size[:, i], size[:, i] ** 2]
    return np.stack(sizes, axis=-1)


def extents(
    turns: Bool[np.ndarray, " d"], low: Float[np.ndarray, "lanes d"], high: Float[np.ndarray, "lanes d"]
) -> Float[np.ndarray, "lanes F"]:
    """Return the range of each feature for coordinates from low to high; 1 for an angle and its turns."""
    ranges = []
    for i, turning in enumerate(turns):
        far, extent = np.maximum(np.abs(low), np.abs(high))[:, i], (high - low)[:, i]
        extent = np.where(extent > _STILL * far, extent, np.where(far > 0.0, far, 1.0))
        ranges += [np.ones(len(low))] * 3 if turning else [extent, 2.0 * far * extent]
    return np.stack(ranges, axis=-1)


def points_a_unit(batch: LaneBatch) -> int:
    """Return the number of points of a unit of time that means are taken over, for an autonomous flow."""
    return min(_MOST_PARTS, batch.steps)


def maps(batch: LaneBatch) -> tuple[ReturnMap, int]:
    """Return the map of a period and 0, or if autonomous the stacked maps of the parts of a unit, and their number."""
    if not batch.flow.autonomous:
        return batch.map(), 0
    parts = points_a_unit(batch)
    strobes = make_parts(batch.flow, batch.solver, batch.steps, parts, compensated=batch.compensated)
    return in_precision(strobes, batch.precision), parts


def average_window(batch: LaneBatch, lanes: LaneRunner, state: State, count: int) -> WindowAverages:
    """Average lanes of a batch from a state over `count` periods, a multiple of `BLOCKS`."""
    strobe, parts = maps(batch)
    shared, static = (strobe, np.int32(count // BLOCKS)), (parts,)
    return lanes(window_averages, shared, (state, dict(batch.p)), periods=count, static=static)


def window_averages(strobe: ReturnMap, each: ArrayLike, state: State, p: Parameters, parts: int) -> WindowAverages:
    """Average one lane over `BLOCKS` times `each` periods."""
    chart = strobe.chart
    turns, d = np.array(chart.angles), chart.dimension
    width = int(3 * turns.sum() + 2 * (~turns).sum())

    def point(sums: _Sums, strobe: ReturnMap) -> tuple[_Sums, Array]:
        before = sums.state
        after = strobe(before, p)
        moved = jnp.stack(chart.lower(before, jax.tree.map(jnp.subtract, after, before)))
        u = chart.point(after)
        low, high = jnp.minimum(sums.low, u), jnp.maximum(sums.high, u)
        sums = sums._replace(state=after, low=low, high=high, path=sums.path + jnp.abs(moved))
        return sums, features(turns, u, moved)

    def period(k: Array, carry: tuple[_Sums, Array]) -> tuple[_Sums, Array]:
        sums, weights = carry
        if parts:
            sums, seen = lax.scan(point, sums, strobe)
            seen = jnp.mean(seen, axis=0)
        else:
            sums, seen = point(sums, strobe)
        at = (jnp.float64(k) + 0.5) / (BLOCKS * jnp.float64(each))
        of_whole, of_half = half_window_weights(at)
        of_halves = jnp.stack([jnp.where(at < 0.5, of_half, 0.0), jnp.where(at < 0.5, 0.0, of_half)])
        halves = sums.halves + of_halves[:, None] * seen[None, :]
        sums = sums._replace(whole=sums.whole + of_whole * seen, halves=halves, block=sums.block + seen)
        return sums, weights + jnp.stack([of_whole, *of_halves])

    def block(carry: tuple[_Sums, Array], number: Array) -> tuple[tuple[_Sums, Array], Array]:
        sums, weights = carry
        start = sums._replace(block=as_batched(jnp.zeros_like(sums.block), sums.path[0])), weights
        ended = lax.fori_loop(number * each, (number + 1) * each, period, start)
        return ended, ended[0].block / jnp.float64(each)

    zero, far = jnp.zeros(width), jnp.full(d, jnp.inf)
    initial = _Sums(state, zero, jnp.zeros((2, width)), zero, far, -far, jnp.zeros(d))
    initial = as_batched(initial, jax.tree.leaves(state)[0])
    (sums, weights), blocks = lax.scan(block, (initial, jnp.zeros(3)), jnp.arange(BLOCKS, dtype=jnp.int32))
    whole, halves = sums.whole / weights[0], sums.halves / weights[1:, None]
    return WindowAverages(sums.state, whole, halves, blocks, sums.low, sums.high, sums.path)
