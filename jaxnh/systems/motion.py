"""States of a mechanical system, and the chart of their section coordinates."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.chart import Chart, general_directions
from jaxnh.systems.state import Number, Vector, error_components, masked


class Motion(NamedTuple):
    """State of a lane.

    Attributes:
        q: k coordinates.
        v: velocities: k of q̇, or quasi-velocities.
        watch: largest |f| before a projection so far, and the reason of its failure, a number of `STATUS`.
    """

    q: Vector
    v: Vector
    watch: Vector


@error_components.register
def _(y: Motion) -> tuple[Vector, Vector]:
    return y.q, y.v


@masked.register
def _(y: Motion, kept: Number, reason: Number | None = None) -> Motion:
    q, v = masked((y.q, y.v), kept)
    if reason is None:
        return Motion(q, v, y.watch)
    drift, before = y.watch
    return Motion(q, v, (drift, jnp.where(kept | (before > 0.0), before, 1.0 * reason)))


class ReducedMotion(NamedTuple):
    """State that steps carry of a lane whose constraints give some of its velocities.

    Attributes:
        q: k coordinates.
        u: velocities that are free, the others being functions of them.
    """

    q: Vector
    u: Vector


class MotionChart(Chart):
    """Coordinates of a motion, those that are ignorable left out, and all its velocities.

    Attributes:
        kept: numbers of the coordinates that are not left out.
        count: number of all of them.
    """

    kept: tuple[int, ...] = eqx.field(static=True)
    count: int = eqx.field(static=True)

    def components(self, y: Motion) -> Vector:
        return *(y.q[i] for i in self.kept), *y.v

    def state(self, u: Number) -> Motion:
        """The motion with section coordinates; ignorable coordinates are zero."""
        zero = np.zeros_like(u[0]) if isinstance(u, np.ndarray) else jnp.zeros_like(u[0])
        q = [zero] * self.count
        for j, i in enumerate(self.kept):
            q[i] = u[j]
        return Motion(tuple(q), tuple(u[i] for i in range(len(self.kept), self.dimension)), (zero, zero))

    def directions(self, k: int) -> tuple[Vector, ...]:
        return general_directions(self.dimension, k)
