"""Any system of differential equations ẏ = rhs(y, t) as a flow: its coordinates are those of its section.

There is no constraint to keep, and nothing to report but whether a state is finite.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.systems.definition import DefinedFlow, Definition, marked
from jaxnh.systems.flow import FAULTS, Number, Output, Parameters, Vector, turned


class Point(NamedTuple):
    """State of a lane.

    Attributes:
        y: d coordinates.
    """

    y: Vector


class FirstOrder(DefinedFlow):
    """Any system of a right-hand side, its definition's `rhs`; made by `first_order`."""

    # ---- names

    @property
    def coordinates(self) -> tuple[str, ...]:
        """As the system names them."""
        return self.names

    def words(self, name: str) -> str:
        """What a parameter or coordinate is called."""
        if label := self.said("labels", name):
            return f"{label} {name}"
        if name not in self.names:
            return f"parameter {name}"
        return f"{'angle' if self.angles[self.names.index(name)] else 'coordinate'} {name}"

    @property
    def plane(self) -> tuple[str, str]:
        """The first coordinate, and the second where there is one."""
        return self.names[0], self.names[min(1, len(self.names) - 1)]

    # ---- motion

    def rhs(self, t: ArrayLike, y: Point, p: Parameters) -> Point:
        """Time derivative of a state."""
        rates = self.definition(p)["rhs"](tuple(y.y), t)
        return Point(tuple(jnp.asarray(rate, jnp.float64) + jnp.zeros_like(y.y[0]) for rate in rates))

    # ---- the section: all coordinates

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    @property
    def exponents(self) -> int:
        """One a coordinate."""
        return self.dimension

    def chart(self, y: Point) -> Float[Array, " dimension"]:
        """The coordinates, angles in [−π, π)."""
        return jnp.stack([turned(x) if angle else x for x, angle in zip(y.y, self.angles, strict=True)])

    def unchart(self, u: Number) -> Point:
        """The state with these coordinates."""
        return Point(tuple(u[i] for i in range(self.dimension)))

    def wrap(self, difference: Number) -> Number:
        """A difference of coordinates (..., dimension), its angles in [−π, π)."""
        xp = np if isinstance(difference, np.ndarray) else jnp
        columns = [difference[..., i] for i in range(self.dimension)]
        return xp.stack([turned(x) if angle else x for x, angle in zip(columns, self.angles, strict=True)], axis=-1)

    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Largest difference of coordinates between points (..., dimension): (...,)."""
        return np.max(np.abs(self.wrap(one - other)), axis=-1)

    def signal(self, y: Point) -> Vector:
        """The first coordinate; of an angle its cosine and sine."""
        first = y.y[0]
        return (jnp.cos(first), jnp.sin(first)) if self.angles[0] else (first,)

    # ---- tangents

    def lift(self, y: Point, tangent: Vector) -> Point:
        """The tangent itself."""
        return Point(tuple(tangent))

    def lower(self, y: Point, tangent: Point) -> Vector:
        """The tangent itself."""
        return tuple(tangent.y)

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> Point:
        """The state with coordinates by name."""
        return Point(tuple(np.asarray(coordinates[name], float) for name in self.names))

    def section_point(self, y: Point) -> Float[np.ndarray, "... dimension"]:
        """Coordinates of states (...,) on the host."""
        return np.stack(np.broadcast_arrays(*y.y), axis=-1)

    def random_states(self, draws: np.ndarray, box: float, p: Parameters) -> Point:
        """Start states of even draws (lanes, dimension) from [−1, 1], times the box; angles times π."""
        return Point(tuple(draws[:, i] * (np.pi if angle else box) for i, angle in enumerate(self.angles)))

    def outputs(self, y: Point, t: np.ndarray) -> dict[str, Output]:
        """The coordinates by name."""
        return {
            name: Output(turned(x) if angle else x, self.words(name), {"units": self.units(name)})
            for name, x, angle in zip(self.names, y.y, self.angles, strict=True)
        }

    def reports(self, y: Point) -> dict[str, Output]:
        """Of each trajectory (..., points), by the last of its states, why it has failed."""
        finite = np.all([np.isfinite(x[..., -1]) for x in y.y], axis=0)
        flags = {"flag_values": np.arange(len(FAULTS), dtype=np.int8), "flag_meanings": " ".join(FAULTS)}
        reason = np.where(finite, 0, FAULTS.index("not_finite")).astype(np.int8)
        return {"failure": Output(reason, "why the trajectory has failed", flags)}


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
