"""The particle of equation (1) without a constraint, by the general route: T and Q, and no f.

With a constraint the same equations are those of `systems.IsokineticParticle` by another way, which tests and prices
compare it with.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.lagrangian import Motion, NonholonomicSystem, nonholonomic_system
from jaxnh.systems.particle import SWEEPS


class FreeParticle(NonholonomicSystem):
    """A particle in the plane under the paper's forces, equation (1); made by `free_particle`.

    Attributes:
        without: effects that are left out, of `systems.EFFECTS`; without forcing there is no clock.
    """

    without: frozenset[str] = eqx.field(static=True, default=frozenset())

    @property
    def autonomous(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether there is no clock."""
        return "forcing" in self.without

    @property
    def sweeps(self) -> str:
        """What differs from lane to lane, in words and with its symbol."""
        return SWEEPS[self.swept]

    def outputs(self, states: Motion, t: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
        """The paper's coordinates of states by name, each with words for it."""
        (x1, y1), (x2, y2) = states.q, states.v
        return {
            "x1": (x1, "position x1"),
            "x2": (x2, "velocity x2 = dx1/dt"),
            "y1": (y1, "position y1"),
            "y2": (y2, "velocity y2 = dy1/dt"),
        }

    def reports(self, states: Motion) -> dict[str, tuple[np.ndarray, str, dict[str, Any]]]:
        """Why a trajectory has failed; there is no constraint to drift from."""
        found = super().reports(states)
        return {"failure": found["failure"]}


@functools.cache
def definition(without: frozenset[str], constrained: bool = False) -> Callable[..., Mapping[str, Any]]:
    """Parameters a, b, c, d and ω to T, Q and, if constrained, f of the particle without some of `systems.EFFECTS`."""

    def system(a: Any, b: Any, c: Any, d: Any, omega: Any) -> Mapping[str, Any]:
        def kinetic(q: Any, v: Any, t: Any) -> Any:
            return 0.5 * (v[0] ** 2 + v[1] ** 2)

        def forces(q: Any, v: Any, t: Any) -> tuple[Any, Any]:
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

        def speed(q: Any, v: Any, t: Any) -> tuple[Any]:
            return (v[0] ** 2 + v[1] ** 2 - c - d * jnp.sin(t),)

        found = {"T": kinetic, "Q": forces, "coordinates": ("x1", "y1"), "period": 2 * math.pi / omega}
        return {**found, "f": speed} if constrained else found

    return system


def free_particle(
    a: float, b: float | None, omega: float, swept: str, without: frozenset[str] = frozenset()
) -> FreeParticle:
    """The particle of equation (1), lanes differing in a or b, without some of `systems.EFFECTS`."""
    parameters = {"a": a, "b": 0.0 if b is None else b, "c": 0.0, "d": 0.0, "omega": omega}
    made = nonholonomic_system(definition(without), parameters, swept)
    fields = (made.define, made.parameters, made.swept, made.names, made.constraints)
    return FreeParticle(*fields, made.period, made.angles, made.ignorable, without)
