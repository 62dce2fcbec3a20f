"""Levels of integrals: a system that keeps one, as its energy, is seen on a level of it as on a constraint.

The level is one parameter more. Steps leave it by the error of the method; projection goes back by a common factor of
the velocities. Maps then have a derivative by the level, periodic orbits are isolated on it, and the exponent zero of
motions to other levels is none of the spectrum's.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from jax.typing import ArrayLike

from jaxnh.systems.definition import Definition
from jaxnh.systems.flow import Flow
from jaxnh.systems.lagrangian import Lagrangian

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
