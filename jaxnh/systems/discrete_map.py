"""A map y → image(y) as a system: time counts its iterates, and one iterate takes the place of a period."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.systems.definition import Definition, marked
from jaxnh.systems.first_order import Point, PointFlow, point_like
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.user_functions import components_of, pointwise

_FAR = 1024.0
"""Angles beyond this lose their whole turns before they are mapped, and have them back in the image.

A map that turns an angle several times while it goes through one turn would enlarge them, and their rounding, forever.
"""


class DiscreteMap(PointFlow):
    """Any map, its definition's `map`; made by `discrete_map`.

    Its clock has an iterate as period, 1. What is a rate of a flow is here a change in one iterate.
    """

    @property
    def continuous(self) -> bool:
        """No: there is nothing between two iterates."""
        return False

    def image(self, y: Point, p: Parameters) -> Point:
        """The next iterate, angles with the whole turns that they have made."""
        return self._map_angles(self.definition(p)["map"], y)

    def rhs(self, t: ArrayLike, y: Point, p: Parameters) -> Point:
        """Displacement in one iterate."""
        return jax.tree.map(jnp.subtract, self.image(y, p), y)

    def divergence(self, t: ArrayLike, y: Point, p: Parameters) -> Number:
        """Logarithm of the growth of volume in one iterate, ln |det ∂image/∂y|, at one state.

        Its mean is the sum of the Lyapunov exponents; minus infinity where the map folds.
        """
        jacobian = jax.jacfwd(lambda u: jnp.stack(self.image(Point(tuple(u)), p).y))(jnp.stack(y.y))
        return jnp.log(jnp.abs(jnp.linalg.det(jacobian)))

    def _map_angles(self, image: Callable[[Vector], Iterable[Number]], y: Point) -> Point:
        """The image of a state, whose angles are mapped without many whole turns."""
        turns = tuple(_whole_turns(x) if angle else None for x, angle in zip(y.y, self.angles, strict=True))
        near = tuple(x if whole is None else x - whole for x, whole in zip(y.y, turns, strict=True))
        mapped = point_like(image(near), y)
        return Point(tuple(x if whole is None else x + whole for x, whole in zip(mapped.y, turns, strict=True)))


class InverseMap(DiscreteMap):
    """The inverse of a map, its definition's `inverse`."""

    def image(self, y: Point, p: Parameters) -> Point:
        """The iterate before."""
        inverse = pointwise(components_of(self.definition(p)["inverse"]))
        return self._map_angles(inverse, y)


def _whole_turns(angle: Number) -> Number:
    """The whole turns of an angle beyond `_FAR`, zero of one that is not."""
    return jnp.where(jnp.abs(angle) > _FAR, angle - lax.rem(angle, jnp.full_like(angle, 2 * np.pi)), 0.0)


def inverse_map(system: DiscreteMap) -> InverseMap | None:
    """The inverse of a map; None where its definition has none."""
    if "inverse" not in system.definition({}):
        return None
    return InverseMap(system.define, system.values, system.of_lanes, system.names, system.angles, system.clock)


def discrete_map(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> DiscreteMap:
    """The map that a function of its parameters defines.

    Args:
        define: parameters by name to a mapping with `map`, a function of y, a tuple of d numbers, to d numbers, the
            next iterate; `coordinates`, their d names; and where there are some, names of coordinates that are
            `angles`, and `inverse`, a function of the next iterate to y.
        parameters: values of all parameters.
        of_lanes: names of those that lanes may have of their own, by default all.
    """
    definition = define(**parameters)
    names = tuple(definition["coordinates"])
    return DiscreteMap(define, dict(parameters), of_lanes, names, marked(definition, "angles"), True)
