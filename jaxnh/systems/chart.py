"""Section coordinates: the numbers of a state that a return map acts on, of all phase space or of a section of it.

A chart is made from a flow (`Flow.chart`), or from a flow and a plane (`maps.section.Section.chart`).
"""

from __future__ import annotations

import abc
from typing import Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnh.systems.state import Number, State, Vector


class Chart(eqx.Module):
    """Section coordinates of states, (dimension,) of one state, (..., dimension) of many on the host.

    Attributes:
        angles: for each section coordinate whether it is an angle, which returns after 2π.
        positions: how many of them, the first ones, are positions; the others are velocities, or their directions.
        dimensionless: whether they are of order one as they are, so that what is near needs no other measure.
    """

    angles: tuple[bool, ...] = eqx.field(static=True)
    positions: int = eqx.field(static=True)
    dimensionless: bool = eqx.field(static=True)

    @property
    def dimension(self) -> int:
        """Number of section coordinates."""
        return len(self.angles)

    @abc.abstractmethod
    def components(self, y: State) -> Vector:
        """Section coordinates of a state, one by one, angles as they are."""

    @abc.abstractmethod
    def state(self, u: Number) -> State:
        """The state with section coordinates u[0], u[1], …"""

    def lift(self, y: State, tangent: Vector) -> State:
        """The tangent at a state that has these section coordinates; of a linear chart the same at all states."""
        return self.state(tangent)

    def lower(self, y: State, tangent: State) -> Vector:
        """Section coordinates of a tangent at a state; of a linear chart the same at all states."""
        return self.components(tangent)

    def directions(self, k: int) -> tuple[Vector, ...]:
        """The first k coordinate directions, tangents to begin with."""
        return tuple(tuple(row.tolist()) for row in np.eye(self.dimension)[:k])

    # ---- of every chart

    def point(self, y: State) -> Float[Array, " dimension"]:
        """Section coordinates of a state, angles in [−π, π)."""
        return jnp.stack(
            [wrap_angle(x) if angle else x for x, angle in zip(self.components(y), self.angles, strict=True)]
        )

    def host_points(self, y: State) -> Float[np.ndarray, "... dimension"]:
        """Section coordinates of states (...,) on the host, angles as they are."""
        return np.stack(np.broadcast_arrays(*self.components(y)), axis=-1)

    def wrap(self, difference: Number) -> Number:
        """A difference of section coordinates (..., dimension), its angles in [−π, π)."""
        xp = np if isinstance(difference, np.ndarray) else jnp
        columns = [difference[..., i] for i in range(self.dimension)]
        return xp.stack([wrap_angle(x) if angle else x for x, angle in zip(columns, self.angles, strict=True)], axis=-1)

    def distance(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Largest difference of positions between points (..., dimension): (...,)."""
        return np.max(np.abs(self.wrap(first - second))[..., : self.positions], axis=-1, initial=0.0)

    def scales(self, box: float) -> Float[np.ndarray, " dimension"]:
        """Half the extent of a box of points in each coordinate: of angles π."""
        return np.where(self.angles, np.pi, box)


class Wrap(Protocol):
    """Brings the angles of differences of section coordinates (..., d) into their range: `Chart.wrap`."""

    def __call__(self, difference: np.ndarray, /) -> np.ndarray: ...


def general_directions(dimension: int, k: int) -> tuple[Vector, ...]:
    """k orthonormal tangents in no special direction: none is lost on constraints or invariant planes."""
    draws = np.linalg.qr(np.random.default_rng(0).normal(size=(dimension, dimension)))[0]
    return tuple(tuple(row.tolist()) for row in draws[:k])


def wrap_angle(angle: Number) -> Number:
    """An angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
