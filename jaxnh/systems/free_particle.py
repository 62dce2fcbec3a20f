"""The particle of equation (1) without a constraint, by the general route: T and Q, and no f.

With a constraint the same equations are those of `particle.IsokineticParticle` by another way, which tests and prices
compare it with.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.definition import Definition
from jaxnh.systems.flow import Parameters
from jaxnh.systems.lagrangian import Lagrangian, LagrangianReadout, Motion, MotionChart, lagrangian
from jaxnh.systems.particle import LABELS, paper_coordinates
from jaxnh.systems.readout import Labels, Output
from jaxnh.systems.state import Number


class FreeParticle(Lagrangian):
    """A particle in the plane under the paper's forces, equation (1); made by `free_particle`.

    Attributes:
        without: effects that are left out, of `particle_parameters.EFFECTS`; without forcing there is no clock.
    """

    without: frozenset[str] = eqx.field(static=True, default=frozenset())

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The paper's x1, x2, y1, y2."""
        return "x1", "x2", "y1", "y2"

    @property
    def parameters(self) -> Parameters:
        """a, b and ω."""
        return {name: self.values[name] for name in ("a", "b", "omega")}

    @property
    def chart(self) -> MotionChart:
        """Positions and velocities, of order one as the paper's equations have no dimensions."""
        return replace(super().chart, dimensionless=True)

    @property
    def autonomous(self) -> bool:
        """Return whether there is no clock."""
        return "forcing" in self.without

    def start(self, coordinates: Mapping[str, ArrayLike]) -> Motion:
        """(q, q̇) at t = 0 with x1, x2, y1 and y2."""
        names = {"x1": "x1", "x1_dot": "x2", "y1": "y1", "y1_dot": "y2"}
        return super().start({ours: coordinates[theirs] for ours, theirs in names.items()})

    @property
    def readout(self) -> FreeReadout:
        """The paper's words."""
        return FreeReadout(self)


class FreeReadout(LagrangianReadout):
    """The paper's coordinates of motions (q, q̇); there is no constraint to drift from."""

    @property
    def labels(self) -> Labels:
        return LABELS

    def coordinates(self, y: Motion, t: np.ndarray) -> dict[str, Output]:
        return paper_coordinates(y.q[0], y.v[0], y.q[1], y.v[1])

    def reports(self, y: Motion) -> dict[str, Output]:
        return {"status": super().reports(y)["status"]}


@functools.cache
def definition(without: frozenset[str], constrained: bool = False) -> Callable[..., Definition]:
    """Parameters a, b, c, d and ω to T, Q and, if constrained, f of the particle.

    Some of `particle_parameters.EFFECTS` may be left out.
    """

    def system(a: Number, b: Number, c: Number, d: Number, omega: Number) -> Definition:
        def kinetic(q: Number, v: Number, t: Number) -> Number:
            return 0.5 * (v[0] ** 2 + v[1] ** 2)

        def forces(q: Number, v: Number, t: Number) -> tuple[Number, Number]:
            (x, y), (x2, y2) = q, v
            springs = a * x, y
            if "cubic_stiffness" not in without:
                springs = x * (a + x * x), y * (1.0 + a * (y * y))
            if "forcing" not in without:
                g = 1.0 + jnp.sin(omega * t)
                springs = g * springs[0], g * springs[1]
            pulls = (0.0, 0.0) if "coupling" in without else (b * y, b * x)
            drags = (0.0, 0.0) if "damping" in without else (a * x2, a * y2)
            return pulls[0] - springs[0] - drags[0], pulls[1] - springs[1] - drags[1]

        def speed(q: Number, v: Number, t: Number) -> tuple[Number]:
            return (v[0] ** 2 + v[1] ** 2 - c - d * jnp.sin(t),)

        functions = {"T": kinetic, "Q": forces, "coordinates": ("x1", "y1"), "period": 2 * math.pi / omega}
        return {**functions, "f": speed} if constrained else functions

    return system


def free_particle(a: float, b: float | None, omega: float, without: Collection[str] = ()) -> FreeParticle:
    """The particle of equation (1) without some of `particle_parameters.EFFECTS`.

    b is None where every lane has its own.
    """
    left_out = frozenset(without)
    parameters = {"a": a, "b": 0.0 if b is None else b, "c": 0.0, "d": 0.0, "omega": omega}
    made = lagrangian(definition(left_out), parameters, of_lanes=("a", "b"))
    return FreeParticle(**vars(made), without=left_out)
