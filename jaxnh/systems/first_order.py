"""Systems whose state is a point, its coordinates those of the section; of these, differential equations ẏ = rhs(y, t).

There is no constraint to keep, and nothing to report but whether a state is finite. Maps are in `discrete_map`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.chart import Chart, general_directions, wrap_angle
from jaxnh.systems.definition import DefinedFlow, DefinedReadout, Definition, marked
from jaxnh.systems.flow import Parameters
from jaxnh.systems.readout import Labels, Output, pairs
from jaxnh.systems.state import Number, State, Vector


class Point(NamedTuple):
    """State of a lane.

    Attributes:
        y: d coordinates.
    """

    y: Vector


class CoordinateChart(Chart):
    """All coordinates."""

    def components(self, y: State) -> Vector:
        return tuple(y.y)

    def state(self, u: Number) -> State:
        return Point(tuple(u[i] for i in range(self.dimension)))

    def directions(self, k: int) -> tuple[Vector, ...]:
        return general_directions(self.dimension, k)


class PointFlow(DefinedFlow):
    """A system whose state is a point, a number a coordinate."""

    # ---- names

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates in the system."""
        return self.names

    # ---- motion

    @property
    def exponents(self) -> int:
        """One exponent a coordinate."""
        return len(self.names)

    @property
    def chart(self) -> CoordinateChart:
        """All coordinates."""
        return CoordinateChart(self.angles, positions=len(self.names), dimensionless=False)

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> State:
        """The state with coordinates by name."""
        return Point(tuple(np.asarray(coordinates[name], float) for name in self.names))

    @property
    def readout(self) -> PointReadout:
        """Coordinates as the definition calls them."""
        return PointReadout(self)


class PointReadout(DefinedReadout):
    """States that are points, a number a coordinate."""

    @property
    def labels(self) -> Labels:
        names, angles = self.flow.names, self.flow.angles
        kinds = {name: "angle" if angle else "coordinate" for name, angle in zip(names, angles, strict=True)}
        return self.labelled(kinds, pairs(names))

    def coordinates(self, y: State, t: np.ndarray) -> dict[str, Output]:
        words = self.labels
        return {
            name: Output(wrap_angle(x) if angle else x, words.long_names[name], {"units": words.units[name]})
            for name, x, angle in zip(self.flow.names, y.y, self.flow.angles, strict=True)
        }


class FirstOrder(PointFlow):
    """Any system of a right-hand side, its definition's `rhs`; made by `first_order`."""

    def rhs(self, t: ArrayLike, y: State, p: Parameters) -> State:
        """Time derivative of a state."""
        rates = self.definition(p)["rhs"](tuple(y.y), t)
        return point_like(rates, y)


def point_like(numbers: Iterable[Number], y: Point) -> Point:
    """Numbers that a definition returns, constants among them, as a point of the shape of another."""
    return Point(tuple(jnp.asarray(number, jnp.float64) + jnp.zeros_like(y.y[0]) for number in numbers))


def first_order(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> FirstOrder:
    """The system that a function of its parameters defines.

    Args:
        define: parameters by name to a mapping with `rhs`, a function of (y, t) to d numbers, y being a tuple of d;
            `coordinates`, their d names; with a clock its `period`, without one if wanted a `time_unit` that lengths of
            time are counted in; and where there are some, names of coordinates that are `angles`.
        parameters: values of all parameters.
        of_lanes: names of those that lanes may have of their own, by default all.
    """
    definition = define(**parameters)
    names, clock = tuple(definition["coordinates"]), "period" in definition
    return FirstOrder(define, dict(parameters), of_lanes, names, marked(definition, "angles"), clock)
