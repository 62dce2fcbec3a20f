"""What a strobe map is: states and tangents over one period, whatever system and solver it has."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.section import SectionedFlow
from jaxnh.systems.lagrangian import NonholonomicSystem
from jaxnh.systems.particle import IsokineticParticle

System = IsokineticParticle | NonholonomicSystem | SectionedFlow
"""Systems have the same section: `dimension`, `exponents`, `chart`, `unchart`, `wrap` and so on."""


def swept_name(system: System) -> str:
    """Name of the parameter that differs from lane to lane."""
    return system.sweeps.rsplit(" ", 1)[-1]


class Tangent(NamedTuple):
    """A direction in phase and parameter space: δ(q, n) as a state, and δb, each component of shape ().

    Without δb nothing of the derivative in b is computed.
    """

    state: Any
    b: ArrayLike | None = None


class Pushed(NamedTuple):
    """Result of `Strobe.push`.

    Attributes:
        state: the state later.
        tangents: the tangents later, in the order given.
        volume: determinant of the derivative of the section coordinates, of (x1, y1, θ) exp(−∫ n·F/s dt).
    """

    state: Any
    tangents: tuple[Tangent, ...]
    volume: Array


class Strobe(eqx.Module):
    """P(z; b) for one lane: state and b in, the state one period later out. Use under `jax.vmap`."""

    system: eqx.AbstractVar[Any]

    @property
    def most_lanes(self) -> int | None:
        """Lanes a tile at most, where more would be slower."""
        return None

    @abc.abstractmethod
    def __call__(self, state: Any, b: ArrayLike) -> Any:
        """The state one strobe period later."""

    @abc.abstractmethod
    def push(self, state: Any, b: ArrayLike, tangents: tuple[Tangent, ...]) -> Pushed:
        """The state and any number of tangents one strobe period later, exact derivatives of `__call__`."""

    def stretched(self, factor: ArrayLike) -> Strobe:
        """The map over so many times the time, of a system without a clock; of maps of one step alone."""
        raise NotImplementedError
