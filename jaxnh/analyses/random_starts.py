"""Start states drawn evenly from a box of coordinates, some at each value of the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.base import OptionError, Setting, Starts
from jaxnh.analyses.batch import LaneBatch
from jaxnh.maps.section import begin
from jaxnh.systems.flow import Flow
from jaxnh.systems.rows import select

Box = Mapping[str, tuple[float, float]]
"""Coordinates of the start by name, each with its lowest and its highest value."""

_EQUAL = 1e-6  # of the modulus of a coordinate: one that differs by less does not


def check_box(box: Box, setting: Setting) -> None:
    """Check that the option `box` is of coordinates that a start has, and that no axis is one of start states."""
    flow = setting.flow
    for name in box:
        if name not in flow.coordinates:
            raise OptionError(f"there is no coordinate {name}; known are {', '.join(flow.coordinates)}", f"box.{name}")
        if not _decides(flow, name):
            raise OptionError(f"the constraint decides {name}; leave it out", f"box.{name}")
    for axis in setting.axes:
        if axis.kind == "start":
            message = f"random starts and the axis {axis.name} of start states exclude each other; leave one out"
            raise OptionError(message, "box")


def _decides(flow: Flow, name: str) -> bool:
    """Return whether a start state depends on a coordinate."""
    states = [flow.start({**dict.fromkeys(flow.coordinates, 0.0), name: value}) for value in (0.0, 1e-3)]
    first, second = (np.stack(np.broadcast_arrays(*jax.tree.leaves(state))) for state in states)
    return not np.array_equal(first, second)


def random_start_batch(
    batch: LaneBatch, starts: int, seed: int, box: Box
) -> tuple[LaneBatch, dict[str, Float[np.ndarray, " lanes"]]]:
    """Return the batch with so many random starts for each lane in turn, and the values drawn, by coordinate.

    A lane has its starts by its place along the first axis, whatever lanes it is computed with. All values of the other
    axes have the same starts, so that shares that differ along these differ by no chance of the draw.
    """
    places, width = batch.places, starts * len(box)
    first = int(places.min())
    bits = np.random.PCG64(seed)
    bits.advance(first * width)  # a draw of 64 bits a number
    count = int(places.max()) - first + 1
    draws = np.random.Generator(bits).random((count, starts, len(box)))[places - first]
    drawn = {name: low + (high - low) * draws[..., k].ravel() for k, (name, (low, high)) in enumerate(box.items())}
    start = select(batch.without_section().start, np.s_[:, None])
    coordinates = batch.flow.readout.coordinates(start, np.zeros(1))
    others = {name: np.repeat(np.asarray(output.data)[:, 0], starts) for name, output in coordinates.items()}
    p = {name: np.repeat(values, starts) for name, values in batch.p.items()}
    state = begin(batch.system, batch.flow.start(others | drawn))
    return replace(batch, start=state, p=p, place=np.repeat(places, starts), axis=None), drawn


def box_corners(batch: LaneBatch, box: Box) -> tuple[LaneBatch, LaneBatch]:
    """Return the batch at the lowest and at the highest values of a box of starts."""
    low, high = (
        random_start_batch(batch, 1, 0, {name: (side[k], side[k]) for name, side in box.items()})[0] for k in (0, 1)
    )
    return low, high


def box_size(
    batch: LaneBatch, box: Box, starts: Float[np.ndarray, "lanes starts d"] | None = None
) -> Float[np.ndarray, "lanes d"]:
    """Return the unit of lengths: half the sides of a box in each coordinate, of angles one.

    Of a coordinate that the box leaves out it is half the extent of the starts, as these come to a section, or its
    modulus where they do not differ.
    """
    corners = np.stack([batch.chart.host_points(corner.start) for corner in box_corners(batch, box)], axis=1)
    half, size = 0.5 * np.abs(corners[:, 1] - corners[:, 0]), extent(batch, corners if starts is None else starts)[0]
    given = ~np.array(batch.chart.angles) & (half > _EQUAL * np.abs(corners).max(axis=1))
    return np.where(given, half, size)


def extent(
    batch: LaneBatch, points: Float[np.ndarray, "lanes starts d"]
) -> tuple[Float[np.ndarray, "lanes d"], Float[np.ndarray, "lanes d"]]:
    """Return half the extent of points, and that or what is more, their largest modulus; of angles one."""
    finite = np.isfinite(points).all(axis=2, keepdims=True)
    high = np.max(np.where(finite, points, -np.inf), axis=1)
    low = np.min(np.where(finite, points, np.inf), axis=1)
    half, modulus = 0.5 * (high - low), np.maximum(np.abs(high), np.abs(low))
    size = np.where(half > _EQUAL * modulus, half, modulus)
    known = ~np.array(batch.chart.angles) & (size > 0.0) & np.isfinite(size)
    return np.where(known, size, 1.0), np.where(known, np.maximum(size, modulus), 1.0)


def draw_starts(options: Any) -> Starts | None:
    """Return the draw of the random starts that options with `n_starts`, `seed` and a `box` ask for, if any."""
    if not options.n_starts:
        return None
    return lambda batch: (
        random_start_batch(batch, options.n_starts, options.seed, options.box)[0].start,
        np.repeat(np.arange(batch.count), options.n_starts),
    )
