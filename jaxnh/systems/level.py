"""Levels of integrals: a system that keeps one, as its energy, is seen on a level of it as on a constraint.

The level is one parameter more. Steps leave it by the error of the method; projection goes back by a common factor of
the velocities. Maps then have a derivative by the level, periodic orbits are isolated on it, and the exponent zero of
motions to other levels is none of the spectrum's.

Volume and area: the divergence tells how volume grows, off f = 0, norms and levels as well, tangents of motions that
keep them how an area does. As the field keeps these functions F, area over √det(F′F′ᵀ) grows as volume does.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.systems.definition import Definition
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.motion import Motion

AnyFlow = TypeVar("AnyFlow", bound=Flow)


@dataclass(frozen=True)
class _WithLevel:
    """A definition that takes the level of an integral beside its own parameters.

    Attributes:
        define: parameters by name to the definition.
        name: of the integral.
    """

    define: Callable[..., Definition]
    name: str

    def __call__(self, **parameters: Any) -> Definition:
        return self.define(**{name: value for name, value in parameters.items() if name != self.name})


def on_level(flow: AnyFlow, levels: Mapping[str, ArrayLike], swept: Collection[str] = ()) -> AnyFlow:
    """Return a system of mechanics on the level of an integral, by name, which lanes have of their own if it is swept.

    Without levels it is returned as it is, and may be any.
    """
    for name, value in levels.items():
        assert isinstance(flow, Lagrangian)
        own = flow.of_lanes if flow.of_lanes is None or name not in swept else (*flow.of_lanes, name)
        values = {**flow.values, name: value}
        flow = replace(flow, define=_WithLevel(flow.define, name), values=values, of_lanes=own, level=name)
    return flow


def off_level(flow: AnyFlow) -> AnyFlow:
    """Return a system on no level, whose states are any."""
    return replace(flow, level=None) if isinstance(flow, Lagrangian) and flow.level else flow


def constraint_gradients(flow: Lagrangian, y: Motion, p: Parameters) -> Float[Array, "m dimension"]:
    """Derivatives by section coordinates, at t = 0, of all that motions keep: f, norms and the level's integral."""
    norms = [group for group in flow.norms if not all(flow.ignorable[i] for i in group)]

    def kept(u: Float[Array, " dimension"]) -> Float[Array, " m"]:
        z = flow.chart.state(tuple(u))
        values = [*flow.residuals(0.0, z, p)[: flow.constraints], *(sum(z.q[i] * z.q[i] for i in g) for g in norms)]
        return jnp.stack(values if flow.level is None else [*values, flow.integral(flow.level, 0.0, z, p)])

    return jax.jacfwd(kept)(jnp.stack(flow.chart.components(y)))


def log_area(flow: Lagrangian, gradients: Float[np.ndarray, "lanes m dimension"]) -> Float[np.ndarray, " lanes"]:
    """Logarithm of the area on f = 0, norms and level over the volume that the divergence is of, ln √det(F′F′ᵀ).

    Where steps carry the free velocities alone, the volume is of these: over |det ∂f/∂w|, w the other velocities.
    """
    logs = 0.5 * np.linalg.slogdet(gradients @ gradients.swapaxes(-1, -2))[1]
    if flow.explicit is None:
        return logs
    given = [flow.chart.positions + j for j in flow.explicit.given]
    return logs - np.linalg.slogdet(gradients[:, : flow.constraints, given])[1]
