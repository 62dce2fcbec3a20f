"""Systems ẏ = rhs(y, t) whose state jumps where a wall is met, or whose field changes where a surface is crossed.

Walls and surfaces are zeros of functions of (y, t), their heights. A field that changes reads on which sides of its
surfaces a state is, so that a step may keep to one branch of it beyond the surface as well, where it has none of its
own. How such motions are integrated is in `maps.jumping`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.definition import Definition, marked
from jaxnh.systems.first_order import CoordinateChart, FirstOrder
from jaxnh.systems.flow import NOT_FINITE, Output, Parameters, status
from jaxnh.systems.state import Number, Vector, error_components

DIRECTIONS = ("up", "down", "both")
"""Directions in which a wall may be passed: its height rises through zero, falls, or either."""


class PiecewisePoint(NamedTuple):
    """State of a lane.

    Attributes:
        y: d coordinates.
        reason: why the lane has failed, else zero.
    """

    y: Vector
    reason: Any


@error_components.register
def _(y: PiecewisePoint) -> tuple[Vector]:
    return (y.y,)


class PiecewiseChart(CoordinateChart):
    """All coordinates."""

    def state(self, u: Number) -> PiecewisePoint:
        return PiecewisePoint(tuple(u[i] for i in range(self.dimension)), jnp.zeros_like(u[0]))


class PiecewiseSmooth(FirstOrder):
    """A right-hand side with jumps of the state and switches of the field; made by `piecewise_smooth`.

    Attributes:
        jumps: direction in which each wall is passed.
        switches: number of surfaces where the field changes.
    """

    jumps: tuple[str, ...] = eqx.field(static=True)
    switches: int = eqx.field(static=True)

    def heights(self, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> tuple[Number, ...]:
        """Heights of a state above the walls, which rise where they are passed (either way for "both"), and surfaces.

        Returns:
            A number for each jump, then for each switch, of the shape of a component.
        """
        definition = self.definition(p)
        walls = [jump["when"](y.y, t) for jump in definition.get("jumps", ())]
        walls = [-wall if way == "down" else wall for wall, way in zip(walls, self.jumps, strict=True)]
        surfaces = [switch["on"](y.y, t) for switch in definition.get("switches", ())]
        return tuple(jnp.asarray(height, jnp.float64) for height in (*walls, *surfaces))

    def jumped(self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> PiecewisePoint:
        """The state after a jump."""
        after = self.definition(p)["jumps"][number]["then"](tuple(y.y), t)
        return PiecewisePoint(tuple(jnp.asarray(x, jnp.float64) for x in after), y.reason)

    def rhs(self, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> PiecewisePoint:
        """Time derivative of a state by the branch of the field that it is in; on a surface by that above it."""
        return self.branch(t, y, p, self.sides(t, y, p))

    def sides(self, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> tuple[Number, ...]:
        """The side of each switch that a state is on: +1 above it and on it, −1 below."""
        heights = self.heights(t, y, p)[len(self.jumps) :] if self.switches else ()
        return tuple(jnp.where(height >= 0.0, 1.0, -1.0) for height in heights)

    def branch(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """Time derivative of a state by a branch of the field, wherever the state is.

        Args:
            sides: +1 above, −1 below, of each switch.
        """
        rhs = self.definition(p)["rhs"]
        rates = rhs(tuple(y.y), t, sides) if self.switches else rhs(tuple(y.y), t)
        zero = jnp.zeros_like(y.y[0])
        return PiecewisePoint(tuple(jnp.asarray(rate, jnp.float64) + zero for rate in rates), zero)

    @property
    def chart(self) -> PiecewiseChart:
        """All coordinates."""
        return PiecewiseChart(self.angles, positions=len(self.names), dimensionless=False)

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> PiecewisePoint:
        """The state with coordinates by name."""
        y = super().start(coordinates).y
        return PiecewisePoint(y, np.zeros_like(y[0]))

    def reports(self, y: PiecewisePoint) -> dict[str, Output]:
        """Return the status of each trajectory, from the last of its states (..., points)."""
        reason = np.asarray(y.reason)[..., -1]
        finite = np.all([np.isfinite(x[..., -1]) for x in y.y], axis=0)
        return {"status": status(np.where(finite, 0, np.where(reason > 0, reason, NOT_FINITE)))}


def piecewise_smooth(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> PiecewiseSmooth:
    """The system that a function of its parameters defines.

    Args:
        define: as of `first_order`, with `jumps`, each a mapping of `when`, the height (y, t) to a number, `direction`,
            one of `DIRECTIONS`, and `then`, (y, t) to the d numbers after the jump; and `switches`, each a mapping of
            `on`, the height of a surface. With switches `rhs` is a function of (y, t, side), side a number ±1 for each.
        parameters, of_lanes: as of `first_order`.
    """
    definition = define(**parameters)
    jumps = tuple(jump["direction"] for jump in definition.get("jumps", ()))
    return PiecewiseSmooth(
        define,
        dict(parameters),
        of_lanes,
        tuple(definition["coordinates"]),
        marked(definition, "angles"),
        "period" in definition,
        jumps,
        len(definition.get("switches", ())),
    )
